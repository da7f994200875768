"""Tolerances on a ``.model`` line, as PSpice writes them: ``.model rmod RES(R=1 DEV=1% LOT=5%)``.

There the R of a resistor's model (C of a capacitor's, L of an inductor's) is a factor of the value that each
element states, and DEV and LOT behind it are the deviations of that factor: one draw for each element, and
one for all that use the model. ngspice ignores both words, knows no CAP and IND, and has no such factor, so
that it gets the line without them; what they say is read from `Line.drawn`.

DEV and LOT are uniform unless ``/GAUSS`` stands behind the word: that is the standard deviation, drawn
within three of them (PSpice Reference Guide, ``.MODEL``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from cosim.ngspice.lines import Line, number, tokens

__all__ = ["Deviation", "as_elements_mean", "deviations", "without_tolerances"]

#: Type of a model, PSpice's and ngspice's -> ngspice's, whose letter is also the factor's name.
_TYPES = {"res": "r", "r": "r", "cap": "c", "c": "c", "ind": "l", "l": "l"}
#: Types that ngspice does not know: in their models it would take a factor for a value.
_PSPICE_ONLY = ("cap", "ind")
_MODEL = re.compile(
    r"(\.model\s+\S+(?:\s+ako:\s*\S+)?)\s+([a-z]\w*)\s*\(?(.*?)\)?\s*", re.IGNORECASE | re.DOTALL
)
_TOLERANCE = re.compile(
    r"(?<![\w.])(dev|lot)((?:\s*/\s*\w+)*)\s*[\s=]\s*(?=[-+.\d{])([^\s(),%]+(?:\s*%)?)", re.IGNORECASE
)
_MENTIONED = re.compile(r"(?<![\w.])(?:dev|lot)\s*(?:/|=|\s[\s=]*[-+.\d{])", re.IGNORECASE)
_SETTING = re.compile(r"(?<![\w.])(\w+)\s*=\s*([^\s(),]+)")
_SHAPES = {"": "uniform", "uniform": "uniform", "gauss": "gauss"}


@dataclass(frozen=True)
class Deviation:
    """One DEV or LOT of a factor: its `kind` in lower case, `shape` 'uniform' or 'gauss', `size` a share."""

    kind: str
    shape: str
    size: float


class _Wrong(Exception):
    """Why a tolerance cannot be drawn."""


def without_tolerances(line: Line) -> Line:
    """Return a ``.model`` statement as ngspice reads it, with a fault where its tolerances cannot be drawn.

    Tolerances of other parameters than the factor (a temperature coefficient, a transistor's gain) are left
    out with a note: nothing is drawn for them.
    """
    words = _MODEL.fullmatch(line.text)
    stated = words is not None and _MENTIONED.search(words[3]) is not None
    if words is None or not (stated or words[2].lower() in _PSPICE_ONLY):
        return line
    kind = _TYPES.get(words[2].lower(), "")
    try:
        other = [name for name, _ in _read(words[3]) if name != kind] if stated else []
        text = _plain(words[1], words[2], kind, words[3])
    except _Wrong as wrong:
        return replace(line, fault=str(wrong))
    if not stated:
        return line.rewritten(text)
    note = f"tolerances of {', '.join(dict.fromkeys(other))} are not drawn" if other else ""
    drawn = line.text if len(other) < len(list(_read(words[3]))) else line.drawn
    return replace(line, text=text, note="; ".join(filter(None, (line.note, note))), drawn=drawn)


def deviations(line: Line) -> tuple[Deviation, ...]:
    """Return the tolerances of the factor that a ``.model`` statement had; none where it had none."""
    words = _MODEL.fullmatch(line.drawn)
    if words is None:
        return ()
    kind = _TYPES.get(words[2].lower())
    return tuple(each for name, each in _read(words[3]) if name == kind)


def as_elements_mean(line: Line) -> Line:
    """Return a resistor, capacitor or inductor with its value before its model, where both stand there."""
    words = tokens(line.text)
    if words[0][0].lower() not in "rcl" or len(words) < 5:
        return line
    model, value = words[3:5]
    if _is_value(model) or "=" in model or not _is_value(value):
        return line
    return line.rewritten(" ".join([*words[:3], value, model, *words[5:]]))


def _is_value(word: str) -> bool:
    return number(word) is not None or word[0] in "{'"


def _plain(head: str, typed: str, kind: str, settings: str) -> str:
    """Return the statement without tolerances, and without a factor of 1."""
    rest = _TOLERANCE.sub(" ", settings)
    if kind:
        for name, value in _SETTING.findall(rest):
            if name.lower() == kind and number(value) != 1.0:
                raise _Wrong(
                    f"{name}={value} is a factor of every value in PSpice, and none in ngspice: write it "
                    f"into the values, and {name}=1 here"
                )
        rest = _SETTING.sub(lambda each: " " if each[1].lower() == kind else each[0], rest)
    left = ",".join(filter(None, (" ".join(part.split()) for part in rest.split(","))))
    return f"{head} {kind or typed}" + (f"({left})" if left else "")


def _read(settings: str) -> Iterator[tuple[str, Deviation]]:
    """Yield every tolerance with the parameter that it is of: the one before it."""
    tolerances = {match.start(): match for match in _TOLERANCE.finditer(settings)}
    bare = _TOLERANCE.sub(lambda match: " " * len(match[0]), settings)
    left = _MENTIONED.search(bare)
    if left is not None:
        raise _Wrong(f"{left[0].strip()} is no tolerance (allowed: DEV=1%, LOT/GAUSS=5%, after a parameter)")
    owners = {match.start(): match[1].lower() for match in _SETTING.finditer(bare)}
    owner, seen = "", set[tuple[str, str]]()
    for place in sorted({*tolerances, *owners}):
        if place in owners:
            owner = owners[place]
            continue
        deviation = _deviation(tolerances[place])
        if not owner or (owner, deviation.kind) in seen:
            why = "is stated twice" if owner else "stands behind no parameter"
            raise _Wrong(f"{tolerances[place][0].strip()} {why}")
        seen.add((owner, deviation.kind))
        yield owner, deviation


def _deviation(match: re.Match[str]) -> Deviation:
    written = match[0].strip()
    named = [word.strip().lower() for word in match[2].split("/")[1:]]
    if len(named) > 1 or (named and named[0] not in _SHAPES):
        raise _Wrong(
            f"{written}: {'/'.join(named)} is no shape that is drawn here (allowed: {match[1]}, "
            f"{match[1]}/UNIFORM, {match[1]}/GAUSS); what varies together stands behind a $: match=NAME"
        )
    size = number(match[3].removesuffix("%").strip())
    if size is None or not size > 0.0:
        raise _Wrong(f"{written} is no tolerance (allowed: a number above 0, in per cent or of the factor 1)")
    share = size / 100.0 if match[3].endswith("%") else size
    return Deviation(match[1].lower(), _SHAPES[named[0] if named else ""], share)
