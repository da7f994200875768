"""The worst device that the tolerances allow: the extremes of a measure over the box of all deviations.

One-at-a-time sensitivities are wrong where a component pulls both ways through a shared lot, where the
extreme lies inside the box, and where two components must move together. So: vertices that gradients point
to, from several starts, again until nothing changes; a bounded search from the best of them, which may end
inside; and all corners of the few variables that matter most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.types import Array

__all__ = ["Extreme", "extremes"]

Measure = Callable[[Array], Array]
#: Share of a variable's range by which a gradient is taken.
_STEP = 1e-3
_ROUNDS, _CLIMBS = 6, 15
#: Slopes below this share of the largest are rounding: which way they point means nothing.
_NOISE = 1e-6
#: Variables of which all corners are looked at.
_ALL_CORNERS = 6


@dataclass(frozen=True)
class Extreme:
    """An extreme of a measure: its value, where it is in units of the box (-1 to 1), and evaluations."""

    value: float
    point: Array
    evaluations: int


def extremes(measure: Measure, variables: int, starts: Sequence[Array] = ()) -> tuple[Extreme, Extreme]:
    """Return the least and the largest value of a measure over [-1, 1]^variables.

    Parameters
    ----------
    measure
        Values (n,) of points (n, variables); NaN where there is none.
    variables
        Dimension.
    starts
        Points to begin at beside the middle: the worst samples.
    """
    known = _Known(measure)
    least = _largest(_Search(known, variables, -1.0), starts)
    most = _largest(_Search(known, variables, 1.0), starts)
    return (
        Extreme(-least.value, least.best, known.count),
        Extreme(most.value, most.best, known.count),
    )


class _Known:
    """The measure, with the slopes that were already taken; both extremes use them."""

    def __init__(self, measure: Measure) -> None:
        self._measure, self.count = measure, 0
        self._slopes: dict[bytes, tuple[float, Array]] = {}

    def values(self, points: Array) -> Array:
        self.count += len(points)
        return np.asarray(self._measure(points), dtype=float)

    def slopes(self, at: Array) -> tuple[float, Array]:
        """Return value and slope along each variable, by a step to the side where there is room."""
        name = at.tobytes()
        if name not in self._slopes:
            step = np.where(at > 0.0, -_STEP, _STEP)
            values = self.values(np.vstack([at, at + np.diag(step)]))
            with np.errstate(invalid="ignore"):
                slopes = (values[1:] - values[0]) / step
            slopes = np.where(np.isfinite(slopes), slopes, 0.0)
            slopes[np.abs(slopes) < _NOISE * np.abs(slopes).max(initial=0.0)] = 0.0
            self._slopes[name] = float(values[0]), slopes
        return self._slopes[name]


class _Search:
    """The best point so far, upwards or, with `sign` -1, downwards."""

    def __init__(self, known: _Known, variables: int, sign: float) -> None:
        self._known, self._sign = known, sign
        self.variables, self.best, self.value = variables, np.zeros(variables), -np.inf
        self.settled = False

    def look(self, points: Array) -> Array:
        values = self._sign * self._known.values(points)
        values = np.where(np.isfinite(values), values, -np.inf)
        self._keep(points, values)
        return values

    def _keep(self, points: Array, values: Array) -> None:
        k = int(np.argmax(values))
        if values[k] > self.value:
            self.value, self.best, self.settled = float(values[k]), points[k].copy(), False

    def gradient(self, at: Array) -> Array:
        value, slopes = self._known.slopes(at)
        if np.isfinite(value):
            self._keep(at[None, :], np.array([self._sign * value]))
        return self._sign * slopes

    def vertices(self, start: Array) -> None:
        """Go where the gradient points, to the end of the box, until it points there already."""
        at = start
        for _ in range(_ROUNDS):
            there = np.where(self.gradient(at) >= 0.0, 1.0, -1.0)
            if np.array_equal(there, at):
                # every slope points out of the box: no small step from here goes further up
                self.settled = self.settled or np.array_equal(at, self.best)
                return
            # the corner, and half-way to it: an extreme inside the box lies between
            self.look(np.vstack([there, 0.5 * (at + there)]))
            at = there

    def corners(self, few: NDArray[np.intp]) -> None:
        """Look at all corners of a few variables, the others as at the best point."""
        signs = np.array(list(product((-1.0, 1.0), repeat=len(few))))
        points = np.tile(self.best, (len(signs), 1))
        points[:, few] = signs
        self.look(points)

    def climb(self) -> None:
        """Climb from the best point and from half-way to the middle, within the box."""
        scale = max(abs(self.value), 1e-300)
        for start in (self.best, 0.5 * self.best):
            scipy.optimize.minimize(
                lambda x: -float(self.look(x[None, :])[0]) / scale,
                start,
                jac=lambda x: -self.gradient(np.array(x)) / scale,
                method="L-BFGS-B",
                bounds=[(-1.0, 1.0)] * self.variables,
                options={"maxiter": _CLIMBS},
            )


def _largest(search: _Search, starts: Sequence[Array]) -> _Search:
    first = [np.zeros(search.variables), *(np.clip(start, -1.0, 1.0) for start in starts)]
    for start in first:
        search.vertices(start)
    search.corners(np.argsort(-np.abs(search.gradient(first[0])))[:_ALL_CORNERS])
    search.vertices(search.best)
    if not search.settled:
        search.climb()
        search.vertices(search.best)
    return search
