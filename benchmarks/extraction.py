"""Extraction of board2: from cold against one run of ngspice on the same board, and from the cache."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.figure import Figure, figure, interleaved
from benchmarks.rig import slope
from cosim.circuits.extraction import extract
from cosim.circuits.spice import Drive, testbench
from cosim.ngspice.child import Child
from cosim.ngspice.deck import Deck
from cosim.plan import Plan

Report = Callable[[dict[str, Any]], None]
#: 181 points: twenty a decade over nine decades.
SWEEP = "dec 20 0.1 100meg"


def _asked(plan: Plan, cache: bool) -> dict[str, Any]:
    """Return the question that `cosim run` asks."""
    solver = plan.scene.solver
    return {
        "board": plan.board,
        "model": "linear",
        "band_hz": solver.band_hz,
        "tolerance": solver.reduction_tolerance,
        "cache": cache,
    }


def seconds(payload: dict[str, Any], report: Report) -> list[float]:
    """Return the wall times [s] of extractions in this process, one after the other."""
    asked, times = payload["asked"], []
    for _ in range(payload["times"]):
        begun = time.perf_counter()
        extract(asked, lambda progress: None)
        times.append(time.perf_counter() - begun)
    return times


def deck(board: Deck) -> str:
    """Return the deck of one `.ac`, from the first angle to the motor currents."""
    drive = Drive(board.joints, False, ())
    pins = {pin: "dc 0 ac 1" if pin == "pot1" else "dc 0 ac 0" for pin in drive.sources()}
    lines = ["one sweep", *board.text.splitlines()[1:], *testbench(board, drive, pins)]
    lines += [f".ac {SWEEP}", ".save v(imot1) v(imot2)", ".end"]
    return "\n".join(lines) + "\n"


def _in_fresh_process(asked: dict[str, Any], times: int) -> list[float]:
    with Child() as child:
        found: list[float] = child.call("benchmarks.extraction:seconds", {"asked": asked, "times": times})
    return found


def cold(repetitions: int) -> list[Figure]:
    """Extract in a process that has imported everything but extracted nothing; compare with `ngspice -b`."""
    plan = slope()
    program = shutil.which("ngspice")
    if program is None:
        raise RuntimeError("the program ngspice is not installed")
    asked = _asked(plan, False)
    again: list[float] = []
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        file = Path(folder) / "board2.cir"
        file.write_text(deck(plan.board), encoding="utf-8")
        command = [program, "-n", "-b", "-r", str(file.with_suffix(".raw")), str(file)]

        def peer() -> float:
            begun = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True, cwd=folder)
            return time.perf_counter() - begun

        def ours() -> float:
            first, *rest = _in_fresh_process(asked, 3)
            again.extend(rest)
            return first

        walls = interleaved(repetitions, ours, peer)
        raw = file.with_suffix(".raw").read_bytes()
    if b"No. Points: 181" not in raw[:1000]:
        raise RuntimeError("ngspice did not write 181 points")
    details = {
        "ours_ms": 1e3 * statistics.median(walls[0]),
        "ngspice_ms": 1e3 * statistics.median(walls[1]),
        "ours_again_in_one_process_ms": 1e3 * statistics.median(again),
    }
    ratios = [a / b for a, b in zip(*walls, strict=True)]
    return [figure("extraction_vs_ac", ratios, details=details)]


def cached(repetitions: int) -> list[Figure]:
    """Extract an unchanged board, in fresh processes."""
    asked = _asked(slope(), True)
    _in_fresh_process(asked, 1)
    found = [_in_fresh_process(asked, 3) for _ in range(repetitions)]
    details = {"again_in_one_process_ms": 1e3 * statistics.median([t for times in found for t in times[1:]])}
    return [figure("extraction_cached_ms", [1e3 * times[0] for times in found], details=details)]
