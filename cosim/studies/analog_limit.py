"""How stiff and how damped an analog wall may be: delay of the circuit, saturation, noise of potentiometers.

A spring whose force lags by the sum of its circuit's time constants is a spring and a negative damper,
b_eq = -k sum(tau): the contact stays stable while the device brakes more than that, k < b/sum(tau), and
b^2/m more where the braking itself comes without delay. A damper is bounded by its lags of second order. Long
before that, multipliers reach full scale, the driver its current limit, or potentiometer noise is felt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from scipy.optimize import brentq

from cosim.analysis.device_passivity import device_of
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.linearise import linearise
from cosim.analysis.noise_covariance import noise_covariance
from cosim.analysis.passivity import least_damping
from cosim.analysis.stability import border, held
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError, fail
from cosim.plan import resolve
from cosim.scene import Method, PotNoise, Scene
from cosim.scene.mechanism import operator
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.grid import geometric
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "Delay", "delay", "lag", "noise_force"]


SPRING, DAMPER = "analog_stiffness_n_per_m", "analog_damping_n_s_per_m"
#: Ranges scanned for borders [N/m, N s/m]; a spring too soft to matter [N/m].
_SPRINGS, _DAMPERS, _SOFT = (1.0, 1e9), (1e-2, 1e6), 1e-6
#: Slow against every pole of the circuit, fast enough to show its lag [rad/s].
_SLOW = 1e-2


class CeilingParameters(Parameters):
    """``[parameters]`` of the practical upper limit."""

    boards: tuple[Variation, ...] = Field(min_length=1)
    damper_with_n_per_m: Annotated[float, Field(gt=0, le=1e6), Unit("N/m")] = 100.0
    noise_with_n_per_m: Annotated[float, Field(gt=0, le=1e6), Unit("N/m")] = 20.0
    depth_m: Annotated[float, Field(gt=0, le=1), Unit("m")] = 0.01
    speed_m_per_s: Annotated[float, Field(gt=0, le=10), Unit("m/s")] = 0.1
    noise_n: Annotated[float, Field(gt=0, le=10), Unit("N")] = 0.05
    noise_points: int = Field(default=25, ge=3, le=400)


@dataclass(frozen=True)
class Delay:
    """Borders of one board that delay sets.

    Attributes
    ----------
    lag_s : sum of the time constants in the spring's path, sum(tau)
    mass_kg, viscosity_n_s_per_m : moving mass, and what brakes it with the springs off
    spring_n_per_m, spring_hz : border of the held contact, and its frequency; infinite without one
    passive_spring_n_per_m : stiffest spring whose device is passive at every frequency
    damper_n_s_per_m, damper_hz, passive_damper_n_s_per_m : the same for a damper beside the stated spring
    """

    lag_s: float
    mass_kg: float
    viscosity_n_s_per_m: float
    spring_n_per_m: float
    spring_hz: float
    passive_spring_n_per_m: float
    damper_n_s_per_m: float
    damper_hz: float
    passive_damper_n_s_per_m: float

    @property
    def eaten_n_per_m(self) -> float:
        """Stiffness at which delay has eaten all viscosity, b/sum(tau)."""
        return self.viscosity_n_s_per_m / self.lag_s if self.lag_s > 0.0 else math.inf


def lag(constants: DesignConstants, circuit: LinearCircuit) -> float:
    """Return the delay [s] of the first joint's spring alone: the sum of its path's time constants.

    Leakage through other multipliers, measured with that gain at zero, is subtracted: a damper's offset is a
    viscosity and would look like a lead of the spring. The certificate, `cosim check` and the blocks of the
    path give the same number.
    """
    spring = np.zeros(len(circuit.gain))
    spring[0] = constants.v_fs
    s = 1j * np.array([0.0, _SLOW])
    through = (circuit.response(s, spring) - circuit.response(s, 0.0 * spring))[:, 0, 0]
    return float(-(through[1] / through[0]).imag / _SLOW)


def delay(contact: HeldContact, beside: float) -> Delay:
    """Return the borders that a circuit's delay sets to a wall of analog springs or dampers.

    Parameters
    ----------
    beside
        Stiffness [N/m] of the spring with which the damper is tried.
    """

    def wall(spring: float, damper: float) -> HeldContact:
        return contact.with_computer(**{SPRING: spring, DAMPER: damper})

    def end(at: Callable[[float], HeldContact], span: tuple[float, float]) -> tuple[float, float]:
        edge = border(lambda x: held(at(x)), *span, rtol=1e-9).value
        if not 0.0 < edge < math.inf:
            return edge, math.nan
        poles = np.linalg.eigvals(linearise(at(edge), preload=False).a)
        return edge, float(abs(poles[int(np.argmax(poles.real))].imag)) / (2.0 * math.pi)

    def passive(at: Callable[[float], HeldContact], span: tuple[float, float]) -> float:
        def least(x: float) -> float:
            return least_damping(device_of(at(math.exp(x))))[0]

        low, high = (math.log(x) for x in span)
        if least(high) >= 0.0:
            return math.inf
        return math.exp(brentq(least, low, high, xtol=1e-9)) if least(low) > 0.0 else 0.0

    w = contact.torques
    free = device_of(wall(_SOFT, 0.0))
    inertia = contact.linkage.mass_matrix(contact.q, operator(contact.scene))
    mass = 1.0 / float(w @ np.linalg.solve(inertia, w))

    def springs(k: float) -> HeldContact:
        return wall(k, 0.0)

    def dampers(c: float) -> HeldContact:
        return wall(beside, c)

    spring, spring_hz = end(springs, _SPRINGS)
    damper, damper_hz = end(dampers, _DAMPERS)
    return Delay(
        lag(contact.constants, contact.circuit), mass,
        free.viscosity(_SLOW), spring, spring_hz,
        passive(springs, _SPRINGS), damper, damper_hz, passive(dampers, _DAMPERS),
    )  # fmt: skip


def noise_force(contact: HeldContact) -> float | None:
    """Return the rms force [N] of the motors along the normal at rest, None where the contact is unstable."""
    try:
        return noise_covariance(contact).rms("motor_normal")
    except InputError as error:
        if "no stationary noise" in str(error):
            return None
        raise


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Find every limit of analog stiffness and damping on each board, and say which comes first."""
    given: CeilingParameters = spec.parameters
    points.expect(len(given.boards) + 2)
    delays: dict[str, Delay] = {}
    scene = spec.scene(*given.boards[0].set)
    if scene.computer.method is not Method.CONTINUOUS or not scene.is_slider:
        fail("the limits are those of method continuous on a slider", file=str(spec.file), key="scene")
    for board in given.boards:
        contact = HeldContact.of(resolve(spec.scene(*board.set)))

        def ask(contact: HeldContact = contact) -> dict[str, Any]:
            numbers = asdict(delay(contact, given.damper_with_n_per_m))
            return {k: v if math.isfinite(v) else None for k, v in numbers.items()}

        got = points.get(board.name, ask)
        delays[board.name] = Delay(**{k: math.inf if v is None else v for k, v in got.items()})
    first = HeldContact.of(resolve(scene))
    noise = _noise(first, given, delays[given.boards[0].name], points)
    limits = _limits(first.scene, first.constants, given, delays[given.boards[0].name], noise)
    columns: dict[str, list[Any]] = {"board": list(delays)}
    for name, read in _COLUMNS.items():
        values = [read(each) for each in delays.values()]
        columns[name] = [value if math.isfinite(value) else None for value in values]
    table = Table(
        "delay", "What delay allows, board by board", columns,
        f"Held contact, linear models of the netlist; dampers beside {given.damper_with_n_per_m:g} N/m. "
        "Empty: no limit within what was scanned.",
    )  # fmt: skip
    return spec.result(limits, table, noise, verdicts=_verdicts(limits, delays, given))


