"""Monte Carlo of a scene: from the request to findings, and a folder that keeps them."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cosim.catalogue import UNITS
from cosim.caution import Caution, warn
from cosim.errors import InputError, fail
from cosim.storage.checksums import read_object
from cosim.tolerance.corner_search import Corner, corner
from cosim.tolerance.engine import Processes, run
from cosim.tolerance.missing import Missing, lacks
from cosim.tolerance.model_levels import check, two_levels
from cosim.tolerance.monte_carlo import BEYOND, Measurer, Study, draw, pilot_size
from cosim.tolerance.preparation import MOST, Asked, Prepared, prepare
from cosim.tolerance.rare_study import rare_failures
from cosim.tolerance.spec import Spec
from cosim.tolerance.study_results import Findings, find
from cosim.tolerance.unit_cube import Sampling, sampling
from cosim.types import Array, Progress

__all__ = [
    "RECORD", "Asked", "Prepared", "Processes", "check_folder", "measure_shard", "monte_carlo", "one_sample",
    "prepare",
]  # fmt: skip

RECORD = "mc.json"

#: Samples of a pilot, which is discarded.
_PILOT = 64
#: ... and those of it that must have a measure whose mean is asked for.
_LEAST_KNOWN = 4
_UNTIL = re.compile(r"(\w+)\s*(?:\+-|±|\+/-)\s*([\d.eE+-]+)\s*(.*)")


def measure_shard(
    prepared: Prepared, processes: Processes, part: tuple[int, int], on_progress: Progress | None = None
) -> str:
    """Measure one of n shards of a study and keep its samples; return what was done, in words."""
    how, _ = sampled(prepared, prepared.batch(prepared.names, prepared.plan.model), on_progress)
    summary = run(
        prepared.job(how, how.n), processes.folder, workers=processes.workers, chunk=processes.chunk,
        part=part, on_progress=on_progress,
    )  # fmt: skip
    missing = summary.read()[1]
    some = "; ".join(f"{lack.samples} lack {lack.text}" for lack in lacks(missing, prepared.names))
    return f"samples {summary.first} to {summary.last - 1} of {how.n}, {some or 'all with all measures'}"


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
    if asked.two_level:
        check(prepared)
    if asked.rare and not asked.specs:
        fail("counts failures of a specification: give one", key="--rare", allowed="--spec")
    batch = prepared.batch(prepared.names, model)
    how, notes = sampled(prepared, batch, on_progress)
    engine = processes.of(prepared.job(how, how.n)) if processes is not None else None
    study = draw(
        prepared.tolerances, how, prepared.names, batch, model, on_progress=on_progress, engine=engine
    )
    _warn_of_missing(study, asked.specs)
    corners = _corners(prepared, study, on_progress)
    levels = two_levels(prepared, study, processes, on_progress) if asked.two_level else None
    rare = rare_failures(prepared, study, processes, on_progress) if asked.rare else None
    return find(
        study, asked.specs, wanted=asked.wanted, corners=corners, notes=notes, levels=levels, rare=rare
    )


def sampled(
    prepared: Prepared, batch: Measurer, on_progress: Progress | None = None
) -> tuple[Sampling, list[str]]:
    """Return the sampling, sized by a pilot if a precision is asked for, and a remark on it."""
    asked, n, notes = prepared.asked, prepared.asked.n, list[str]()
    count = len(prepared.tolerances.variables)
    if asked.until:
        until = _until(asked)
        first = sampling(asked.method, _PILOT, count, _pilot_seed(prepared.seed))
        pilot = draw(
            prepared.tolerances, first, prepared.names, batch, prepared.plan.model, on_progress=on_progress
        )
        n = pilot_size(until, pilot, asked.specs)
        if n > MOST:
            fail(
                _endless(n, until[0], pilot),
                key="--until",
                value=asked.until,
                allowed=f"what takes at most {MOST} samples",
            )
        notes.append(f"{n} samples for {asked.until}, judged by a pilot of {first.n} that was discarded")
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
        fail("is not a sample of the study", key="--sample", value=number, allowed=f"0 to {how.n - 1}")
    batch = prepared.batch(prepared.names, prepared.plan.model)
    values = prepared.tolerances.values(how.uniforms(number, 1))
    rows = batch.measures(values)
    failures: Missing = {number: batch.failures[0]} if batch.failures else {}
    plan = prepared.plan
    return Study(prepared.tolerances, how, plan.model, prepared.names, rows[0], rows, failures), values[0]


def check_folder(folder: Path, digest: str) -> None:
    """Refuse a folder that holds another study, so that nothing is overwritten.

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


def _warn_of_missing(study: Study, specs: Sequence[Spec]) -> None:
    """Say which measures devices lack, why, and what that means for specifications of them."""
    for lack in lacks(study.failures, study.names):
        limits = ", ".join(spec.text for spec in specs if spec.measure in lack.names)
        warn(
            Caution(
                "measures-missing",
                f"{lack.samples} of {study.sampling.n} devices have no {lack.text}, the first (sample "
                f"{lack.first}): {lack.why}",
                f"they count as not passing {limits}" if limits else "they are left out of its distribution",
            )
        )


def _corners(prepared: Prepared, study: Study, on_progress: Progress | None) -> dict[str, Corner]:
    if not prepared.asked.corners:
        return {}
    model = prepared.plan.model
    cheap = "linear" if model == "spice" else model
    corners = {}
    for place, name in enumerate(prepared.names):
        if on_progress is not None:
            on_progress(place, len(prepared.names), f"worst case of {name}")
        own = prepared.batch((name,), model) if model != cheap else None
        corners[name] = corner(study, name, prepared.batch((name,), cheap), own)
    return corners


def _until(asked: Asked) -> tuple[str, float]:
    match = _UNTIL.fullmatch(asked.until.strip())
    size = float(match[2]) if match and re.fullmatch(r"\d*\.?\d+(e[-+]?\d+)?", match[2], re.I) else math.nan
    allowed = '"yield +- 0.5%" with a --spec, or a measure such as "k_max +- 5 N/m"'
    if match is None or not 0.0 < size < math.inf:
        fail("is not a precision", key="--until", value=asked.until, allowed=allowed)
    what, unit = match[1], match[3].strip()
    if what == "yield":
        allowed = '"yield +- 0.5%" and a --spec'
        if unit != "%" or not asked.specs:
            fail("needs a --spec, and per cent", key="--until", value=asked.until, allowed=allowed)
        if size >= 50.0:
            fail("tells nothing of a yield", key="--until", value=asked.until, allowed="> 0% and < 50%")
        return what, size / 100.0
    if what not in (*asked.measures, *(spec.measure for spec in asked.specs)):
        fail("is of a measure that is not asked for", key="--until", value=asked.until, allowed=allowed)
    own = UNITS.get(what, "")
    if unit not in ("", own):
        fail("is not the measure's unit", key="--until", value=asked.until, allowed=own or "no unit")
    return what, size


def _endless(n: int, what: str, pilot: Study) -> str:
    """Say why no study reaches a precision."""
    known = int(np.isfinite(pilot.column(what)).sum()) if what in pilot.names else pilot.sampling.n
    if known < _LEAST_KNOWN:
        return f"cannot be judged: {known} of the pilot's {pilot.sampling.n} devices have the measure"
    return f"would take {n if n < BEYOND else f'more than {BEYOND:.0e}'} samples"


def _pilot_seed(seed: int) -> int:
    """Return the seed of the pilot: no sample of it is one of the study."""
    return int.from_bytes(hashlib.sha256(f"pilot {seed}".encode()).digest()[:6], "big")
