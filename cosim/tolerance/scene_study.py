"""Monte Carlo of a scene: from what is asked to findings, and a folder that keeps them."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim.catalogue import UNITS
from cosim.caution import Caution, warn
from cosim.comparisons.measuring import check_measures, needs_a_run
from cosim.errors import InputError, fail
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from cosim.scene.load import SceneLike
from cosim.seal import read_object
from cosim.tolerance.batch import Batch
from cosim.tolerance.corner_search import Corner, corner
from cosim.tolerance.cube_points import Method, Sampling, sampling
from cosim.tolerance.engine import Job, merge, run
from cosim.tolerance.findings import Findings, find
from cosim.tolerance.monte_carlo import Engine, Measurer, Study, draw, pilot_size
from cosim.tolerance.recipe import Recipe
from cosim.tolerance.spec import Spec
from cosim.tolerance.trim import Trimmed, trims
from cosim.tolerance.variables import tolerances
from cosim.tolerance.varying import Tolerances

__all__ = [
    "RECORD", "Asked", "Prepared", "Processes", "check_folder", "measure_shard", "monte_carlo", "one_sample",
    "prepare",
]  # fmt: skip

RECORD = "mc.json"
Array = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

#: Samples of a pilot, which is discarded.
_PILOT = 64
_UNTIL = re.compile(r"(\w+)\s*(?:\+-|±|\+/-)\s*([\d.eE+-]+)\s*(.*)")
_MOST = 10_000_000


@dataclass(frozen=True)
class Asked:
    """What ``cosim mc`` is asked for.

    Attributes
    ----------
    scene, overrides, trust
        As for `load_scene` and `resolve`.
    measures, specs
        Names; limits, whose measures come on top.
    n, method, seed
        Samples; `seed` is the scene's where it is None.
    until
        As ``yield +- 0.5%`` or ``k_max +- 5 N/m``: `n` is then found by a pilot.
    wanted
        Yield that the bill's loosest tolerances keep.
    corners
        Whether to search the worst case.
    """

    scene: SceneLike
    overrides: tuple[str, ...] = ()
    measures: tuple[str, ...] = ()
    specs: tuple[Spec, ...] = ()
    n: int = 200
    method: Method = "plain"
    seed: int | None = None
    until: str = ""
    wanted: float | None = None
    corners: bool = False
    trust: bool = False


@dataclass(frozen=True)
class Prepared:
    """A scene that is ready to be drawn: plan, what varies, measures, seed."""

    asked: Asked
    plan: Plan
    tolerances: Tolerances
    names: tuple[str, ...]
    seed: int

    def batch(self, names: Sequence[str], model: str) -> Measurer:
        """Return what measures devices, trimmed where the scene asks for it."""
        told = trims(self.plan.scene)
        needed = tuple(dict.fromkeys((*names, *(trim.measure for trim in told))))
        designed = self.tolerances.nominal.tolist()
        found: Measurer = Batch(self.plan, self.tolerances.keys, needed, model, designed)
        for trim in told:
            found = Trimmed(found, needed, trim, _columns(trim.resistor, self.tolerances))
        return found if needed == tuple(names) else _Some(found, len(names))

    def job(self, how: Sampling) -> Job:
        """Return the study as the engine takes it."""
        text = json.dumps([self.digest(), how.as_dict()], sort_keys=True)
        return Job(hashlib.sha256(text.encode()).hexdigest(), self.names, how.n, _Work(self, how))

    def digest(self) -> str:
        """SHA-256 of all that the samples depend on."""
        scene, asked = self.plan.scene, self.asked
        parts = (
            cosim.__version__, scene.digest(), scene.code_digest(), self.plan.board.digest, self.plan.model,
            *self.names, asked.method, str(asked.n), asked.until, str(self.seed),
        )  # fmt: skip
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@dataclass(frozen=True)
class _Work:
    """Makes what measures samples of a study in a process of the engine."""

    prepared: Prepared
    how: Sampling

    def __call__(self) -> Callable[[int, int], tuple[Array, Mapping[int, str]]]:
        batch = self.prepared.batch(self.prepared.names, self.prepared.plan.model)

        def work(first: int, count: int) -> tuple[Array, Mapping[int, str]]:
            values = self.prepared.tolerances.values(self.how.uniforms(first, count))
            return batch.measures(values), dict(batch.failures)

        return work


@dataclass(frozen=True)
class Processes:
    """How the engine measures: see `cosim.tolerance.engine.run`; `shards` are folders to be merged."""

    folder: Path
    workers: int | None = None
    chunk: int | None = None
    shards: tuple[Path, ...] = ()

    def of(self, job: Job) -> Engine:
        """Return what measures a job."""

        def engine(on_progress: Progress | None) -> tuple[Array, dict[int, str]]:
            if self.shards:
                return merge(job, self.folder, self.shards).read()
            found = run(job, self.folder, workers=self.workers, chunk=self.chunk, on_progress=on_progress)
            return found.read()

        return engine


def measure_shard(
    prepared: Prepared, processes: Processes, part: tuple[int, int], on_progress: Progress | None = None
) -> str:
    """Measure one of n shards of a study and keep its samples; return what was done, in words."""
    how, _ = sampled(prepared, prepared.batch(prepared.names, prepared.plan.model), on_progress)
    found = run(
        prepared.job(how), processes.folder, workers=processes.workers, chunk=processes.chunk, part=part,
        on_progress=on_progress,
    )  # fmt: skip
    failed = len(found.read()[1])
    return f"samples {found.first} to {found.last - 1} of {how.n}, {failed} of them without measures"


def prepare(asked: Asked) -> Prepared:
    """Load, resolve and check everything before the first sample.

    Raises
    ------
    InputError
        For anything wrong with the scene, its tolerances, measures and numbers.
    """
    names = tuple(dict.fromkeys((*asked.measures, *(spec.measure for spec in asked.specs))))
    check_measures(names)
    if not 1 <= asked.n <= _MOST:
        fail("is no number of samples", key="-n", value=asked.n, allowed=f"1 to {_MOST}")
    if asked.seed is not None and not 0 <= asked.seed < 2**63:
        fail("is no seed", key="--seed", value=asked.seed, allowed="0 to 9223372036854775807, as the scene's")
    if asked.wanted is not None and not 0.0 < asked.wanted < 1.0:
        fail("is no yield", key="--yield", value=f"{100 * asked.wanted:g}%", allowed="> 0% and < 100%")
    scene = load_scene(asked.scene, asked.overrides)
    trims(scene)
    plan = resolve(scene, trust=asked.trust)
    if scene.tolerance.calibration == "gains" and plan.model == "spice" and needs_a_run(names):
        file = str(scene.file) if scene.file else None
        fail("runs on the models linear and ideal only: give --model linear", file=file,
             key="tolerance.calibration", value="gains")  # fmt: skip
    found = tolerances(scene, board=plan.board)
    for name in found.idle:
        warn(
            Caution(
                "tolerance-unused",
                f"tolerance.{name}: nothing that is in force belongs to it",
                "switch the effect on that uses it, or take it out",
            )
        )
    seed = scene.seed if asked.seed is None else asked.seed
    own = tuple(name for name in scene.measures.names if ":" not in name)
    names = names or own or ("peak_force", "max_penetration")
    return Prepared(asked, plan, _with_trimmers(plan, found), names, seed)


def monte_carlo(
    prepared: Prepared, on_progress: Progress | None = None, processes: Processes | None = None
) -> Findings:
    """Draw, measure and work out; in this process alone, or by the engine, which keeps the samples.

    Raises
    ------
    InputError
        Where nothing varies, or the device as designed lacks a measure.
    """
    asked, model = prepared.asked, prepared.plan.model
    batch = prepared.batch(prepared.names, model)
    how, notes = sampled(prepared, batch, on_progress)
    engine = processes.of(prepared.job(how)) if processes is not None else None
    study = draw(
        prepared.tolerances, how, prepared.names, batch, model, on_progress=on_progress, engine=engine
    )
    corners = _corners(prepared, study, on_progress)
    return find(study, asked.specs, wanted=asked.wanted, corners=corners, notes=notes)


def sampled(
    prepared: Prepared, batch: Measurer, on_progress: Progress | None = None
) -> tuple[Sampling, list[str]]:
    """Return which samples are taken, by a pilot where a precision is asked for, and what to say of it."""
    asked, n, notes = prepared.asked, prepared.asked.n, list[str]()
    count = len(prepared.tolerances.variables)
    if asked.until:
        until = _until(asked)
        first = sampling("plain", _PILOT, count, _pilot_seed(prepared.seed))
        pilot = draw(
            prepared.tolerances, first, prepared.names, batch, prepared.plan.model, on_progress=on_progress
        )
        n = pilot_size(until, pilot, asked.specs)
        if n > _MOST:
            fail(f"{asked.until} would take {n} samples", key="--until", value=asked.until)
        notes.append(f"{n} samples for {asked.until}, judged by a pilot of {_PILOT} that was discarded")
    how = sampling(asked.method, n, count, prepared.seed)
    if how.n != n:
        notes.append(f"{how.n} samples instead of {n}: {how.replicates} randomisations of {how.each}")
    return how, notes


def one_sample(prepared: Prepared, number: int) -> tuple[Study, Array]:
    """Measure one sample of a study alone; return it with the values of its components, as in the study.

    Raises
    ------
    InputError
        For a number beyond the study.
    """
    asked = prepared.asked
    how = sampling(asked.method, asked.n, len(prepared.tolerances.variables), prepared.seed)
    if number < 0 or (asked.method != "plain" and number >= how.n):
        fail("is no sample of the study", key="--sample", value=number, allowed=f"0 to {how.n - 1}")
    batch = prepared.batch(prepared.names, prepared.plan.model)
    values = prepared.tolerances.values(how.uniforms(number, 1))
    rows = batch.measures(values)
    failures = {number: batch.failures[0]} if batch.failures else {}
    plan = prepared.plan
    return Study(prepared.tolerances, how, plan.model, prepared.names, rows[0], rows, failures), values[0]


def check_folder(folder: Path, digest: str) -> None:
    """Refuse a folder that holds another study: nothing of it is written over.

    Raises
    ------
    InputError
        Naming the folder.
    """
    file = folder / RECORD
    if not os.path.isfile(file):
        return
    try:
        known = read_object(file).get("digest")
    except InputError:
        known = None
    if known != digest:
        fail("holds another study; choose another folder with -o, or remove it", file=str(folder))


def _corners(prepared: Prepared, study: Study, on_progress: Progress | None) -> dict[str, Corner]:
    if not prepared.asked.corners:
        return {}
    model = prepared.plan.model
    cheap = "linear" if model == "spice" else model
    found = {}
    for place, name in enumerate(prepared.names):
        if on_progress is not None:
            on_progress(place, len(prepared.names), f"worst case of {name}")
        own = prepared.batch((name,), model) if model != cheap else None
        found[name] = corner(study, name, prepared.batch((name,), cheap), own)
    return found


def _until(asked: Asked) -> tuple[str, float]:
    match = _UNTIL.fullmatch(asked.until.strip())
    size = float(match[2]) if match and re.fullmatch(r"\d*\.?\d+(e[-+]?\d+)?", match[2], re.I) else math.nan
    allowed = '"yield +- 0.5%" with a --spec, or a measure such as "k_max +- 5 N/m"'
    if match is None or not size > 0.0:
        fail("is no precision", key="--until", value=asked.until, allowed=allowed)
    if asked.method != "plain":
        fail("is for plain sampling", key="--until", value=asked.until, allowed="--sampling plain")
    what, unit = match[1], match[3].strip()
    if what == "yield":
        allowed = '"yield +- 0.5%" and a --spec'
        if unit != "%" or not asked.specs or size >= 50.0:
            fail("needs a --spec, and per cent", key="--until", value=asked.until, allowed=allowed)
        return what, size / 100.0
    if what not in (*asked.measures, *(spec.measure for spec in asked.specs)):
        fail("is of a measure that is not asked for", key="--until", value=asked.until, allowed=allowed)
    if unit not in ("", UNITS[what]):
        fail("is not the measure's unit", key="--until", value=asked.until, allowed=UNITS[what] or "no unit")
    return what, size


def _pilot_seed(seed: int) -> int:
    """Return the seed of the pilot: no sample of it is one of the study."""
    return int.from_bytes(hashlib.sha256(f"pilot {seed}".encode()).digest()[:6], "big")


def _with_trimmers(plan: Plan, found: Tolerances) -> Tolerances:
    """Return what varies and what is trimmed: a trimmer without a tolerance begins at its nominal value."""
    missing = [trim.resistor for trim in trims(plan.scene) if not _columns(trim.resistor, found)]
    if not missing:
        return found
    table = plan.scene.tolerance
    named = {**table.components, **dict.fromkeys(missing, "1%")}
    scene = plan.scene.model_copy(update={"tolerance": table.model_copy(update={"components": named})})
    try:
        every = tolerances(scene, board=plan.board)
    except InputError as error:
        raise InputError(
            replace(problem, key=(problem.key or "").replace("components", "trim"))
            for problem in error.problems
        ) from None
    still = [
        replace(each, distribution="trimmed", lots=(), recipe=Recipe(each.nominal))
        for each in every.components
        if each.key not in found.keys
    ]
    return replace(found, components=(*found.components, *still))


def _columns(name: str, found: Tolerances) -> tuple[int, ...]:
    """Return the places of a resistor's components: its own, or those of all instances or of a parameter."""
    return tuple(
        place
        for place, each in enumerate(found.components)
        if name in (each.key, each.key.rpartition(".")[2], *each.names)
    )


class _Some:
    """A batch of which the first measures are wanted."""

    def __init__(self, batch: Measurer, count: int) -> None:
        self._batch, self._count = batch, count
        self.failures: Mapping[int, str] = {}

    def measures(self, values: Any) -> Any:
        """Return the first measures."""
        found = self._batch.measures(values)
        self.failures = self._batch.failures
        return found[:, : self._count]
