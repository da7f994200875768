"""What a board does besides its small-signal paths: current limit, control voltage, offsets."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from cosim.circuits.extraction.path_measurement import LOW_HZ, Session
from cosim.circuits.extraction.testbench import Testbench
from cosim.errors import NoOperatingPoint
from cosim.types import Array, Complex

__all__ = ["ControlPath", "Offsets", "beyond_rounding", "control_path", "current_limits", "offsets"]


#: Command voltages go this many times the converters' range: far enough for any driver that clamps.
_BEYOND = 5.0
_STEPS = 40
#: Where no operating point is found so far out: how far the commands go then, from rest.
_NEARER = (_BEYOND, 2.0, 1.0)
#: Offsets below this are rounding: volts relative to full scale, and amperes of a motor.
_ROUNDING, _ROUNDING_A = 1e-12, 1e-12
#: A point of a sweep is as wrong as ngspice's tolerance allows, 1e-6 at a knee, and otherwise on either side
#: of rest. Newton's method halves the digits that are wrong with each start from the point before.
_AGAIN, _BESIDE = 8, 1e-10
#: Slope relative to that at rest, below which the current no longer rises.
_FLAT = 0.01
#: Control voltages at which the gain is compared with its value at full scale.
SHARES = (-1.0, -0.5, -0.1, 0.0, 0.1, 0.5, 1.0)
#: Volts at X while the control path is measured.
_AT_X = (1.0, 0.1, 0.01)


@dataclass(frozen=True)
class ControlPath:
    """What the gain pins do besides multiplying.

    Attributes
    ----------
    nonlinearity
        [m], largest difference between gain and control voltage's share of full scale, as a share of the
        gain at full scale.
    delay_s
        [m], how much later than X the control voltage acts; ``None`` for a board without probes.
    error
        Largest difference between control path and X path in the band, relative; ``None`` without probes.
    """

    nonlinearity: Array
    delay_s: Array | None
    error: float | None


@dataclass(frozen=True)
class Offsets:
    """What a board does with every pin at zero.

    Attributes
    ----------
    current
        [n] A, motor currents without what passes the multipliers.
    x, y
        [m] V, what each multiplier sees at its inputs, its own offsets included.
    """

    current: Array
    x: Array
    y: Array


def current_limits(session: Testbench) -> Array:
    """Return the lowest and highest current of each motor at standstill [n, 2] A, infinite where none shows.

    From a `.dc` sweep of its command: the current where it stops rising.

    Raises
    ------
    NoOperatingPoint
        Where ngspice finds none within the converters' range either.
    """
    out = np.tile([-np.inf, np.inf], (session.joints, 1))
    for i in range(session.joints):
        volts, current = _swept(session, f"cmd{i + 1}", f"imot{i + 1}")
        slope = np.diff(current)
        middle = _STEPS // 2
        flat = np.abs(slope) < _FLAT * np.abs(slope[middle])
        # beside the knee: far beyond it, what the command sends past the driver counts as well
        knees = [middle + int(np.argmax(flat[middle:]))] if flat[-1] else []
        knees += [middle - int(np.argmax(flat[middle - 1 :: -1]))] if flat[0] else []
        for knee in knees:
            side = int(current[knee] > current[middle])
            at = float(volts[knee]), float(current[knee])
            out[i, side] = _settled(session, f"cmd{i + 1}", f"imot{i + 1}", *at)
    return out


def _swept(session: Testbench, pin: str, output: str) -> tuple[Array, Array]:
    """Sweep a command from far below the converters' range to far above it: volts and currents [_STEPS + 1].

    Where ngspice does not find the first point as it is, since it is far from rest, it goes from rest to
    either end, and where vendors' models have no operating point so far out, less far.
    """
    full = session.simulator.constant("dac_v")
    try:
        reach = _BEYOND * full
        direct = session.sweep(pin, -reach, reach, _STEPS, output, aided=False)
        return np.linspace(-reach, reach, _STEPS + 1), direct
    except NoOperatingPoint:
        for share in _NEARER:
            reach = share * full
            with contextlib.suppress(NoOperatingPoint):
                low, high = (session.sweep(pin, 0.0, end, _STEPS // 2, output) for end in (-reach, reach))
                return np.linspace(-reach, reach, _STEPS + 1), np.concatenate([low[::-1], high[1:]])
        raise


def _settled(session: Testbench, pin: str, output: str, volts: float, current: float) -> float:
    """Return the current [A] at a command [V], of which a sweep says `current`, to ten digits.

    Where ngspice finds no point but from its neighbours: the sweep's.
    """
    with contextlib.suppress(NoOperatingPoint):
        end = volts * (1.0 + _AGAIN * _BESIDE)
        again = float(session.sweep(pin, volts, end, _AGAIN, output)[-1])
        if abs(again - current) < _FLAT * abs(current):  # not another solution
            return again
    return current


def offsets(session: Session) -> Offsets:
    """Measure the offsets of a board at its operating point.

    With a current k (X + x) (Y + y) behind each multiplier, d/dX at two control voltages gives k and y, d/dY
    gives k x. Without probes x is what the current of the channel's own motor does at full scale, and y
    cannot be separated from a direct path.
    """
    return beyond_rounding(session, _offsets(session))


def beyond_rounding(session: Session, measured: Offsets) -> Offsets:
    """Return offsets without those that are nothing but rounding."""
    tiny = _ROUNDING * session.v_fs
    floors = (("current", _ROUNDING_A), ("x", tiny if session.multipliers else _ROUNDING_A), ("y", tiny))
    kept = {}
    for name, least in floors:
        value: Array = getattr(measured, name)
        kept[name] = np.where(np.abs(value) > least, value, 0.0)
    return Offsets(**kept)


def _offsets(session: Session) -> Offsets:
    """Measure them, rounding included."""
    n, full = session.joints, session.v_fs
    motors = [int(pin[3]) - 1 for pin in session.channels]
    outputs = [f"imot{i + 1}" for i in range(n)]
    if not session.multipliers:
        rest, x = session.operating_point(outputs), []
        for pin, motor in zip(session.channels, motors, strict=True):
            session.hold({pin: full})
            x.append(session.operating_point(outputs)[motor] - rest[motor])
            session.hold({pin: 0.0})
        return Offsets(rest, np.array(x), np.zeros(len(x)))
    once = f"lin 1 {LOW_HZ[0]} {LOW_HZ[0]}"
    rest = session.operating_point(outputs)
    columns: dict[int, Complex] = {}
    for group in session.groups():
        columns |= _group(session, group, once, by_control=True)
    by_y = np.array([np.real(columns[c][0]) for c in range(len(motors))])
    zero = np.real(_through(session, once)[0])
    session.hold(dict.fromkeys(session.channels, full))
    held = np.real(_through(session, once)[0])
    session.hold(dict.fromkeys(session.channels, 0.0))
    each = (held - zero) / full
    alive = each != 0.0  # a channel that reaches no motor has no offset to speak of
    x, y = (np.divide(part, each, out=np.zeros(len(each)), where=alive) for part in (by_y, zero))
    through = np.zeros(n)
    np.add.at(through, motors, each * x * y)
    return Offsets(rest - through, x, y)


def control_path(session: Session, band_hz: float) -> ControlPath:
    """Compare the gains at several control voltages, and the control path with that of X over the band."""
    if not session.multipliers:
        return ControlPath(_lumped_nonlinearity(session), None, None)
    once = f"lin 1 {LOW_HZ[0]} {LOW_HZ[0]}"
    gains = []
    for share in SHARES:
        session.hold(dict.fromkeys(session.channels, share * session.v_fs))
        gains.append(np.real(_through(session, once)[0]))
    session.hold(dict.fromkeys(session.channels, 0.0))
    table = np.array(gains)
    alive = table[-1] != 0.0  # a channel that reaches no motor bends nothing
    share = np.divide(table, table[-1], out=np.zeros(table.shape), where=alive)
    nonlinearity = np.where(alive, np.abs(share - np.array(SHARES)[:, None]).max(axis=0), 0.0)
    delay, error = _dynamics(session, band_hz)
    return ControlPath(nonlinearity, delay, error)


def _through(session: Session, sweep: str) -> Complex:
    """Return the current of each channel's own motor per volt at X [F, m].

    What crosses between joints is the same share of it at every gain, and so counts for nothing.
    """
    columns: dict[int, Complex] = {}
    for group in session.groups():
        columns |= _group(session, group, sweep, by_control=False)
    return np.stack([columns[c] for c in range(len(session.channels))], axis=1)


def _group(session: Session, group: list[int], sweep: str, *, by_control: bool) -> dict[int, Complex]:
    """Drive X probes, or gain pins, of channels of different motors: current per volt of each channel [F]."""
    n = session.joints
    parts = [session.multipliers[c] for c in group]
    outputs = [f"imot{c // n % n + 1}" for c in group]
    if by_control:
        response = session.respond(dict.fromkeys([part.channel for part in parts], 1.0), sweep, outputs)
        return {c: response[:, k] for k, c in enumerate(group)}
    inside = [part.x_node for part in parts]
    response = session.respond(dict.fromkeys([part.x for part in parts], 1.0), sweep, [*outputs, *inside])
    return {c: response[:, k] / response[:, len(group) + k] for k, c in enumerate(group)}


def _lumped_nonlinearity(session: Session) -> Array:
    """Return the same from pot -> imot as a whole, at the frequency where each path is strongest."""
    n, worst = session.joints, []
    for pin in session.channels:
        i, j = int(pin[3]), int(pin[4])
        curves = []
        for share in SHARES:
            session.hold({pin: share * session.v_fs})
            curves.append(session.respond(f"pot{j}", "dec 2 0.1 10k", [f"imot{i}"])[:, 0])
        session.hold({pin: 0.0})
        table = np.array(curves) - curves[SHARES.index(0.0)]
        strongest = int(np.argmax(np.abs(table[-1])))
        if table[-1, strongest] == 0.0:  # it reaches no motor
            worst.append(0.0)
            continue
        ratio = table[:, strongest] / table[-1, strongest]
        worst.append(np.abs(ratio - np.array(SHARES)).max())
    assert len(worst) == 2 * n * n
    return np.array(worst)


def _dynamics(session: Session, band_hz: float) -> tuple[Array, float]:
    """Return how much later than X the control voltage acts [m] s, and the largest difference in the band.

    With `_AT_X` at every X; less of it where that drives an amplifier of low supplies to its limit, so that
    nothing comes through. What is not known then either is 0.
    """
    for volts in _AT_X:
        try:
            delays, worst = _dynamics_at(session, band_hz, volts)
        except NoOperatingPoint:
            if volts == _AT_X[-1]:
                raise
            continue
        finally:
            session.hold(dict.fromkeys(session.channels, 0.0))
            session.hold({part.x: 0.0 for part in session.multipliers})
        if np.isfinite(delays).all():
            break
    return np.where(np.isfinite(delays), delays, 0.0), worst


def _dynamics_at(session: Session, band_hz: float, volts: float) -> tuple[Array, float]:
    sweep = f"dec 4 {band_hz / 100.0!r} {band_hz!r}"
    delays, worst = np.zeros(len(session.channels)), 0.0
    session.hold({part.x: volts for part in session.multipliers})
    for group in session.groups():
        by_control = _group(session, group, sweep, by_control=True)
        pins = [session.channels[c] for c in group]
        session.hold(dict.fromkeys(pins, session.v_fs))
        by_x = _group(session, group, sweep, by_control=False)
        session.hold(dict.fromkeys(pins, 0.0))
        omega = 2.0 * np.pi * session.hz
        for c in group:
            if by_control[c][0].real == 0.0 or by_x[c][0] == 0.0:
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = by_control[c] / by_x[c]
                ratio = ratio / ratio[0].real
            delays[c] = -float(ratio[0].imag) / omega[0]
            worst = max(worst, float(np.abs(ratio - 1.0).max()))
    return delays, worst
