"""A random sample of a study, measured again from its record and compared bit for bit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from typing_extensions import TypedDict

import cosim
from cosim.errors import InputError, fail
from cosim.scene import load_scene
from cosim.storage.checksums import read_object
from cosim.storage.field_types import fits, refuse_code
from cosim.tolerance.missing import text_of
from cosim.tolerance.preparation import Asked, Prepared, prepare
from cosim.tolerance.sample_store import SAMPLES, Samples
from cosim.tolerance.scene_study import RECORD
from cosim.tolerance.spec import Spec
from cosim.tolerance.unit_cube import Sampling
from cosim.types import Progress

__all__ = ["asked_of", "record_of", "repeat_samples"]


def record_of(prepared: Prepared) -> dict[str, Any]:
    """Return a study's request, JSON-ready, so that it can be repeated."""
    asked, file = prepared.asked, prepared.plan.scene.file
    kept = {name: getattr(asked, name) for name in _PLAIN}
    limits = [
        [spec.measure, *(end if math.isfinite(end) else None for end in (spec.low, spec.high))]
        for spec in asked.specs
    ]
    return {
        "cosim": cosim.__version__, "scene": str(file.resolve()) if file is not None else "",
        "overrides": list(asked.overrides), "measures": list(asked.measures), "specs": limits, **kept,
    }  # fmt: skip


_PLAIN = ("n", "method", "seed", "until", "wanted", "corners", "two_level", "rare")


class _Asked(TypedDict):
    """The form of what is kept."""

    cosim: str
    scene: str
    overrides: list[str]
    measures: list[str]
    specs: list[list[str | float | None]]
    n: int
    method: Literal["plain", "lhs", "sobol"]
    seed: int | None
    until: str
    wanted: float | None
    corners: bool
    two_level: bool
    rare: bool


class _Points(TypedDict):
    """The form of a sampling."""

    method: Literal["plain", "lhs", "sobol"]
    n: int
    variables: int
    seed: int
    replicates: int


def asked_of(stored: Mapping[str, Any], *, trust: bool = False) -> Asked:
    """Return what `record_of` gave."""
    specs = tuple(
        Spec(str(name), -math.inf if low is None else float(low), math.inf if high is None else float(high))
        for name, low, high in stored["specs"]
    )
    plain = {name: stored[name] for name in _PLAIN}
    overrides, measures = (tuple(map(str, stored[name])) for name in ("overrides", "measures"))
    return Asked(str(stored["scene"]), overrides, measures, specs, trust=trust, **plain)


def _is_spec(limits: list[str | float | None]) -> bool:
    return len(limits) == 3 and isinstance(limits[0], str) and not any(isinstance(e, str) for e in limits[1:])


def repeat_samples(
    folder: Path, count: int, seed: int, *, trust: bool = False, on_progress: Progress | None = None
) -> tuple[list[int], list[str]]:
    """Measure some samples of a study again, each alone.

    Parameters
    ----------
    folder
        Of `cosim mc`.
    count, seed
        How many, chosen by `seed`.

    Returns
    -------
    list, list
        Samples that were repeated, and what differs, in words.

    Raises
    ------
    InputError
        For a study of another version, and one whose scene or board has changed since.
    """
    file = folder / RECORD
    record = read_object(file)
    stored = record.get("asked")
    if not isinstance(stored, dict) or not isinstance(record.get("sampling"), dict):
        fail("does not say what was asked: an earlier version wrote it; run the study again", file=str(file))
    if stored.get("cosim") != cosim.__version__:
        fail(
            f"was written by cosim {stored.get('cosim')}, this is {cosim.__version__}: its figures can be "
            "read, but samples of two versions need not be equal; run the study again",
            file=str(file),
        )
    formed = fits(stored, _Asked) and fits(record["sampling"], _Points)
    if not formed or not all(_is_spec(limits) for limits in stored["specs"]):
        fail("is not a record of a study", file=str(file))
    asked, how = asked_of(stored, trust=trust), Sampling.of(record["sampling"])
    refuse_code(load_scene(asked.scene, asked.overrides).code(), str(file), trust=trust)
    try:
        prepared = prepare(asked)
    except InputError as error:  # what the record asks for, or its scene as it is now
        raise InputError(replace(each, file=each.file or str(file)) for each in error.problems) from None
    if prepared.digest() != record.get("digest"):
        fail(
            "the scene, its board or its tolerances have changed since: what is there now is another study",
            file=str(asked.scene),
        )
    if not (folder / SAMPLES).is_file():
        fail("keeps no samples", file=str(folder))
    job = prepared.job(how, how.n)
    kept, failures = Samples(folder, job.digest, prepared.names, 0, how.n, made=True).read()
    chosen = np.random.default_rng(seed).choice(how.n, min(count, how.n), replace=False)
    numbers = sorted(map(int, chosen))
    work, different = job.make(), list[str]()
    for done, number in enumerate(numbers):
        if on_progress is not None:
            on_progress(done, len(numbers), f"sample {number}")
        table, failed = work(number, 1)
        if failed.get(0, {}) != failures.get(number, {}):
            now, before = (
                text_of(of) or "all measures" for of in (failed.get(0, {}), failures.get(number, {}))
            )
            different.append(f"sample {number}: {now}; kept: {before}")
        for name, now, before in zip(prepared.names, table[0], kept[number], strict=True):
            if now.tobytes() != before.tobytes() and not (math.isnan(now) and math.isnan(before)):
                different.append(f"sample {number}: {name} = {now!r}, kept {before!r}")
    return numbers, different
