"""What a study of accuracy keeps of a run: measures, where the fingertip went, and what it cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import TypedDict

from cosim.ngspice.child import Child, call
from cosim.plan import Plan
from cosim.results import Run
from cosim.types import Array

__all__ = [
    "AXES", "Failed", "First", "Second", "Summary", "instants", "motion", "peers", "summary", "trace_errors",
]  # fmt: skip

#: Signals that errors are measured on: position of the tip [m], force of the operator on the device [N].
AXES = ("x", "y", "fx", "fy")
#: Most instants at which two runs are compared.
_MOST_INSTANTS = 400


class _Motion(TypedDict, total=False):
    x: list[float]
    y: list[float]
    fx: list[float]
    fy: list[float]


class Summary(TypedDict):
    """A kept run, as `summary` returns it."""

    measures: dict[str, float]
    motion: _Motion
    wall_s: float
    cpu_s: float
    setup_s: float
    points: int
    rejected: int
    states: int | None


class First(Summary):
    """The first reference, with the instants at which the others are compared with it."""

    times: list[float]


class Failed(TypedDict):
    """A setting that did not run, and why."""

    failed: str


class _Reason(TypedDict):
    reason: str


class _Peer(TypedDict):
    motion: _Motion
    wall_s: list[float]
    cpu_s: list[float]
    points: int


class Second(Summary):
    """The second reference, with its decks in plain ngspice by label."""

    decks: dict[str, _Peer | _Reason]


def instants(run: Run) -> Array:
    """Return the instants [k] s at which runs are compared: samples, where every run has a point."""
    times = np.asarray(run.samples["time"], np.float64)
    times = times[(times > 0.0) & (times <= run.scene.duration_s)]
    if len(times) > _MOST_INSTANTS:
        times = times[np.unique(np.linspace(0, len(times) - 1, _MOST_INSTANTS).round().astype(int))]
    return times if len(times) else np.array([run.scene.duration_s])


def motion(signals: Mapping[str, Array], times: Array) -> dict[str, list[float]]:
    """Return the signals of `AXES` that there are at given times [k] s, behind their start.

    Where a signal jumps it is the limit from the left, which every integrator has a row for.
    """
    t, first = np.unique(np.asarray(signals["time"]), return_index=True)
    return {
        name: [float(signals[name][0]), *np.interp(times, t, np.asarray(signals[name])[first]).tolist()]
        for name in AXES
        if name in signals
    }


def summary(run: Run, times: Array | None = None) -> dict[str, Any]:
    """Return a run JSON-ready: 'measures', 'motion' at the instants, and the costs, set-up apart."""
    stats = run.stats
    measures = {name: float(row["value"]) for name, row in run.measures.items()}
    return {
        "measures": {name: value for name, value in measures.items() if math.isfinite(value)},
        "motion": motion(run.signals, instants(run) if times is None else times),
        "wall_s": float(stats["wall_s"]),
        "cpu_s": float(stats["cpu_s"]),
        "setup_s": max(float(stats["total_s"]) - float(stats["wall_s"]), 0.0),
        "points": int(stats["points"]),
        "rejected": int(stats["rejected"]),
        "states": run.plan["circuit_states"],
    }


def trace_errors(traces: Mapping[str, list[float]], truth: Mapping[str, list[float]]) -> dict[str, float]:
    """Return the largest errors of 'position' and 'force', as shares of the largest travel and force.

    A tip that does not move, and a force that is zero on both sides, have no error.
    """
    out = {}
    for name, pair in (("position", ("x", "y")), ("force", ("fx", "fy"))):
        if not all(axis in traces and axis in truth for axis in pair):
            continue
        right = np.array([truth[axis] for axis in pair])
        size = right - right[:, :1] if name == "position" else right
        largest = float(np.hypot(*size).max())
        if largest > 0.0:
            out[name] = float(np.hypot(*(np.array([traces[axis] for axis in pair]) - right)).max()) / largest
    return out


def peers(
    decks: Mapping[str, str], plan: Plan, times: Array, repeats: int, child: Child | None
) -> dict[str, Any]:
    """Run whole decks in plain ngspice: label -> 'motion', 'wall_s' and 'cpu_s' by repetition, 'points'."""
    answer: dict[str, Any] = call(
        "cosim.accuracy.run_outcome:run_decks",
        {"decks": dict(decks), "times": times, "repeats": repeats, "end_s": plan.scene.duration_s},
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
        reads=[Path(plan.board.path).parent],
    )
    return answer


def run_decks(payload: dict[str, Any], report: Any) -> dict[str, Any]:
    """Run decks one after the other, in ngspice's process; one that fails has only a 'reason'."""
    import time

    from cosim.errors import CosimError
    from cosim.ngspice.sandbox import processor_s
    from cosim.ngspice.simulator import Simulator

    out: dict[str, Any] = {}
    for label, text in payload["decks"].items():
        lines = text.splitlines()
        command = next(line for line in lines if line.startswith(".tran"))[1:]
        kept = "\n".join(line for line in lines if not line.startswith((".tran", ".meas"))) + "\n"
        walls, cpus = [], []
        try:
            for _ in range(payload["repeats"]):
                simulator = Simulator(on_time=lambda reached: report({"time_s": reached}))
                simulator.load(kept)
                wall, cpu = time.perf_counter(), processor_s()
                simulator.command(command)
                walls.append(time.perf_counter() - wall)
                cpus.append(processor_s() - cpu)
            names = {*simulator.vector_names()}
            signals = {name: np.real(simulator.vector(name)) for name in ("time", *AXES) if name in names}
        except CosimError as error:
            out[label] = {"reason": error.in_brief}
            continue
        out[label] = {
            "motion": motion(signals, payload["times"]),
            "wall_s": walls,
            "cpu_s": cpus,
            "points": len(signals["time"]),
        }
    return out
