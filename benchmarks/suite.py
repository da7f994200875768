"""The benchmarks by name; each returns its figures."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import choice, extraction, models, monte_carlo, stiff, sweeps, tolerance
from benchmarks.chains import chain_plan
from benchmarks.figure import Figure, figure, interleaved
from benchmarks.rig import CURRENTS, ROOT, SLOPE, Outcome, error, instants, slope
from cosim.ngspice.child import Child

_RELATIVE = "of the largest motor current"
#: Length of the runs of the growth figure [s], and its joints.
GROWTH_S, GROWTH_JOINTS = 1.0, (1, 2, 3, 4, 5, 6)


def _call(function: str, **payload: Any) -> Any:
    """Run a function of `benchmarks.sides` in a fresh process."""
    with Child() as child:
        return child.call(f"benchmarks.sides:{function}", payload)


def _ratios(ours: list[float], peer: list[float]) -> list[float]:
    return [a / b for a, b in zip(ours, peer, strict=True)]


def _ms(seconds: list[float]) -> float:
    return 1e3 * statistics.median(seconds)


def replay(repetitions: int) -> list[Figure]:
    """Lockstep against the same library and deck with recorded sources."""
    got = _call("replay_pair", plan=slope(), repetitions=repetitions)
    ours, peer = got["walls"]
    points = got["points"]
    errors = {
        "error_ours": got["error_ours"],
        "error_peer": got["error_peer"],
        "error_unit": f"{_RELATIVE}; each against its own tight run, ours without rounding in the computer",
    }
    details = {
        "ours_ms": _ms(ours),
        "replay_ms": _ms(peer),
        "ratio_of_fastest": min(ours) / min(peer),
        "points": points,
        "rejected": got["rejected"],
        "difference_of_the_two": got["difference"],
    }
    ratio = points[0] / points[1]
    return [
        figure("lockstep_vs_replay", _ratios(ours, peer), **errors, details=details),
        figure("lockstep_vs_replay_points", [ratio], **errors, details={"points": points}),
    ]


def callbacks(repetitions: int) -> list[Figure]:
    """Share of the compiled callbacks in the wall time of a run."""
    got = _call("callback_times", plan=slope(), repetitions=repetitions)
    work, empty, wall = got["walls"]
    shares = [(a - b) / c for a, b, c in zip(work, empty, wall, strict=True)]
    details = {
        "callbacks_ms": _ms(work) - _ms(empty),
        "loop_ms": _ms(empty),
        "wall_ms": _ms(wall),
        "share_with_the_loop": statistics.median(work) / statistics.median(wall),
        "calls": got["calls"],
    }
    return [figure("callback_share", shares, details=details)]


def monolithic(repetitions: int) -> list[Figure]:
    """Lockstep against the linkage as elements of the deck."""
    got = _call("monolithic_choice", repetitions=repetitions)
    ours, peer = got["walls"]
    details = {key: value for key, value in got.items() if not key.startswith(("walls", "error"))}
    details |= {"ours_ms": _ms(ours), "peer_ms": _ms(peer)}
    return [
        figure(
            "lockstep_vs_monolithic",
            _ratios(ours, peer),
            error_ours=got["error_ours"],
            error_peer=got["error_peer"],
            error_unit="of the largest motor current or joint angle; both against one tight lockstep",
            details=details,
        )
    ]


def pyspice(repetitions: int) -> list[Figure]:
    """Compiled callbacks against the same lockstep in PySpice's own style."""
    plan = slope()
    with Child() as compiled, Child() as plain:

        def ours() -> float:
            return float(compiled.call("benchmarks.sides:lockstep_wall", {"plan": plan}))

        def peer() -> float:
            return Outcome(**plain.call("benchmarks.pyspice:run", payload)).wall_s

        truth = Outcome(**compiled.call("benchmarks.sides:lockstep_run", {"plan": plan}))
        payload = {"plan": plan, "constants": truth.constants}
        once = Outcome(**plain.call("benchmarks.pyspice:run", payload))
        walls = interleaved(repetitions, ours, peer)
    difference = error(once.signals, truth.signals, CURRENTS, instants(plan))
    return [
        figure(
            "lockstep_vs_pyspice",
            _ratios(*walls),
            error_ours=0.0,
            error_peer=difference,
            error_unit=f"{_RELATIVE}; difference of the two",
            details={
                "ours_ms": _ms(walls[0]),
                "pyspice_ms": _ms(walls[1]),
                "points": (truth.stats["points"], once.stats["points"]),
            },
        )
    ]


def growth(repetitions: int) -> list[Figure]:
    """Wall time against number of equations, 1 to 6 joints."""
    rows: dict[int, dict[str, Any]] = {}
    walls: dict[int, list[float]] = {n: [] for n in GROWTH_JOINTS}
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name, Child() as child:
        plans = {n: chain_plan(n, Path(name) / str(n), GROWTH_S) for n in GROWTH_JOINTS}
        for plan in plans.values():
            plan.stated()  # read by a process of its own, which the confined child could not start
        for repetition in range(repetitions + 1):
            for n, plan in plans.items():
                payload = {"plan": plan, "count": repetition == 0}
                got = child.call("benchmarks.sides:growth_run", payload)
                if repetition == 0:
                    rows[n] = got
                else:
                    walls[n].append(got["wall_s"])
    size = np.log([rows[n]["equations"] for n in GROWTH_JOINTS])

    def exponent(times: list[float]) -> float:
        return float(np.polyfit(size, np.log(times), 1)[0])

    each = [exponent([walls[n][k] for n in GROWTH_JOINTS]) for k in range(repetitions)]
    middle = {n: statistics.median(walls[n]) for n in GROWTH_JOINTS}
    details = {
        f"{n} joints": {
            "equations": rows[n]["equations"],
            "points": rows[n]["points"],
            "s_per_simulated_s": middle[n] / GROWTH_S,
            "us_per_point": 1e6 * middle[n] / rows[n]["points"],
        }
        for n in GROWTH_JOINTS
    }
    ratio = exponent(list(middle.values()))
    return [figure("growth_exponent", each, ratio=ratio, details=details)]


