"""The simulation's child process: board, linkage, computer and hand in one lockstep run."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import Drive, lockstep_deck, saved
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.probes import external_probes
from cosim.circuits.extraction.swing import swings as measured_swings
from cosim.errors import CosimError, Crawl, InputError, Problem, SimulationError, StepTooSmall, nearest
from cosim.loop.component_noise import ComponentGrid, component_grid
from cosim.loop.dac_channels import drive
from cosim.loop.setup import Memory, columns, pack, sample_columns
from cosim.loop.signals import Layout, write_signals
from cosim.loop.spice import coupling, watch
from cosim.loop.spice.convergence import PATIENCE, Aid, aided, bound_work, plain_start
from cosim.loop.state import Fault
from cosim.loop.userclass import Said, in_users_words
from cosim.loop.userlaw import UserLaw, load_law
from cosim.measures import AT_LIMIT
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator
from cosim.results import RAW
from cosim.scene import PythonOperator, Scene
from cosim.staging import disk_errors

_FAULTS = {
    Fault.NOT_FINITE: "a motor current is not a finite number",
    Fault.DIVERGED: "the coupling of circuit and linkage diverged: a joint angle was predicted wrong by more "
    "than half a radian in one step; shorten solver.max_step_s",
    Fault.STEP_COLLAPSED: "the steps became endlessly short: more than a million points in one sampling "
    "period; loosen solver.coupling_tolerance_rad or solver.rtol",
    Fault.SAMPLE_LOST: "a sample of the computer was overtaken before its DACs changed",
    Fault.RAN_AWAY: "the device ran away: a joint turns faster than 1e5 rad/s. The closed loop is "
    "unstable or a force has no bounds: look at resistors and gains that were changed (cosim check tells "
    "gains and loop margins), the operator, and the stiffness that the sampling period allows "
    "(cosim stability)",
    Fault.STOPPED: "stopped",
    Fault.CRAWLS: f"ngspice crawls: Newton's method takes {PATIENCE:g} times the steps that were predicted",
}
#: Faults that another error control may get around.
_KINDS = {Fault.STEP_COLLAPSED: StepTooSmall, Fault.CRAWLS: Crawl}
#: Frequency of the low-frequency limit of the back-EMF's viscosity: far below L/R, far above leakage.
_LOW_HZ = 0.1
#: Streamed while the simulation runs, in the result's temporary folder.
ROWS, SAMPLES = "rows.f64", "samples.f64"
Report = Callable[[dict[str, Any]], None]


class Owner(Protocol):
    """Whoever owns time, as a `Recorder` knows it."""

    def truncate_vectors(self) -> bool:
        """Forget what has been handed over; whether that was possible."""

    def stop(self) -> None:
        """End the run at its next point."""


class Recorder:
    """Streams rows and samples to files, and turns faults of compiled code into exceptions."""

    def __init__(
        self,
        memory: Memory,
        simulator: Owner,
        folder: Path,
        report: Report,
        *,
        deck: str | None = None,
        person: str = "operator",
        nodes: Sequence[str] = (),
    ) -> None:
        self.memory, self.simulator, self.report = memory, simulator, report
        self.folder, self.deck, self.person, self.nodes = folder, deck, person, tuple(nodes)
        self.failure: BaseException | None = None
        self.running = True  # only a running analysis can be stopped; another would stop at once later
        self.rows: BinaryIO = open(folder / ROWS, "wb")
        self.samples: BinaryIO = open(folder / SAMPLES, "wb")
        self.bytes = 0
        self.callback = ctypes.CFUNCTYPE(None)(self.drain)
        state = memory.state[0]
        state["drain_address"] = ctypes.cast(self.callback, ctypes.c_void_p).value

    def drain(self) -> None:
        """Write what compiled code has left in the buffers; called by it, so it must not raise."""
        try:
            s = self.memory.state[0]
            with disk_errors(self.folder):
                self._write(self.rows, self.memory.rows, "rows_used")
                self._write(self.samples, self.memory.samples, "samples_used")
            self.simulator.truncate_vectors()
            try:
                self.memory.operator.raise_pending()
            except BaseException as error:
                raise in_users_words(self.person, error, float(s["t"])) from error
            if s["fault"]:
                kind = _KINDS.get(int(s["fault"]), SimulationError)
                raise kind(self._words(s), deck=self.deck, time_s=float(s["t"]))
            self.report({"time_s": float(s["t"]), "points": int(s["points"])})
        except BaseException as error:
            self.fail(error)

    def _words(self, state: np.void) -> str:
        """Return what a fault means; voltages that no circuit has are of the node that is worst."""
        if not self.nodes or state["fault"] != Fault.NOT_FINITE:
            return _FAULTS[int(state["fault"])]
        from cosim.loop.spice.callbacks import NO_VOLTAGE  # which has set the fault

        peaks = state["node_peak"][: len(self.nodes)]
        if not np.all(peaks < NO_VOLTAGE):
            worst = int(np.argmax(np.where(np.isnan(peaks), math.inf, peaks)))
            return (
                f"{self.nodes[worst]} is at {peaks[worst]:.3g} V, which no circuit is: an expression divides "
                "by zero, or a gain has no bounds"
            )
        return _FAULTS[int(state["fault"])]

    def fail(self, error: BaseException) -> None:
        """Keep what went wrong in a callback and stop ngspice at its next point."""
        self.failure = self.failure or error
        if self.running:
            self.simulator.stop()

    def _write(self, file: BinaryIO, buffer: np.ndarray[Any, Any], used: str) -> None:
        state = self.memory.state[0]
        file.write(buffer[: state[used]].data)
        state[used] = 0

    def close(self) -> None:
        """Write the rest and close; raises what went wrong while compiled code was running."""
        self.drain()
        for file in (self.rows, self.samples):
            try:
                with disk_errors(self.folder):
                    file.close()
            except InputError as error:  # the rest in the buffer met a full disk
                self.fail(error)
        if self.failure is not None:
            raise self.failure


def read_constants(simulator: Simulator, file: str) -> DesignConstants:
    """Design constants of the loaded board."""
    values: dict[str, float | None] = {}
    for name in (*DesignConstants.names(), "motor_k"):
        try:
            values[name] = simulator.constant(name)
        except CosimError:
            values[name] = None
    return DesignConstants.read(values, file)


def back_emf_viscosity(simulator: Simulator, circuit: Drive, state: np.void) -> NDArray[np.float64]:
    """Viscosity [n, n] N m s/rad that the motors' back-EMF gives the joints, measured by `.ac` on the board.

    At a low frequency and at the start's gains; zero where the motors have no back-EMF.
    """
    n = circuit.joints
    admittance = np.zeros((n, n))
    if circuit.speeds:
        first = circuit.sources().index("vel1")
        held = {f"v{k:02d}": float(state["out"][k]) for k in range(len(circuit.sources()))}
        simulator.attach(source=lambda name, t: held.get(name, 0.0))  # a probe inside the board is at 0 V
        for j in range(n):
            simulator.command(f"alter @v{first + j:02d}[acmag] = 1")
            simulator.command(f"ac lin 1 {_LOW_HZ} {_LOW_HZ}")
            admittance[:, j] = [np.real(simulator.vector(f"imot{i + 1}")[0]) for i in range(n)]
            simulator.command(f"alter @v{first + j:02d}[acmag] = 0")
    viscosity: NDArray[np.float64] = -float(state["torque_per_amp"]) * float(state["gear"]) * admittance
    return viscosity


def simulate(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run one scene on the `spice` model, with what `convergence` does where ngspice comes to no end.

    Parameters
    ----------
    payload
        'scene': Scene; 'board': Deck; 'recorded', 'watched': node names; 'tolerances': Tolerances;
        'predicted_points': of the run; 'folder': where signals.raw and samples.f64 are written
    report
        called with the simulated time and the points so far

    Returns
    -------
    dict
        'ledger', 'sample_columns', 'constants', 'stats', 'peaks' (largest |v| of each node), 'clipped_s' (how
        long it was at its limit), 'swings' (output limits by node), 'end' (volts of
        'nodes' and 'pins' at the last point, 'speed_rad_per_s' of the fastest joint, 'hung' as of
        `watch.hung`; of a device at rest the 'operating_point' of the nodes), 'ngspice' (version),
        'said' (what the law printed), 'component_noise' (as `ComponentGrid.about`); signals.raw and
        samples.f64 are in the folder
    """
    attempts = 0

    def attempt(aid: Aid) -> dict[str, Any]:
        nonlocal attempts
        attempts += 1
        number = attempts  # each begins at t = 0
        return _simulate(payload, lambda p: report({**p, "attempt": number} if "time_s" in p else p), aid)

    return aided(payload["tolerances"], attempt)