_COLUMNS: dict[str, Callable[[Delay], float]] = {
    col.SUM_OF_TIME_CONSTANTS: lambda d: 1e6 * d.lag_s,
    col.VISCOSITY: lambda d: d.viscosity_n_s_per_m,
    "moving mass [kg]": lambda d: d.mass_kg,
    "b/sum(tau) [N/m]": lambda d: d.eaten_n_per_m,
    col.STABLE_SPRING_UP_TO: lambda d: d.spring_n_per_m,
    "rings at [Hz]": lambda d: d.spring_hz,
    "passive spring up to [N/m]": lambda d: d.passive_spring_n_per_m,
    "stable damper up to [N s/m]": lambda d: d.damper_n_s_per_m,
    "rings there at [Hz]": lambda d: d.damper_hz,
    "passive damper up to [N s/m]": lambda d: d.passive_damper_n_s_per_m,
    "that over 8 b": lambda d: d.passive_damper_n_s_per_m / (8.0 * d.viscosity_n_s_per_m),
}


def _noise(contact: HeldContact, given: CeilingParameters, delays: Delay, points: Points) -> Table:
    """Return the force of white potentiometer noise over stiffness, and over damping."""
    scene = contact.scene
    white = scene.effects.model_copy(update={"pot_noise": PotNoise.WHITE})
    noisy = contact.of_scene(scene.model_copy(update={"effects": white}))
    columns: dict[str, list[Any]] = {
        name: [] for name in ("varied", "value [N/m or N s/m]", col.FORCE_IN_THE_LOOP_RMS, "threshold [N]")
    }
    for name, key, other, low, end in (
        ("spring", SPRING, {DAMPER: 0.0}, 10.0, delays.spring_n_per_m),
        ("damper", DAMPER, {SPRING: given.noise_with_n_per_m}, 0.01, delays.damper_n_s_per_m),
    ):
        high = 0.99 * end if math.isfinite(end) else 1e4 * low
        values = geometric(low, high, given.noise_points).tolist()

        def curve(
            key: str = key, other: dict[str, float] = other, values: list[float] = values
        ) -> list[float | None]:
            return [noise_force(noisy.with_computer(**other, **{key: x})) for x in values]

        forces = points.get(f"noise over the {name}", curve)
        if (grid_end := _bracket(values, forces, given.noise_n)) is not None:

            def limit(
                key: str = key, other: dict[str, float] = other, ends: tuple[float, float] = grid_end
            ) -> float:
                def over(x: float) -> float:
                    force = noise_force(noisy.with_computer(**other, **{key: math.exp(x)}))
                    return math.log(force / given.noise_n) if force else math.nan

                return math.exp(brentq(over, *(math.log(x) for x in ends), xtol=1e-6))

            at = points.get(f"noise limit of the {name}", limit)
            place = next(i for i, x in enumerate(values) if x >= at)
            values = [*values[:place], at, *values[place:]]
            forces = [*forces[:place], given.noise_n, *forces[place:]]
        columns["varied"] += [name] * len(values)
        columns["value [N/m or N s/m]"] += values
        columns[col.FORCE_IN_THE_LOOP_RMS] += forces
        columns["threshold [N]"] += [given.noise_n] * len(values)
    pot = scene.device.potentiometer
    return Table(
        "noise", "Force of the potentiometer's noise", columns,
        f"White noise of {1e3 * pot.noise_rad:g} mrad rms up to {pot.noise_bandwidth_hz:g} Hz, exact "
        f"covariance of the mass at rest on the wall; dampers beside {given.noise_with_n_per_m:g} N/m.",
    )  # fmt: skip


