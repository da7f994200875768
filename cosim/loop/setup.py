"""From a scene and the board's constants to the compiled lockstep's memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import Drive
from cosim.circuits.design_constants import DesignConstants
from cosim.effects import EFFECTS
from cosim.errors import fail
from cosim.loop.columns import columns, sample_columns
from cosim.loop.component_noise import ComponentGrid
from cosim.loop.computer import COMPUTER, Method, Path
from cosim.loop.dac_channels import channels, is_geometric
from cosim.loop.ngspice_data import name_hash
from cosim.loop.noise import Noise, no_noise, potentiometer_noise, with_errors
from cosim.loop.state import QUEUE, STATE
from cosim.scene import Scene, choices
from cosim.scene.mechanism import encoder_step, known_mechanism, mechanism, operator, start
from mech import Operator

_METHOD = {
    choices.Method.DISCRETE: Method.DISCRETE,
    choices.Method.CONTINUOUS: Method.CONTINUOUS,
    choices.Method.COMBINED: Method.COMBINED,
    choices.Method.JOINT_PD: Method.JOINT_PD,
}
#: The first step behind a jump, as a share of the longest step (backward Euler; see adams.py).
FIRST_STEP_SHARE = 0.002


def noise(scene: Scene) -> Noise:
    """Draw the potentiometers' noise and errors of the scene (null form: nothing drawn)."""
    kind, pot, effects = scene.effects.pot_noise, scene.device.potentiometer, scene.effects
    drawn = no_noise(scene.joints) if kind is choices.PotNoise.NONE else _pot_noise(scene)
    return with_errors(
        drawn,
        scene.seed,
        linearity_rad=pot.linearity_rad if effects.pot_linearity else 0.0,
        period_rad=pot.linearity_period_rad,
        gain_error=pot.gain_error if effects.pot_calibration else 0.0,
        zero_rad=pot.zero_rad if effects.pot_calibration else 0.0,
    )


def _pot_noise(scene: Scene) -> Noise:
    kind, pot = scene.effects.pot_noise, scene.device.potentiometer
    return potentiometer_noise(
        kind.value,
        scene.joints,
        scene.seed,
        scene.duration_s,
        pot.noise_rad,
        pot.noise_bandwidth_hz,
        pot.position_period_rad,
        span_rad=2 * math.pi,
    )


def computer_record(scene: Scene, constants: DesignConstants) -> NDArray[np.void]:
    """Pack what the compiled computer needs (`COMPUTER`, one record)."""
    c = np.zeros((), COMPUTER)
    computer, dac = scene.computer, scene.computer.dac
    c["n"] = scene.joints
    c["method"] = _METHOD[computer.method]
    c["path"] = Path.U if computer.command_path is choices.CommandPath.U else Path.CMD
    c["period"] = computer.period_s
    c["kp"] = computer.discrete_stiffness_n_per_m
    c["kd"] = computer.discrete_damping_n_s_per_m
    c["k_dp"] = computer.analog_stiffness_n_per_m
    c["k_dd"] = computer.analog_damping_n_s_per_m
    c["geometric"] = is_geometric(scene)
    c["ramp"], c["anchored"] = computer.gain_ramp_samples, computer.onset is choices.Onset.ANCHORED
    if scene.wall is not None:
        c["point"], c["normal"] = scene.wall.point_m, scene.wall.normal
    c["joint_gain"] = -1.0
    for j, gain in enumerate(computer.joint_stiffness_n_m_per_rad):
        c["joint_gain"][j] = gain
    c["joint_damper"] = -1.0
    for j, gain in enumerate(computer.joint_damping_n_m_s_per_rad):
        c["joint_damper"][j] = gain
    c["encoder_step"] = encoder_step(scene, constants.gear)
    cutoff = computer.velocity.filter_hz
    c["velocity_keep"] = 0.0 if cutoff is None else math.exp(-2 * math.pi * cutoff * computer.period_s)
    c["v_rad"] = constants.v_rad
    c["volts_per_stiffness"] = constants.v_fs / constants.k_fs
    c["volts_per_damping"] = constants.v_fs / constants.c_fs
    c["v_nm"] = constants.v_nm
    c["dac_range"] = math.inf
    if scene.effects.dac:
        reach = dac.range_v if dac.range_v is not None else constants.dac_v
        bits = dac.bits if dac.bits is not None else round(constants.dac_bits)
        c["dac_range"] = reach
        c["dac_step"] = 2 * reach / 2**bits
    return c


