"""Whether two versions compute the same, bit for bit: `python -m benchmarks.same_results COMMIT`.

Every shipped scene runs on every circuit model, and every study of the paper with few and short points, once
with the working tree and once with COMMIT. Each version compiles into a cache of its own, `cosim warm` first:
the order in which functions are compiled decides the last bit. Signals, samples, measures with their errors,
tables and verdicts are compared; times, versions and digests are not.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cosim.studies.study import StudyResult

__all__ = ["FALL", "PERIODS", "SHORT", "differences", "first", "small"]

ROOT = Path(__file__).resolve().parents[1]
MODELS = ("ideal", "linear", "spice")
#: Column of a study with the wall time of runs.
_CLOCK = "time [s]"
Case = dict[str, Any]


def first(count: int) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    """Return what keeps the first `count` values of a parameter."""
    return lambda given: given[:count]


#: Periods [s] whose thousandfold is no short decimal in binary: 20.299999999999997, 52.699999999999996.
PERIODS = (0.0203, 0.0527)
FALL = {"window_s": 0.2, "rest_time_s": 0.05, "phases": 1}
#: Study file of the paper -> changes of its parameters with which it is short.
SHORT: dict[str, dict[str, Any]] = {
    "0_1_acceptance": {},
    "0_2_passive": {"depths_m": (0.01,), "dampers_n_s_per_m": (2.0,), "seconds": 0.3},
    "1_fig13": {**FALL, "periods_s": PERIODS, "families": first(1)},
    "3_fig16_18": {"runs": first(1)},
    "4_fig18_poses": {},
    "5_1_eta": {},
    "5_2_rendering": {"cases": first(1), "stiffness_noticed": (0.07, 0.14), "force_noticed": (0.07, 0.29)},
    "5_3_footnote": {"points": 5, "opamps": first(1), "corners_hz": first(1), "drivers_hz": first(1)},
    "5_4_shift": {"periods_s": PERIODS, "cases": first(2), "gains": first(1)},
    "5_5_corner": {"corners_hz": (2.0, 1000.0)},
    "5_6_budget": {},
    "6a_ceiling": {"boards": first(1), "noise_points": 5},
    "6b_onset": {**FALL, "periods_s": PERIODS, "stiffness_n_per_m": (20.0, 25.0), "ways": first(1)},
    "7_footnote2": {},
    "8_device": {},
    "8_maps": {**FALL, "periods_s": PERIODS, "dampings_n_s_per_m": (0.6,), "stiffness_shares": (0.6,),
               "stiffness_n_per_m": (10.0,), "panels": first(1), "widths": first(1)},
}  # fmt: skip


def small(name: str, **changes: Any) -> StudyResult:
    """Run a study of the paper with other parameters, its points one after the other.

    Parameters
    ----------
    name
        Of its file in ``scenes/paper``.
    changes
        Values of parameters, or functions of the values that the file states.
    """
    from cosim.assets import scenes_folder
    from cosim.storage.checkpoint import Points
    from cosim.studies.study import load_study

    class Serial(Points):
        """A pool of processes takes longer to start than these points take."""

        def map(
            self, compute: Callable[[Any], Any], arguments: Mapping[str, Any], workers: int | None = 1
        ) -> list[Any]:
            return super().map(compute, arguments, 1)

    spec = load_study(Path(scenes_folder()) / "paper" / f"{name}.toml")
    given = spec.parameters
    values = {key: value(getattr(given, key)) if callable(value) else value for key, value in changes.items()}
    with Serial(None) as points:
        return spec.study.analyse(replace(spec, parameters=given.model_copy(update=values)), points)


def differences(old: Case, new: Case) -> list[str]:
    """Return what two results of one case do not share, one line each."""
    lines = [f"only one of them has {name}" for name in sorted(old.keys() ^ new.keys())]
    for name in sorted(old.keys() & new.keys()):
        a, b = old[name], new[name]
        if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
            if repr(a) != repr(b):
                lines.append(f"{name}: {a} -> {b}")
        elif a.shape != b.shape:
            lines.append(f"{name}: {len(a)} values -> {len(b)}")
        elif a.tobytes() != b.tobytes():
            lines.append(f"{name}: by up to {np.max(np.abs(a - b)):.3g} of {np.max(np.abs(a)):.3g}")
    return lines


def _scene(path: Path, model: str) -> Case:
    import cosim

    try:
        run = cosim.run(cosim.load_scene(path, [f"solver.model={model}"]))
    except cosim.CosimError as refusal:
        return {"refused": str(refusal).replace(str(path.parents[1]), "")}
    case: Case = {f"signals.{name}": np.array(values) for name, values in run.signals.items()}
    case |= {f"samples.{name}": np.array(values) for name, values in run.samples.items()}
    case |= {f"measures.{name}": dict(row) for name, row in run.measures.items()}
    return case | {"work": dict(run.ledger)}


def _study(name: str) -> Case:
    result = small(name, **SHORT[name])
    case: Case = {f"{table.name}.{key}": list(column) for table in result.tables
                  for key, column in table.columns.items() if key != _CLOCK}  # fmt: skip
    # by place: fields may have got other names
    return case | {f"verdict {k}": tuple(vars(v).values()) for k, v in enumerate(result.verdicts)}


def _cases() -> Iterator[tuple[str, Callable[[], Case]]]:
    from cosim.assets import scenes_folder

    for path in sorted(Path(scenes_folder()).glob("*.toml")):
        for model in MODELS:
            yield f"{path.stem} on {model}", lambda path=path, model=model: _scene(path, model)  # type: ignore[misc]
    for name in SHORT:
        yield name, lambda name=name: _study(name)  # type: ignore[misc]


def _compute(words: Sequence[str], out: Path) -> None:
    """Compute the cases whose names hold one of `words` with whatever cosim is imported."""
    results = {}
    for name, compute in _cases():
        if any(word in name for word in words or [""]):
            print(name, flush=True)
            results[name] = compute()
    out.write_bytes(pickle.dumps(results))


def _computed_by(tree: Path, words: Sequence[str], place: Path) -> dict[str, Case]:
    """Return the results of the sources in `tree`, compiled into a cache below `place`."""
    place.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(place / "cache"),
                   "SOURCE_DATE_EPOCH": "0"}  # fmt: skip
    environment.pop("NUMBA_CACHE_DIR", None)
    out = place / "results"
    program = [sys.executable, "-P"]
    with (place / "log").open("w") as log:
        for arguments in (["-m", "cosim", "warm"], [__file__, "--compute", str(out), *words]):
            done = subprocess.run([*program, *arguments], env=environment, cwd=place, stdout=log, stderr=log)
            if done.returncode:
                sys.exit(f"{tree}: {(place / 'log').read_text()[-3000:]}")
    results: dict[str, Case] = pickle.loads(out.read_bytes())
    return results


def main() -> int:
    """Compare with a commit; exit code 1 when anything differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.same_results", description=__doc__)
    parser.add_argument("commit", help="what to compare the working tree with")
    parser.add_argument("words", nargs="*", help="only cases whose names hold one of these")
    parser.add_argument("--compute", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.compute:
        _compute(args.words, Path(args.commit))
        return 0
    with tempfile.TemporaryDirectory(prefix="cosim-same-") as folder:
        place = Path(folder)
        other = place / "other"
        other.mkdir()
        archive = subprocess.run(
            ["git", "archive", args.commit], cwd=ROOT, check=True, stdout=subprocess.PIPE
        )
        subprocess.run(["tar", "-x", "-C", str(other)], input=archive.stdout, check=True)
        with ThreadPoolExecutor(2) as pool:
            old, new = pool.map(_computed_by, (other, ROOT), [args.words] * 2, (place / "old", place / "new"))
    unequal = 0
    for name in sorted(old | new):
        lines = differences(old[name], new[name])
        unequal += bool(lines)
        print(f"{name}: {'differs' if lines else 'the same'}, {len(new[name])} results")
        print("".join(f"  {line}\n" for line in lines[:5]), end="")
    print(f"{len(new)} cases, {unequal} differ")
    return min(unequal, 1)


if __name__ == "__main__":
    sys.exit(main())
