"""Typing errors that ngspice ignores, reports without a line, or crashes on."""

import re
from itertools import pairwise

from cosim.errors import Problem
from cosim.ngspice.lines import Line, number, strange_character, tokens

__all__ = ["balanced", "malformed"]

_PAIRS = {"}": "{", ")": "(", "]": "["}
_GLUED = re.compile(r"\}[\w.]")
_STRING = re.compile(r"=\s*\"")
_TEXT = re.compile(r"\btext:", re.IGNORECASE)
_PWL = re.compile(r"\bpwl\s*\(([^()]*)\)", re.IGNORECASE)
_NAME = re.compile(r"[a-z_]\w*", re.IGNORECASE)
_APART = re.compile(r"(?:t|g|meg|k|mil|m|u|µ|μ|n|p|f)(?:ohms?|Ω|f|h|hz|v|a|s)?", re.IGNORECASE)
"""A scale, and a unit, that stand behind a blank: ngspice looks for a model or a parameter of that name."""
_BRACKETS = re.compile(r"[{}()\[\]]")


def malformed(line: Line) -> Problem | None:
    """Return what is wrong with the form of a statement, or ``None``.

    A resistor without a value is 1 mOhm to ngspice; of an open brace it does not say where; an open
    parenthesis in a B source inside a subcircuit overwrites the stack of version 39, which also crashes at a
    ``.csparam`` without a value, a ``.model`` without a type and a ``pwl()`` of one number. A string is put
    in for a parameter after all checks, so that it could stand for anything.
    """
    words = tokens(line.text)
    reason = (
        strange_character(line.text)
        or line.fault
        or _unbalanced(line.text)
        or _statement(line.keyword, words)
        or _strings(line)
        or _scale_apart(line.keyword, words)
    )
    if not reason and _GLUED.search(line.text):
        reason = "something stands directly behind '}': ngspice reads it as another value"
    if not reason and line.keyword[:1] in ("r", "c", "l") and len(words) < 4:
        reason = "has no value" if len(words) == 3 else "needs two nodes and a value"
    return Problem(reason, file=line.file, line=line.lineno, value=line.text) if reason else None


def balanced(text: str) -> bool:
    """Whether every brace, bracket and parenthesis has its counterpart."""
    return _unbalanced(text) is None


def _statement(keyword: str, words: list[str]) -> str | None:
    if keyword.startswith("+"):
        return "a continuation line without a line before it"
    if keyword in (".csparam", ".param", ".params"):
        wrong = [word for word in words[1:] or [""] if not all(word.partition("=")[::2])]
        if wrong and (keyword == ".csparam" or "=" in wrong[0] or len(words) == 1):
            return f"must be {keyword} name = value"
    if keyword == ".csparam" and len(words) != 2:
        return "must be .csparam name = value"
    if keyword == ".model":
        rest = "".join(words[2:3]) if "(" not in "".join(words[1:2]) else ""
        if len(words) < 3 or _NAME.match(rest) is None:
            return "must be .model name type (parameters), with the type as a plain word"
    if any(len(inside.replace(",", " ").split()) < 2 for inside in _PWL.findall(" ".join(words[3:]))):
        return "pwl() needs at least two numbers"
    return None


def _scale_apart(keyword: str, words: list[str]) -> str | None:
    """Return which number has its scale behind a blank."""
    parameters = keyword in (".param", ".params", ".csparam")
    if not parameters and keyword[:1] not in ("r", "c", "l"):
        return None
    for value, behind in pairwise(words[1:] if parameters else words[3:5]):
        written = value.partition("=")[2] if parameters else value
        if _APART.fullmatch(behind) and number(written) is not None and written[-1:].isdigit():
            return f"{written} {behind}: a blank stands before the scale; write {written}{behind}"
    return None


def _strings(line: Line) -> str | None:
    """Refuse a parameter whose value is a string."""
    if line.keyword[:1] != "x" and line.keyword not in (".param", ".params", ".csparam", ".subckt"):
        return None
    if _STRING.search(line.text) or _TEXT.search(line.text):
        return "a parameter whose value is a string is not allowed (--trust allows it)"
    return None


def _unbalanced(text: str) -> str | None:
    opened: list[str] = []
    for match in _BRACKETS.finditer(text):
        c = match[0]
        if c not in _PAIRS:
            opened.append(c)
        elif not opened or opened.pop() != _PAIRS[c]:
            return f"'{c}' closes nothing"
    return f"'{opened[-1]}' is not closed" if opened else None
