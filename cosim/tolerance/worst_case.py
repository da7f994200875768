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
from numpy.typing import NDArray
from scipy.optimize import minimize

__all__ = ["Extreme", "extremes"]

Array = NDArray[np.float64]
Measure = Callable[[Array], Array]
#: Share of a variable's range by which a gradient is taken.
_STEP = 1e-3
_ROUNDS = 8
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
    least = _largest(lambda x: -measure(x), variables, starts)
    most = _largest(measure, variables, starts)
    return Extreme(-least.value, least.point, least.evaluations), most


def _largest(measure: Measure, variables: int, starts: Sequence[Array]) -> Extreme:
    search = _Search(measure, variables)
    first = [np.zeros(variables), *(np.clip(start, -1.0, 1.0) for start in starts)]
    search.look(np.array(first))
    slopes = search.gradient(first[0])
    for start in first:
        search.vertices(start)
    search.corners(np.argsort(-np.abs(slopes))[:_ALL_CORNERS])
    search.polish()
    search.vertices(search.best)
    return Extreme(search.value, search.best, search.count)


class _Search:
    """The best point so far."""

    def __init__(self, measure: Measure, variables: int) -> None:
        self._measure, self._variables = measure, variables
        self.best, self.value, self.count = np.zeros(variables), -np.inf, 0

    def look(self, points: Array) -> Array:
        found = np.asarray(self._measure(points), dtype=float)
        self.count += len(points)
        found = np.where(np.isfinite(found), found, -np.inf)
        k = int(np.argmax(found))
        if found[k] > self.value:
            self.value, self.best = float(found[k]), points[k].copy()
        return found

    def gradient(self, at: Array) -> Array:
        """Return the slope along each variable, by a step to the side where there is room."""
        step = np.where(at > 0.0, -_STEP, _STEP)
        values = self.look(np.vstack([at, at + np.diag(step)]))
        with np.errstate(invalid="ignore"):
            slopes = (values[1:] - values[0]) / step
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def vertices(self, start: Array) -> None:
        """Go where the gradient points, to the end of the box, until it points there already."""
        at = start
        for _ in range(_ROUNDS):
            there = np.where(self.gradient(at) >= 0.0, 1.0, -1.0)
            # the corner, and half-way to it: an extreme inside the box lies between
            self.look(np.vstack([there, 0.5 * (at + there)]))
            if np.array_equal(there, at):
                return
            at = there

    def corners(self, few: NDArray[np.intp]) -> None:
        """Look at all corners of a few variables, the others as at the best point."""
        signs = np.array(list(product((-1.0, 1.0), repeat=len(few))))
        points = np.tile(self.best, (len(signs), 1))
        points[:, few] = signs
        self.look(points)

    def polish(self) -> None:
        """Climb from the best point and from the middle, within the box."""
        scale = max(abs(self.value), 1e-300)
        for start in (self.best, 0.9 * self.best, np.zeros(self._variables)):
            minimize(
                lambda x: -float(self.look(x[None, :])[0]) / scale,
                start,
                jac=lambda x: -self.gradient(x) / scale,
                method="L-BFGS-B",
                bounds=[(-1.0, 1.0)] * self._variables,
                options={"maxiter": 20},
            )
