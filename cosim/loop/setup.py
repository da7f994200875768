"""From a scene and the board's constants to the compiled lockstep's memory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import Drive
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import InputError, Problem
from cosim.loop.component_noise import ComponentGrid
from cosim.loop.computer import COMPUTER, Method, Path
from cosim.loop.dac_channels import channels, is_geometric
from cosim.loop.noise import Noise, no_noise, period_jitter, potentiometer_noise, with_errors
from cosim.loop.spice.coupling import name_hash
from cosim.loop.state import QUEUE, STATE
from cosim.scene import Scene, schema
from mech import Chain, Hand, NoOperator, Operator, ParameterError, PointMass, Slider, load_user

_METHOD = {
    schema.Method.DISCRETE: Method.DISCRETE,
    schema.Method.CONTINUOUS: Method.CONTINUOUS,
    schema.Method.COMBINED: Method.COMBINED,
    schema.Method.JOINT_PD: Method.JOINT_PD,
}
#: The first step behind a jump, as a share of the longest step (backward Euler; see adams.py).
FIRST_STEP_SHARE = 0.002


def mechanism(scene: Scene, gear: float) -> Chain | Slider:
    """Linkage of the scene with the effects that are off left out."""
    effects = scene.effects
    device = scene.device
    if device.chain is not None and device.linkage is schema.Linkage.CHAIN:
        chain = device.chain
        zeros = (0.0,) * len(chain.lengths_m)
        return Chain(
            lengths_m=chain.lengths_m,
            masses_kg=chain.masses_kg,
            coms_m=chain.coms_m,
            inertias_kg_m2=chain.inertias_kg_m2,
            rotor_inertia_kg_m2=chain.rotor_inertia_kg_m2 if effects.rotor_inertia else zeros,
            gear=gear,
            gravity_m_per_s2=chain.gravity_m_per_s2 if effects.gravity else (0.0, 0.0),
            coriolis=effects.coriolis,
            viscous_n_m_s=chain.viscous_n_m_s if effects.viscous else zeros,
            coulomb_n_m=chain.coulomb_n_m if effects.coulomb else zeros,
            coulomb_speed_rad_per_s=chain.coulomb_speed_rad_per_s,
            stops_rad=(chain.stops_rad or None) if effects.end_stops else None,
            stop_stiffness_n_m_per_rad=chain.stop_stiffness_n_m_per_rad,
            stop_damping_n_m_s=chain.stop_damping_n_m_s,
            stop_restitution=chain.stop_restitution if effects.end_stops else None,
            **_shafts(scene, chain),
        )
    slider = device.slider
    assert slider is not None  # the scene's checks hold this
    return Slider(
        radius_m=slider.radius_m,
        mass_kg=slider.mass_kg,
        rotor_inertia_kg_m2=slider.rotor_inertia_kg_m2 if effects.rotor_inertia else 0.0,
        gear=gear,
        direction=slider.direction,
        origin_m=slider.origin_m,
        gravity_m_per_s2=slider.gravity_m_per_s2 if effects.gravity else (0.0, 0.0),
        viscous_n_m_s=slider.viscous_n_m_s if effects.viscous else 0.0,
        coulomb_n_m=slider.coulomb_n_m if effects.coulomb else 0.0,
        coulomb_speed_rad_per_s=slider.coulomb_speed_rad_per_s,
        stops_rad=(slider.stops_rad or None) if effects.end_stops else None,
        stop_stiffness_n_m_per_rad=slider.stop_stiffness_n_m_per_rad,
        stop_damping_n_m_s=slider.stop_damping_n_m_s,
        stop_restitution=slider.stop_restitution if effects.end_stops else None,
        **_shafts(scene, slider),
    )


def _shafts(scene: Scene, table: schema.Chain | schema.Slider) -> dict[str, Any]:
    """Fields of a linkage whose motors sit behind shafts; none when the effect is off."""
    if not scene.effects.shaft:
        return {}
    return {
        "shaft_stiffness_n_m_per_rad": table.shaft_stiffness_n_m_per_rad,
        "shaft_damping_n_m_s": table.shaft_damping_n_m_s,
        "backlash_rad": table.backlash_rad if scene.effects.backlash else 0.0,
    }


def operator(scene: Scene) -> Operator:
    """Return the operator of the scene as mechanics knows it; a user's class is loaded from its file.

    Raises
    ------
    InputError
        When the user's file or class is not what it should be.
    """
    try:
        return _operator(scene)
    except ParameterError as error:
        file = str(scene.file) if scene.file else None
        raise InputError(Problem(str(error), file=file, key="operator")) from error


def _operator(scene: Scene) -> Operator:
    given, dynamic = scene.operator, scene.effects.operator_dynamics
    if isinstance(given, schema.MassOperator):
        return PointMass(mass_kg=given.mass_kg)
    if isinstance(given, schema.HandOperator):
        return Hand(
            mass_kg=given.mass_kg if dynamic else 0.0,
            damping_n_s_per_m=given.damping_n_s_per_m if dynamic else 0.0,
            stiffness_n_per_m=given.stiffness_n_per_m,
            waypoints_s_m=given.waypoints_s_m,
            force_s_n=given.force_s_n,
        )
    if isinstance(given, schema.PythonOperator):
        return load_user(given.file, scene.file.parent if scene.file else ".")
    return NoOperator()


def noise(scene: Scene) -> Noise:
    """Draw the potentiometers' noise and errors of the scene (null form: nothing drawn)."""
    kind, pot, effects = scene.effects.pot_noise, scene.device.potentiometer, scene.effects
    drawn = no_noise(scene.joints) if kind is schema.PotNoise.NONE else _pot_noise(scene)
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