def _simulate(payload: dict[str, Any], report: Report, aid: Aid) -> dict[str, Any]:
    scene: Scene = payload["scene"]
    board: Deck = payload["board"]
    recorded, watched = tuple(payload["recorded"]), tuple(payload["watched"])
    nodes = recorded + tuple(node for node in watched if node not in recorded)
    # ngspice itself tells the time when no point is accepted for long: steps cut endlessly are no progress
    moving = False

    def beat(reached: float) -> None:
        report({"time_s": reached} if moving else {})  # an analysis before the run has its own clock

    component = component_grid(scene, board, report)
    if component is not None:
        board = external_probes(board, _with_probes(component, board))
    simulator = Simulator(on_time=beat)
    measured = measured_swings(simulator, board)  # in decks of their own
    circuit = drive(scene)
    text = lockstep_deck(board, circuit, aid.tolerances, nodes, aid.lines)
    simulator.load(text, lines=board.lines, name=str(board.path))
    constants = read_constants(simulator, str(board.path))
    if component is not None:  # compiled code hears of a probe by ngspice's name
        probes = tuple((simulator.called(name), sign) for name, sign in component.probes)
        component = replace(component, probes=probes)
    memory = pack(scene, constants, circuit, recorded, nodes[len(recorded) :], component=component)
    if not aid.patient:
        tolerance = scene.solver.coupling_tolerance_rad
        bound_work(memory, payload["predicted_points"], scene.duration_s, tolerance)
    swings = {a.out_node: measured[a.path].limit_v for a in board.amplifiers if a.path in measured}
    swings |= {
        a.out_node: simulator.constant(a.swing_param)
        for a in board.amplifiers
        if a.swing_param and a.path not in measured
    }
    state = memory.state[0]
    limits = {node: AT_LIMIT * limit for node, limit in swings.items()}
    state["node_limit"][: len(nodes)] = [limits.get(node, math.inf) for node in nodes]
    watch.begin(state, nodes, swings, scene.computer.period_s)
    missing: list[str] = []
    person = scene.operator.file if isinstance(scene.operator, PythonOperator) else "operator"
    recorder = Recorder(
        memory, simulator, Path(payload["folder"]), report, deck=str(board.path), person=person, nodes=nodes
    )
    recorder.running = False
    said = Said()
    if scene.computer.law is not None:
        where = scene.computer.law
        law = UserLaw(load_law(where, scene.file, said), state, recorder.fail, where, scene, constants, said)
        state["law_address"] = law.address

    def named(names: list[str]) -> None:
        state["time_index"] = names.index("time")
        wanted = [name.lower() for name in saved(circuit, nodes)]
        missing.extend(name for name in wanted if name not in names)
        if missing:
            raise InputError("the board lacks a node")
        at = [names.index(name) for name in wanted]
        state["current_index"][: circuit.joints] = at[: circuit.joints]
        state["node_index"][: len(nodes)] = at[circuit.joints :]

    state["breakpoint_address"] = simulator.set_breakpoint_address()
    coupling.begin(state)
    if recorder.failure is not None:
        raise recorder.failure
    coupling.fill(state, 0.0)
    n = circuit.joints
    if aid.plain:
        held = {f"v{k:02d}": float(state["out"][k]) for k in range(len(circuit.sources()))}
        start = plain_start(simulator, board, circuit, held, aid)
        text = lockstep_deck(board, circuit, aid.tolerances, nodes, [*aid.lines, *start])
        simulator.load(text, lines=board.lines, name=str(board.path))
    state["b_emf"][:n, :n] = back_emf_viscosity(simulator, circuit, state)
    from cosim.loop.spice import callbacks  # compiled on import: not for our own loop's sake

    simulator.attach(
        data=callbacks.accepted.address,
        init=named,
        source=callbacks.source.address,
        sync=callbacks.synchronise.address,
        user=memory.state.ctypes.data,
        data_stays=True,
    )
    wall, cpu = time.perf_counter(), time.process_time()
    moving = recorder.running = True
    try:
        simulator.command(
            f"tran {scene.solver.max_step_s!r} {scene.duration_s!r} 0 {scene.solver.max_step_s!r}"
        )
    except InputError:
        if missing:
            raise unknown_nodes(simulator, text, board, missing) from None
        raise
    finally:
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        recorder.close()
    shafts = scene.effects.shaft
    layout = Layout(tuple(columns(circuit, recorded, shafts=shafts)), circuit, constants, state["p"])
    folder = Path(payload["folder"])
    done = np.array(state["work"]) if shafts else None
    ledger = write_signals(folder / ROWS, folder / RAW, layout, scene.title, done)
    (folder / ROWS).unlink()
    end: dict[str, Any] = {
        "nodes": dict(zip(nodes, state["node_volts"].tolist(), strict=False)),
        "pins": dict(zip(circuit.sources(), state["out"].tolist(), strict=False)),
        "speed_rad_per_s": float(np.abs(state["v"][:n]).max()),
        "hung": watch.hung(state, nodes, circuit),
    }
    if end["speed_rad_per_s"] <= watch.REST_RAD_PER_S:
        end["operating_point"] = watch.operating_point(simulator, list(end["pins"].values()), nodes)
    return {
        "ledger": ledger,
        "sample_columns": sample_columns(circuit.joints),
        "constants": constants,
        "stats": statistics(memory, wall, cpu),
        "component_noise": component.about if component is not None else None,
        "peaks": dict(zip(nodes, state["node_peak"].tolist(), strict=False)),
        "clipped_s": dict(zip(nodes, state["node_clipped"].tolist(), strict=False)),
        "end": end,
        "swings": swings,
        "ngspice": simulator.version,
        "said": said.lines,
    }


