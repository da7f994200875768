"""Samples beside those of a study: of a cheaper model, at other points; each in a folder of its own.

What depends on seconds is decided once, and kept.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.catalogue import needing_no_run
from cosim.errors import fail
from cosim.storage.staging import atomic_file, disk_errors
from cosim.tolerance.engine import LEVELS, Processes
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.plane import Plane, fit_plane, samples_for
from cosim.tolerance.preparation import Points, Prepared
from cosim.tolerance.sensitivity import deviations
from cosim.tolerance.two_level import Pilot, TwoLevel, cheap_samples, corrected, pilot_of
from cosim.tolerance.unit_cube import REPLICATES, Sampling, sampling
from cosim.types import Array, Progress

__all__ = ["CHEAPER", "Chosen", "LevelSamples", "cheaper"]


#: Model -> the next cheaper one.
CHEAPER = {"spice": "linear", "linear": "ideal"}
#: Samples that are timed, dear and cheap, and those before them that warm up.
_TIMED, _WARM = (4, 24), 4
#: Cheap samples of one randomisation, at most; in all they never cost more than the dear ones.
_MOST_CHEAP = 1 << 16
#: ... and beside planes, which leave them little to tell, this share of the dear ones' cost.
_BESIDE_PLANES = 0.1


@dataclass(frozen=True)
class Chosen:
    """Some samples of a sampling, by their numbers."""

    among: Sampling
    numbers: tuple[int, ...]

    def uniforms(self, first: int, count: int) -> Array:
        """Return points of the unit cube (count, variables)."""
        chosen = self.numbers[first : first + count]
        rows = [self.among.uniforms(number, 1) for number in chosen]
        return np.concatenate(rows) if rows else np.empty((0, self.among.variables))

    def as_dict(self) -> dict[str, Any]:
        """Return what the points depend on, JSON-ready."""
        return {"among": self.among.as_dict(), "numbers": list(self.numbers)}


def cheaper(model: str) -> str:
    """Return the next cheaper model.

    Raises
    ------
    InputError
        Where there is none.
    """
    if model not in CHEAPER:
        fail(f"the model {model} has no cheaper one", key="--two-level", allowed="--model spice or linear")
    return CHEAPER[model]


class LevelSamples:
    """Measures what is beside a study's own samples."""

    def __init__(
        self, prepared: Prepared, study: Study, cheap: str, processes: Processes | None,
        on_progress: Progress | None,
    ) -> None:  # fmt: skip
        limited = [spec.measure for spec in prepared.asked.specs]
        # what needs no run is the same on both models
        self.names = tuple(n for n in study.names if n in limited or not needing_no_run((n,)))
        self.prepared, self.study, self.cheap = prepared, study, cheap
        self._processes, self._show = processes, on_progress
        self._decided: dict[str, Any] = {}

    def named(self, table: Array) -> dict[str, Array]:
        """Return the columns of a table by measure."""
        return {name: table[:, k] for k, name in enumerate(self.names)}

    def own(self) -> Array:
        """Return the study's samples of these measures (n, measures)."""
        return np.stack([self.study.column(name) for name in self.names], axis=1)

    def measured(self, name: str, points: Points, n: int, model: str | None = None) -> Array:
        """Return measures (n, measures) of points, kept in a folder of that name."""
        model = model or self.cheap

        def show(at: int, of: int, _: str) -> None:
            if self._show is not None:
                self._show(at, of, f"samples of {model}")

        job = replace(self.prepared, names=self.names).job(points, n, model)
        if self._processes is None:
            return job.make()(0, n)[0]
        return self._processes.beside(name).measured(job, show)[0]

    def seconds(self) -> tuple[float, float]:
        """Return seconds of a dear and of a cheap sample, each measured after one that warms up."""

        def timed() -> list[float]:
            times = []
            for model, count in zip((self.study.model, self.cheap), _TIMED, strict=True):
                batch = self.prepared.batch(self.names, model)
                values = self.study.tolerances.values(self.study.sampling.uniforms(0, count + _WARM))
                batch.measures(values[:_WARM])
                begun = time.perf_counter()
                batch.measures(values[_WARM:])
                times.append((time.perf_counter() - begun) / count)
            return times

        dear, cheap = self.decided("seconds", timed)
        return float(dear), float(cheap)

    def decided(self, name: str, decide: Callable[[], Any]) -> Any:
        """Return what was decided before, else decide it and keep it."""
        if self._processes is None:
            if name not in self._decided:
                self._decided[name] = decide()
            return self._decided[name]
        file = self._processes.folder / LEVELS / f"{name}.json"
        digest = self.prepared.digest()
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            known = {}
        if isinstance(known, dict) and known.get("digest") == digest and name in known:
            return known[name]
        value = decide()
        with disk_errors(file.parent):
            file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(file) as part:
                part.write_text(json.dumps({"digest": digest, name: value}) + "\n", encoding="utf-8")
        return value

    def pilot(self, name: str, same: Array, first: int) -> Pilot | str:
        """Return what the pilot says of a measure, or why there is none."""
        low, high = self.named(same)[name], self.study.column(name)
        if not np.isfinite(high).all():
            return f"{int(np.sum(~np.isfinite(high)))} samples lack the measure"
        if not np.isfinite(low[:first]).all():
            return f"the model {self.cheap} does not always have the measure"
        dear, cheap = self.seconds()
        return pilot_of(low[:first], high[:first], cheap / dear)

    def planes(self, pilots: Mapping[str, Pilot | str]) -> dict[str, Plane]:
        """Return planes through samples of the cheap model, where these cost less than half the dear ones."""
        paying = _paying(pilots)
        n, count = samples_for(len(self.study.tolerances.variables)), len(self.study.tolerances.variables)
        if not paying or 2 * n > self.study.sampling.n / paying[0].cost_ratio:
            return {}
        points = sampling("plain", n, count, self.prepared.seed + 2)
        z = deviations(self.study.tolerances, points.uniforms(0, n))
        table = self.named(self.measured("plane", points, n))
        planes = {name: fit_plane(z, table[name]) for name in self.names}
        return {name: plane for name, plane in planes.items() if plane is not None}

    def cube(
        self, pilots: Mapping[str, Pilot | str], first: int, n: int, beside: int = 0, *, weighs: bool = True
    ) -> Sampling:
        """Return the cheap level's points: as many as the most demanding estimate wants, within its cost.

        `n` are the dear samples that they correct, the pilot's `first` among them; `beside` cheap samples are
        spent already; `weighs` says that strata are weighed by these.
        """
        paying = _paying(pilots)
        count, seed = len(self.study.tolerances.variables), self.prepared.seed
        if not paying:
            return sampling("sobol", 0, count, seed + 1)
        each = max(cheap_samples(pilot, n - first) for pilot in paying)
        within = _BESIDE_PLANES if beside else 1.0
        most = int((within * n / paying[0].cost_ratio - beside) / REPLICATES)
        if self.prepared.asked.specs and weighs:
            each = _MOST_CHEAP
        each = max(min(each, most, _MOST_CHEAP), 16)
        return sampling("sobol", (1 << (each.bit_length() - 1)) * REPLICATES, count, seed + 1)

    def moments(
        self, name: str, pilot: Pilot | str, same: Array, values: Array, first: int,
        plane: tuple[Plane, Array] | None = None,
    ) -> TwoLevel:  # fmt: skip
        """Return mean and standard deviation of a measure; `plane` comes with what it is at `values`."""
        high = self.study.column(name)[first : len(same)]
        if isinstance(pilot, str):
            known = high[np.isfinite(high)]
            none = Pilot(0.0, 0.0, 0.0, 0.0, float(known.mean()) if len(known) else 0.0, 0.0, 1.0)
            return corrected(none, known, known, np.empty((REPLICATES, 0)), word=pilot)
        # where the cheap model is silent it says what it says on average: any function of a draw may be used
        tables = (same[first:], values)
        low, cheap = (np.nan_to_num(self.named(t)[name], nan=pilot.middle_of_cheap) for t in tables)
        return corrected(pilot, high, low, cheap.reshape(REPLICATES, -1), known=plane)


def _paying(pilots: Mapping[str, Pilot | str]) -> list[Pilot]:
    return [pilot for pilot in pilots.values() if isinstance(pilot, Pilot) and not pilot.words]
