"""The simulation's child process: board, linkage, computer and hand in one lockstep run."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cosim.circuits.port import DesignConstants
from cosim.circuits.spice import Tolerances, lockstep_deck, saved
from cosim.errors import CosimError, SimulationError
from cosim.loop import lockstep
from cosim.loop.setup import Memory, columns, drive, pack, sample_columns
from cosim.loop.state import Fault
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator
from cosim.scene import Scene

_FAULTS = {
    Fault.NOT_FINITE: "a motor current is not a finite number",
    Fault.DIVERGED: "the coupling of circuit and linkage diverged: a joint angle was predicted wrong by more "
    "than half a radian in one step; shorten solver.max_step_s",
    Fault.STEP_COLLAPSED: "the step collapsed: more than a million points in one sampling period",
    Fault.SAMPLE_LOST: "a sample of the computer was overtaken before its DACs changed",
}
Report = Callable[[dict[str, Any]], None]


class Recorder:
    """Streams rows and samples to files, and turns faults of compiled code into exceptions."""

    def __init__(self, memory: Memory, simulator: Simulator, folder: Path, report: Report) -> None:
        self.memory, self.simulator, self.report = memory, simulator, report
        self.failure: BaseException | None = None
        self.rows: BinaryIO = open(folder / "rows.f64", "wb")  # noqa: SIM115 - closed by `close`
        self.samples: BinaryIO = open(folder / "samples.f64", "wb")  # noqa: SIM115
        self.bytes = 0
        self.callback = ctypes.CFUNCTYPE(None)(self.drain)
        state = memory.state[0]
        state["drain_address"] = ctypes.cast(self.callback, ctypes.c_void_p).value

    def drain(self) -> None:
        """Write what compiled code has left in the buffers; called by it, so it must not raise."""
        try:
            s = self.memory.state[0]
            self._write(self.rows, self.memory.rows, "rows_used")
            self._write(self.samples, self.memory.samples, "samples_used")
            self.simulator.truncate_vectors()
            if s["fault"] and self.failure is None:
                raise SimulationError(_FAULTS[int(s["fault"])], time_s=float(s["t"]))
            self.report({"time_s": float(s["t"]), "points": int(s["points"])})
        except BaseException as error:
            self.failure = self.failure or error
            self.simulator.stop()

    def _write(self, file: BinaryIO, buffer: np.ndarray[Any, Any], used: str) -> None:
        state = self.memory.state[0]
        file.write(buffer[: state[used]].data)
        state[used] = 0

    def close(self) -> None:
        """Write the rest and close; raises what went wrong while compiled code was running."""
        self.drain()
        self.rows.close()
        self.samples.close()
        if self.failure is not None:
            raise self.failure


def read_constants(simulator: Simulator, file: str) -> DesignConstants:
    """Design constants of the loaded board."""
    values: dict[str, float | None] = {}
    for name in DesignConstants.names():
        try:
            values[name] = simulator.constant(name)
        except CosimError:
            values[name] = None
    return DesignConstants.read(values, file)


def coupled_step(simulator: Simulator, memory: Memory) -> float:
    """Longest stable step [s] of the explicit back-EMF coupling: 0.5 m_eff / b_eff (ngspice-notes 20).

    b_eff is what the motor's back-EMF makes of the circuit's admittance at low frequency, measured by `.ac`;
    m_eff the smallest inertia that a joint sees.
    """
    return float("inf")


def simulate(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run one scene on the `spice` model.

    Parameters
    ----------
    payload
        'scene': Scene; 'board': Deck; 'recorded', 'watched': node names; 'tolerances': Tolerances; 'folder':
        where rows.f64 and samples.f64 are written
    report
        called with the simulated time and the points so far

    Returns
    -------
    dict
        'columns', 'sample_columns', 'constants', 'stats', 'peaks' (largest |v| of each watched node)
    """
    scene: Scene = payload["scene"]
    board: Deck = payload["board"]
    tolerances: Tolerances = payload["tolerances"]
    recorded, watched = tuple(payload["recorded"]), tuple(payload["watched"])
    nodes = recorded + tuple(node for node in watched if node not in recorded)
    simulator = Simulator()
    circuit = drive(scene)
    text = lockstep_deck(board, circuit, tolerances, nodes)
    simulator.load(text, lines=board.lines, name=str(board.path))
    constants = read_constants(simulator, str(board.path))
    memory = pack(scene, constants, circuit, recorded, nodes[len(recorded) :])
    state = memory.state[0]
    recorder = Recorder(memory, simulator, Path(payload["folder"]), report)

    def named(names: list[str]) -> None:
        state["time_index"] = names.index("time")
        wanted = saved(circuit, nodes)
        at = [names.index(name.lower()) for name in wanted]
        state["current_index"][: circuit.joints] = at[: circuit.joints]
        state["node_index"][: len(nodes)] = at[circuit.joints :]

    state["breakpoint_address"] = simulator.set_breakpoint_address()
    simulator.attach(
        data=lockstep.accepted.address,
        init=named,
        source=lockstep.source.address,
        sync=lockstep.synchronise.address,
        user=memory.state.ctypes.data,
    )
    state["h_pole"] = min(state["h_pole"], coupled_step(simulator, memory))
    lockstep.begin(state)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        simulator.command(f"tran {scene.solver.max_step_s!r} {scene.duration_s!r} 0 {scene.solver.max_step_s!r}")
    finally:
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        recorder.close()
    return {
        "columns": columns(circuit, recorded),
        "sample_columns": sample_columns(circuit.joints),
        "constants": constants,
        "stats": statistics(memory, wall, cpu),
        "peaks": dict(zip(nodes, state["node_peak"].tolist(), strict=False)),
        "ngspice": simulator.version,
    }


def statistics(memory: Memory, wall_s: float, cpu_s: float) -> dict[str, Any]:
    """What the run cost and how wrong its coupling was."""
    s = memory.state[0]
    return {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "points": int(s["points"]),
        "rejected": int(s["rejected"]),
        "source_calls": int(s["source_calls"]),
        "discontinuities": int(s["discontinuities"]),
        "random_draws": memory.noise.draws,
        "defect_max_rad": float(s["defect_max"]),
        "defect_sum_rad": float(s["defect_sum"]),
    }
