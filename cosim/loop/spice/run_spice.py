"""The simulation's child process: board, linkage, computer and hand in one lockstep run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import REST_RAD_PER_S, Drive, lockstep_deck, saved
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.probes import external_probes
from cosim.circuits.extraction.swing import Swing
from cosim.circuits.extraction.swing import swings as measured_swings
from cosim.errors import InputError, Problem, fail, nearest
from cosim.loop import events
from cosim.loop.columns import columns, sample_columns
from cosim.loop.component_noise import ComponentGrid, component_grid
from cosim.loop.dac_channels import drive
from cosim.loop.recorder import ROWS, Recorder, statistics
from cosim.loop.run_messages import RunAnswer, RunRequest
from cosim.loop.setup import Memory, pack
from cosim.loop.signals import Layout, write_signals
from cosim.loop.spice import coupling, watch
from cosim.loop.spice.convergence import Aid, aided, bound_work, plain_start
from cosim.loop.userclass import PrintCapture
from cosim.loop.userlaw import UserLaw, load_law
from cosim.measures import AT_LIMIT
from cosim.ngspice.deck import Deck
from cosim.ngspice.sandbox import processor_s
from cosim.ngspice.simulator import Simulator
from cosim.scene import PythonOperator, Scene
from cosim.storage.rawfile import RAW
from cosim.types import Report

#: Frequency of the low-frequency limit of the back-EMF's viscosity: far below L/R, far above leakage.
_LOW_HZ = 0.1


def _held(state: np.void, circuit: Drive) -> dict[str, float]:
    """Return the present voltages of the EXTERNAL sources by their names."""
    return {f"v{k:02d}": float(state["out"][k]) for k in range(len(circuit.sources()))}


def back_emf_viscosity(simulator: Simulator, circuit: Drive, state: np.void) -> NDArray[np.float64]:
    """Viscosity [n, n] N m s/rad that the motors' back-EMF gives the joints, measured by `.ac` on the board.

    At a low frequency and at the start's gains; zero where the motors have no back-EMF.
    """
    n = circuit.joints
    admittance = np.zeros((n, n))
    if circuit.speeds:
        first = circuit.sources().index("vel1")
        held = _held(state, circuit)
        simulator.attach(source=lambda name, t: held.get(name, 0.0))  # a probe inside the board is at 0 V
        for j in range(n):
            simulator.command(f"alter @v{first + j:02d}[acmag] = 1")
            simulator.command(f"ac lin 1 {_LOW_HZ} {_LOW_HZ}")
            admittance[:, j] = [np.real(simulator.vector(f"imot{i + 1}")[0]) for i in range(n)]
            simulator.command(f"alter @v{first + j:02d}[acmag] = 0")
    viscosity: NDArray[np.float64] = -state["torque_per_amp"][:n, None] * float(state["gear"]) * admittance
    return viscosity


def simulate(request: RunRequest, report: Report) -> RunAnswer:
    """Run one scene on the `spice` model, with the aids of `convergence` where ngspice does not converge.

    `report` gets simulated time and points so far.
    """
    attempts = 0

    def attempt(aid: Aid) -> RunAnswer:
        nonlocal attempts
        attempts += 1
        number = attempts  # each begins at t = 0
        return _simulate(request, lambda p: report({**p, "attempt": number} if "time_s" in p else p), aid)

    return aided(request.tolerances, attempt)


def _simulate(request: RunRequest, report: Report, aid: Aid) -> RunAnswer:
    scene, board, constants = request.scene, request.board, request.constants
    recorded, watched = request.recorded, request.watched
    nodes = recorded + tuple(node for node in watched if node not in recorded)
    # ngspice itself reports the time when no point is accepted for long: cuts of the step are no progress
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
    if component is not None:
        component = _called(component, simulator)
    printed = PrintCapture()
    memory = _packed(
        printed, scene, constants, circuit, recorded, nodes[len(recorded) :], component=component
    )
    if not aid.patient:
        tolerance = scene.solver.coupling_tolerance_rad
        bound_work(memory, request.predicted_points, scene.duration_s, tolerance)
    swings = _output_limits(simulator, board, measured)
    state = memory.state[0]
    state["w"]["mode"]["located"] = state["p"]["coulomb_on"]
    state["node"]["limit"][: len(nodes)] = [AT_LIMIT * swings.get(node, math.inf) for node in nodes]
    watch.begin(state, nodes, swings, scene.computer.period_s)
    missing: list[str] = []
    person = scene.operator.file if isinstance(scene.operator, PythonOperator) else "operator"
    recorder = Recorder(
        memory, simulator, request.folder, report, deck=str(board.path), person=person, nodes=nodes
    )
    recorder.running = False
    law = _own_law(scene, constants, state, recorder, printed)  # kept alive: compiled code calls it
    if law is not None:
        state["law_address"] = law.address

    def named(names: list[str]) -> None:
        state["time_index"] = names.index("time")
        wanted = [name.lower() for name in saved(circuit, nodes)]
        missing.extend(name for name in wanted if name not in names)
        if missing:
            raise InputError("the board lacks a node")
        at = [names.index(name) for name in wanted]
        state["current_index"][: circuit.joints] = at[: circuit.joints]
        state["node"]["index"][: len(nodes)] = at[circuit.joints :]

    state["breakpoint_address"] = simulator.set_breakpoint_address()
    events.begin(state)
    if recorder.failure is not None:
        raise recorder.failure
    coupling.fill(state, 0.0)
    if aid.plain:
        start = plain_start(simulator, board, circuit, _held(state, circuit), aid)
        text = lockstep_deck(board, circuit, aid.tolerances, nodes, [*aid.lines, *start])
        simulator.load(text, lines=board.lines, name=str(board.path))
    state["b_emf"][: circuit.joints, : circuit.joints] = back_emf_viscosity(simulator, circuit, state)
    moving = recorder.running = True
    try:
        wall, cpu = _transient(simulator, scene, memory, named)
    except InputError:
        if missing:
            raise unknown_nodes(simulator, text, board, missing) from None
        raise
    finally:
        recorder.close()
    return RunAnswer(
        ledger=_signals(scene, constants, circuit, recorded, state, request.folder),
        sample_columns=sample_columns(circuit.joints),
        stats=statistics(memory, wall, cpu),
        ngspice=str(simulator.version),
        printed=printed.lines,
        component_noise=component.about if component is not None else None,
        swings=swings,
        **_at_nodes(simulator, circuit, nodes, state),
    )


def _transient(
    simulator: Simulator, scene: Scene, memory: Memory, named: Callable[[list[str]], None]
) -> tuple[float, float]:
    """Integrate in ngspice, the linkage in its callbacks; return wall and CPU time [s]."""
    from cosim.loop.spice import callbacks  # compiles on import, which the linear loop does not need

    simulator.attach(
        data=callbacks.accepted.address, init=named, source=callbacks.source.address,
        sync=callbacks.synchronise.address, user=memory.state.ctypes.data, data_stays=True,
    )  # fmt: skip
    wall, cpu = time.perf_counter(), processor_s()
    step = scene.solver.max_step_s
    simulator.command(f"tran {step!r} {scene.duration_s!r} 0 {step!r}")
    return time.perf_counter() - wall, processor_s() - cpu


def _at_nodes(simulator: Simulator, circuit: Drive, nodes: tuple[str, ...], state: np.void) -> dict[str, Any]:
    """Return the nodes' peaks and times at their limits over the run, and the state at its end."""
    end: dict[str, Any] = {
        "nodes": dict(zip(nodes, state["node"]["volts"].tolist(), strict=False)),
        "pins": dict(zip(circuit.sources(), state["out"].tolist(), strict=False)),
        "speed_rad_per_s": float(np.abs(state["v"][: circuit.joints]).max()),
        "hung": watch.hung(state, nodes, circuit),
    }
    if end["speed_rad_per_s"] <= REST_RAD_PER_S:
        end["operating_point"] = watch.operating_point(simulator, list(end["pins"].values()), nodes)
    return {
        "peaks": dict(zip(nodes, state["node"]["peak"].tolist(), strict=False)),
        "clipped_s": dict(zip(nodes, state["node"]["clipped"].tolist(), strict=False)),
        "end": end,
    }


