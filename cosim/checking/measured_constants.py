"""What the board states (`.csparam`) against what ngspice measures on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cosim.checking.probed_board import ProbedBoard
from cosim.checking.signal_paths import LOW_HZ, Path, low_hz
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import NoOperatingPoint

UNITS = {"v_rad": "V/rad", "k_fs": "N m/rad", "c_fs": "N m s/rad", "v_nm": "V/(N m)", "w_rated": "V"}
Readings = dict[tuple[str, str], tuple[float | None, float | None]]
"""(name, where) -> (measured, spread in %)."""
_APART = 10.0
"""Ratio of the two frequencies at which the damper is read."""


@dataclass(frozen=True)
class Constant:
    """A design constant at one place.

    Attributes
    ----------
    name, unit : as the board states it
    where : joint, or motor and joint as in the pin ksp12
    stated : the board's ``.csparam``
    measured : on the board at the level in force; ``None`` where nothing comes through
    ideal : the same with ideal parts, which leaves the board's own components
    spread_percent : change of the damper between its two frequencies
    """

    name: str
    unit: str
    where: str
    stated: float
    measured: float | None
    ideal: float | None
    spread_percent: float | None = None

    @property
    def deviation_percent(self) -> float | None:
        """Measured over stated, less one [%]."""
        return None if self.measured is None else 100.0 * (self.measured / self.stated - 1.0)

    @property
    def ideal_deviation_percent(self) -> float | None:
        """Share of the deviation that the board's own components make [%]."""
        return None if self.ideal is None else 100.0 * (self.ideal / self.stated - 1.0)


@dataclass(frozen=True)
class Rest:
    """What a joint does out of contact: gains, inputs and speeds all at zero.

    Attributes
    ----------
    current_a, force_n : of the motor, and at the reach `r_tip`
    leak_n_per_m, leak_n_s_per_m : stiffness and damping left at the tip, of the largest of its joints
    """

    joint: int
    current_a: float
    force_n: float
    leak_n_per_m: float
    leak_n_s_per_m: float


def measure_constants(
    bench: ProbedBoard, constants: DesignConstants, paths: list[Path], notes: list[str]
) -> Readings:
    """Read every constant at every place, one gain at full scale at a time.

    Springs and commands are read at a low frequency; the damper as H(jw)/(jw) at two, from its quadrature
    part, which a spring's leakage does not touch. What a multiplier puts out for rated current is a point far
    from rest: where ngspice finds none, a line of ``notes`` says so and the rest stands.
    """
    per_ampere = constants.kt * constants.gear
    joints = range(1, bench.joints + 1)
    narrow = min((p.bandwidth_hz for p in paths if p.bandwidth_hz is not None), default=None)
    f = low_hz(narrow)
    readings: Readings = {}
    for i in joints:
        for j in joints:
            pair = f"{i}{j}"
            bench.hold_only({f"ksp{i}{j}": constants.v_fs})
            k = -_real(bench, f"pot{j}", f"imot{i}", f) * per_ampere
            readings["k_fs", pair] = k, None
            if i == j:
                by_u = _real(bench, f"u{j}", f"imot{i}", f) * per_ampere
                readings["v_rad", f"{j}"] = (k / by_u if by_u else None), None
            bench.hold_only({f"ksd{i}{j}": constants.v_fs})
            c, c_above = (-_rate(bench, f"pot{j}", f"imot{i}", hz) * per_ampere for hz in (f, _APART * f))
            readings["c_fs", pair] = c, (100.0 * (c_above / c - 1.0) if c else None)
            try:
                w = multiplier_volts(bench, constants, i, j)
            except NoOperatingPoint as reason:
                notes.append(f"w_rated {pair} is not known: {reason}")
                w = None
            if w is not None:
                readings["w_rated", pair] = w, None
    bench.hold_only({})
    for i in joints:
        by_cmd = _real(bench, f"cmd{i}", f"imot{i}", f) * per_ampere
        readings["v_nm", f"{i}"] = (1.0 / by_cmd if by_cmd else None), None
    return readings


def multiplier_volts(bench: ProbedBoard, constants: DesignConstants, i: int, j: int) -> float | None:
    """Return what the multiplier from joint j to motor i puts out for rated current, at full-scale gain [V].

    It is the multiplier with the largest output, all other gains being zero. ``None`` if the board has none,
    or the motor gets nothing.
    """
    outputs = [a.out_node for a in bench.board.amplifiers if a.role == "vca"]
    rated = constants.i_rated * constants.kt * constants.gear
    bench.hold_only({f"ksp{i}{j}": constants.v_fs, f"pot{j}": -rated / constants.k_fs})
    point = bench.operating_point()
    current = abs(point[f"imot{i}"])
    if not outputs or current == 0.0:
        return None
    return max(abs(point[node]) for node in outputs) * constants.i_rated / current


def table(constants: DesignConstants, real: Readings, ideal: Readings) -> list[Constant]:
    """Put stated, measured and ideal side by side, in the order of `UNITS`."""
    return [
        Constant(name, unit, where, getattr(constants, name), value, ideal[name, where][0], spread)
        for name, unit in UNITS.items()
        for (measured, where), (value, spread) in real.items()
        if measured == name
    ]


def measure_rest(bench: ProbedBoard, constants: DesignConstants) -> list[Rest]:
    """Read what is left with every gain at zero."""
    bench.hold_only({})
    currents = bench.operating_point()
    per_ampere = constants.kt * constants.gear
    joints = range(1, bench.joints + 1)
    per_metre = per_ampere / constants.r_tip**2
    k = {(i, j): -_real(bench, f"pot{j}", f"imot{i}", LOW_HZ) * per_metre for j in joints for i in joints}
    c = {(i, j): -_rate(bench, f"pot{j}", f"imot{i}", LOW_HZ) * per_metre for j in joints for i in joints}
    return [
        Rest(
            joint=i,
            current_a=currents[f"imot{i}"],
            force_n=currents[f"imot{i}"] * per_ampere / constants.r_tip,
            leak_n_per_m=max((k[i, j] for j in joints), key=abs),
            leak_n_s_per_m=max((c[i, j] for j in joints), key=abs),
        )
        for i in joints
    ]


def _real(bench: ProbedBoard, pin: str, output: str, f_hz: float) -> float:
    return float(bench.response(pin, f"lin 1 {f_hz!r} {f_hz!r}")[output][0].real)


def _rate(bench: ProbedBoard, pin: str, output: str, f_hz: float) -> float:
    h = bench.response(pin, f"lin 1 {f_hz!r} {f_hz!r}")[output][0]
    return float(h.imag) / (2 * math.pi * f_hz)