@dataclass
class Memory:
    """A packed lockstep: the record and the arrays it points to (kept alive here).

    Attributes
    ----------
    state : one `STATE` record
    drawings : what effects drew for it (`Effect.pack`)
    rows, samples : buffers that compiled code fills and Python drains, [capacity, columns]
    """

    state: NDArray[np.void]
    rows: NDArray[np.float64]
    samples: NDArray[np.float64]
    noise: Noise
    drive: Drive
    operator: Operator
    knots: NDArray[np.float64]
    drawings: list[NDArray[np.float64]]
    component: ComponentGrid | None = None

    @property
    def draws(self) -> int:
        """Random numbers drawn for the run."""
        drawn = self.component.draws if self.component is not None else 0
        return self.noise.draws + sum(max(len(each) - 1, 0) for each in self.drawings) + drawn


def pack(
    scene: Scene,
    constants: DesignConstants,
    circuit: Drive,
    recorded: tuple[str, ...],
    watched: tuple[str, ...],
    row_capacity: int = 2048,
    sample_capacity: int = 256,
    component: ComponentGrid | None = None,
) -> Memory:
    """Build the lockstep's memory at time 0, the first sample not yet computed.

    Parameters
    ----------
    recorded : nodes written at every point; watched : further nodes of which only the peak is kept
    component : noise of the board's components, where the scene asks for it
    """
    n = scene.joints
    linkage = mechanism(scene, constants.gear)
    state = np.zeros(1, STATE)
    s = state[0]
    person = operator(scene)
    s["p"], s["op"] = linkage.pack()[0], person.pack()[0]
    s["known"] = known_mechanism(scene, constants.gear).pack()[0]
    s["running"] = 1
    s["n"] = n
    q, v = start(scene, linkage)
    s["q"][:n], s["v"][:n] = q, v
    s["coordinates"] = linkage.coordinates
    if linkage.coordinates > n:  # the motors start with their joints: no twist, in the middle of the gap
        s["motor"] = n
        s["q"][n : 2 * n], s["v"][n : 2 * n] = q, v
        s["w"]["mode"]["latched"] = 1
    s["torque_per_amp"][:n] = constants.torques_per_amp(n)
    s["gear"] = constants.gear
    s["t_trial"] = math.nan
    s["speeds"] = n if circuit.speeds else 0
    names = channels(n)
    s["dac"]["channel"][: len(circuit.channels)] = [names.index(c) for c in circuit.channels]
    s["dac"]["count"] = len(circuit.channels)
    s["dac"]["first"] = n + s["speeds"]
    if scene.effects.dac_settling:
        s["dac"]["settle"] = scene.computer.dac.settling_s
    s["c"] = computer_record(scene, constants)
    _put_delay(s, scene)
    period = scene.computer.period_s
    s["clock"]["last_tick"] = math.floor(scene.duration_s / period * (1 + 1e-12))
    s["t_end"] = scene.duration_s
    drawings = [each.pack(s, scene) for each in EFFECTS if each.is_in_force(scene)]
    drawn = noise(scene)
    if drawn.dt > 0:
        s["noise"]["address"], s["noise"]["rows"], s["noise"]["dt"] = (
            drawn.grid.ctypes.data,
            len(drawn.grid),
            drawn.dt,
        )
    if len(drawn.table):
        s["position_noise"]["address"], s["position_noise"]["points"] = (
            drawn.table.ctypes.data,
            len(drawn.table),
        )
        s["position_noise"]["lo"], s["position_noise"]["step"] = drawn.lo, drawn.step
    grids = [drawn.dt] if drawn.dt > 0 else []
    if component is not None:
        _put_component(s, component)
        grids.append(component.dt)
    _put_steps(s, scene, grids)
    rows = np.zeros((row_capacity, len(columns(circuit, recorded, shafts=scene.effects.shaft))))
    samples = np.zeros((sample_capacity, len(sample_columns(n))))
    s["rows"]["address"], s["rows"]["capacity"], s["columns"] = rows.ctypes.data, len(rows), rows.shape[1]
    s["samples"]["address"], s["samples"]["capacity"] = samples.ctypes.data, len(samples)
    s["nodes"], s["nodes_recorded"] = len(recorded) + len(watched), len(recorded)
    knots = np.array([t for t in person.knots_s if 0.0 < t < scene.duration_s])
    s["knots"]["address"], s["knots"]["count"] = knots.ctypes.data, len(knots)
    return Memory(state, rows, samples, drawn, circuit, person, knots, drawings, component)


