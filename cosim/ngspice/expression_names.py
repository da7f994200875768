"""Expressions of a netlist, taken apart as far as they name nodes and elements.

Only ``v(...)`` and ``i(...)`` hold names (an argument of a ``.func`` is none to ngspice there either). All
else is numbers, operators, and words of letters and digits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

__all__ = ["Name", "Refused", "arguments", "checked", "is_name", "parts"]

_TOKEN = re.compile(
    r"(?:\d[\w.]*|\.\d\w*)"  # a number with its scale and unit
    r"|(?P<word>[A-Za-z_]\w*)(?P<call>\s*\()?"
    r"|[-+*/^%!<>=&|?:,()\[\]{}'~. \t]",
    re.ASCII,
)
_SIMPLE = re.compile(r"[\w+\-.{}=]*", re.ASCII)
_UNITS = {"\u00b5": "u", "\u2126": "", "\u03a9": "", "\u00b0": ""}
"""Signs in numbers: micro, and units, which mean nothing to ngspice."""
_ACCESS = {"v": False, "i": True}
"""Functions of nodes and of elements."""
_NOT_IN_NAMES = re.compile(r"[\s{}='\",;]")
_LONGEST = 500


class Refused(ValueError):
    """Why a statement is not handed to ngspice."""


@dataclass(frozen=True)
class Name:
    """A node, or an element, that an expression speaks of."""

    text: str
    is_element: bool = False


def checked(name: str) -> str:
    """Return `name` if it can be one of a node, element, subcircuit or model."""
    if not name or _NOT_IN_NAMES.search(name) or not name.isprintable():
        raise Refused(f"{name!r} is not a name")
    if len(name) > _LONGEST:
        raise Refused(f"a name of {len(name)} letters is too long")
    return name


def is_name(text: str) -> bool:
    """Return whether `text` can be the name of a node or an element."""
    try:
        return bool(checked(text))
    except Refused:
        return False


def arguments(text: str, *, blanks: bool = False) -> list[str]:
    """Split at commas (and blanks) outside parentheses."""
    words, depth, start = [], 0, 0
    for k, c in enumerate(text):
        depth += (c in "({[") - (c in ")}]")
        if depth == 0 and (c == "," or (blanks and c.isspace())):
            words.append(text[start:k].strip())
            start = k + 1
    return [*words, text[start:].strip()]


def parts(text: str) -> list[str | Name]:
    """Return an expression in pieces, its names apart.

    Raises
    ------
    Refused
        For a character that no expression holds.
    """
    if _SIMPLE.fullmatch(text):
        return [text]
    out: list[str | Name] = []
    place = 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None and text[place] in _UNITS:
            out.append(_UNITS[text[place]])
            place += 1
            continue
        if match is None:
            raise Refused(f"{text[place]!r} is not allowed in an expression")
        place = match.end()
        out.append(match[0])
        role = _ACCESS.get(match["word"].lower()) if match["call"] else None
        if role is None:
            continue
        end = _closing(text, place)
        for k, each in enumerate(arguments(text[place:end])):
            out += [","] if k else []
            out.append(Name(checked(each), role))
        place = end
    return out


def _closing(text: str, start: int) -> int:
    """Return the place of the parenthesis that closes the one before `start`."""
    depth = 1
    for place in range(start, len(text)):
        depth += (text[place] == "(") - (text[place] == ")")
        if depth == 0:
            return place
    raise Refused("'(' is not closed")
