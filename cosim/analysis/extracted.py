"""The circuit model and the design constants of a planned scene, from ngspice's child process."""

from __future__ import annotations

from cosim.circuits import cache
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.ngspice.child import Child, call
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
        Whether it is reduced as the scene's solver asks for, as it is in runs; all poles otherwise.

    Raises
    ------
    InputError
        For a board that has no such model.
    """
    solver, board = plan.scene.solver, plan.board
    model = "ideal" if plan.model == "ideal" else "linear"
    band_hz, tolerance = (solver.band_hz, solver.reduction_tolerance) if reduced else (0.0, 0.0)
    circuit, _ = cache.load(cache.Asked(board.text, model, band_hz, tolerance))
    if circuit is None:
        circuit = call(
            "cosim.circuits.extraction.extract:extract",
            {"board": board, "model": model, "band_hz": band_hz, "tolerance": tolerance},
            time_limit_s=solver.time_limit_s,
            deck=str(board.path),
            child=child,
        )
    return circuit, plan.stated(child).constants()
