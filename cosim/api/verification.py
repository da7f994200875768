"""A result compared with its own repetition."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import cosim
from cosim.errors import fail
from cosim.results import BOARD, RECORD, Run
from cosim.storage.field_types import refuse_code
from cosim.storage.results_nearby import results_below
from cosim.storage.staging import scratch_folder
from cosim.types import Progress

__all__ = ["Verified", "verify"]

_MOST = 100_000


@dataclass(frozen=True)
class Verified:
    """What was repeated, in words, and what differs; empty where all bits are the same."""

    what: str
    repeated: tuple[int, ...]
    different: tuple[str, ...]


def verify(
    folder: str | os.PathLike[str],
    *,
    samples: int = 8,
    seed: int = 0,
    trust: bool = False,
    on_progress: Progress | None = None,
) -> Verified:
    """Repeat a run, or a random sample of a study, from what its folder keeps, and compare bit for bit.

    A run is repeated from the scene and the board that it keeps, even if the netlists have changed since. A
    study is repeated from its scene, which must not have changed.

    Parameters
    ----------
    folder
        Of `cosim run` or `cosim mc`.
    samples, seed
        Of a study: how many samples, and what chooses them.
    trust
        Whether netlists may hold commands and name files, and the Python that a stored scene names may run.

    Raises
    ------
    InputError
        For a folder that holds neither, or another version's result.

    Examples
    --------
    >>> import cosim
    >>> from cosim.assets import scenes_folder
    >>> scene = cosim.load_scene(scenes_folder() / 'drop.toml', ['duration_s=0.02', 'solver.model=linear'])
    >>> run = cosim.run(scene, estimate=False)
    >>> verify(run.signals.path.parent).different
    ()
    """
    place = Path(folder)
    if not 1 <= samples <= _MOST:
        fail("is not a possible number of samples", key="--samples", value=samples, allowed=f"1 to {_MOST}")
    if seed < 0:
        fail("is not a valid seed", key="--seed", value=seed, allowed=">= 0")
    if os.path.isfile(place / RECORD):
        return _run_again(place, trust)
    from cosim.tolerance.replay import repeat_samples
    from cosim.tolerance.sample_store import is_named
    from cosim.tolerance.scene_study import RECORD as STUDY

    if not os.path.isfile(place / STUDY):
        if is_named(place):
            fail(
                "holds an unfinished study, or a shard of one: what can be verified is there once `cosim mc` "
                "has ended; repeat that command, which goes on, or put shards together by `cosim mc --merge`",
                file=str(place),
            )
        fail(
            f"holds neither a run ({RECORD}) nor a study of tolerances ({STUDY})"
            + results_below(place, (RECORD, STUDY)),
            file=str(place),
        )
    numbers, different = repeat_samples(place, samples, seed, trust=trust, on_progress=on_progress)
    return Verified(f"{len(numbers)} samples of a study", tuple(numbers), tuple(different))


def _run_again(folder: Path, trust: bool) -> Verified:
    from cosim.ngspice import deck_file
    from cosim.plan import resolve
    from cosim.runner import run

    kept = Run.load(folder)
    versions = kept.provenance.get("versions", {})
    made = versions.get("cosim") if isinstance(versions, dict) else None
    if made != cosim.__version__:
        fail(
            f"was written by cosim {made}, this is {cosim.__version__}: it can be read and compared "
            "(cosim report, cosim compare --last), but its bits need not come again",
            file=str(folder),
        )
    if not (folder / BOARD).is_file():
        fail("keeps no board to be run again", file=str(folder))
    refuse_code(kept.scene.code(), str(folder), trust=trust)
    plan = resolve(kept.scene, trust=trust, board=deck_file.load(folder, trust=trust))
    with scratch_folder("verify") as scratch:
        again = run(plan, scratch / "run", formats=())
        different = []
        for what, old, new in (
            ("signal", kept.signals, again.signals), ("sample", kept.samples, again.samples),
        ):  # fmt: skip
            names = [*dict.fromkeys([*old, *new])]
            for name in names:
                if name not in old or name not in new:
                    different.append(f"{what} {name}: only in the {'kept' if name in old else 'new'} run")
                    continue
                # a column of a memory map is strided: compare contiguous copies
                a, b = (np.ascontiguousarray(side[name]) for side in (old, new))
                if a.shape != b.shape:
                    different.append(f"{what} {name}: {len(b)} values, kept {len(a)}")
                elif a.tobytes() != b.tobytes():
                    first = int(np.flatnonzero(a.view(np.uint8) != b.view(np.uint8))[0]) // a.itemsize
                    text = f"{what} {name}: {float(b[first])!r} at place {first}, kept {float(a[first])!r}"
                    different.append(text)
    return Verified("a run", (), tuple(different))