def _bracket(values: list[float], rms: list[float | None], threshold: float) -> tuple[float, float] | None:
    """Return the neighbours between which the noise first reaches the threshold; None where it does not."""
    last: float | None = None
    for value, force in zip(values, rms, strict=True):
        if force is None:
            continue
        if force >= threshold:
            return (last, value) if last is not None and force > threshold else None
        last = value
    return None


def _crossing(table: Table, name: str, threshold: float) -> float:
    """Return the first value at which the noise reaches the threshold; infinite where it does not."""
    for kind, value, rms, _ in zip(*table.columns.values(), strict=True):
        if kind == name and rms is not None and rms >= threshold:
            return float(value)
    return math.inf


def _limits(
    scene: Scene, constants: DesignConstants, given: CeilingParameters, delays: Delay, noise: Table
) -> Table:
    reach = scene.device.slider.radius_m if scene.device.slider else 1.0
    push = constants.torque_per_amp / reach
    rows = (
        ("circuit delay: stable contact", delays.spring_n_per_m, delays.damper_n_s_per_m),
        ("circuit delay: passive device", delays.passive_spring_n_per_m, delays.passive_damper_n_s_per_m),
        ("multiplier at full scale", constants.k_fs / reach**2, constants.c_fs / reach**2),
        (
            f"driver's current limit at {1e3 * given.depth_m:g} mm, {given.speed_m_per_s:g} m/s",
            push * constants.i_limit / given.depth_m, push * constants.i_limit / given.speed_m_per_s,
        ),
        (
            "motor's rated current, the same",
            push * constants.i_rated / given.depth_m, push * constants.i_rated / given.speed_m_per_s,
        ),
        (
            f"potentiometer noise above {given.noise_n:g} N rms",
            _crossing(noise, "spring", given.noise_n), _crossing(noise, "damper", given.noise_n),
        ),
    )  # fmt: skip
    return Table(
        "limits", "Practical upper limit of the analog path",
        {
            "limit": [name for name, _, _ in rows],
            col.STIFFNESS: [k if math.isfinite(k) else None for _, k, _ in rows],
            "damping [N s/m]": [c if math.isfinite(c) else None for _, _, c in rows],
        },
        f"Board '{given.boards[0].name}'. What switching on at samples costs is a study of its own.",
    )  # fmt: skip


def _verdicts(limits: Table, delays: dict[str, Delay], given: CeilingParameters) -> list[Verdict]:
    names = limits.columns["limit"]
    texts, out = [], []
    for column, unit in ((col.STIFFNESS, "N/m"), ("damping [N s/m]", "N s/m")):
        rising = sorted(
            (value, name) for name, value in zip(names, limits.columns[column], strict=True) if value
        )
        texts.append("; ".join(f"{value:.3g} {unit} ({name})" for value, name in rising))
    out.append(
        Verdict("N4", "practical upper limit of analog stiffness", "'theoretically no upper limit'", texts[0],
                None)
    )  # fmt: skip
    out.append(Verdict("N4", "practical upper limit of analog damping", "a question", texts[1], None))
    for name, delay in delays.items():
        low = delay.eaten_n_per_m
        high = low + delay.viscosity_n_s_per_m**2 / delay.mass_kg
        if not math.isfinite(delay.spring_n_per_m):
            continue
        out.append(
            Verdict(
                "N4", f"delay bounds the spring: {name}",
                f"viscosity over delay, {low:.4g} N/m, to {high:.4g} where braking has no delay; within 2 %",
                f"{delay.spring_n_per_m:.4g} N/m, with a delay of {1e6 * delay.lag_s:.3g} us",
                0.98 * low <= delay.spring_n_per_m <= 1.02 * high, own=True,
            )
        )  # fmt: skip
    return out


STUDY = Study("ceiling", "practical upper limit of analog stiffness and damping", CeilingParameters, analyse)