def _put_delay(s: np.void, scene: Scene) -> None:
    """Set the computing delay; `InputError` for one that would lose samples."""
    period = scene.computer.period_s
    if scene.effects.delay:
        s["clock"]["delay_ticks"] = scene.computer.delay_periods
        s["clock"]["delay_s"] = scene.computer.delay_fraction * period
    if s["clock"]["delay_ticks"] + 2 > QUEUE:
        fail(
            "a sample would be lost",
            file=scene.file_name,
            key="computer.delay_periods",
            value=scene.computer.delay_periods,
            allowed=f"<= {QUEUE - 2}",
        )


def _put_steps(s: np.void, scene: Scene, grids: list[float]) -> None:
    """Set the longest steps and tolerances; `grids` [s] are those of the noises."""
    period = scene.computer.period_s
    solver = scene.solver
    s["steps"]["longest"] = min(solver.max_step_s, period)
    s["steps"]["first"] = FIRST_STEP_SHARE * s["steps"]["longest"]
    if s["dac"]["settle"] > 0.0:
        s["steps"]["first"] = min(float(s["steps"]["first"]), s["dac"]["settle"] / 3)
    s["steps"]["couple"] = s["steps"]["longest"]
    s["steps"]["pole"] = s["steps"]["longest"]
    s["steps"]["tol"] = solver.coupling_tolerance_rad
    s["steps"]["trapezoids"] = solver.method is choices.Integration.TRAP
    # A million is thousands of times what a period needs, ten times more than it was asked for is too.
    fine = min([float(s["steps"]["longest"]), *grids])
    s["steps"]["most"] = max(1_000_000, math.ceil(10 * period / fine))
    s["calls"]["free"] = math.inf  # `convergence` bounds what may be tried again
    s["steps"]["least"] = 1e-12 * max(period, scene.duration_s * 1e-3)


def _put_component(s: np.void, component: ComponentGrid) -> None:
    """Give compiled code the address of component noise, and its sources."""
    s["component"]["address"], s["component"]["rows"] = component.values.ctypes.data, len(component.values)
    s["component"]["dt"], s["component"]["inputs"] = component.dt, component.inputs
    names = [np.frombuffer(name.encode(), np.uint8) for name, _ in component.probes]
    s["probe"]["count"] = len(names)
    s["probe"]["name"][: len(names)] = [name_hash(name, len(name)) for name in names]
    s["probe"]["input"][: len(names)] = component.group[: len(names)]
    s["probe"]["sign"][: len(names)] = [sign for _, sign in component.probes]


def shift_samples(memory: Memory, share: float) -> None:
    """Let every sample but the first, at power-up, come early by a share of the period, 0 to 1.

    It changes only when an event happens between two samples. Used in place of a period jitter.
    """
    state = memory.state[0]
    late = np.full(int(state["clock"]["last_tick"]) + 2, -share * float(state["c"]["period"]))
    late[0] = 0.0
    memory.drawings.append(late)
    state["clock"]["jitter"] = late.ctypes.data