def _called(component: ComponentGrid, simulator: Simulator) -> ComponentGrid:
    """Return the noise with its probes under the names that ngspice passes to compiled code."""
    return replace(component, probes=tuple((simulator.called(name), sign) for name, sign in component.probes))


def _own_law(
    scene: Scene, constants: DesignConstants, state: np.void, recorder: Recorder, printed: PrintCapture
) -> UserLaw | None:
    """Return the control law of the user's own, if the scene names one."""
    where = scene.computer.law
    if where is None:
        return None
    return UserLaw(
        load_law(where, scene.file, printed), state, recorder.fail, where, scene, constants, printed
    )


def _output_limits(simulator: Simulator, board: Deck, measured: Mapping[str, Swing]) -> dict[str, float]:
    """Return how far the amplifiers' outputs go [V], by node: as measured, or as their parts state it."""
    limits = {a.out_node: measured[a.path].limit_v for a in board.amplifiers if a.path in measured}
    return limits | {
        a.out_node: simulator.constant(a.swing_param)
        for a in board.amplifiers
        if a.swing_param and a.path not in measured
    }


def _signals(
    scene: Scene,
    constants: DesignConstants,
    circuit: Drive,
    recorded: tuple[str, ...],
    state: np.void,
    folder: Path,
) -> dict[str, Any]:
    """Turn the streamed rows into signals.raw; return the energy ledger."""
    shafts = scene.effects.shaft
    names = tuple(columns(circuit, recorded, shafts=shafts))
    layout = Layout(names, circuit, constants, state["p"], one_sided=True)
    done = np.array(state["work"]) if shafts else None
    ledger = write_signals(folder / ROWS, folder / RAW, layout, scene.title, done)
    (folder / ROWS).unlink()
    return ledger


def _packed(printed: PrintCapture, *scene: Any, **more: Any) -> Memory:
    """Return what `pack` makes; what a user's operator prints, then and later, goes to `printed`."""
    with printed.listening():
        memory = pack(*scene, **more)
    memory.operator.listen(printed.listening)
    return memory


def _with_probes(component: ComponentGrid, board: Deck) -> set[str]:
    """Return the names of the probes through which noise enters; `InputError` for a board without any."""
    if not component.probes:
        fail(
            "the multipliers have no 0 V probe in series with X through which noise could enter",
            file=str(board.path),
            key="effects.component_noise",
            value=True,
            allowed="false, or the model ideal or linear",
        )
    return {name for name, _ in component.probes}


def unknown_nodes(simulator: Simulator, text: str, board: Deck, missing: list[str]) -> InputError:
    """Return the error that names the missing nodes, each with the board's nearest name."""
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