def memory(repetitions: int) -> list[Figure]:
    """Peak resident memory of a 100 s scene; measured once, it does not vary."""
    back_and_forth = ", ".join(
        f"[{2 * k + t!r}, {x!r}, {y!r}]"
        for k in range(50)
        for t, x, y in ((0.4, 0.02404, 0.10904), (1.4, 0.06646, 0.15146))
    )
    plan = slope(
        "duration_s=100.0",
        f"operator.waypoints_s_m=[[0.0, 0.01697, 0.11611], {back_and_forth}]",
    )
    got = _call("memory_run", plan=plan)
    return [figure("memory_100s_mb", [got["peak_mb"]], details={"points": got["points"]})]


def _seconds(command: list[str]) -> float:
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return time.perf_counter() - begun


def _cosim() -> list[str]:
    """Return the command as installed beside this Python, else as a module."""
    script = Path(sys.executable).with_name("cosim")
    return [str(script)] if script.exists() else [sys.executable, "-m", "cosim"]


def help_time(repetitions: int) -> list[Figure]:
    """Compare `cosim --help` with importing numpy."""
    ours, peer = interleaved(
        repetitions,
        lambda: _seconds([*_cosim(), "--help"]),
        lambda: _seconds([sys.executable, "-c", "import numpy"]),
    )
    details = {"help_ms": _ms(ours), "numpy_ms": _ms(peer)}
    return [figure("help_vs_numpy", _ratios(ours, peer), details=details)]


def warm(repetitions: int, name: str = "warm_run_outside_s", *model: str) -> list[Figure]:
    """Wall time of a whole `cosim run`, less its simulation."""
    outside, inside = [], []
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        command = [*_cosim(), "run", str(SLOPE), *model, "--out", f"{folder}/run", "--json"]
        for repetition in range(repetitions + 1):
            begun = time.perf_counter()
            done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
            wall = time.perf_counter() - begun
            simulated = json.loads(done.stdout)["runs"][0]["stats"]["wall_s"]
            if repetition:
                outside.append(wall - simulated)
                inside.append(simulated)
    details = {"simulation_ms": _ms(inside)}
    return [figure(name, outside, details=details)]


def warm_linear(repetitions: int) -> list[Figure]:
    """Measure the same on `linear`, whose simulation takes ten milliseconds."""
    return warm(repetitions, "warm_linear_outside_s", "--model", "linear")


def limits(repetitions: int) -> list[Figure]:
    """Wall time of a whole `cosim stability` of a scene whose circuit is known."""
    command = [*_cosim(), "stability", str(SLOPE.with_name("press.toml"))]
    _seconds(command)
    return [figure("stability_s", [_seconds(command) for _ in range(repetitions)])]


#: Figures of each measurement, and the measurement.
SUITE: dict[tuple[str, ...], Callable[[int], list[Figure]]] = {
    ("lockstep_vs_replay", "lockstep_vs_replay_points"): replay,
    ("callback_share",): callbacks,
    ("lockstep_vs_monolithic",): monolithic,
    ("lockstep_vs_pyspice",): pyspice,
    ("growth_exponent",): growth,
    ("memory_100s_mb",): memory,
    ("help_vs_numpy",): help_time,
    ("warm_run_outside_s",): warm,
    ("warm_linear_outside_s",): warm_linear,
    ("stability_s",): limits,
    ("linear_vs_monolithic_slope",): models.linear_slope,
    ("ideal_vs_monolithic_slope",): models.ideal_slope,
    ("linear_vs_monolithic_drop",): models.linear_drop,
    ("linear_vs_stiff_solvers",): stiff.solvers,
    ("extraction_vs_ac",): extraction.cold,
    ("reextraction_vs_ac",): extraction.after_changes,
    ("auto_vs_all_effects",): choice.chosen,
    ("fig13_vs_monolithic",): sweeps.fig13,
    ("border_map",): sweeps.borders,
    ("extraction_cached_ms",): extraction.cached,
    ("mc_extraction_vs_ac",): tolerance.draws_against_ac,
    ("batch_vs_single",): tolerance.batch_against_single,
    ("two_level_vs_plain_press",): monte_carlo.two_levels("press"),
    ("two_level_vs_plain_drop",): monte_carlo.two_levels("drop"),
    ("two_level_vs_plain_slope",): monte_carlo.two_levels("slope"),
    ("yield_vs_plain",): monte_carlo.yields,
    ("engine_overhead",): monte_carlo.engine_overhead,
    ("two_cores",): monte_carlo.two_cores,
}
