"""Recorded signals as piecewise linear sources."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cosim.effects.dac_skew import skew_s
from cosim.scene import Scene

#: A DAC without settling time jumps right after its sample instant; a deck needs a slope [s].
RISE_S = 100e-9
#: A point this close to the line through its neighbours, in shares of the signal's range, is left out.
_STRAIGHT = 1e-13

Vector = NDArray[np.float64]


def settling_s(scene: Scene) -> float:
    """Length of the ramp [s] by which the DACs change, 0 when they jump."""
    return scene.computer.dac.settling_s if scene.effects.dac_settling else 0.0


def channel(time: Vector, volts: Vector, settle: float) -> tuple[Vector, Vector]:
    """Corners of a DAC channel that was recorded at every accepted point.

    Parameters
    ----------
    time, volts
        Recorded points, shape (points,) [s, V]. Where a ramp begins and ends there is a point.
    settle
        Length of a ramp [s]. At 0 the channel jumps right after a recorded point, to that of the same time or
        to the next, which becomes a ramp of `RISE_S`.

    Returns
    -------
    tuple
        Times and values of the corners, the first at time 0.
    """
    changed = np.flatnonzero(np.diff(volts)) + 1
    if settle > 0.0:
        near = np.unique(np.concatenate([[0], changed - 1, changed]))
        return straightened(time[near], volts[near])
    t, v = [time[0]], [volts[0]]
    for k in changed:
        before = time[k - 1]
        after = time[np.searchsorted(time, before, side="right")]
        t += [before, before + min(RISE_S, after - before)]
        v += [volts[k - 1], volts[k]]
    start = 1 if len(t) > 1 and t[1] == t[0] else 0
    return np.array(t[start:]), np.array(v[start:])


def straightened(t: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Leave out what lies on the straight line between the points around it."""
    allowed = _STRAIGHT * (np.ptp(v) + np.max(np.abs(v)))
    keep = [0]
    for k in range(1, len(t) - 1):
        a, b = keep[-1], k + 1
        line = v[a] + (v[b] - v[a]) * (t[k] - t[a]) / (t[b] - t[a])
        if abs(v[k] - line) > allowed:
            keep.append(k)
    if len(t) > 1:
        keep.append(len(t) - 1)
    return t[keep], v[keep]


def source(node: str, t: Vector, v: Vector) -> str:
    """Return a source of piecewise linear voltage at a node, with all digits.

    A B-source finds its place among the corners by bisection, where the time of a V-source's `pwl` grows with
    their number; but ngspice stops at none of them: see `clocks`. Beyond its ends it goes on along
    the first and the last line, so both are made level.
    """
    if np.all(v == v[0]):
        return f"V{node} {node} 0 dc {float(v[0])!r}"
    t = np.concatenate([[t[0] - 1.0], t, [t[-1] + 1.0]])
    v = np.concatenate([v[:1], v, v[-1:]])
    corners = ",".join(f"{float(a)!r},{float(b)!r}" for a, b in zip(t, v, strict=True))
    return f"B{node} {node} 0 v=pwl(time,{corners})"


def stopping_source(node: str, t: Vector, v: Vector) -> str:
    """Return the same as a V-source, at each of whose corners ngspice stops."""
    corners = " ".join(f"{float(a)!r} {float(b)!r}" for a, b in zip(t, v, strict=True))
    return f"V{node} {node} 0 pwl({corners})"


def channels(scene: Scene, signals: Mapping[str, Vector], names: tuple[str, ...]) -> list[str]:
    """Return the sources of the DAC channels `names` as recorded in `signals`, and their clocks."""
    time = np.asarray(signals["time"])
    settle = settling_s(scene)
    lines = [source(name, *channel(time, np.asarray(signals[name]), settle)) for name in names]
    return lines + clocks(scene)


def clocks(scene: Scene) -> list[str]:
    """Return sources that make ngspice stop where DACs begin and end to change.

    A pulse toggles at every sample with the slope of the DACs: its corners are theirs. With skew, the
    equilibria's DACs have a clock of their own.
    """
    computer, effects = scene.computer, scene.effects
    period, rise = computer.period_s, settling_s(scene) or RISE_S
    starts = [computer.delay_fraction * period if effects.delay else 0.0]
    if skew_s(scene) > 0.0:
        starts.append(starts[0] + skew_s(scene))
    return [
        f"Vclock{k} clock{k} 0 pulse(0 1 {start!r} {rise!r} {rise!r} {period - rise!r} {2 * period!r})"
        for k, start in enumerate(starts)
        if rise < period
    ]
