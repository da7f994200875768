"""Scenes of the random search against whole decks in plain ngspice: `python -m benchmarks.trouble_reference`.

The bound of `spice` comes from `linear`, so that these two agree proves little. A deck holds the linkage as
elements and the DACs as recorded voltages, and shares neither coupling nor integrator of the mechanics, nor
the extraction of a circuit, with either. It is run twice, by Gear's rule and by trapezoids; what these two
disagree by is the floor. Compared are the largest force and the deepest penetration at the samples. A scene
that cannot be written as a deck is left out and counted by the reason.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.rig import ROOT
from benchmarks.trouble_scenes import Drawn, drawn
from cosim.accuracy.estimate import estimator
from cosim.accuracy.run_outcome import instants, motion, peers
from cosim.accuracy.solver_settings import carries
from cosim.caution import collected
from cosim.circuits.decks import Tolerances
from cosim.errors import CosimError, InputError
from cosim.export.scene_deck import deck_lines
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import Scene, load_scene
from cosim.storage.staging import scratch_folder

#: Both decks: method, and steps as a share of the scene's.
_DECKS = {"gear": 1.0 / 40.0, "trap": 1.0 / 25.0}
#: Bounds are of 95 %: beyond three times them is no chance.
_CHANCE = 3.0
#: A deck's DACs without settling take 100 ns to jump; shares of the largest value.
_JUMPS, _SETTLES = 2e-5, 1e-6


def peaks(scene: Scene, traces: dict[str, list[float]]) -> dict[str, float]:
    """Return the largest force [N] and the deepest penetration [m] of traces at the samples."""
    out = {"peak_force": float(np.hypot(traces["fx"], traces["fy"]).max())}
    if scene.wall is not None:
        (px, py), (nx, ny) = scene.wall.point_m, scene.wall.normal
        depth = (px - np.array(traces["x"])) * nx + (py - np.array(traces["y"])) * ny
        out["max_penetration"] = float(max(depth.max(), 0.0))
    return out


def compared(scene: Drawn, child: Child) -> dict[str, Any]:
    """Run a scene on its models and as decks; measure -> value, floor, and error over bound by model."""
    models = [m for m in ("spice", "linear") if carries(load_scene(scene.file, scene.overrides({})), m)]
    decks: dict[str, Any] = {}
    rows: dict[str, dict[str, Any]] = {}
    codes = None
    for model in models:
        tables = load_scene(
            scene.file, scene.overrides({"solver.model": model, "solver.time_limit_s": 900.0})
        )
        with scratch_folder("trouble") as folder, collected(forward=False):
            plan = resolve(tables)
            done = run(plan, folder / "run", formats=(), child=child, errors=estimator(plan, child))
            if model == "spice":
                times, codes = instants(done), np.asarray(done.samples["u_rad1"])
                for method, share in _DECKS.items():
                    step = max(share * min(tables.solver.max_step_s, tables.computer.period_s), 1e-9)
                    solver = tables.solver.model_copy(update={"max_step_s": step})
                    fine = replace(plan, scene=tables.model_copy(update={"solver": solver}),
                                   tolerances=Tolerances(1e-7, method, 1e-13))  # fmt: skip
                    decks[method] = "\n".join(deck_lines(fine, done)) + "\n"
                decks = peers(decks, plan, times, 1, child)
                failed = next((each["reason"] for each in decks.values() if "reason" in each), None)
                if failed:
                    return {"outcome": "no deck", "words": failed}
                gear, trap = (peaks(tables, decks[method]["motion"]) for method in _DECKS)
            assert codes is not None
            if not np.allclose(np.asarray(done.samples["u_rad1"]), codes, rtol=0.0, atol=1e-9):
                continue  # another count of an encoder: the deck has the codes of `spice`
            got = peaks(tables, motion(done.signals, times))
            for name, right in gear.items():
                bound = done.measures[name].get("error")
                least = (_SETTLES if tables.effects.dac_settling else _JUMPS) * abs(right)
                floor = abs(right - trap[name]) + least
                apart = abs(got[name] - right)
                if bound is not None and right != 0.0:
                    rows[f"{model} {name}"] = {"value": right, "apart": apart, "bound": bound, "floor": floor,
                                               "over": apart / (bound + floor)}  # fmt: skip
    worst = max((row["over"] for row in rows.values()), default=0.0)
    return {"outcome": "apart" if worst > _CHANCE else "held" if worst <= 1.0 else "nearly", "rows": rows}


def main() -> int:
    """Compare every scene that can be written as a deck; 1 where one is apart."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trouble_reference")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-n", type=int, default=100, help="how many scenes are looked at")
    args = parser.parse_args()
    counts: Counter[str] = Counter()
    child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
    for number in range(args.n):
        scene = drawn(args.seed, number)
        if scene.slip is not None:
            continue
        if not child.alive:
            child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
        try:
            seen = compared(scene, child)
        except InputError as error:
            seen = {"outcome": "no deck", "words": error.problems[0].message}
        except CosimError as error:
            seen = {"outcome": "failed", "words": str(error).splitlines()[0]}
        counts[seen["outcome"]] += 1
        print(json.dumps({"number": number, **seen}), flush=True)
    child.close()
    print(", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    return int(counts["apart"] > 0)


if __name__ == "__main__":
    sys.exit(main())
