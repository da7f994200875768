"""Arithmetic of plain parameters: what a condition or a value comes to before ngspice sees it."""

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from cosim.ngspice.lines import number

__all__ = ["evaluate", "is_well_formed", "reduce", "split"]

_WORD = re.compile(r"\s*(\d[\w.]*(?:(?<=[eE])[-+]\d+)?|\.\d[\w.]*|[A-Za-z_]\w*|\|\||&&|[!()*/+-])")
_RANK = {"||": 1, "&&": 2, "+": 3, "-": 3, "*": 4, "/": 4, "!": 5, "neg": 5}
_BINARY: dict[str, Callable[[float, float], float]] = {
    "||": lambda a, b: float(bool(a) or bool(b)), "&&": lambda a, b: float(bool(a) and bool(b)),
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip


def evaluate(text: str, known: Mapping[str, float]) -> float | None:
    """Return the value of an expression of numbers, names, ``+ - * / ! && ||`` and parentheses.

    ``None`` where it holds anything else, an unknown name, or a value that is not finite. The time it takes
    is linear in its length, however deep its parentheses are.
    """
    words = split(text)
    value = None if words is None else reduce(words, known)
    return value if value is not None and math.isfinite(value) else None


def reduce(words: Sequence[str], known: Mapping[str, Any]) -> Any:
    """Return the value of an expression in words, in the arithmetic of `known`; ``None`` if malformed."""
    values: list[Any] = []
    waiting: list[str] = []
    operand = True  # whether a value is due
    try:
        for word in words:
            if word == "(" or (operand and word in "!-"):
                if not operand:
                    return None
                waiting.append("neg" if word == "-" else word)
            elif operand and word == "+":
                continue
            elif operand:
                value = known.get(word.lower(), number(word))
                if value is None or word == ")":
                    return None
                values.append(value)
                operand = False
            elif word == ")":
                while waiting and waiting[-1] != "(":
                    _apply(waiting.pop(), values)
                if not waiting:
                    return None
                waiting.pop()
            elif word in _RANK and word != "!":
                while waiting and _RANK.get(waiting[-1], 0) >= _RANK[word]:
                    _apply(waiting.pop(), values)
                waiting.append(word)
                operand = True
            elif not operand:
                return None
        if operand or "(" in waiting:
            return None
        while waiting:
            _apply(waiting.pop(), values)
    except (ZeroDivisionError, OverflowError):
        return None
    return values[0] if len(values) == 1 else None


def is_well_formed(text: str) -> bool:
    """Whether an expression of the kind that `evaluate` knows is complete, its names all being known."""
    words = split(text)
    if words is None:
        return True  # another kind, which ngspice decides
    names = (word.lower() for word in words if word[0].isalpha() or word[0] == "_")
    return evaluate(text, {name: math.sqrt(2 + k) for k, name in enumerate(names)}) is not None


@lru_cache(maxsize=10_000)  # a parameter is evaluated until no value changes
def split(text: str) -> tuple[str, ...] | None:
    """Return the words of an expression; ``None`` where it holds what is not known here."""
    words, at = list[str](), 0
    text = text.strip()
    while at < len(text):
        match = _WORD.match(text, at)
        if match is None:
            return None
        words.append(match[1])
        at = match.end()
    return tuple(words)


def _apply(sign: str, values: list[float]) -> None:
    last = values.pop()
    if sign == "neg":
        values.append(-last)
    elif sign == "!":
        values.append(float(not last))
    else:
        values.append(_BINARY[sign](values.pop(), last))
