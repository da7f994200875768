"""Yields of a study by strata: which samples are taken, and what they say."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.tolerance import intervals
from cosim.tolerance.border_strata import (
    BORDER,
    FAILS,
    PASSES,
    STRATA,
    Border,
    allocation,
    failure_rate,
)  # fmt: skip
from cosim.tolerance.intervals import Estimate
from cosim.tolerance.level_samples import Chosen
from cosim.tolerance.monte_carlo import Study, passed
from cosim.tolerance.preparation import Points, Prepared
from cosim.tolerance.spec import Spec
from cosim.types import Array

__all__ = ["Sampled", "Stratified", "expected_halves", "yields_by_strata"]

#: Samples of the cheap model that are looked through for the border, at most.
_LOOKED_THROUGH = 1 << 18


class Sampled(Protocol):
    """Who measures: on the study's model, and what tells the strata apart; see `LevelSamples`."""

    study: Study
    prepared: Prepared

    def named(self, table: Array) -> dict[str, Array]:
        """Return the columns of a table by measure."""

    def own(self) -> Array:
        """Return the study's samples of these measures (n, measures)."""

    def seconds(self) -> tuple[float, float]:
        """Return seconds of a dear and of a cheap sample."""

    def decided(self, name: str, decide: Callable[[], Any]) -> Any:
        """Return what was decided before, else decide it and keep it."""

    def measured(self, name: str, points: Points, n: int, model: str | None = None) -> Array:
        """Return measures (n, measures) of points."""


@dataclass(frozen=True)
class Stratified:
    """A yield by strata.

    Attributes
    ----------
    failing, plain
        Share of failing devices, and what the plain dear samples alone say.
    weights, counted, failed
        Of each stratum: share, dear samples, and those that failed.
    correlation
        Of whether a device passes, between both models; NaN where all of the plain samples agree.
    word
        Why only the plain samples are used, if so.
    by
        What sorts devices into the strata.
    """

    failing: Estimate
    plain: Estimate
    weights: tuple[float, ...]
    counted: tuple[int, ...]
    failed: tuple[int, ...]
    correlation: float
    word: str = ""
    by: str = ""

    @property
    def passing(self) -> Estimate:
        """The yield; of the plain samples alone where strata do not pay."""
        of = self.plain if self.word else self.failing
        return Estimate(1.0 - of.value, 1.0 - of.high, 1.0 - of.low, of.how)


def expected_halves(weights: Array, cheap: int, n: int) -> tuple[float, float]:
    """Return half the interval that strata promise, and that they would without a border.

    With n plain dear samples and n/2 more. Half of the devices at the border are taken to fail, and none
    beyond it.
    """

    def half(of: Array) -> float:
        counted = allocation(of.mean(axis=0), n, n // 2)
        failed = counted[FAILS], counted[BORDER] // 2, 0
        return failure_rate(of, failed, counted, cheap).half

    sharp = weights.copy()
    sharp[:, FAILS] += 0.5 * sharp[:, BORDER]
    sharp[:, PASSES] += 0.5 * sharp[:, BORDER]
    sharp[:, BORDER] = 0.0
    return half(weights), half(sharp)


def yields_by_strata(
    work: Sampled, border: Border, same: Array, weights: Array, cheap: int, first: int, by: str
) -> tuple[int, dict[str, Stratified]]:
    """Return the dear samples besides the study's own, and the yield of each specification by strata.

    Parameters
    ----------
    same
        [n, measures], the study's own devices on the cheap model.
    weights, cheap
        (randomisations, strata), the strata's shares, and how many devices of the cheap model they come from.
    first
        Own devices that the border was learned from; they are not counted.
    by
        What sorts the devices, for people.
    """
    study, specs = work.study, work.prepared.asked.specs
    n = study.sampling.n
    wanted = allocation(weights.mean(axis=0), n - first, n // 2)
    strata = border.strata(work.named(same))
    # another limit of the same study has a border of its own: what was chosen for this one would bias it
    of = hashlib.sha256(repr(specs).encode()).hexdigest()[:8]
    chosen = work.decided(f"chosen-{of}", lambda: _chosen(work, border, strata[first:], weights, wanted, of))
    among = study.sampling
    more = np.array(chosen, dtype=np.int64)
    results = work.own()[first:]
    if len(more):
        points = Chosen(among, tuple(chosen))
        rows = work.measured(f"border-{of}", points, len(more), study.model)
        lower = work.measured(f"border-cheap-{of}", points, len(more))
        results = np.concatenate([results, rows])
        strata = np.concatenate([strata, border.strata(work.named(lower))])
    strata = strata[first:]
    every = {spec.text: (spec,) for spec in specs} | ({"all": tuple(specs)} if len(specs) > 1 else {})
    return len(more), {
        text: replace(_stratified(work, some, results, strata, weights, cheap, same), by=by)
        for text, some in every.items()
    }


def _chosen(
    work: Sampled, border: Border, strata: NDArray[np.int64], weights: Array, wanted: Sequence[int], of: str
) -> list[int]:
    """Return the numbers of further samples at the border and beyond, as the cheap model finds them."""
    missing = [max(wanted[h] - int(np.sum(strata == h)), 0) for h in range(BORDER + 1)]
    n, chosen = work.study.sampling.n, list[int]()
    mean = weights.mean(axis=0)
    length = max((m / mean[h] for h, m in enumerate(missing) if m and mean[h] > 0.0), default=0.0)
    length = min(1.3 * length, _LOOKED_THROUGH, n * work.seconds()[0] / work.seconds()[1])
    if length < 1.0:
        return []
    further = Chosen(work.study.sampling, tuple(range(n, n + math.ceil(length))))
    table = work.measured(f"further-{of}", further, len(further.numbers))
    for number, h in zip(further.numbers, border.strata(work.named(table)), strict=True):
        if h <= BORDER and missing[h] > 0:
            missing[h] -= 1
            chosen.append(number)
    return chosen


def _stratified(
    work: Sampled, specs: Sequence[Spec], results: Array, strata: NDArray[np.int64], weights: Array,
    cheap: int, same: Array,
) -> Stratified:  # fmt: skip
    """Return the yield of some specifications; the strata are those of all of them."""
    study = work.study

    def passing(table: Array) -> NDArray[np.bool_]:
        columns = work.named(table)
        return np.asarray(np.all([spec.passed(columns[spec.measure]) for spec in specs], axis=0))

    good = passing(results)
    counted = [int(np.sum(strata == h)) for h in range(len(STRATA))]
    failed = [int(np.sum((strata == h) & ~good)) for h in range(len(STRATA))]
    own = passed(study, specs)
    plain = intervals.share(~own, study.sampling)
    rate = failure_rate(weights, failed, counted, cheap)
    lower = passing(same)
    correlation = math.nan
    if 0 < own.sum() < len(own) and 0 < lower.sum() < len(lower):
        correlation = float(np.corrcoef(own, lower)[0, 1])
    word = ""
    if rate.half >= plain.half:
        word = f"strata leave +-{100 * rate.half:.3g} %: the plain samples of {study.model} alone tell more"
    return Stratified(
        rate,
        plain,
        tuple(map(float, weights.mean(axis=0))),
        tuple(counted),
        tuple(failed),
        correlation,
        word,
    )
