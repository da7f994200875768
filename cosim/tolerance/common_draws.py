"""Designs by their distributions: boards or values under one scene, all with the same draws.

Every random variable draws its numbers by its own name: a resistor that two boards have in common deviates by
the same in both, whatever else they have (common random numbers). What differs is the design, not the draw.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import InputError, Problem, fail
from cosim.scene.load import SceneLike
from cosim.tolerance import intervals
from cosim.tolerance.bill import gained
from cosim.tolerance.engine import Processes, run
from cosim.tolerance.intervals import Estimate
from cosim.tolerance.monte_carlo import Study, Summary, check_nominal, passed, summary, yields
from cosim.tolerance.preparation import MOST, Asked, Prepared, prepare
from cosim.tolerance.spec import Spec
from cosim.tolerance.unit_cube import sampling
from cosim.types import Array, Progress

__all__ = ["Named", "Side", "sides"]


#: Half the spacing of the generator's numbers: keeps them away from 0.
_HALF = 2.0**-54
#: Numbers that Philox makes at once.
_BLOCK = 4


@dataclass(frozen=True)
class Named:
    """Samples in which a variable's numbers depend on its name, the seed and the sample's number alone.

    Examples
    --------
    >>> a, b = Named(('r1', 'r2'), 3), Named(('r0', 'r2'), 3)
    >>> bool((a.uniforms(5, 10)[:, 1] == b.uniforms(0, 20)[5:15, 1]).all())
    True
    """

    variables: tuple[str, ...]
    seed: int

    def uniforms(self, first: int, count: int) -> Array:
        """Return samples ``first`` to ``first + count - 1``, (count, variables), within (0, 1)."""
        out = np.empty((count, len(self.variables)))
        blocks, before = divmod(first, _BLOCK)
        for j, name in enumerate(self.variables):
            digest = hashlib.sha256(f"{self.seed} {name}".encode()).digest()
            generator = np.random.Philox(key=np.frombuffer(digest[:16], np.uint64)).advance(blocks)
            out[:, j] = np.random.Generator(generator).random(before + count)[before:]
        return out + _HALF

    def as_dict(self) -> dict[str, Any]:
        """Return what the points depend on, JSON-ready."""
        return {"by name": list(self.variables), "seed": self.seed}


@dataclass(frozen=True)
class Side:
    """One design.

    Attributes
    ----------
    label, study
        Its name, and its samples.
    summaries, yields
        By measure and by specification.
    changes, gains
        Of the mean of each measure, and of each yield, against the first side: of the same draws.
    """

    label: str
    study: Study
    summaries: Mapping[str, Summary]
    yields: Mapping[str, Estimate]
    changes: Mapping[str, Estimate]
    gains: Mapping[str, Estimate]


def sides(
    scene: SceneLike,
    designs: Sequence[tuple[str, tuple[str, ...]]],
    measures: Sequence[str],
    specs: Sequence[Spec],
    n: int,
    folder: Path,
    *,
    seed: int | None = None,
    trust: bool = False,
    on_progress: Progress | None = None,
) -> list[Side]:
    """Measure devices of several designs; finished samples in `folder` are not measured again.

    Parameters
    ----------
    designs
        Name and overrides of each; the first is the reference.
    n
        Devices of each design.

    Raises
    ------
    InputError
        For a design that does not fit, one in which nothing varies, and a number of devices out of range.
    """
    if not 2 <= n <= MOST:
        fail("is not a possible number of devices", key="--mc", value=n, allowed=f"2 to {MOST}")
    prepared = [
        (label, prepare(Asked(scene, overrides, tuple(measures), tuple(specs), n, seed=seed, trust=trust)))
        for label, overrides in designs
    ]
    steady = [label for label, each in prepared if not each.tolerances.components]
    if steady:
        raise InputError(
            Problem(f"{label}: nothing varies: give tolerances in the netlist or in [tolerance]", key="--mc")
            for label in steady
        )
    out: list[Side] = []
    for number, (label, each) in enumerate(prepared):

        def show(at: int, of: int, _: str, number: int = number, label: str = label) -> None:
            if on_progress is not None:
                on_progress(number * of + at, len(prepared) * of, label)

        study = _measured(each, n, Processes(folder / _file_name(number, label)), show)
        out.append(_side(label, study, specs, out[0].study if out else study))
    return out


def _file_name(number: int, label: str) -> str:
    return f"{number:03d}-" + "".join(c if c.isalnum() or c in "._=-+" else "_" for c in label)[:80]


def _measured(prepared: Prepared, n: int, processes: Processes, on_progress: Progress) -> Study:
    variables = prepared.tolerances.variables
    points = Named(variables, prepared.seed)
    batch = prepared.batch(prepared.names, prepared.plan.model)
    nominal = batch.measures(prepared.tolerances.nominal[None, :])[0]
    check_nominal(prepared.names, nominal, batch.failures)
    results, failures = run(prepared.job(points, n), processes.folder, on_progress=on_progress).read()
    # of how it was sampled only the way matters here: intervals are those of plain samples
    how = sampling("plain", n, len(variables), prepared.seed)
    return Study(
        prepared.tolerances, how, prepared.plan.model, prepared.names, nominal, results, failures
    )  # fmt: skip


def _side(label: str, study: Study, specs: Sequence[Spec], first: Study) -> Side:
    changes = {}
    for name in study.names:
        difference = study.column(name) - first.column(name)
        if np.isfinite(difference).sum() < 2:
            fail("fewer than two draws have this measure on both sides", key="--measure", value=name)
        changes[name] = intervals.mean(difference, study.sampling)
    gains = {spec.text: gained(passed(first, (spec,)), passed(study, (spec,))) for spec in specs}
    if len(specs) > 1:
        gains["all"] = gained(passed(first, specs), passed(study, specs))
    summaries = {name: summary(study, name) for name in study.names}
    return Side(label, study, summaries, yields(study, specs), changes, gains)
