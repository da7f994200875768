"""Slips of the pen that ngspice passes over, reports without a line, or dies of."""

from cosim.errors import Problem
from cosim.ngspice.lines import Line, tokens

__all__ = ["malformed"]

_PAIRS = {"}": "{", ")": "(", "]": "["}


def malformed(line: Line) -> Problem | None:
    """Return what is wrong with the form of a statement, or ``None``.

    A resistor without a value is 1 mOhm to ngspice; of an open brace it does not say where; and an open
    parenthesis in a B source inside a subcircuit overwrites the stack of version 39.
    """
    reason = _unbalanced(line.text)
    words = tokens(line.text)
    if reason is None and line.keyword[:1] in ("r", "c", "l") and len(words) < 4:
        reason = "has no value" if len(words) == 3 else "needs two nodes and a value"
    return Problem(reason, file=line.file, line=line.lineno, value=line.text) if reason else None


def _unbalanced(text: str) -> str | None:
    opened: list[str] = []
    for c in text:
        if c in _PAIRS.values():
            opened.append(c)
        elif c in _PAIRS and (not opened or opened.pop() != _PAIRS[c]):
            return f"'{c}' closes nothing"
    return f"'{opened[-1]}' is not closed" if opened else None
