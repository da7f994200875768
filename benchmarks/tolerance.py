"""Monte Carlo: a draw's circuit model against one run of ngspice, and a batch against single runs."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.extraction import peer_ac
from benchmarks.figure import Figure, figure, interleaved
from benchmarks.rig import ROOT, slope
from cosim.circuits.draws.admittances import nominal_values
from cosim.circuits.draws.models import Draws
from cosim.circuits.extraction.extract import extract
from cosim.ngspice.child import Child
from cosim.ngspice.deck import Deck
from cosim.ngspice.placed_values import Placed, board_netlist, walk
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch
from cosim.tolerance.scene_variables import tolerances

Report = Callable[[dict[str, Any]], None]
_DRAWS = 40
#: Samples of the batch that is timed, and single runs; both times are stated per sample.
_BATCH = 50
_SCENE = ROOT / "scenes" / "drop.toml"


def passive(board: Deck) -> list[str]:
    """Return the keys of all resistors and capacitors of a board outside its parts."""
    names = [
        f"{path}.{line.keyword}".removeprefix("xboard.")
        for path, block, *_ in walk(board_netlist(board), board.board)
        if not block.is_part
        for line in block.body
        if line.keyword[0] in "rc"
    ]
    return sorted(names)


def draw_seconds(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Return the wall times [s] of models of draws, and how far some are from extractions of their decks."""
    board, keys = payload["board"], payload["keys"]
    nominal = np.array(nominal_values(board, keys))
    draws = Draws(board, keys, nominal.tolist(), "linear")
    rng = np.random.default_rng(payload["seed"])
    reduced = payload["band_hz"], payload["tolerance"]
    times, kept, anew = [], [], 0
    for draw in range(_DRAWS + 2):
        values = (nominal * rng.uniform(0.95, 1.05, len(keys))).tolist()
        begun = time.perf_counter()
        circuit = draws.at(values, *reduced)
        if draw >= 2:
            times.append(time.perf_counter() - begun)
        anew += "anew" in circuit.certificate
        kept.append((values, circuit))
    s = 2j * np.pi * np.geomspace(0.1, reduced[0], 200)
    worst = 0.0
    for values, circuit in kept[:2] if payload["check"] else []:
        deck = Placed.of(board, keys).deck(values)
        full = extract({"board": deck, "model": "linear", "cache": False}, report)
        held = np.full(len(full.gain), 10.0)
        want, got = full.response(s, held), circuit.response(s, held)
        peak = np.abs(want).max(axis=0)
        worst = max(worst, float((np.abs(got - want).max(axis=0) / np.where(peak > 1e-12, peak, 1.0)).max()))
    return {"times": times, "difference": worst, "anew": anew}


def draws_against_ac(repetitions: int) -> list[Figure]:
    """Model of a draw of all resistors and capacitors of board2, in one process; against `ngspice -b`."""
    plan = slope()
    answers: list[dict[str, Any]] = []
    keys = passive(plan.board)
    solver = plan.scene.solver
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder, Child() as child:

        def ours() -> float:
            payload = {
                "board": plan.board, "keys": keys, "seed": len(answers), "check": not answers,
                "band_hz": solver.band_hz, "tolerance": solver.reduction_tolerance,
            }  # fmt: skip
            answers.append(child.call("benchmarks.tolerance:draw_seconds", payload))
            return statistics.median(answers[-1]["times"])

        walls = interleaved(repetitions, ours, peer_ac(plan.board, folder))
    details = {
        "components": len(keys),
        "ours_ms": 1e3 * statistics.median(walls[0]),
        "ngspice_ms": 1e3 * statistics.median(walls[1]),
        "fitted_anew": sum(answer["anew"] for answer in answers),
    }
    return [
        figure(
            "mc_extraction_vs_ac",
            [a / b for a, b in zip(*walls, strict=True)],
            error_ours=max(answer["difference"] for answer in answers),
            error_peer=0.0,
            error_unit=f"of each path's maximum in the band; against a full extraction, tolerance "
            f"{solver.reduction_tolerance:g}",
            details=details,
        )
    ]


def batch_against_single(repetitions: int) -> list[Figure]:
    """Compare a `linear` drop sample of a batch with one `cosim run` of the same scene."""
    scene = load_scene(_SCENE, ['solver.model="linear"'])
    plan = resolve(scene)
    variables = tolerances(scene, board=plan.board)
    rng = np.random.default_rng(1)
    values = variables.values(rng.uniform(1e-9, 1.0, (_BATCH, len(variables.variables))))
    with (
        tempfile.TemporaryDirectory(prefix="cosim-bench-") as name,
        Batch(plan, variables.keys, ("max_penetration",), designed=variables.nominal.tolist()) as batch,
    ):
        command = [sys.executable, "-m", "cosim", "run", str(_SCENE), "--set", "solver.model=linear",
                   "--out", f"{name}/run"]  # fmt: skip

        def ours() -> float:
            begun = time.perf_counter()
            table = batch.measures(values)
            if not np.isfinite(table).all():
                raise RuntimeError(f"samples failed: {batch.failures}")
            return (time.perf_counter() - begun) / _BATCH

        def peer() -> float:
            begun = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
            return time.perf_counter() - begun

        walls = interleaved(repetitions, ours, peer)
    details = {
        "components": len(variables.keys),
        "ours_ms": 1e3 * statistics.median(walls[0]),
        "cosim_run_ms": 1e3 * statistics.median(walls[1]),
    }
    return [figure("batch_vs_single", [a / b for a, b in zip(*walls, strict=True)], details=details)]