def _with_probes(component: ComponentGrid, board: Deck) -> set[str]:
    """Return the names of the probes through which noise enters; `InputError` for a board without any."""
    if not component.probes:
        raise InputError(
            Problem(
                "the multipliers have no 0 V probe in series with X through which noise could enter",
                file=str(board.path),
                key="effects.component_noise",
                value=True,
                allowed="false, or the model ideal or linear",
            )
        )
    return {name for name, _ in component.probes}


def unknown_nodes(simulator: Simulator, text: str, board: Deck, missing: list[str]) -> InputError:
    """Return the error that names the nodes asked for in vain, each with the nearest that the board has."""
    circuit = "\n".join(line for line in text.splitlines() if not line.startswith(".save"))
    simulator.load(circuit)
    simulator.attach(source=lambda name, t: 0.0)
    simulator.command("op")
    names = simulator.vector_names()
    return InputError(
        Problem(
            "the board has no such node" + (f"; nearest is {near}" if (near := nearest(name, names)) else ""),
            file=str(board.path),
            key="record.nodes",
            value=name,
        )
        for name in missing
    )


def statistics(memory: Memory, wall_s: float, cpu_s: float) -> dict[str, Any]:
    """Tell what the run cost and how wrong its coupling was."""
    s = memory.state[0]
    return {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "points": int(s["points"]),
        "rejected": int(s["rejected"]),
        "source_calls": int(s["source_calls"]),
        "discontinuities": int(s["discontinuities"]),
        "random_draws": memory.draws,
        "defect_max_rad": float(s["defect_max"]),
        "defect_sum_rad": float(s["defect_sum"]),
    }
