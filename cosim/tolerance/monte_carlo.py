"""Monte Carlo: measures of many devices that are built from one design, and their statistics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError, Problem, fail
from cosim.tolerance import intervals
from cosim.tolerance.intervals import Estimate
from cosim.tolerance.missing import Missing, Reasons
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.spec import Spec
from cosim.tolerance.unit_cube import Sampling
from cosim.types import Array

__all__ = [
    "BEYOND", "QUANTILES", "Engine", "Measurer", "Study", "Summary", "check_nominal", "draw",
    "summary", "yields",
]  # fmt: skip

#: Shares of devices below the quantiles that are reported.
QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)
#: A number of samples that no study reaches.
BEYOND = 10**18
#: What a chunk should take [s]: long enough to cost nothing, short enough to see it move.
_CHUNK_S = 2.0
_MOST_TOGETHER = 4096


class Measurer(Protocol):
    """What measures devices: values of components (n, components) -> measures (n, measures), NaN: none."""

    @property
    def failures(self) -> Missing:
        """Sample of the last call -> measure -> why it has none."""

    def measures(self, values: Array) -> Array:
        """Return the measures of samples."""


class Engine(Protocol):
    """Measures all samples of a study, wherever."""

    def __call__(self, on_progress: Callable[[int, int, str], None] | None) -> tuple[Array, Missing]:
        """Return measures (n, measures), and sample -> measure -> why it has none."""
        ...


@dataclass(frozen=True)
class Study:
    """Measured devices.

    Attributes
    ----------
    tolerances, sampling, model
        What varies, which samples were taken, and the circuit model.
    names
        Measures, in the order of the columns.
    nominal
        Measures of the device as designed.
    results
        Measures (n, measures); NaN where there is none.
    failures
        Sample -> measure -> why it has none.
    seconds
        Wall time.
    """

    tolerances: Tolerances
    sampling: Sampling
    model: str
    names: tuple[str, ...]
    nominal: Array
    results: Array
    failures: Missing = field(default_factory=dict)
    seconds: float = 0.0

    def column(self, name: str) -> Array:
        """Return a measure of all samples (n,)."""
        return self.results[:, self.names.index(name)]

    def uniforms(self) -> Array:
        """Return the random numbers of all samples (n, variables)."""
        return self.sampling.uniforms(0, self.sampling.n)

    def thinned(self, most: int) -> Study:
        """Return the study of its first samples, of each randomisation as many; at most so many in all.

        What looks at each component of each sample has that much to hold, however long the study.
        """
        few = self.sampling.thinned(most)
        if few is self.sampling:
            return self
        rows = self.results.reshape(few.replicates, self.sampling.each, -1)[:, : few.each]
        return replace(self, sampling=few, results=rows.reshape(few.n, -1), failures={})


@dataclass(frozen=True)
class Summary:
    """What the devices do in one measure; `lacking`: samples without it."""

    name: str
    nominal: float
    mean: Estimate
    spread: Estimate
    quantiles: Mapping[float, Estimate]
    least: float
    largest: float
    lacking: int


def draw(
    tolerances: Tolerances,
    sampling: Sampling,
    names: Sequence[str],
    batch: Measurer,
    model: str,
    *,
    on_progress: Callable[[int, int, str], None] | None = None,
    engine: Engine | None = None,
) -> Study:
    """Measure all samples: here one chunk after the other, or by an engine that has its own processes.

    Raises
    ------
    InputError
        Where nothing varies, and where the device as designed lacks a measure.
    """
    begun = time.perf_counter()
    if not tolerances.components:
        raise InputError(
            "nothing varies: give tolerances in the netlist (`.param r=10k $ tol=1%`) or in the scene's "
            "[tolerance]"
        )
    nominal = batch.measures(tolerances.nominal[None, :])[0]
    check_nominal(names, nominal, batch.failures)
    if engine is None:
        results, failures = _one_by_one(tolerances, sampling, len(names), batch, on_progress)
    else:
        results, failures = engine(on_progress)
    return Study(
        tolerances, sampling, model, tuple(names), nominal, results, failures, time.perf_counter() - begun
    )


def _one_by_one(
    tolerances: Tolerances,
    sampling: Sampling,
    count: int,
    batch: Measurer,
    on_progress: Callable[[int, int, str], None] | None,
) -> tuple[Array, Missing]:
    results = np.full((sampling.n, count), np.nan)
    failures: dict[int, Reasons] = {}
    at, together = 0, 1
    while at < sampling.n:
        count = min(together, sampling.n - at)
        started = time.perf_counter()
        values = tolerances.values(sampling.uniforms(at, count))
        results[at : at + count] = batch.measures(values)
        failures |= {at + k: why for k, why in batch.failures.items()}
        at += count
        if on_progress is not None:
            on_progress(at, sampling.n, "samples")
        taken = time.perf_counter() - started
        together = min(max(int(count * _CHUNK_S / max(taken, 1e-3)), 1), 4 * count, _MOST_TOGETHER)
    return results, failures


def check_nominal(names: Sequence[str], nominal: Array, failures: Missing) -> None:
    """Refuse measures that the device as designed lacks, each with its own reason; it is sample 0."""
    lacking = [name for name, value in zip(names, nominal, strict=True) if not math.isfinite(value)]
    if lacking:
        why = failures.get(0, {})
        raise InputError(
            Problem(
                f"the device as designed has no such measure: {why.get(name, 'the scene has none')}",
                key="--measure", value=name,
            )
            for name in lacking
        )  # fmt: skip


def summary(study: Study, name: str) -> Summary:
    """Return what the devices do in one measure."""
    column = study.column(name)
    known = column[np.isfinite(column)]
    if len(known) < 2:
        why = next((f": {each[name]}" for each in study.failures.values() if name in each), "")
        fail(f"fewer than two samples have this measure{why}", key="--measure", value=name)
    how = study.sampling
    return Summary(
        name,
        float(study.nominal[study.names.index(name)]),
        intervals.mean(column, how),
        intervals.spread(column, how),
        {share: intervals.quantile(column, share, how) for share in QUANTILES},
        float(known.min()),
        float(known.max()),
        len(column) - len(known),
    )


def yields(study: Study, specs: Sequence[Spec]) -> dict[str, Estimate]:
    """Return the share of devices that pass each specification, and all of them where there are several."""
    estimates = {
        spec.text: intervals.share(spec.passed(study.column(spec.measure)), study.sampling) for spec in specs
    }
    if len(specs) > 1:
        estimates["all"] = intervals.share(passed(study, specs), study.sampling)
    return estimates


def passed(study: Study, specs: Sequence[Spec]) -> NDArray[np.bool_]:
    """Return which samples pass all specifications."""
    every = [spec.passed(study.column(spec.measure)) for spec in specs]
    table = np.array(every) if every else np.isfinite(study.results).T
    return np.asarray(table.all(axis=0), dtype=bool)


def worst(study: Study, name: str, count: int = 5) -> list[tuple[int, float]]:
    """Return the samples farthest from the nominal device, the farthest first."""
    column, nominal = study.column(name), float(study.nominal[study.names.index(name)])
    order = np.argsort(-np.where(np.isfinite(column), np.abs(column - nominal), -1.0), kind="stable")
    return [(int(k), float(column[k])) for k in order[:count] if math.isfinite(column[k])]


def pilot_size(until: tuple[str, float], pilot: Study, specs: Sequence[Spec]) -> int:
    """Return how many samples make an interval as narrow as asked, judged by a discarded pilot.

    Of randomisations the error is taken to fall as that of plain samples does; it falls no slower.

    Parameters
    ----------
    until
        'yield' with half the width in shares, or a measure with half the width of its mean in its unit.
    pilot
        Samples that are not used again.
    specs
        What the yield is of.
    """
    what, half = until
    if pilot.sampling.replicates > 1:
        seen = (
            intervals.share(passed(pilot, specs), pilot.sampling)
            if what == "yield"
            else intervals.mean(pilot.column(what), pilot.sampling)
        )
        return max(_ceil(pilot.sampling.n * (seen.half / half) * (seen.half / half)), pilot.sampling.n)
    z = 1.959964
    if what == "yield":
        # of a share that a pilot saw as 0 or 1 no more is known than its exact bound
        estimate = intervals.share(passed(pilot, specs), pilot.sampling)
        p = min(max(estimate.value, 1.0 - estimate.high), 1.0 - estimate.low)
        p = p if 0.0 < p < 1.0 else (estimate.low if p >= 1.0 else estimate.high)
        return _ceil(max(p * (1.0 - p) * (z / half) * (z / half), 2.0 / half))
    sigma = intervals.spread(pilot.column(what), pilot.sampling)
    return max(_ceil((z * sigma.high / half) * (z * sigma.high / half)), 16)


def _ceil(number: float) -> int:
    """Return the next whole number; of what overflows, one that no study reaches."""
    return math.ceil(min(number, BEYOND))


def rows(study: Study) -> tuple[list[str], list[list[Any]]]:
    """Return heading and rows of a table of all samples."""
    head = ["sample", *study.names]
    return head, [[k, *map(float, row)] for k, row in enumerate(study.results)]
