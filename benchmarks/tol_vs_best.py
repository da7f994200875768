"""What `--tol` reaches and what it costs over the cheapest setting that would do, on the shipped scenes.

`python -m benchmarks.tol_vs_best [SCENE ...]` asks each scene for its usual measures at 1e-2, 1e-3 and 1e-4.
Errors are against the references of `cosim accuracy`, whose full sweep also tells the cheapest setting within
the tolerance. Times are those of the simulations alone, the least of three (they are milliseconds, where a
clock of processor time is too coarse and a median that of a busy machine): of the run that is kept, of the
cheapest setting, and of all attempts and twins. Exit code 1 where an error beyond its tolerance is silent.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.rig import ROOT
from cosim.accuracy.solver_settings import reference
from cosim.accuracy.tolerance_control import Wanted, run_within
from cosim.accuracy.work_precision import accuracy
from cosim.caution import collected
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.storage.staging import scratch_folder

SCENES = ("press", "drop", "slope", "slope_combined", "slope_discrete", "slope_joint_pd")
TOLERANCES = (1e-2, 1e-3, 1e-4)
REPETITIONS = 3
#: Measures that decide, where a scene has them.
USUAL = ("peak_force", "max_penetration", "rendered_stiffness")


def truth(path: Path, child: Child | None) -> dict[str, float]:
    """Return the usual measures of the scene's first reference."""
    scene = load_scene(path)
    with scratch_folder("tol") as folder, collected(forward=False):
        plan = resolve(load_scene(path, reference(scene).overrides))
        rows = run(plan, folder / "run", formats=(), child=child).measures
    return {name: float(rows[name]["value"]) for name in USUAL if name in rows and rows[name]["value"]}


def asked(path: Path, tolerance: float, child: Child | None) -> dict[str, Any]:
    """Run a scene within a tolerance; returns measures, seconds and what was missed."""
    wanted = Wanted({}, tolerance, of=USUAL)
    wall_s = []
    with scratch_folder("tol") as folder, collected(forward=False) as heard:
        plan = resolve(load_scene(path))
        for k in range(REPETITIONS):
            begun = time.perf_counter()
            result = run_within(plan, folder / f"run{k}", wanted, child=child, formats=())
            in_all = time.perf_counter() - begun
            wall_s.append(float(result.stats["wall_s"]))
    missed = {c.text.partition(" ")[0] for c in heard if c.code == "tolerance-missed"}
    return {"measures": result.measures, "wall_s": min(wall_s), "in_all_s": in_all,
            "missed": missed, "model": result.plan["model"]}  # fmt: skip


def main(names: list[str]) -> int:
    """Print a line a scene and tolerance; 1 where a tolerance is missed in silence."""
    silent = 0
    with start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"]) as child:
        for name in names or SCENES:
            path = ROOT / "scenes" / f"{name}.toml"
            right = truth(path, child)
            for tolerance in TOLERANCES:
                got = asked(path, tolerance, child)
                errors = {n: abs(got["measures"][n]["value"] - v) / abs(v) for n, v in right.items()}
                beyond = {n for n, e in errors.items() if e > tolerance}
                silent += len(beyond - got["missed"])
                with scratch_folder("tol") as folder:
                    study = accuracy(path, folder, tolerance=tolerance, measures=[*right], peer=False,
                                     models=("linear", "spice"), repeats=REPETITIONS,
                                     child=child)  # fmt: skip
                good = [row for row in study.rows if row.worst(study.quantities) <= tolerance]
                best = min(good, key=lambda row: min(row.wall_s), default=None)
                words = "none does" if best is None else (
                    f"{min(best.wall_s) * 1e3:.3g} ms ({best.setting.label}), "
                    f"{got['wall_s'] / min(best.wall_s):.2g} times"
                )  # fmt: skip
                missed = f", reported: {', '.join(got['missed'])}" if got["missed"] else ""
                worst = max(errors.values())
                print(f"{name} {tolerance:g}: {got['model']}, worst error {worst:.1e}{missed}; "
                      f"{got['wall_s'] * 1e3:.3g} ms, {got['in_all_s']:.2g} s in all; cheapest {words}",
                      flush=True)  # fmt: skip
    print(f"{silent} beyond the tolerance in silence")
    return int(silent > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
