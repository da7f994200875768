"""Our time over that of the best peer at equal accuracy, over a range of accuracies.

`python -m benchmarks.work_precision [spice|linear] [--out FOLDER]` prints a line an accuracy and the worst of
the range, and draws all settings of all peers.

* `wp_spice`: the lockstep against one deck in plain ngspice (trapezoids and Gear) and
  against PySpice with callbacks in Python, the same netlist, shipped scenes; errors of position and force
  against the references of `cosim accuracy`, processor time. Not above 1. Rounding in the computer is off:
  the deck in plain ngspice does not close the loop but is given the codes of a tight run, so that an encoder
  count which comes a sample early is an error of ours alone, and the same for every setting that has it
  (drop: 2e-3 of the force, at whatever tolerance).
  XSPICE's `filesource` in place of the deck's own sources is drawn, not gated.
* `wp_linear`: our own loop against SciPy's LSODA and Radau and SUNDIALS' CVODE and IDA (where scikit-sundae
  is installed) on the linear system of the drop; errors against matrix exponentials. Not above 0.05.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.callback_peer import callback_rows
from benchmarks.filesource_peer import filesource_rows
from benchmarks.models import Prepared, model, packed, scene, signals
from benchmarks.rig import ROOT, SMOOTH, lockstep, retold
from benchmarks.stiff import DURATION_S, OUR_TOLERANCES, Solver, lsoda, radau, sundials, system
from cosim.accuracy.pareto import Row
from cosim.accuracy.work_precision import accuracy
from cosim.loop.linear.run_linear import prepare
from cosim.ngspice.child import Child, start_early
from cosim.storage.staging import scratch_folder
from reports.accuracy import write_accuracy
from reports.style import INK, JOINTS, figure, look

SCENES = ("press", "drop", "slope")
#: Accuracies of the range, and the peers' tolerances, the loosest first.
SPICE, LINEAR = (1e-2, 1e-3, 1e-4, 1e-5), (1e-2, 1e-4, 1e-6, 1e-8)
PEER_TOLERANCES = tuple(10.0**-k for k in range(2, 12))
LIMITS = {"spice": 1.0, "linear": 0.05}
REPETITIONS = 3
#: What errors are of.
TRACES = ("position", "force")


def wp_spice(out: Path) -> float:
    """Print and return the worst ratio of the lockstep over its peers; pictures go into `out`."""
    worst = 0.0
    with start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"]) as child:
        for name in SCENES:
            path = ROOT / "scenes" / f"{name}.toml"
            with scratch_folder("wp") as folder:
                study = accuracy(path, folder, overrides=SMOOTH, models=("spice",), repeats=REPETITIONS,
                                 child=child)  # fmt: skip
                peers = callback_rows(path, SMOOTH, folder, REPETITIONS)
                drawn = filesource_rows(path, SMOOTH, folder, REPETITIONS)
            study = replace(study, rows=(*study.rows, *peers))
            write_accuracy(replace(study, rows=(*study.rows, *drawn)), out / name)
            for wanted in SPICE:
                best = {}
                for who in ("spice", "peer"):
                    rows = [
                        row for row in study.rows if row.setting.model == who and row.worst(TRACES) <= wanted
                    ]
                    best[who] = min(rows, key=cpu_s, default=None)
                ours, peer = best["spice"], best["peer"]
                ratio = cpu_s(ours) / cpu_s(peer) if ours and peer else math.inf if peer else 0.0
                worst = max(worst, ratio)
                lines = [f"{who} {1e3 * cpu_s(row):.3g} ms ({row.setting.label}, {row.worst(TRACES):.1e})"
                        if row else f"{who}: none" for who, row in best.items()]  # fmt: skip
                print(f"{name} {wanted:g}: {'; '.join(lines)}; ratio {ratio:.3g}", flush=True)
    return worst


def cpu_s(row: Row) -> float:
    """Processor time of a setting [s]: on a busy machine wall time is that of others."""
    return statistics.median(row.cpu_s)


def race(payload: dict[str, Any], report: Any) -> list[dict[str, Any]]:
    """Time all solvers on the linear system of the drop, in the child process."""
    plan = scene("drop", "effects.dac=false", "effects.dac_settling=false", f"duration_s={DURATION_S!r}")
    constants = lockstep(retold(plan)).constants
    assert constants is not None
    circuit = model(plan, "linear", 0.0)
    table = signals(packed(plan, constants, circuit, OUR_TOLERANCES[-1]))
    system_of_scene = system(prepare(plan.scene, constants, circuit, record=False), table)
    truth = system_of_scene.outputs(system_of_scene.exact())
    size = np.abs(truth).max(axis=0)
    instants = system_of_scene.period_s * np.arange(1, len(system_of_scene.a) + 1)

    def ours(tol: float) -> float:
        got = signals(packed(plan, constants, circuit, tol))
        columns = [np.interp(instants, got["time"], got[name]) for name in ("q1", "v1", "imot1")]
        return float((np.abs(np.column_stack(columns) - truth).max(axis=0) / size).max())

    peers: dict[str, Solver] = {"LSODA": lsoda, "Radau": radau, **sundials()}
    made = []
    for name, solver in peers.items():
        for rtol in PEER_TOLERANCES:
            walls = []
            for _ in range(REPETITIONS):
                begun = time.perf_counter()
                points = solver(system_of_scene, rtol)
                walls.append(time.perf_counter() - begun)
            error = float((np.abs(system_of_scene.outputs(points) - truth).max(axis=0) / size).max())
            made.append({"who": name, "tolerance": rtol, "error": error, "wall_s": statistics.median(walls)})
            report({"time_s": rtol})
            if error <= LINEAR[-1]:
                break
    for tol in (1e-3, 1e-4, 1e-5, *OUR_TOLERANCES):
        run = Prepared(plan, constants, circuit, tol)
        wall = statistics.median(run.seconds() for _ in range(5 * REPETITIONS))
        made.append({"who": "ours", "tolerance": tol, "error": ours(tol), "wall_s": wall})
    return made


def wp_linear(out: Path) -> float:
    """Print and return the worst ratio of our own loop over the fastest stiff solver; draw all of them."""
    with Child() as child:
        made = child.call("benchmarks.work_precision:race", {})
    draw(made, out / "linear.png")
    worst = 0.0
    for wanted in LINEAR:
        fit = [each for each in made if each["error"] <= wanted]
        ours = min((e for e in fit if e["who"] == "ours"), key=lambda e: e["wall_s"], default=None)
        peer = min((e for e in fit if e["who"] != "ours"), key=lambda e: e["wall_s"], default=None)
        ratio = ours["wall_s"] / peer["wall_s"] if ours and peer else math.inf if peer else 0.0
        worst = max(worst, ratio)
        lines = [
            f"{e['who']} {1e3 * e['wall_s']:.3g} ms ({e['tolerance']:g}, error {e['error']:.1e})"
            for e in (ours, peer)
            if e
        ]
        print(f"linear {wanted:g}: {'; '.join(lines)}; ratio {ratio:.3g}", flush=True)
    return worst


def draw(made: list[dict[str, Any]], file: Path) -> None:
    """Draw error over time of all solvers on the linear system."""
    with look():
        drawing, grid = figure(4.0, 1, 1)
        axes = grid[0, 0]
        for k, who in enumerate(dict.fromkeys(e["who"] for e in made)):
            rows = sorted((e["wall_s"], e["error"]) for e in made if e["who"] == who)
            color = INK if who == "ours" else JOINTS[k % len(JOINTS)]
            axes.plot(*zip(*rows, strict=True), "o-", color=color, markersize=4, label=who)
        axes.set(xscale="log", yscale="log", xlabel="wall time [s]", ylabel="largest error, relative",
                 title="The drop as a linear system: our loop and general stiff solvers")  # fmt: skip
        axes.legend(frameon=False)
        file.parent.mkdir(parents=True, exist_ok=True)
        drawing.savefig(file)


def main(arguments: list[str]) -> int:
    """Run the races asked for; 1 where one is above its limit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.work_precision")
    parser.add_argument("names", nargs="*", metavar="spice|linear", help="races; by default both")
    parser.add_argument("--out", type=Path, default=Path("out/work_precision"), help="folder of the pictures")
    asked = parser.parse_args(arguments)
    races = {"linear": wp_linear, "spice": wp_spice}
    unknown = [name for name in asked.names if name not in races]
    if unknown:
        parser.error(f"no such race: {', '.join(unknown)}")
    missed = 0
    for name in asked.names or races:
        worst = races[name](asked.out)
        missed += worst > LIMITS[name]
        print(f"wp_{name}: {worst:.3g}, not above {LIMITS[name]:g}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
