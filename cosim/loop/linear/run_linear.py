"""A run of the `ideal` or `linear` circuit model in our own time loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.extract import extract
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import fail
from cosim.loop import events
from cosim.loop.columns import columns, sample_columns
from cosim.loop.component_noise import ComponentGrid, component_grid
from cosim.loop.dac_channels import channels, drive
from cosim.loop.linear import stepper
from cosim.loop.linear.exact_matrices import Step
from cosim.loop.linear.exact_slider import Exact, exact
from cosim.loop.linear.offset_state import shifted
from cosim.loop.linear.step_layout import plan
from cosim.loop.linear.step_maps import Plan
from cosim.loop.linear.step_memory import StepMemory, step_memory
from cosim.loop.pin_voltages import pins
from cosim.loop.recorder import ROWS, Recorder, statistics
from cosim.loop.run_messages import RunAnswer, RunRequest
from cosim.loop.setup import Memory, pack
from cosim.loop.signals import Layout, write_signals
from cosim.loop.state import Fault
from cosim.loop.userclass import PrintCapture
from cosim.loop.userlaw import UserLaw, load_law
from cosim.ngspice.sandbox import processor_s
from cosim.scene import PythonOperator, Scene
from cosim.scene.mechanism import is_linear_between_events
from cosim.storage.rawfile import RAW
from cosim.types import Report

#: First step behind a jump of the DACs, as a share of the period, when rows are recorded; or as a share of
#: the time in which the circuit settles, where that is longer.
FIRST_ROW_SHARE, _FIRST_OF_FRESH = 2.0**-11, 1.0 / 24.0
#: The longest step of a scene that does not state one [s].
_USUAL_STEP_S = 2e-3
#: So many of its slowest time constants behind a jump a circuit has settled: rows need not follow it.
_SETTLED = 3.0
#: Whether scenes are linear between events, of those whose compiled loop this process has loaded.
_loaded: set[bool] = set()


class Clock:
    """What a `Recorder` asks of whoever owns time."""

    def __init__(self, state: np.void) -> None:
        self.state = state

    def truncate_vectors(self) -> bool:
        """Return True: rows are all that is kept."""
        return True

    def stop(self) -> None:
        """End the loop at its next step."""
        if not self.state["fault"]:
            self.state["fault"] = Fault.STOPPED


@dataclass
class Propagation:
    """A packed run: `run()` takes it to its end.

    Attributes
    ----------
    memory : the record shared with the lockstep, its rows and samples
    circuit : what is simulated
    plan : maps of the circuit
    step : states of the circuit and scratch memory
    exact, callback : memory of the exact path, and what makes its matrices; failures : of that
    first_s : longest step behind a jump; 0 for none
    tables : where compiled code finds all that
    asked : steps of the exact path, as they are asked for
    """

    memory: Memory
    circuit: LinearCircuit
    plan: Plan
    step: StepMemory
    exact: Exact
    callback: Callable[[], None]
    failures: list[Exception]
    first_s: float
    tables: stepper.Tables
    asked: list[Step]

    def run(self) -> None:
        """Integrate to the end of the scene, or to a fault (`memory.state['fault']`).

        The first sample is computed, the circuit put at its operating point, and the start written as a row.
        """
        state = self.memory.state[0]
        events.begin(state)
        self.step.states[:] = rest(self.circuit, state, self.memory.component)
        stepper.run(self.tables, self.first_s)
        if self.failures:
            raise self.failures[0]


def prepare(
    scene: Scene,
    constants: DesignConstants,
    circuit: LinearCircuit,
    *,
    record: bool,
    dense: bool = True,
    row_capacity: int = 2048,
    sample_capacity: int = 256,
    component: ComponentGrid | None = None,
) -> Propagation:
    """Pack a scene at time 0, its first sample not yet computed.

    Parameters
    ----------
    record
        Whether rows are written.
    dense
        Whether rows show the motion: steps at most `solver.max_step_s`, and short behind a jump. Otherwise
        the tolerance alone decides, as it does without rows.
    component
        Noise of the board's components, where the scene asks for it.
    """
    memory = pack(scene, constants, drive(scene), (), (), row_capacity, sample_capacity, component)
    return with_circuit(memory, scene, constants, circuit, record=record, dense=dense)


def with_circuit(
    memory: Memory,
    scene: Scene,
    constants: DesignConstants,
    circuit: LinearCircuit,
    *,
    record: bool,
    dense: bool = True,
    expected: Sequence[Step] = (),
) -> Propagation:
    """Put a circuit to the memory of a scene at time 0; see `prepare`.

    `expected` are steps that a run before has asked for (`Propagation.asked`): made together, they cost less.
    """
    n, driving, component = scene.joints, memory.drive, memory.component
    state = memory.state[0]
    state["rows"]["capacity"] = len(memory.rows) if record else 0
    if not (record and dense):
        state["steps"]["longest"] = scene.computer.period_s
    state["w"]["mode"]["located"] = any(
        state["p"][name] for name in ("coulomb_on", "stops_on", "backlash_on")
    )
    state["w"]["mode"]["stops_located"] = state["p"]["stops_on"]
    names = channels(n)
    driven = [names.index(name) - n for name in driving.channels if name.startswith("ks")]
    shifted_circuit = shifted(circuit)
    maps = plan(
        shifted_circuit, driven,
        gear=constants.gear,
        commands=any(name.startswith("cmd") for name in driving.channels),
        speeds=driving.speeds,
        bent=bool(state["position_noise"]["address"]),
        noise=component.group if component is not None else None,
        shafts=scene.effects.shaft,
    )  # fmt: skip
    state["speeds"] = 0  # the pins vel are no part of a row
    step = step_memory(maps, np.zeros(maps.before + maps.after))
    first = 0.0
    if record and dense:
        state["steps"]["fresh"] = _SETTLED * _slowest(shifted_circuit.a_post)
        first = max(
            FIRST_ROW_SHARE * scene.computer.period_s, _FIRST_OF_FRESH * float(state["steps"]["fresh"])
        )
        if scene.solver.max_step_s < _USUAL_STEP_S:  # rows asked for closer than usual are closer here, too
            first *= scene.solver.max_step_s / _USUAL_STEP_S
            state["steps"]["fresh"] = max(float(state["steps"]["fresh"]), scene.computer.period_s)
    failures: list[Exception] = []
    asked: list[Step] = []
    leaps, callback = exact(
        state, shifted_circuit, memory.knots, failures, asked,
        linear=is_linear_between_events(scene), expected=expected,
    )  # fmt: skip
    tables = stepper.Tables(memory.state, maps, step, leaps)
    return Propagation(memory, circuit, maps, step, leaps, callback, failures, first, tables, asked)


def _slowest(a: NDArray[np.float64]) -> float:
    """Return the slowest time constant [s] of a stable system; 0 without states."""
    rates = np.abs(np.linalg.eigvals(a).real)
    return float(1.0 / rates.min()) if len(rates) and rates.min() > 0.0 else 0.0


def rest(
    circuit: LinearCircuit, state: np.void, component: ComponentGrid | None = None
) -> NDArray[np.float64]:
    """States of the circuit at its operating point with the pins as they are at the accepted point."""
    n, m = circuit.joints, len(circuit.gain)
    level = np.zeros(4 * n + m)
    pins(state, level)
    pot_u, gains = level[: 2 * n], circuit.gain * (level[2 * n : 2 * n + m] + circuit.y_offset)
    z = _still(circuit.a_pre, circuit.b_pre @ pot_u, "a_pre")
    x = circuit.c_pre @ z + circuit.d_pre @ pot_u + circuit.x_offset
    if component is not None:
        x += component.values[0, component.group]
    after = np.concatenate([gains * x, level[2 * n + m :]])
    one = np.ones(int(circuit.x_offset.any()))  # see `shifted`
    return np.concatenate([z, one, _still(circuit.a_post, circuit.b_post @ after, "a_post")])


def _still(a: NDArray[np.float64], drive: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Solve 0 = a z + drive."""
    if not len(a):
        return np.zeros(0)
    scale = np.abs(a).max(axis=1)
    scaled = a / np.where(scale > 0, scale, 1.0)[:, None]
    try:
        z = np.asarray(np.linalg.solve(scaled, -drive / np.where(scale > 0, scale, 1.0)), np.float64)
    except np.linalg.LinAlgError:
        z = np.full(len(a), math.nan)
    if not np.isfinite(z).all():
        fail("the circuit has a pole at zero: it has no operating point", key=name)
    return z


