"""Compiled shaft between a motor and its joint: a torsion spring with a damper, and the gear's backlash.

With a shaft the motors are coordinates of their own. Angles and speeds are then [joints, motors], a motor's
angle counted at the joint (motor turns over gear); the twist is the motor's angle less the joint's. Without
backlash the torque is T = k twist + c twist'.

Backlash is a gap of +-half_gap in series with that spring and damper (M. Nordin, J. Galic and P.-O. Gutman,
"New models for backlash and gear play", Int. J. Adaptive Control and Signal Processing 11, 1997): a flank
that carries leaves x = twist -+ half_gap to the shaft, T = k x + c x', until T has fallen to zero; then no
tooth touches, no torque passes, and the shaft relaxes, x = x0 exp(-k t/c), until the rest of the twist has
crossed the gap. As the gap goes to zero this is the shaft without backlash.

Which flank carries is memory, not a function of the state: `tooth` of `WORK.flank`, with `slack` and `left`,
the twist x0 and the time at which the flank was left. A time loop that sets `latched` of `WORK.mode` keeps
them with `engage` at its accepted points, and ends its steps where `margin` vanishes.
"""

import math
from typing import Any

from numpy.typing import NDArray

from mech.compiled import entry, inner, inner_inlined, vector
from mech.records import LINKAGE, WORK

__all__ = ["EDGE_RAD", "engage", "margin", "shaft_torque", "windup_energy"]

Vector = NDArray[Any]
Record = Any

#: A margin below zero by less is rounding [rad]: right after a change of flank it is zero.
EDGE_RAD = 1e-14


@inner_inlined
def _slack(p: Record, i: int, t: float, w: Record) -> float:
    """Twist [rad] that a shaft without a flank to push on has not yet let go."""
    if w.flank.slack[i] == 0.0:
        return 0.0
    return float(
        w.flank.slack[i] * math.exp(-(t - w.flank.left[i]) * p.shaft_stiffness[i] / p.shaft_damping[i])
    )


@inner
def engage(p: Record, t: float, q: Vector, v: Vector, w: Record) -> tuple[bool, float]:
    """Bring the flanks up to date; True if one changes, and the energy [J] that goes with it.

    What the shaft holds when its flank is left is lost to its damper (and taken off that loss again where a
    flank carries before the shaft has relaxed).
    """
    n = p.n
    changed = False
    lost = 0.0
    for i in range(n):
        if p.half_gap[i] == 0.0:
            continue
        k, c = p.shaft_stiffness[i], p.shaft_damping[i]
        twist = q[n + i] - q[i]
        rate = v[n + i] - v[i]
        tooth = w.flank.tooth[i]
        if tooth != 0:
            x = twist - tooth * p.half_gap[i]
            if tooth * (k * x + c * rate) <= 0.0:
                changed = True
                lost += 0.5 * k * x * x
                w.flank.tooth[i] = 0
                w.flank.slack[i] = x if c > 0.0 else 0.0
                w.flank.left[i] = t
        else:
            slack = _slack(p, i, t, w)
            bare = twist - slack
            if c > 0.0:
                rate += k / c * slack
            side = 1 if bare > 0.0 else -1
            if abs(bare) > p.half_gap[i] and side * rate > 0.0:
                changed = True
                x = twist - side * p.half_gap[i]
                lost -= 0.5 * k * x * x
                w.flank.tooth[i] = side
    return changed, lost


@inner_inlined
def shaft_torque(p: Record, q: Vector, v: Vector, w: Record) -> None:
    """Fill `w.tau_shaft` (motor on joint) and `w.tau_loss`, its part that stores nothing [N m].

    Where no loop keeps the flanks (`w.mode.latched` 0) they are those of a state that begins here.
    """
    n = p.n
    if p.backlash_on and w.mode.latched == 0:
        for i in range(n):
            w.flank.tooth[i] = 0
            w.flank.slack[i] = 0.0
        engage(p, 0.0, q, v, w)
    for i in range(n):
        spring = p.shaft_stiffness[i] * (q[n + i] - q[i])
        loss = p.shaft_damping[i] * (v[n + i] - v[i])
        if p.half_gap[i] > 0.0:
            if w.flank.tooth[i] == 0:
                spring = 0.0
                loss = 0.0
            else:
                spring -= p.shaft_stiffness[i] * w.flank.tooth[i] * p.half_gap[i]
        w.tau_shaft[i] = spring + loss
        w.tau_loss[i] = loss


@inner_inlined
def margin(p: Record, i: int, t: float, twist: float, rate: float, w: Record) -> float:
    """How far [rad] a state is from a change of flank: negative beyond it, infinite without a gap."""
    gap = p.half_gap[i]
    if gap == 0.0:
        return math.inf
    tooth = w.flank.tooth[i]
    if tooth != 0:
        return float(tooth * (twist + p.shaft_damping[i] / p.shaft_stiffness[i] * rate) - gap)
    return float(gap - abs(twist - _slack(p, i, t, w)))


@entry(LINKAGE, vector, WORK, result=float, how=inner_inlined)
def windup_energy(p: Record, q: Vector, w: Record) -> float:
    """Energy stored in the shafts [J]."""
    total = 0.0
    if p.shaft_on:
        for i in range(p.n):
            x = q[p.n + i] - q[i]
            if p.half_gap[i] > 0.0:
                x = x - w.flank.tooth[i] * p.half_gap[i] if w.flank.tooth[i] != 0 else 0.0
            total += 0.5 * p.shaft_stiffness[i] * x * x
    return total
