"""Strata by a plane in place of the cheap model: it costs nothing, and their weights are known well.

The plane is fitted to samples of its own. Where it is less sure than the cheap model its border is wider, no
more: every stratum is counted by dear samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cosim.tolerance.border_strata import Border, replicate_weights
from cosim.tolerance.level_samples import LevelSamples
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.plane import Plane
from cosim.tolerance.preparation import Points, Prepared
from cosim.tolerance.sensitivity import deviations
from cosim.tolerance.unit_cube import sampling
from cosim.types import Array

__all__ = ["PlaneSamples"]

#: Points by which the strata are weighed: for each dear sample, so that the weights' error is small beside
#: the bound of no failure, 3/n; at least, and at most.
_WEIGHED, _LEAST, _MOST = 800, 1 << 17, 1 << 22
#: Points of which a plane is evaluated together.
_TOGETHER = 1 << 14
#: Seconds of a value of a plane: far below those of any sample.
_SECONDS = 1e-6


class PlaneSamples:
    """Samples as of `LevelSamples`, the cheap model's replaced by planes.

    Parameters
    ----------
    work
        Measures on the study's model.
    planes
        Measure -> plane; each measure that has a specification.
    """

    def __init__(self, work: LevelSamples, planes: Mapping[str, Plane]) -> None:
        self._work, self._planes = work, planes
        self.study: Study = work.study
        self.prepared: Prepared = work.prepared
        self.named = work.named
        self.own = work.own

    def weights(self, border: Border) -> tuple[Array, int]:
        """Return the strata's share in each randomisation (randomisations, strata), and the points in all."""
        count, wanted = len(self.study.tolerances.variables), _WEIGHED * self.study.sampling.n
        cube = sampling("sobol", min(max(wanted, _LEAST), _MOST), count, self.prepared.seed + 3)
        strata = np.empty(cube.n, dtype=np.int64)
        for first in range(0, cube.n, _TOGETHER):
            table = self._values(cube.uniforms(first, min(_TOGETHER, cube.n - first)))
            strata[first : first + len(table)] = border.strata(self.named(table))
        return replicate_weights(strata, cube.replicates), cube.n

    def seconds(self) -> tuple[float, float]:
        """Return seconds of a dear sample, and of a value of a plane."""
        return self._work.seconds()[0], _SECONDS

    def decided(self, name: str, decide: Callable[[], Any]) -> Any:
        """Return what was decided before, else decide it and keep it."""
        return self._work.decided(f"{name}-by-plane", decide)

    def measured(self, name: str, points: Points, n: int, model: str | None = None) -> Array:
        """Return measures (n, measures) of points: by planes, or on the study's model; NaN: no plane."""
        if model is not None:
            return self._work.measured(f"{name}-by-plane", points, n, model)
        starts = range(0, n, _TOGETHER)
        parts = [self._values(points.uniforms(first, min(_TOGETHER, n - first))) for first in starts]
        return np.concatenate(parts) if parts else np.empty((0, len(self._work.names)))

    def _values(self, uniforms: Array) -> Array:
        z = deviations(self.study.tolerances, uniforms)
        table = np.full((len(z), len(self._work.names)), np.nan)
        for column, measure in enumerate(self._work.names):
            if measure in self._planes:
                table[:, column] = self._planes[measure](z)
        return table