def encoder_step(scene: Scene, gear: float) -> float:
    """Joint angle of one encoder count [rad]; 0 when the effect is off."""
    encoder = scene.computer.encoder
    if not scene.effects.encoder:
        return 0.0
    return 2 * math.pi / (encoder.pulses_per_rev * encoder.decoding * gear)


def computer_record(scene: Scene, constants: DesignConstants) -> NDArray[np.void]:
    """Pack what the compiled computer needs (`COMPUTER`, one record)."""
    c = np.zeros((), COMPUTER)
    computer, dac = scene.computer, scene.computer.dac
    c["n"] = scene.joints
    c["method"] = _METHOD[computer.method]
    c["path"] = Path.U if computer.command_path is schema.CommandPath.U else Path.CMD
    c["period"] = computer.period_s
    c["kp"] = computer.discrete_stiffness_n_per_m
    c["kd"] = computer.discrete_damping_n_s_per_m
    c["k_dp"] = computer.analog_stiffness_n_per_m
    c["k_dd"] = computer.analog_damping_n_s_per_m
    c["geometric"] = is_geometric(scene)
    c["ramp"], c["anchored"] = computer.gain_ramp_samples, computer.onset is schema.Onset.ANCHORED
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


def start(scene: Scene, linkage: Chain | Slider) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return initial angles [rad] and speeds [rad/s]; `InputError` when the tip is out of reach."""
    given = scene.device.start
    n = scene.joints
    if given.q_rad is not None:
        q = np.array(given.q_rad, dtype=float)
    else:
        assert given.tip_m is not None  # the scene's checks hold this
        try:
            q = np.asarray(linkage.inverse(np.array(given.tip_m), elbow=given.elbow), dtype=float)
        except ValueError as error:
            key = "device.start.tip_m"
            problem = Problem(str(error), file=str(scene.file), key=key, value=given.tip_m, unit="m")
            raise InputError(problem) from None
    v = np.array(given.v_rad_per_s, dtype=float) if given.v_rad_per_s else np.zeros(n)
    return q, v


@dataclass
class Memory:
    """A packed lockstep: the record and the arrays it points to (kept alive here).

    Attributes
    ----------
    state : one `STATE` record
    rows, samples : buffers that compiled code fills and Python drains, [capacity, columns]
    """

    state: NDArray[np.void]
    rows: NDArray[np.float64]
    samples: NDArray[np.float64]
    noise: Noise
    drive: Drive
    operator: Operator
    knots: NDArray[np.float64]
    jitter: NDArray[np.float64]
    component: ComponentGrid | None = None

    @property
    def draws(self) -> int:
        """Random numbers drawn for the run."""
        drawn = self.component.draws if self.component is not None else 0
        return self.noise.draws + max(len(self.jitter) - 1, 0) + drawn


def columns(drive: Drive, recorded: tuple[str, ...], *, shafts: bool = False) -> list[str]:
    """Names of the columns of `rows`, as `accepted` writes them (tau_*: torques in N m; pot in rad).

    With `shafts` the motors have angles and speeds of their own, qm and vm, at the joint.
    """
    joint = range(1, drive.joints + 1)
    names = ["time", "rule", "x", "y", "fx", "fy"]
    for kind in ("q", "v", "a", "imot", "tau_visc", "tau_coul", "tau_stop", "pot"):
        names += [f"{kind}{j}" for j in joint]
    if shafts:
        names += [f"{kind}{j}" for kind in ("qm", "vm", "tau_shaft") for j in joint] + ["p_shaft", "e_shaft"]
    return names + list(drive.channels) + list(recorded)


def sample_columns(joints: int) -> list[str]:
    """Names of the columns of `samples`, as `_write_sample` writes them."""
    joint = range(1, joints + 1)
    pairs = [f"{a}{b}" for a in joint for b in joint]
    names = ["tick", "time", "contact", "pen", "saturated", "unsolved", "x", "y"]
    for kind in ("q_enc", "v_enc", "u_rad", "cmd_nm"):
        names += [f"{kind}{j}" for j in joint]
    return names + [f"ksp{ab}" for ab in pairs] + [f"ksd{ab}" for ab in pairs]


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
    s["running"] = 1
    s["n"] = n
    q, v = start(scene, linkage)
    s["q"][:n], s["v"][:n] = q, v
    s["coordinates"] = linkage.coordinates
    if linkage.coordinates > n:  # the motors start with their joints: no twist, in the middle of the gap
        s["motor"] = n
        s["q"][n : 2 * n], s["v"][n : 2 * n] = q, v
        s["w"]["latched"] = 1
    s["torque_per_amp"] = constants.torque_per_amp
    s["gear"] = constants.gear
    s["t_trial"] = math.nan
    s["speeds"] = n if circuit.speeds else 0
    names = channels(n)
    s["dac_channel"][: len(circuit.channels)] = [names.index(c) for c in circuit.channels]
    s["dacs"] = len(circuit.channels)
    s["dac_first"] = n + s["speeds"]
    if scene.effects.dac_settling:
        s["settle"] = scene.computer.dac.settling_s
    if scene.effects.dac_skew:
        s["skew"] = scene.computer.dac.skew_s
    s["c"] = computer_record(scene, constants)
    period = scene.computer.period_s
    if scene.effects.delay:
        s["delay_ticks"] = scene.computer.delay_periods
        s["delay_s"] = scene.computer.delay_fraction * period
    if s["delay_ticks"] + 2 > QUEUE:
        raise InputError(
            [
                Problem(
                    "a sample would be lost",
                    file=str(scene.file),
                    key="computer.delay_periods",
                    value=scene.computer.delay_periods,
                    allowed=f"<= {QUEUE - 2}",
                )
            ]
        )
    s["last_tick"] = math.floor(scene.duration_s / period * (1 + 1e-12))
    s["t_end"] = scene.duration_s
    jitter = np.zeros(0)
    if scene.effects.period_jitter is not schema.Jitter.NONE and scene.computer.jitter_share > 0.0:
        share = scene.computer.jitter_share
        jitter = period * period_jitter(
            scene.effects.period_jitter.value, scene.seed, int(s["last_tick"]) + 1, share
        )
        s["jitter"] = jitter.ctypes.data
    drawn = noise(scene)
    if drawn.dt > 0:
        s["noise"], s["noise_rows"], s["noise_dt"] = drawn.grid.ctypes.data, len(drawn.grid), drawn.dt
    if len(drawn.table):
        s["position_noise"], s["position_points"] = drawn.table.ctypes.data, len(drawn.table)
        s["position_lo"], s["position_step"] = drawn.lo, drawn.step
    grids = [drawn.dt] if drawn.dt > 0 else []
    if component is not None:
        _put_component(s, component)
        grids.append(component.dt)
    solver = scene.solver
    s["h_max"] = min(solver.max_step_s, period)
    s["h_first"] = FIRST_STEP_SHARE * s["h_max"]
    if s["settle"] > 0.0:
        s["h_first"] = min(float(s["h_first"]), s["settle"] / 3)
    s["h_couple"] = s["h_max"]
    s["h_pole"] = s["h_max"]
    s["tol"] = solver.coupling_tolerance_rad
    # A million is thousands of times what a period needs, ten times more than it was asked for is too.
    fine = min([float(s["h_max"]), *grids])
    s["most_points"] = max(1_000_000, math.ceil(10 * period / fine))
    s["calls_free"] = math.inf  # `convergence` bounds what may be tried again
    s["delta_min"] = 1e-12 * max(period, scene.duration_s * 1e-3)
    rows = np.zeros((row_capacity, len(columns(circuit, recorded, shafts=scene.effects.shaft))))
    samples = np.zeros((sample_capacity, len(sample_columns(n))))
    s["rows"], s["rows_capacity"], s["columns"] = rows.ctypes.data, len(rows), rows.shape[1]
    s["samples"], s["samples_capacity"] = samples.ctypes.data, len(samples)
    s["nodes"], s["nodes_recorded"] = len(recorded) + len(watched), len(recorded)
    knots = np.array([t for t in person.knots_s if 0.0 < t < scene.duration_s])
    s["knot_times"], s["knots"] = knots.ctypes.data, len(knots)
    return Memory(state, rows, samples, drawn, circuit, person, knots, jitter, component)


def _put_component(s: np.void, component: ComponentGrid) -> None:
    """Tell compiled code where component noise is, and to which sources it belongs."""
    s["component"], s["component_rows"] = component.values.ctypes.data, len(component.values)
    s["component_dt"], s["component_inputs"] = component.dt, component.inputs
    names = [np.frombuffer(name.encode(), np.uint8) for name, _ in component.probes]
    s["probes"] = len(names)
    s["probe_name"][: len(names)] = [name_hash(name, len(name)) for name in names]
    s["probe_input"][: len(names)] = component.group[: len(names)]
    s["probe_sign"][: len(names)] = [sign for _, sign in component.probes]


def shift_samples(memory: Memory, share: float) -> None:
    """Let every sample but the first, at power-up, come early by a share of the period, 0 to 1.

    This varies when between two samples something happens, and nothing else. In place of a period jitter.
    """
    state = memory.state[0]
    memory.jitter = np.full(int(state["last_tick"]) + 2, -share * float(state["c"]["period"]))
    memory.jitter[0] = 0.0
    state["jitter"] = memory.jitter.ctypes.data
