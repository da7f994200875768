"""Functions of PSpice and LTspice in formulas of sources that ngspice lacks or reads otherwise.

``table(x, x1, y1, ...)`` is linear between its points and constant outside them, and its points may be
voltages: ngspice's ``pwl`` takes numbers only and goes on along its last slope. In the mode for LTspice,
ngspice 39's ``pwr`` keeps the sign of its first argument and ``pwrs`` loses it.
"""

import re
from collections.abc import Callable, Collection, Sequence

from cosim.ngspice.dialect import Dialect
from cosim.ngspice.expression_names import arguments

__all__ = ["in_own_words"]

_LONGEST, _DEEPEST = 20_000, 20
"""Letters of a formula, for tables within tables grow by a power of their lengths, and calls within calls.

Beyond them a formula stays as it is.
"""


def _table(x: str, *points: str) -> str:
    if len(points) < 2 or len(points) % 2:
        raise ValueError(points)
    xs, ys = points[::2], points[1::2]
    text = ys[-1]
    for k in range(len(xs) - 2, -1, -1):
        slope = f"({ys[k + 1]}-{ys[k]})/({xs[k + 1]}-{xs[k]})"
        text = f"({x}<{xs[k + 1]} ? {ys[k]}+({x}-{xs[k]})*{slope} : {text})"
        if len(text) > _LONGEST:
            raise ValueError(len(text))
    return f"({x}<{xs[0]} ? {ys[0]} : {text})"


_EVERYWHERE: dict[str, Callable[..., str]] = {
    "table": _table,
    "arcsin": lambda x: f"asin({x})",
    "arccos": lambda x: f"acos({x})",
    "arctan": lambda x: f"atan({x})",
    "hypot": lambda x, y: f"sqrt({x}*{x}+{y}*{y})",
}
_LTSPICE: dict[str, Callable[..., str]] = {
    "buf": lambda x: f"({x}>0.5 ? 1 : 0)",
    "inv": lambda x: f"({x}>0.5 ? 0 : 1)",
    "int": lambda x: f"(sgn({x})*floor(abs({x})))",
    "round": lambda x: f"floor({x}+0.5)",
    "square": lambda x: f"({x}*{x})",
    "pwr": lambda x, y: f"pow(abs({x}),{y})",
    "pwrs": lambda x, y: f"(sgn({x})*pow(abs({x}),{y}))",
}
_CALL = re.compile(rf"(?<![\w.])({'|'.join((*_EVERYWHERE, *_LTSPICE))})\s*\(", re.IGNORECASE)
_FORMULA = re.compile(r"b|[eg].*(?:value\b|=|\{)|[rcvi].*[={]", re.IGNORECASE)


def in_own_words(text: str, dialect: Dialect, defined: Collection[str]) -> str:
    """Return a statement with what ngspice knows in place of the dialect's own functions.

    `defined` are functions that the file itself defines. A call with other arguments than the function takes
    stays as it is, so that ngspice names it.
    """
    if len(text) > _LONGEST or not _FORMULA.match(text):
        return text
    known = {**_EVERYWHERE, **(_LTSPICE if dialect is Dialect.LTSPICE else {})}
    return _rewritten(text, {name: call for name, call in known.items() if name not in defined})


def _rewritten(text: str, known: dict[str, Callable[..., str]], depth: int = 0) -> str:
    if depth > _DEEPEST:
        return text
    out, place = "", 0
    for match in _CALL.finditer(text):
        name = match[1].lower()
        if match.start() < place or name not in known:
            continue
        end = _closing(text, match.end())
        if end is None:
            break  # what follows is inside
        given = [_rewritten(each, known, depth + 1) for each in arguments(text[match.end() : end])]
        out += text[place : match.start()] + _called(known[name], given, text[match.start() : end + 1])
        place = end + 1
    return out + text[place:]


def _called(function: Callable[..., str], given: Sequence[str], written: str) -> str:
    try:
        text = function(*(each if re.fullmatch(r"[\w.]+", each) else f"({each})" for each in given))
    except (TypeError, ValueError):
        return written
    return text if len(text) <= _LONGEST else written


def _closing(text: str, start: int) -> int | None:
    """Return the place of the parenthesis that closes the one before `start`."""
    depth = 1
    for place in range(start, len(text)):
        depth += (text[place] == "(") - (text[place] == ")")
        if depth == 0:
            return place
    return None
