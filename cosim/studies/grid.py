"""Grids of studies: values that print as short decimals, 20.3 ms and not 20.299999999999997.

Inputs (a point of a grid, a period in milliseconds) are rounded to 12 digits when they are made, so that
table, file and computation hold the same short number. Results are never rounded.
"""

from __future__ import annotations

import numpy as np

from cosim.types import Array

__all__ = ["decimal", "even", "geometric", "milli", "percent", "steps"]


#: Four digits fewer than a double holds: coarser than rounding of a sum or product, finer than any tolerance.
_DIGITS = 12


def decimal(value: float) -> float:
    """Return a value rounded to 12 significant digits.

    Examples
    --------
    >>> decimal(0.1 + 0.2)
    0.3
    """
    return float(f"{value:.{_DIGITS}g}")


def milli(value: float) -> float:
    """Return a stated value in thousandths of its unit: 20.3 [ms] for 0.0203 [s].

    Examples
    --------
    >>> milli(0.0203)
    20.3
    """
    return decimal(1e3 * value)


def percent(share: float) -> float:
    """Return a stated share in per cent: 7 for 0.07, which times 100 is 7.000000000000001.

    Examples
    --------
    >>> percent(0.07)
    7.0
    """
    return decimal(100.0 * share)


def even(low: float, high: float, count: int) -> Array:
    """Return `count` values at even distances, both ends among them; shape (count,), unit of the ends.

    Examples
    --------
    >>> even(0.0, 0.3, 4).tolist()
    [0.0, 0.1, 0.2, 0.3]
    """
    return _decimals(np.linspace(low, high, count))


def geometric(low: float, high: float, count: int) -> Array:
    """Return `count` values at even ratios, both ends among them; shape (count,), unit of the ends.

    Examples
    --------
    >>> geometric(1.0, 100.0, 3).tolist()
    [1.0, 10.0, 100.0]
    """
    return _decimals(np.geomspace(low, high, count))


def steps(end: float, step: float) -> Array:
    """Return 0, step, 2 step, ... below `end`; shape (ceil(end/step),), unit of both."""
    return _decimals(np.arange(0.0, end, step))


def _decimals(values: Array) -> Array:
    return np.array([decimal(value) for value in values])
