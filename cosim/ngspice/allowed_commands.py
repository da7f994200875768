"""The only way to send ngspice a command: one of a list, numbers as numbers, names as aliases."""

from __future__ import annotations

import math
import re

from cosim.errors import fail
from cosim.ngspice.aliases import Aliases
from cosim.ngspice.lines import number

__all__ = ["end_and_aim_s", "spelled"]

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?[a-z]{0,5}", re.IGNORECASE | re.ASCII)
_WORD = re.compile(r"[a-z]\w*", re.IGNORECASE | re.ASCII)
_SWEEPS = frozenset({"dec", "oct", "lin"})
_FIXED = frozenset(
    "op|run|reset|resume|status|remcirc|destroy|destroy all|delete all|rusage equations|set nomoremode"
    "|unset ngbehavior".split("|")
)
_ASSIGNED = re.compile(r"(\S+?)\s*=\s*(.+)")
_READING = re.compile(r"@(.+)\[(\w+)\]", re.ASCII)
_BEHAVIOUR = re.compile(r"set ngbehavior=[a-z]+")
_PLOT = re.compile(r"setplot (?:const|(?:op|ac|dc|tran|noise)\d+)")
_DELETE = re.compile(r"delete \d+")
_STOP = re.compile(r"stop when time > -?[\d.]+(?:e[-+]?\d+)?")


def spelled(command: str, aliases: Aliases) -> str:
    """Return a command as ngspice gets it.

    Parameters
    ----------
    command
        With the user's names.
    aliases
        Of the deck that is loaded.

    Raises
    ------
    ValueError
        For what is not one of the commands that may be sent.
    InputError
        For a name that nothing in the deck has.
    """
    words = command.split()
    if not words or command.strip("\r\n") != command or not command.isprintable():
        raise ValueError(f"not one ngspice command: {command!r}")
    text = " ".join(words)
    fixed = (text in _FIXED, *(form.fullmatch(text) for form in (_BEHAVIOUR, _PLOT, _DELETE, _STOP)))
    if any(fixed):
        return text
    writer = _WRITERS.get(words[0])
    if writer is None:
        raise ValueError(f"not a command that is sent to ngspice: {command!r}")
    return " ".join([words[0], *writer(words[1:], aliases)])


def _refuse(what: str) -> ValueError:
    return ValueError(f"not allowed in a command to ngspice: {what!r}")


def _number(word: str) -> str:
    if not _NUMBER.fullmatch(word):
        raise _refuse(word)
    return word


def _element(name: str, aliases: Aliases) -> str:
    path = aliases.element_path(name)
    if path is None:
        fail("the circuit has no such element", key=name)
    return path


def _voltage(word: str, aliases: Aliases) -> str:
    """Write ``v(node)`` or ``v(node,node)``, or a current ``source#branch``."""
    if word.lower().startswith("v(") and word.endswith(")"):
        inner = word[2:-1]
        names = [inner] if aliases.node_path(inner) else inner.split(",")
        nodes = [aliases.node_path(name) or aliases.node(name) for name in names]
        return f"v({','.join(nodes)})"
    vector = aliases.vector(word) if word.lower() != "all" else "all"
    if vector is None:
        fail("the circuit has no such node or source", key=word)
    return vector


def _target(words: list[str], aliases: Aliases) -> list[str]:
    """Write an element, one of its parameters, or ``@element[parameter]``."""
    reading = _READING.fullmatch(words[0])
    if reading is not None and len(words) == 1:
        return [f"@{_element(reading[1], aliases)}[{reading[2]}]"]
    if len(words) > 2 or not all(_WORD.fullmatch(word) for word in words[1:]):
        raise _refuse(" ".join(words))
    return [_element(words[0], aliases), *words[1:]]


def _alter(words: list[str], aliases: Aliases) -> list[str]:
    if "=" not in words:
        raise _refuse(" ".join(words))
    at = len(words) - 1 - words[::-1].index("=")
    values = words[at + 1 :]
    if values[:1] == ["["] and values[-1:] == ["]"]:
        shown = ["[", *map(_number, values[1:-1]), "]"]
    elif len(values) == 1:
        shown = [_number(values[0])]
    else:
        raise _refuse(" ".join(words))
    return [*_target(words[:at], aliases), "=", *shown]


def _alter_parameter(words: list[str], aliases: Aliases) -> list[str]:
    match = _ASSIGNED.fullmatch(" ".join(words))
    if match is None or not _WORD.fullmatch(match[1].lstrip("_")):
        raise _refuse(" ".join(words))
    return [match[1], "=", _number(match[2])]


def _save(words: list[str], aliases: Aliases) -> list[str]:
    return [_voltage(word, aliases) for word in words]


def _print(words: list[str], aliases: Aliases) -> list[str]:
    if len(words) != 1:
        raise _refuse(" ".join(words))
    return _target(words, aliases) if words[0].startswith("@") else [_voltage(words[0], aliases)]


def _noise(words: list[str], aliases: Aliases) -> list[str]:
    if len(words) < 3:
        raise _refuse(" ".join(words))
    return [_voltage(words[0], aliases), _element(words[1], aliases), *_sweep(words[2:], aliases)]


def _sweep(words: list[str], aliases: Aliases) -> list[str]:
    if not words or words[0].lower() not in _SWEEPS:
        raise _refuse(" ".join(words))
    return [words[0], *map(_number, words[1:])]


def _dc(words: list[str], aliases: Aliases) -> list[str]:
    out: list[str] = []
    for k, word in enumerate(words):
        out.append(_number(word) if k % 4 else _element(word, aliases))
    return out


def _transient(words: list[str], aliases: Aliases) -> list[str]:
    last = words[-1:] if words[-1:] == ["uic"] else []
    return [*map(_number, words[: len(words) - len(last)]), *last]


_WRITERS = {
    "ac": _sweep, "alter": _alter, "alterparam": _alter_parameter, "dc": _dc, "noise": _noise,
    "print": _print, "save": _save, "tran": _transient,
}  # fmt: skip


def end_and_aim_s(command: str) -> tuple[float, float]:
    """Return the time [s] at which a ``tran`` command ends and where its last step aims; infinity for others.

    The aim is four roundings short, since ngspice 44's reading of the end may be one below ours; but not
    where ngspice's least step, 1e-11 of its longest, is less: there it would not take that for the end.
    """
    words = command.split()
    if len(words) < 3 or words[0].lower() != "tran":
        return math.inf, math.inf
    step, end, begin, longest = ([number(word) or 0.0 for word in words[1:5] if word != "uic"] + [0.0, 0.0])[
        :4
    ]
    longest = longest or min(step, (end - begin) / 50.0)
    short = 4.0 * 2.0**-52 * end
    return end or math.inf, (end - short if short < 1e-11 * longest else end) or math.inf
