"""Voltages at the pins of the board between events: DACs, and the noise of the potentiometers."""

from __future__ import annotations

from typing import Any

from cosim.loop.state import STATE
from cosim.types import Record
from mech.compiled import carray, doubles_at, entry, inner, inner_inlined, vector

#: Steps over a ramp of the gains, each with the gain of its middle: the torque's impulse is wrong by at most
#: (change of gain) x (change of input) x settling time / (12 x steps^2). The input changes within the ramp by
#: its rate times the settling time: one step is enough for a ramp of at most this share of the period. Not so
#: where contact is made, and gain and input jump together: the speed is off by up to 5e-6 of itself. A
#: tolerance below this one [rad] takes more steps, so that a twin shows the error of a run.
_RAMP, _SHORT = 2, 1e-3
_CLOSE, _CLOSE_RAMP = 1e-8, 4


@inner
def is_gain(s: Record, channel: int) -> bool:
    """Whether a DAC channel is the gain of a multiplier."""
    return bool(s.n <= channel < s.n + 2 * s.n * s.n)


@inner_inlined
def volts(s: Record, channel: int, t: float) -> float:
    """Voltage of a DAC channel [V] at `t`."""
    if s.dac.ramping == 0:
        return float(s.dac.target[channel])
    group = 0 if s.n <= channel < s.n + 2 * s.n * s.n else 1
    part = min(max((t - s.dac.start[group]) / s.dac.settle, 0.0), 1.0)
    return float(s.dac.before[channel] + part * (s.dac.target[channel] - s.dac.before[channel]))


@inner_inlined
def ramp_step(s: Record) -> float:
    """Longest step over a ramp of the gains [s]."""
    if s.steps.tol < _CLOSE:
        return float(s.dac.settle / _CLOSE_RAMP)
    return float(s.dac.settle if s.dac.settle <= _SHORT * s.c.period else s.dac.settle / _RAMP)


@inner_inlined
def gains_ramp(s: Record) -> bool:
    """Whether a multiplier's gain is on its way to another value."""
    if s.dac.ramping == 0:
        return False
    for i in range(s.dac.count):
        channel = s.dac.channel[i]
        if s.n <= channel < s.n + 2 * s.n * s.n and s.dac.before[channel] != s.dac.target[channel]:
            return True
    return False


@inner_inlined
def grid_noise(s: Record, t: float, joint: int) -> float:
    """Noise of a potentiometer [rad] that is linear between the ticks of its grid."""
    if s.noise.address == 0:
        return 0.0
    table = carray(doubles_at(s.noise.address), (s.noise.rows * s.n,))
    x = t / s.noise.dt - s.noise.tick
    at = s.noise.tick * s.n + joint
    return float(table[at] + x * (table[at + s.n] - table[at]))


@inner
def component(s: Record, t: float, place: int) -> float:
    """Component noise [V] at a place, the different X first, then the pins cmd; linear between its ticks."""
    if s.component.address == 0:
        return 0.0
    width = s.component.inputs + s.n
    table = carray(doubles_at(s.component.address), (s.component.rows * width,))
    x = t / s.component.dt - s.component.tick
    at = s.component.tick * width + place
    return float(table[at] + x * (table[at + width] - table[at]))


@entry(STATE, float, int, result=float)
def position_noise(s: Record, q: float, joint: int) -> float:
    """Noise of a potentiometer [rad] that belongs to its angle.

    A cubic between the points of its table, whose slope at a point is that of the line through the two beside
    it (Catmull and Rom, 1974): a differentiator makes a jump of the current of every kink.
    """
    if s.position_noise.address == 0:
        return 0.0
    table = carray(doubles_at(s.position_noise.address), (s.position_noise.points * s.n,))
    x = min(max((q - s.position_noise.lo) / s.position_noise.step, 0.0), s.position_noise.points - 1.000001)
    i = int(x)
    x -= i
    at = i * s.n + joint
    left, right = table[at], table[at + s.n]
    before = table[at - s.n] if i > 0 else 2.0 * left - right
    behind = table[at + 2 * s.n] if i + 2 < s.position_noise.points else 2.0 * right - left
    square = before - 2.5 * left + 2.0 * right - 0.5 * behind
    cube = 1.5 * (left - right) + 0.5 * (behind - before)
    return float(left + x * (0.5 * (right - before) + x * (square + x * cube)))


@inner
def noise_at(s: Record, t: float, joint: int) -> float:
    """Return what the potentiometer of a joint adds to its angle [rad]: linear in time, then by the angle."""
    value = 0.0
    if s.noise.address != 0:
        table = carray(doubles_at(s.noise.address), (s.noise.rows * s.n,))
        x = t / s.noise.dt - s.noise.tick
        at = s.noise.tick * s.n + joint
        value += table[at] + x * (table[at + s.n] - table[at])
    return float(value + position_noise(s, s.q_trial[joint], joint))


@entry(STATE, vector)
def pins(s: Record, out: Any) -> None:
    """Fill `out` with the pins pot, all DAC channels and vel at the accepted point; [4 n + 2 n^2]."""
    n = s.n
    dacs = 2 * n + 2 * n * n
    for j in range(n):
        out[j] = s.q[j] + grid_noise(s, s.t, j) + position_noise(s, s.q[j], j)
        out[n + dacs + j] = s.gear * s.v[s.motor + j]
    for channel in range(dacs):
        out[n + channel] = volts(s, channel, s.t)
    for i in range(n):
        out[dacs + i] += component(s, s.t, s.component.inputs + i)
