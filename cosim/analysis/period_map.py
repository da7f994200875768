"""The exact map of one sampling period: computer, DACs, circuit, motor, linkage and operator together.

The state is X = (x, samples, DACs, noise): the continuous state x of `cosim.analysis.linearise`; what the
computer read at its last samples; for both groups of DACs (gains; equilibria and commands) the reading that
they come from and the one that they go to, since they settle along a ramp; and the noise of the
potentiometers at the last and the next tick of its grid. Between two events the state goes by the matrix
exponential, an event is a matrix of its own, and a period is the product of both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from cosim.analysis.covariance_steps import exact_step
from cosim.analysis.linearise import Output, System
from cosim.types import Array

__all__ = ["Group", "Lifted", "Stretch", "lift"]


#: Instants closer than this share of the period are one.
_SAME = 1e-12


@dataclass(frozen=True)
class Group:
    """DACs that change together.

    Attributes
    ----------
    drive
        [channels + n, S], inputs of the system for a reading of the computer.
    phase_s
        Time within the period at which they start.
    late
        Age of the reading that they start for then, in samples.
    start, end
        Columns of X of the readings they come from and go to.
    """

    drive: Array
    phase_s: float
    late: int
    start: slice
    end: slice


@dataclass(frozen=True)
class Stretch:
    """Time between two instants without an event within.

    Attributes
    ----------
    length_s
        Of the stretch.
    enter
        [N + 2 M, size], from X at the start to the state, the inputs and their slopes (x, i, i') there.
    leave
        [size, size], from X at the start to X at the end.
    exit
        [N + 2 M, size], from X at the end to (x, i, i') there.
    """

    length_s: float
    enter: Array
    leave: Array
    exit: Array


@dataclass(frozen=True)
class Lifted:
    """The linear scene as a chain of events and stretches of a period.

    Attributes
    ----------
    system
        Continuous part, law and timing.
    size
        Of X; the first `states` are x.
    readings
        Columns of the computer's readings, the newest first.
    groups
        DACs that act on the system at all.
    noise
        Columns of the noise at the last tick of its grid, and at the next; None without noise.
    """

    system: System
    size: int
    readings: tuple[slice, ...]
    groups: tuple[Group, ...]
    noise: tuple[slice, slice] | None
    _steps: dict[float, Array] = field(default_factory=dict, repr=False)

    @property
    def states(self) -> int:
        """Number of continuous states."""
        return len(self.system.a)

    @property
    def inputs(self) -> int:
        """Number of inputs of the system: channels and potentiometers."""
        return int(self.system.b.shape[1])

    def step(self, h: float) -> Array:
        """Return the exact map of (x, i, i') over `h` [s]."""
        key = float(f"{h:.13e}")
        if key not in self._steps:
            s = self.system
            # the slope of an input matters to E through the noise alone
            e = np.zeros(s.b.shape)
            e[:, -s.joints :] = s.e
            self._steps[key] = exact_step(s.a, s.b, e, h)
        return self._steps[key]

    def sample(self) -> Array:
        """Return the event of a sample: the computer reads the encoders and estimates speeds."""
        out = np.eye(self.size)
        s, n = self.system, self.system.joints
        for newer, older in pairwise(self.readings):
            out[older] = np.eye(self.size)[newer]
        newest = self.readings[0]
        out[newest] = 0.0
        angles = slice(newest.start, newest.start + n)
        out[angles, :n] = np.eye(n)
        if newest.stop - newest.start > n:
            speeds = slice(angles.stop, newest.stop)
            share = (1.0 - s.keep) / s.period_s
            out[speeds, :n] = share * np.eye(n)
            out[speeds, angles] = -share * np.eye(n)
            out[speeds, speeds] = s.keep * np.eye(n)
        return out

    def release(self, group: Group) -> Array:
        """Return the event at which DACs start for a new reading, from wherever their ramp has got to."""
        out = np.eye(self.size)
        reading = self.readings[group.late]
        out[group.end] = np.eye(self.size)[reading]
        reached = self._part(self.system.period_s)
        out[group.start] = (1.0 - reached) * np.eye(self.size)[group.start]
        out[group.start] += reached * np.eye(self.size)[group.end]
        return out

    def _part(self, since: float) -> float:
        """Share of the way that DACs have gone after a time [s]."""
        settle = self.system.settle_s
        return 1.0 if settle == 0.0 else min(max(since / settle, 0.0), 1.0)

    def stretch(self, t: float, h: float, noise: tuple[float, float] = (0.0, 0.0)) -> Stretch:
        """Return the stretch from `t` [s] within the period over `h` [s]; no event may lie inside.

        Parameters
        ----------
        noise
            Places of both ends between the ticks of the noise around them, 0 to 1.
        """
        states, inputs, n = self.states, self.inputs, self.system.joints
        begin, end = np.zeros((2, inputs, self.size))
        for group in self.groups:
            since = t - group.phase_s
            if since < -_SAME * self.system.period_s:
                since += self.system.period_s
            for row, part in ((begin, self._part(max(since, 0.0))), (end, self._part(since + h))):
                row[:, group.start] += (1.0 - part) * group.drive
                row[:, group.end] += part * group.drive
        if self.noise is not None:
            for row, part in zip((begin, end), noise, strict=True):
                row[-n:, self.noise[0]] += (1.0 - part) * np.eye(n)
                row[-n:, self.noise[1]] += part * np.eye(n)
        enter = np.zeros((states + 2 * inputs, self.size))
        enter[:states, :states] = np.eye(states)
        enter[states : states + inputs] = begin
        enter[states + inputs :] = (end - begin) / h
        leave = np.eye(self.size)
        leave[:states] = self.step(h)[:states] @ enter
        out = enter.copy()
        out[states : states + inputs] = end
        return Stretch(h, enter, leave, out)

    def instants(self) -> list[float]:
        """Return the times within a period [s] at which something begins or ends, 0 first."""
        period, times = self.system.period_s, [0.0]
        for group in self.groups:
            times += [group.phase_s, (group.phase_s + self.system.settle_s) % period]
            if self.system.settle_s >= period:
                times.pop()
        kept: list[float] = []
        for t in sorted(times):
            if t < period * (1.0 - _SAME) and (not kept or t - kept[-1] > _SAME * period):
                kept.append(t)
        return kept

    def ramping(self, t: float) -> bool:
        """Whether DACs are under way at a time within the period [s] that is no later than their start."""
        settle, period = self.system.settle_s, self.system.period_s
        for group in self.groups:
            since = (t - group.phase_s) % period
            if settle > 0.0 and since < settle - _SAME * period and period - since > _SAME * period:
                return True
        return False

    def at(self, t: float) -> Array:
        """Return all events at a time within the period [s] as one map: sample, then DACs."""
        out = self.sample() if t == 0.0 else np.eye(self.size)
        for group in self.groups:
            if abs(t - group.phase_s) <= _SAME * self.system.period_s:
                out = self.release(group) @ out
        return out

    def period(self) -> Array:
        """Return the map of X from just before a sample to just before the next (the monodromy matrix).

        Noise, where there is any, keeps its values.
        """
        out = np.eye(self.size)
        times = [*self.instants(), self.system.period_s]
        for t, after in pairwise(times):
            out = self.stretch(t, after - t).leave @ self.at(t) @ out
        return out

    def output(self, out: Output) -> Array:
        """Return the rows that an output takes from (x, i, i')."""
        slope = np.zeros((len(out.c), self.inputs))
        slope[:, -self.system.joints :] = out.e
        return np.hstack([out.c, out.d, slope])


def lift(system: System, *, noise: bool = False) -> Lifted:
    """Return the period's events for a linear scene; with `noise`, X holds that of the potentiometers too."""
    n, law = system.joints, system.law
    channels = len(law.volts)
    slopes = np.hstack([law.by_angle, law.by_speed]) if law.by_speed.any() else law.by_angle
    width = slopes.shape[1]
    at = len(system.a)
    gains = slice(n, n + 2 * n * n)
    chosen = np.zeros(channels, bool)
    chosen[gains] = True
    parts = []
    for mask, delay in ((chosen, system.lag_s), (~chosen, system.lag_s + system.skew_s)):
        drive = np.zeros((system.b.shape[1], width))
        drive[:channels] = np.where(mask[:, None], slopes, 0.0)
        if (system.b @ drive).any() or any((out.d @ drive).any() for out in system.outputs.values()):
            late, phase = divmod(delay, system.period_s)
            if system.period_s - phase <= _SAME * system.period_s:
                late, phase = late + 1, 0.0
            if phase <= _SAME * system.period_s:
                phase = 0.0
            parts.append((drive, float(phase), int(late)))
    depth = 1 + max((late for _, _, late in parts), default=0)
    readings = tuple(slice(at + k * width, at + (k + 1) * width) for k in range(depth))
    at += depth * width
    groups = []
    for drive, phase, late in parts:
        groups.append(Group(drive, phase, late, slice(at, at + width), slice(at + width, at + 2 * width)))
        at += 2 * width
    ticks = (slice(at, at + n), slice(at + n, at + 2 * n)) if noise else None
    at += 2 * n if noise else 0
    return Lifted(system, at, readings, tuple(groups), ticks)
