"""Preferred values of IEC 60063: what can be bought."""

from __future__ import annotations

import math

__all__ = ["SERIES", "preferred"]

_E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0,
    3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1,
)  # fmt: skip


def _fine(count: int) -> tuple[float, ...]:
    """Return a series of three digits; 9.19 is E192's only value that is not the rounded power."""
    values = [round(10.0 ** (k / count), 2) for k in range(count)]
    return tuple(9.2 if value == 9.19 else value for value in values)


SERIES: dict[str, tuple[float, ...]] = {
    "E6": _E24[::4], "E12": _E24[::2], "E24": _E24, "E48": _fine(48), "E96": _fine(96), "E192": _fine(192),
}  # fmt: skip


def preferred(value: float, series: str) -> float:
    """Return the preferred value nearest to a positive value, by ratio."""
    decade = 10.0 ** math.floor(math.log10(value))
    choices = [decade * each for each in (*SERIES[series], 10.0)]
    best = min(choices, key=lambda each: abs(math.log(each / value)))
    return float(f"{best:.6g}")
