"""Failures of a scene's devices that are too rare for samples: where they begin, and how often they occur."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are used

from cosim.tolerance.engine import Processes
from cosim.tolerance.intervals import Estimate
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.preparation import Prepared
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.rare_failures import (
    Places,
    failure_estimate,
    importance_points,
    nearest_failures,
)  # fmt: skip
from cosim.tolerance.worst_case import Extreme, extremes
from cosim.types import Array, Progress

__all__ = ["Rare", "rare_failures"]


#: Searches, and draws of each inflation: a slope takes as many devices as there are variables.
_SEARCHES, _STARTS = 8, 128
#: Standard deviations at which a cut distribution is at its end but for a billionth.
_CORNER = 6.0
#: Nearest that a uniform number comes to 0 and 1.
_END = 2.0**-53
#: Components of the most probable failing device that are listed.
_LISTED = 8


@dataclass(frozen=True)
class Rare:
    """How often a device fails a specification.

    Attributes
    ----------
    rate
        With its interval.
    model, cheap
        Models: of the samples, and of the search.
    distance, first_order
        Of the nearest failure in standard deviations, and the rate if the border were a plane there;
        infinite and 0 where no failure was found.
    places, evaluations
        Places about which samples were taken, and devices looked at by the search.
    samples, effective
        Dear samples, and how many failing ones of equal weight they are worth.
    device
        The most probable failing device: component -> value, those that deviate most.
    word
        What is to be doubted, or why there is no failure.
    """

    rate: Estimate
    model: str
    cheap: str
    distance: float
    first_order: float
    places: int
    evaluations: int
    samples: int
    effective: float
    device: Mapping[str, float]
    word: str

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, JSON-ready."""
        return {
            "rate": asdict(self.rate),
            "model": self.model, "searched_on": self.cheap,
            "distance_sd": self.distance if math.isfinite(self.distance) else None,
            "first_order": self.first_order, "places": self.places, "evaluations": self.evaluations,
            "samples": self.samples, "effective_samples": self.effective,
            "most_probable_failing_device": dict(self.device), "word": self.word,
        }  # fmt: skip


@dataclass(frozen=True)
class _Normals:
    """Points given as standard normals; they depend on the places and the seed."""

    u: Array

    def uniforms(self, first: int, count: int) -> Array:
        return _uniform(self.u[first : first + count])

    def as_dict(self) -> dict[str, Any]:
        return {"normals": hashlib.sha256(np.ascontiguousarray(self.u).tobytes()).hexdigest()}


def _uniform(u: Array) -> Array:
    return np.asarray(np.clip(scipy.special.ndtr(u), _END, 1.0 - _END))


def rare_failures(
    prepared: Prepared, study: Study, processes: Processes | None, on_progress: Progress | None = None
) -> Rare:
    """Return how often a device fails any of the specifications.

    The failures are searched on `linear` (on `ideal` where the study is) and counted on the study's model, by
    as many samples as it has.
    """
    specs = prepared.asked.specs
    model, seed = study.model, prepared.seed
    cheap = "linear" if model == "spice" else model
    names = tuple(dict.fromkeys(spec.measure for spec in specs))
    batch = prepared.batch(names, cheap)
    sizes = {name: max(float(np.nanstd(study.column(name))), 1e-300) for name in names}
    looked = 0

    def margin(values: Array) -> Array:
        nonlocal looked
        looked += len(values)
        if on_progress is not None:
            on_progress(0, 0, f"{looked} devices on {cheap} in search of failures")
        table = batch.measures(values)
        margins = []
        for spec in specs:
            column = table[:, names.index(spec.measure)]
            margins.append(np.minimum(column - spec.low, spec.high - column) / sizes[spec.measure])
        # what cannot be measured does not pass
        return np.asarray(np.nan_to_num(np.min(margins, axis=0), nan=-1.0))

    tolerances = study.tolerances
    count = len(tolerances.variables)

    def standard(u: Array) -> Array:
        return margin(tolerances.values(_uniform(u)))

    places = nearest_failures(standard, count, seed=seed, most=_SEARCHES, starts=_STARTS)
    if not len(places.at):
        worst = _worst(tolerances, margin)
        if worst is not None and worst.value < 0.0:
            # no draw fails, but the worst device does: the border is on the way to it
            places = nearest_failures(standard, count, begin=_CORNER * worst.point[None, :])
        if not len(places.at):
            return _none(worst, model, cheap, looked)
    u = importance_points(places, max(study.sampling.n, 2), seed)
    job = prepared.job(_Normals(u), len(u), model)
    if processes is None:
        table = job.make()(0, len(u))[0]
    else:
        # another limit of the same study fails elsewhere: its samples stand beside these
        table = processes.beside(f"rare-{job.digest[:8]}").measured(job, on_progress)[0]
    good = [spec.passed(table[:, prepared.names.index(spec.measure)]) for spec in specs]
    estimate = failure_estimate(places, u, ~np.all(good, axis=0))
    how = f"importance sampling, {estimate.effective:.0f} effective failing samples"
    return Rare(
        Estimate(estimate.rate, *estimate.interval, how), model, cheap, places.distance, places.first_order,
        len(places.at), looked, estimate.samples, estimate.effective, _device(tolerances, places),
        estimate.word,
    )  # fmt: skip


def _worst(tolerances: Tolerances, margin: Callable[[Array], Array]) -> Extreme | None:
    """Return the worst device within all limits, where all tolerances have limits."""
    count = len(tolerances.variables)
    if not all(np.isfinite(tolerances.shape(j).support).all() for j in range(count)):
        return None
    return extremes(lambda at: margin(tolerances.in_box(at)), count)[0]


def _none(worst: Extreme | None, model: str, cheap: str, looked: int) -> Rare:
    """Say whether a failure is impossible, or what is not known."""
    word, high = f"no draw of {cheap} fails, not even six times as wide as the tolerances", 1.0
    if worst is not None and worst.value >= 0.0:
        word, high = (
            (
                f"no device within the tolerances, which end, was found to fail: the worst on {cheap} passes "
                f"by {worst.value:.3g} standard deviations"
            ),
            0.0,
        )
    elif worst is not None:
        word = (
            f"the worst device within the tolerances fails on {cheap}, no draw does, and no way from the "
            "design to it was found: how rare a failure is stays unknown"
        )
    possible = Estimate(0.0, 0.0, high, "search on the cheap model")
    return Rare(possible, model, cheap, math.inf, 0.0, 0, looked, 0, 0.0, {}, word)


def _device(tolerances: Tolerances, places: Places) -> dict[str, float]:
    """Return the components of the most probable failing device that deviate most."""
    nearest = places.nearest
    values = tolerances.values(_uniform(nearest[None, :]))[0]
    by_key: dict[str, float] = {}
    for j in np.argsort(-np.abs(nearest)):
        for place in tolerances.members(int(j)):
            if len(by_key) < _LISTED:
                by_key[tolerances.components[place].key] = float(values[place])
    return by_key
