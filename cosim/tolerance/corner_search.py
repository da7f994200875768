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
    points, within = _in_box(study)
    column = np.where(within, study.column(name), np.nan)
    starts = [points[k] for k, _ in worst(study, name, 40) if within[k]][:_STARTS]

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
                values[side], ends[side] = float(column[k]), points[k]
    there = tolerances.in_box(ends)
    low, high = (dict(zip(tolerances.keys, map(float, row), strict=True)) for row in there)
    return Corner(values[0], values[1], low, high, most.evaluations, int(np.sum(~within)))


def _in_box(study: Study) -> tuple[Array, NDArray[np.bool_]]:
    """Return the samples as points of the box, and which of them lie inside."""
    uniforms = study.uniforms()
    points = np.empty_like(uniforms)
    for j in range(uniforms.shape[1]):
        shape = study.tolerances.shape(j)
        deviation = shape.inverse(uniforms[:, j])
        low, high = shape.box
        points[:, j] = np.where(deviation < 0.0, -deviation / (low or -np.inf), deviation / (high or np.inf))
    return points, np.asarray((np.abs(points) <= 1.0 + 1e-9).all(axis=1))
