"""Roots and minima on a line, by the two methods of R. P. Brent.

`scipy.optimize` has both, to the same last digit, and takes a fifth of the time of `cosim stability` for its
import.

References
----------
R. P. Brent, Algorithms for Minimization without Derivatives, Prentice-Hall 1973, chapters 4 and 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["minimum", "root"]

#: Steps before a search is given up; halving alone takes 1100 from the largest float to the smallest.
_MOST_STEPS = 500
#: The share of a bracket that golden section leaves out.
_GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
#: Of a place, where a parabola is flat to rounding: the root of the machine's precision.
_FLAT = math.sqrt(2.2e-16)


def root(
    function: Callable[[float], float], low: float, high: float, *, rtol: float = 4 * 2.0**-52, xtol: float
) -> float:
    """Return where a continuous function is zero between two points at which its signs differ.

    Parameters
    ----------
    rtol, xtol
        The root lies within `xtol` + `rtol` |root| of the answer.

    Raises
    ------
    ValueError
        Where the signs do not differ, or the function is no number.
    RuntimeError
        Where the steps do not end.

    Examples
    --------
    >>> round(root(lambda x: x * x - 2.0, 0.0, 2.0, xtol=1e-12), 9)
    1.414213562
    """

    def value(x: float) -> float:
        y = function(x)
        if math.isnan(y):
            raise ValueError(f"the function is no number at {x!r}")
        return y

    last, here = low, high  # the two newest points; `here` is the best, `far` has the other sign
    f_last, f_here = value(last), value(here)
    if f_last == 0.0:
        return last
    if f_here == 0.0:
        return here
    if (f_last < 0.0) == (f_here < 0.0):
        raise ValueError(f"the function has the same sign at {low!r} and {high!r}")
    far = f_far = step = before = 0.0
    for _ in range(_MOST_STEPS):
        if f_last != 0.0 and f_here != 0.0 and (f_last < 0.0) != (f_here < 0.0):
            far, f_far = last, f_last
            step = before = here - last
        if abs(f_far) < abs(f_here):
            last, here, far = here, far, here
            f_last, f_here, f_far = f_here, f_far, f_here
        least = 0.5 * (xtol + rtol * abs(here))
        half = 0.5 * (far - here)
        if f_here == 0.0 or abs(half) < least:
            break
        tried = math.inf
        if abs(before) > least and abs(f_here) < abs(f_last):
            if last == far:  # a straight line through two points
                tried = -f_here * (here - last) / (f_here - f_last)
            else:  # the inverse of a parabola through three
                to_last, to_far = (f_last - f_here) / (last - here), (f_far - f_here) / (far - here)
                below = to_far * to_last * (f_far - f_last)
                if below != 0.0:
                    tried = -f_here * (f_far * to_far - f_last * to_last) / below
        if 2.0 * abs(tried) < min(abs(before), 3.0 * abs(half) - least):
            before, step = step, tried
        else:
            before = step = half
        last, f_last = here, f_here
        here += step if abs(step) > least else math.copysign(least, half)
        f_here = value(here)
    else:
        raise RuntimeError(f"no root was found between {low!r} and {high!r}")
    return here


def minimum(
    function: Callable[[float], float], low: float, high: float, *, xtol: float
) -> tuple[float, float]:
    """Return where a function with one minimum between two points has it, and its value there.

    Parameters
    ----------
    xtol
        How near the place is to be; half of the digits of a float at best, where a parabola is flat.

    Examples
    --------
    >>> place, value = minimum(lambda x: (x - 1.0) ** 2 + 3.0, 0.0, 3.0, xtol=1e-9)
    >>> round(place, 6), value
    (1.0, 3.0)
    """
    best = second = third = low + _GOLDEN * (high - low)
    f_best = f_second = f_third = function(best)
    step = before = 0.0
    for _ in range(_MOST_STEPS):
        middle = 0.5 * (low + high)
        least = _FLAT * abs(best) + xtol / 3.0
        if not abs(best - middle) > 2.0 * least - 0.5 * (high - low):
            break
        by_parabola = False
        if abs(before) > least:
            r, q = (best - second) * (f_best - f_third), (best - third) * (f_best - f_second)
            p, q = (best - third) * q - (best - second) * r, 2.0 * (q - r)
            p, q = (-p if q > 0.0 else p), abs(q)
            r, before = before, step
            # inside the bracket, and half of the step before the last at most
            by_parabola = abs(p) < abs(0.5 * q * r) and q * (low - best) < p < q * (high - best)
            if by_parabola:
                step = p / q
                if best + step - low < 2.0 * least or high - (best + step) < 2.0 * least:
                    step = least if middle >= best else -least
        if not by_parabola:
            before = low - best if best >= middle else high - best
            step = _GOLDEN * before
        place = best + (max(abs(step), least) if step >= 0.0 else -max(abs(step), least))
        f_place = function(place)
        if f_place <= f_best:
            low, high = (best, high) if place >= best else (low, best)
            third, f_third, second, f_second = second, f_second, best, f_best
            best, f_best = place, f_place
        else:
            low, high = (place, high) if place < best else (low, place)
            if f_place <= f_second or second == best:
                third, f_third, second, f_second = second, f_second, place, f_place
            elif f_place <= f_third or third in (best, second):
                third, f_third = place, f_place
    return best, f_best
