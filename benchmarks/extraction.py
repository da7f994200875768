"""Extraction of board2, cold, after changed values and from the cache, against one run of ngspice on it."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figure import Figure, figure, interleaved
from benchmarks.rig import slope
from cosim.circuits.decks import Drive, testbench
from cosim.circuits.extraction.alter import altered
from cosim.circuits.extraction.extract import extract
from cosim.circuits.extraction.reextract import Reextraction
from cosim.circuits.linear_circuit import LinearCircuit
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
        seconds_taken: list[float] = child.call(
            "benchmarks.extraction:seconds", {"asked": asked, "times": times}
        )
    return seconds_taken


#: Parts of the board with a tolerance, and a parameter that stands in expressions too.
_PARTS = {
    "r_diff_in": 10e3, "r_diff_fb": 169e3, "c_der_in": 1e-6, "r_der_fb": 100e3, "r_der_in": 1.58e3,
    "c_der_fb": 1e-9, "r_sum_fb": 10e3, "r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_sum_cmd": 20e3,
    "r_drv_in": 10e3, "r_drv_fb": 20e3, "motor_l": 1.5e-3,
}  # fmt: skip
_PARAMETER = {"motor_r": 5.0}
_DRAWS = 20


def again_seconds(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Return the wall times [s] of extractions after changed values, and how far they are from full ones."""
    asked = payload["asked"]
    board: Deck = asked["board"]
    session = Reextraction(board, asked["band_hz"], asked["tolerance"])
    rng = np.random.default_rng(payload["seed"])
    times: dict[str, list[float]] = {"parts": [], "with_a_parameter": []}
    kept: list[tuple[dict[str, float], LinearCircuit]] = []
    anew = 0
    for name, nominal in (("parts", _PARTS), ("with_a_parameter", _PARTS | _PARAMETER)):
        for draw in range(_DRAWS + 2):
            values = {key: value * rng.uniform(0.95, 1.05) for key, value in nominal.items()}
            begun = time.perf_counter()
            circuit = session.at(values)
            if draw >= 2:  # ngspice orders its matrix in the first
                times[name].append(time.perf_counter() - begun)
            anew += "extracted_anew" in circuit.certificate
        kept.append((values, circuit))
    s = 2j * np.pi * np.geomspace(0.1, asked["band_hz"], 200)
    worst = 0.0
    for values, circuit in kept:
        deck = altered(board, {key: repr(value) for key, value in values.items()})
        full = extract({"board": deck, "model": "linear", "cache": False}, report)
        held = np.full(len(full.gain), 10.0)
        want, got = full.response(s, held), circuit.response(s, held)
        peak = np.abs(want).max(axis=0)
        worst = max(worst, float((np.abs(got - want).max(axis=0) / np.where(peak > 1e-12, peak, 1.0)).max()))
    return {"times": times, "difference": worst, "anew": anew}


def peer_ac(board: Deck, folder: str) -> Callable[[], float]:
    """Return a function that runs `ngspice -b` on one `.ac` and tells its wall time [s]."""
    program = shutil.which("ngspice")
    if program is None:
        raise RuntimeError("the program ngspice is not installed")
    file = Path(folder) / "board2.cir"
    file.write_text(deck(board), encoding="utf-8")
    command = [program, "-n", "-b", "-r", str(file.with_suffix(".raw")), str(file)]

    def peer() -> float:
        begun = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd=folder)
        return time.perf_counter() - begun

    peer()
    if b"No. Points: 181" not in file.with_suffix(".raw").read_bytes()[:1000]:
        raise RuntimeError("ngspice did not write 181 points")
    return peer


def cold(repetitions: int) -> list[Figure]:
    """Extract in a process that has imported everything but extracted nothing; compare with `ngspice -b`."""
    plan = slope()
    asked = _asked(plan, False)
    again: list[float] = []

    def ours() -> float:
        first, *rest = _in_fresh_process(asked, 3)
        again.extend(rest)
        return first

    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        walls = interleaved(repetitions, ours, peer_ac(plan.board, folder))
    details = {
        "ours_ms": 1e3 * statistics.median(walls[0]),
        "ngspice_ms": 1e3 * statistics.median(walls[1]),
        "ours_again_in_one_process_ms": 1e3 * statistics.median(again),
    }
    ratios = [a / b for a, b in zip(*walls, strict=True)]
    return [figure("extraction_vs_ac", ratios, details=details)]


def after_changes(repetitions: int) -> list[Figure]:
    """Extract again in one process after 13 values changed by up to 5 %; compare with `ngspice -b`."""
    plan = slope()
    asked = _asked(plan, False)
    answers: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder, Child() as child:

        def ours() -> float:
            payload = {"asked": asked, "seed": len(answers)}
            answers.append(child.call("benchmarks.extraction:again_seconds", payload))
            return statistics.median(answers[-1]["times"]["parts"])

        walls = interleaved(repetitions, ours, peer_ac(plan.board, folder))
    longer = [t for answer in answers[1:] for t in answer["times"]["with_a_parameter"]]
    details = {
        "ours_ms": 1e3 * statistics.median(walls[0]),
        "ngspice_ms": 1e3 * statistics.median(walls[1]),
        "ours_with_a_parameter_ms": 1e3 * statistics.median(longer),
        "extracted_anew": sum(answer["anew"] for answer in answers),
    }
    ratios = [a / b for a, b in zip(*walls, strict=True)]
    return [
        figure(
            "reextraction_vs_ac",
            ratios,
            error_ours=max(answer["difference"] for answer in answers),
            error_peer=0.0,
            error_unit="of each path's maximum in the band; against a full extraction, tolerance "
            f"{asked['tolerance']:g}",
            details=details,
        )
    ]


def cached(repetitions: int) -> list[Figure]:
    """Extract an unchanged board, in fresh processes."""
    asked = _asked(slope(), True)
    _in_fresh_process(asked, 1)
    times = [_in_fresh_process(asked, 3) for _ in range(repetitions)]
    details = {"again_in_one_process_ms": 1e3 * statistics.median([t for times in times for t in times[1:]])}
    return [figure("extraction_cached_ms", [1e3 * times[0] for times in times], details=details)]
