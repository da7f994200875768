"""Two models of one study: what samples of a cheaper model add to those of its own.

The study's own samples are plain ones of the dear model. Beside them, each in a folder of its own: the same
samples on the cheap model, scrambled Sobol points on it, and, for a yield, devices that the cheap model finds
at the limits of the specifications. What depends on the pilot and on seconds is decided once, and kept: an
interrupted study goes on with the same samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cosim.errors import InputError, Problem
from cosim.tolerance.border_strata import STRATA, Border, learned, replicate_weights
from cosim.tolerance.engine import Processes
from cosim.tolerance.level_samples import LevelSamples, cheaper
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.plane import Plane
from cosim.tolerance.plane_samples import PlaneSamples
from cosim.tolerance.preparation import Prepared
from cosim.tolerance.sensitivity import deviations
from cosim.tolerance.strata_yields import Stratified, expected_halves, yields_by_strata
from cosim.tolerance.two_level import TwoLevel
from cosim.tolerance.unit_cube import Sampling
from cosim.types import Array, Progress

__all__ = ["LEAST_DEAR", "Levels", "check", "two_levels"]


#: Dear samples that a study of two models needs.
LEAST_DEAR = 32
_PILOT = 32
#: Planes sort the devices where their border costs less than this much of an interval without a border: the
#: cheap model's own, narrower one takes as many seconds as the dear samples.
_WORTH = 1.5
#: Dear samples that mean and deviation use of a study whose yield takes far more of them.
_ON_BOTH = 2048
#: Points of which a plane is evaluated together.
_TOGETHER = 1 << 14


@dataclass(frozen=True)
class Levels:
    """What two models say.

    Attributes
    ----------
    dear, cheap
        Models.
    seconds
        Of one sample of each.
    moments
        Measure -> mean and standard deviation.
    yields
        Specification -> yield by strata; 'all' where there are several.
    extra
        Dear samples beside the study's own.
    """

    dear: str
    cheap: str
    seconds: tuple[float, float]
    moments: Mapping[str, TwoLevel]
    yields: Mapping[str, Stratified]
    extra: int

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, JSON-ready."""
        return {
            "dear": self.dear,
            "cheap": self.cheap,
            "seconds_of_a_sample": list(self.seconds),
            "extra_dear_samples": self.extra,
            "moments": {
                name: {
                    **asdict(each),
                    "gain": each.pilot.gain(),
                    "gain_of_squares": each.pilot.gain(squares=True),
                }
                for name, each in self.moments.items()
            },
            "yields": {
                text: {
                    **asdict(each),
                    "strata": list(STRATA),
                    "correlation": each.correlation if math.isfinite(each.correlation) else None,
                }
                for text, each in self.yields.items()
            },
        }  # fmt: skip


def two_levels(
    prepared: Prepared, study: Study, processes: Processes | None, on_progress: Progress | None = None
) -> Levels:
    """Correct a study's samples by those of a cheaper model.

    Parameters
    ----------
    study
        Plain samples of the dear model; the first of them are the pilot.

    Raises
    ------
    InputError
        For a model that has no cheaper one.
    """
    cheap = cheaper(study.model)
    n = study.sampling.n
    work = LevelSamples(prepared, study, cheap, processes, on_progress)
    first = _pilot_size(n)
    if not work.names:
        return Levels(study.model, cheap, (0.0, 0.0), {}, {}, 0)
    both = work.measured("pilot", study.sampling, first)
    pilots = {name: work.pilot(name, both, first) for name in work.names}
    planes = work.planes(pilots)
    flat = _flat(work, planes, first)
    same = work.measured("same", study.sampling, n if flat is None else min(n, first + _ON_BOTH))
    spent = max((plane.samples for plane in planes.values()), default=0)
    cube = work.cube(pilots, first, len(same), spent, weighs=flat is None)
    values = work.measured("cheap", cube, cube.n) if cube.n else np.empty((0, len(work.names)))
    at = _at(planes, study, cube)
    moments = {
        name: work.moments(name, pilot, same, values, first, at.get(name)) for name, pilot in pilots.items()
    }
    yields: dict[str, Stratified] = {}
    extra = 0
    if flat is not None:
        by = f"a plane through samples of {cheap}"
        extra, yields = yields_by_strata(
            flat.samples, flat.border, flat.same, flat.weights, flat.cheap, first, by
        )
    elif prepared.asked.specs and cube.n:
        border = learned(prepared.asked.specs, work.named(same[:first]), work.named(work.own()[:first]))
        weights = replicate_weights(border.strata(work.named(values)), cube.replicates)
        extra, yields = yields_by_strata(work, border, same, weights, cube.n, first, cheap)
    return Levels(study.model, cheap, work.seconds(), moments, yields, extra)


def check(prepared: Prepared) -> None:
    """Refuse what two models cannot be asked for, before the first sample.

    Raises
    ------
    InputError
        With all that is wrong.
    """
    asked, problems = prepared.asked, list[Problem]()
    if asked.method != "plain":
        problems.append(
            Problem("is of plain samples", key="--two-level", value=asked.method, allowed="--sampling plain")
        )
    if asked.until:
        reason = "needs -n: how far two models agree, and so what a precision takes, only their samples tell"
        problems.append(Problem(reason, key="--two-level", value=asked.until))
    if asked.n < LEAST_DEAR:
        allowed = f">= {LEAST_DEAR}"
        problems.append(
            Problem("are too few for a pilot and an estimate", key="-n", value=asked.n, allowed=allowed)
        )
    if problems:
        raise InputError(problems)
    cheaper(prepared.plan.model)


@dataclass(frozen=True)
class _Flat:
    """Planes in the cheap model's place: who measures, border, the study's devices, and weights by others."""

    samples: PlaneSamples
    border: Border
    same: Array
    weights: Array
    cheap: int


def _flat(work: LevelSamples, planes: Mapping[str, Plane], first: int) -> _Flat | None:
    """Return what sorts devices by planes; ``None`` where their border is too wide to be worth it.

    What is promised depends on weights and pilot alone, not on what fails.
    """
    specs, n = work.prepared.asked.specs, work.study.sampling.n
    if not specs or not all(spec.measure in planes for spec in specs):
        return None
    samples = PlaneSamples(work, planes)
    same = samples.measured("same", work.study.sampling, n)
    border = learned(specs, work.named(same[:first]), work.named(work.own()[:first]))
    weights, cheap = samples.weights(border)
    half, best = expected_halves(weights, cheap, n - first)
    return _Flat(samples, border, same, weights, cheap) if half < _WORTH * best else None


def _at(planes: Mapping[str, Plane], study: Study, cube: Sampling) -> dict[str, tuple[Plane, Array]]:
    """Return each plane with its values at all points of the cheap level."""
    values: dict[str, list[Array]] = {name: [] for name in planes}
    for start in range(0, cube.n if planes else 0, _TOGETHER):
        points = cube.uniforms(start, min(_TOGETHER, cube.n - start))
        z = deviations(study.tolerances, points)
        for name, plane in planes.items():
            values[name].append(plane(z))
    return {name: (plane, np.concatenate(values[name])) for name, plane in planes.items() if values[name]}


def _pilot_size(n: int) -> int:
    return min(_PILOT, max(n // 3, 8))