def simulate(request: RunRequest, report: Report) -> RunAnswer:
    """Run one scene on the `ideal` or `linear` model; `report` gets simulated time and points so far."""
    scene, board, constants = request.scene, request.board, request.constants
    if request.recorded:
        fail(
            "nodes inside the board exist in the model spice only",
            file=str(board.path),
            key="record.nodes",
            value=", ".join(request.recorded),
        )
    circuit = extract(
        {
            "board": board,
            "model": request.model,
            "band_hz": scene.solver.band_hz,
            "tolerance": scene.solver.reduction_tolerance,
        },
        report,
    )
    component = component_grid(scene, board, report)
    folder = request.folder
    printed = PrintCapture()
    with printed.listening():  # a user's operator is loaded here
        packed = prepare(scene, constants, circuit, record=True, component=component)
    packed.memory.operator.listen(printed.listening)
    state = packed.memory.state[0]
    person = scene.operator.file if isinstance(scene.operator, PythonOperator) else "operator"
    recorder = Recorder(packed.memory, Clock(state), folder, report, deck=str(board.path), person=person)
    if scene.computer.law is not None:
        where = scene.computer.law
        law = UserLaw(
            load_law(where, scene.file, printed), state, recorder.fail, where, scene, constants, printed
        )
        state["law_address"] = law.address
    if (kind := is_linear_between_events(scene)) not in _loaded:
        # a run of no length, without the user's law, loads the compiled loop before the clock starts
        warm = prepare(scene, constants, circuit, record=True, component=component)
        warm.memory.state[0]["t_end"] = 0.0
        warm.run()
        _loaded.add(kind)
    wall, cpu = time.perf_counter(), processor_s()
    try:
        packed.run()
    finally:
        wall, cpu = time.perf_counter() - wall, processor_s() - cpu
        recorder.close()
    names = columns(packed.memory.drive, (), shafts=scene.effects.shaft)
    layout = Layout(tuple(names), packed.memory.drive, constants, state["p"])
    ledger = write_signals(folder / ROWS, folder / RAW, layout, scene.title, packed.step.total)
    (folder / ROWS).unlink()
    return RunAnswer(
        ledger=ledger,
        sample_columns=sample_columns(circuit.joints),
        stats=statistics(packed.memory, wall, cpu),
        ngspice=_version(circuit),
        printed=printed.lines,
        component_noise=component.about if component is not None else None,
        circuit=circuit,
    )


def _version(circuit: LinearCircuit) -> str:
    """Return the version of ngspice that measured the circuit: today's, where an older cache has none."""
    known = circuit.certificate.get("ngspice")
    if known is not None:
        return str(known)
    from cosim.ngspice.simulator import Simulator  # opening the library takes 0.1 s

    return str(Simulator().version)
