"""The worst device of a study: searched on a cheap model, measured on its own, held against its samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.tolerance.monte_carlo import Measurer, Study, worst
from cosim.tolerance.worst_case import extremes
from cosim.types import Array

__all__ = ["Corner", "corner"]

#: Worst samples from which the search begins, too.
_STARTS = 3
#: Samples that are looked at together.
_TOGETHER = 1 << 15


@dataclass(frozen=True)
class Corner:
    """The worst case of a measure over the box of tolerances.

    Attributes
    ----------
    low, high
        Least and largest value found.
    low_at, high_at
        Component -> its value there.
    evaluations
        Devices looked at.
    outside
        Samples with a deviation outside the box: no worst case covers them.
    """

    low: float
    high: float
    low_at: Mapping[str, float]
    high_at: Mapping[str, float]
    evaluations: int
    outside: int


def corner(study: Study, name: str, cheap: Measurer, own: Measurer | None = None) -> Corner:
    """Search the worst case of one measure.

    Parameters
    ----------
    study
        The samples: those inside the box never lie beyond what is returned.
    name
        The measure.
    cheap
        Measures this measure alone.
    own
        Measures it on the study's model, if that is another one: the corners are measured again there.
    """
    tolerances = study.tolerances
    within = _within(study)
    column = np.where(within, study.column(name), np.nan)
    starts = [_in_box(study, k, 1)[0] for k, _ in worst(study, name, 40) if within[k]][:_STARTS]

    def measure(at: Array) -> Array:
        return cheap.measures(tolerances.in_box(at))[:, 0]

    least, most = extremes(measure, len(tolerances.variables), starts)
    ends = np.array([least.point, most.point])
    values = [least.value, most.value]
    if own is not None:
        values = [float(v) for v in own.measures(tolerances.in_box(ends))[:, 0]]
    for side, pick in ((0, np.nanargmin), (1, np.nanargmax)):
        if np.isfinite(column).any():
            k = int(pick(column))
            beyond = column[k] < values[0] if side == 0 else column[k] > values[1]
            if beyond or not np.isfinite(values[side]):
                values[side], ends[side] = float(column[k]), _in_box(study, k, 1)[0]
    there = tolerances.in_box(ends)
    low, high = (dict(zip(tolerances.keys, map(float, row), strict=True)) for row in there)
    return Corner(values[0], values[1], low, high, most.evaluations, int(np.sum(~within)))


def _within(study: Study) -> NDArray[np.bool_]:
    """Return which samples lie inside the box (n,)."""
    inside = np.empty(study.sampling.n, dtype=bool)
    for first in range(0, study.sampling.n, _TOGETHER):
        points = _in_box(study, first, min(_TOGETHER, study.sampling.n - first))
        inside[first : first + len(points)] = (np.abs(points) <= 1.0 + 1e-9).all(axis=1)
    return inside


def _in_box(study: Study, first: int, count: int) -> Array:
    """Return samples as points of the box (count, variables)."""
    uniforms = study.sampling.uniforms(first, count)
    points = np.empty_like(uniforms)
    for j in range(uniforms.shape[1]):
        shape = study.tolerances.shape(j)
        deviation = shape.inverse(uniforms[:, j])
        low, high = shape.box
        points[:, j] = np.where(deviation < 0.0, -deviation / (low or -np.inf), deviation / (high or np.inf))
    return points
