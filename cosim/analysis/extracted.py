"""The circuit model and the design constants of a planned scene, from ngspice's child process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cosim.circuits.decks import lockstep_deck
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.design_numbers import read_constants
from cosim.circuits.extraction.extract import extract
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.dac_channels import drive
from cosim.ngspice.child import Child, call
from cosim.ngspice.simulator import Simulator
from cosim.plan import Plan

__all__ = ["circuit_of"]


def circuit_of(
    plan: Plan, *, reduced: bool = False, child: Child | None = None
) -> tuple[LinearCircuit, DesignConstants]:
    """Return the linear circuit of a plan and its board's constants.

    A plan for `spice` is studied with the `linear` model of the same parts.

    Parameters
    ----------
    reduced
        Whether it is reduced as the scene's solver asks for, as it is in runs; whole otherwise.

    Raises
    ------
    InputError
        For a board that has no such model.
    """
    payload: dict[str, Any] = {
        "board": plan.board,
        "model": "ideal" if plan.model == "ideal" else "linear",
        "scene": plan.scene,
        "tolerances": plan.tolerances,
    }
    if reduced:
        solver = plan.scene.solver
        payload |= {"band_hz": solver.band_hz, "tolerance": solver.reduction_tolerance}
    found: tuple[LinearCircuit, DesignConstants] = call(
        "cosim.analysis.extracted:ask",
        payload,
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
    )
    return found


def ask(
    payload: dict[str, Any], report: Callable[[dict[str, Any]], None]
) -> tuple[LinearCircuit, DesignConstants]:
    """Extract the circuit and read the constants; runs in the child."""
    board = payload["board"]
    asked: dict[str, Any] = {
        k: payload[k] for k in ("board", "model", "band_hz", "tolerance") if k in payload
    }
    circuit = extract(asked, report)
    simulator = Simulator()
    deck = lockstep_deck(board, drive(payload["scene"]), payload["tolerances"], ())
    simulator.load(deck, lines=board.lines, name=str(board.path))
    return circuit, read_constants(simulator, str(board.path))
