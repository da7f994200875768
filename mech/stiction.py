"""Joints at rest under Coulomb friction or on a stop: which are held, which start, and which way.

With friction and stops as located events (`located` and `stops_located` of `WORK.mode`) a joint whose speed
is zero is held while the torque that this takes is within its friction's limit, or pushes as a stop can; else
it starts.
Several joints couple through the mass matrix. The accelerations are those that minimise

    a^T M a / 2 - a^T r + sum f_c |a|      (a >= 0 on a lower stop, a <= 0 on an upper one),

a convex problem with one solution, whatever the order of the joints (Moreau 1988; Glocker 2001).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.compiled import entry, inner, vector
from mech.kernels import dynamics, solve_held
from mech.records import LINKAGE, NMAX, OPERATOR, WORK, Touch

__all__ = ["bounds", "impact", "settle", "touching"]

Vector = NDArray[np.float64]
Record = Any

_PUSHED, _INSIDE, _RESTING = int(Touch.PUSHED), int(Touch.INSIDE), int(Touch.RESTING)
#: Sweeps of coordinate descent between two checks of the pattern, and most checks.
_SWEEPS, _CHECKS = 8, 200


@inner
def bounds(p: Record, w: Record, i: int) -> tuple[float, float]:
    """Least and greatest torque [N m] that friction and stop can hold joint i with."""
    friction = p.coulomb[i] if p.coulomb_on else 0.0
    low = -math.inf if w.contact.touch[i] == _RESTING else -friction
    high = math.inf if w.contact.touch[i] == -_RESTING else friction
    return low, high


@inner
def touching(p: Record, i: int, q: float, v: float) -> int:
    """Return how joint i touches its stops at a state (`Touch`), where the stops give."""
    if not p.stops_on or p.rigid:
        return 0
    if q < p.stop_low[i]:
        return -_PUSHED if p.stop_stiffness >= p.stop_damping * v else -_INSIDE
    if q > p.stop_high[i]:
        return _PUSHED if p.stop_stiffness >= -p.stop_damping * v else _INSIDE
    return 0


@entry(LINKAGE, OPERATOR, float, vector, vector, vector, vector, WORK)
def settle(
    p: Record, op: Record, t: float, q: Vector, v: Vector, tau: Vector, a_out: Vector, w: Record
) -> None:
    """Find accelerations, and set `slide` and `held` of `w.contact` as they are just after `t`.

    The arguments are those of `dynamics`.

    Joints that turn slip the way they turn. A joint that starts leaves the stop that it rested on.
    """
    n = p.n
    resting = np.zeros(NMAX, np.bool_)
    w.contact.holding = 0
    for i in range(n):
        limited = (p.coulomb_on != 0 and p.coulomb[i] > 0.0) or abs(w.contact.touch[i]) == _RESTING
        resting[i] = limited and v[i] == 0.0
        w.contact.held[i] = 1 if resting[i] else 0
        w.contact.holding += w.contact.held[i]
        w.contact.slide[i] = 0 if resting[i] else np.sign(v[i])
    dynamics(p, op, t, q, v, tau, a_out, w)
    if w.contact.holding == 0 or _consistent(p, w, resting, a_out):
        return
    # torque on each joint without what holds or brakes those at rest
    wanted, a = np.zeros(NMAX), np.zeros(NMAX)
    for i in range(n):
        wanted[i] = -w.contact.hold[i]
        a[i] = a_out[i]
        for j in range(n):
            wanted[i] += w.mass[i, j] * a_out[j]
    for _ in range(_CHECKS):
        for _ in range(_SWEEPS):
            for i in range(n):
                left = wanted[i]
                for j in range(n):
                    if j != i:
                        left -= w.mass[i, j] * a[j]
                if resting[i]:
                    low, high = bounds(p, w, i)
                    left = left + low if left + low > 0.0 else min(left + high, 0.0)
                a[i] = left / w.mass[i, i]
        w.contact.holding = 0
        for i in range(n):
            if resting[i]:
                w.contact.held[i] = 1 if a[i] == 0.0 else 0
                w.contact.slide[i] = np.sign(a[i])
                w.contact.holding += w.contact.held[i]
        dynamics(p, op, t, q, v, tau, a_out, w)
        if _consistent(p, w, resting, a_out):
            break
    for i in range(n):
        if resting[i] and not w.contact.held[i] and abs(w.contact.touch[i]) == _RESTING:
            w.contact.touch[i] = 0


@inner
def _consistent(p: Record, w: Record, resting: Any, a: Vector) -> bool:
    """Whether what is held can be held, and what starts goes the way that its friction opposes."""
    for i in range(p.n):
        if not resting[i]:
            continue
        if w.contact.held[i]:
            low, high = bounds(p, w, i)
            if not low <= w.contact.hold[i] <= high:
                return False
        elif w.contact.slide[i] * a[i] < 0.0:
            return False
    return True


@inner
def impact(p: Record, w: Record, v: Vector, side: Any) -> float:
    """Let joints rebound from stops that do not give; return the energy lost [J].

    Newton's law of impact for all of them at once: v' = v + M^-1 P with impulses P >= 0 away from the stop,
    v' + e v >= 0, and one of both zero (Moreau 1988): the energy never grows, and one solution, which is
    found by trying. Friction is finite, so its impulse is none. `w.mass` is the mass matrix there.

    Parameters
    ----------
    v
        Joint speeds [rad/s] before, replaced by those behind.
    side
        [n] -1 for a joint on its lower stop, +1 on its upper one, 0 for a free one.
    """
    n = p.n
    jump, change, best = np.zeros(NMAX), np.zeros(NMAX), np.zeros(NMAX)
    least = math.inf
    for pattern in range(1, 1 << n):
        possible = True
        for i in range(n):
            struck = (pattern >> i) & 1 == 1
            possible = possible and not (struck and side[i] == 0)
            w.contact.held[i] = 1 if struck else 0
            jump[i] = -(1.0 + p.restitution) * v[i] if struck else 0.0
        if not possible:
            continue
        for i in range(n):
            change[i] = 0.0
            for j in range(n):
                change[i] -= w.mass[i, j] * jump[j]
        solve_held(n, w, change)
        wrong = 0.0
        for i in range(n):
            change[i] += jump[i]
        for i in range(n):
            if side[i] == 0:
                continue
            if w.contact.held[i]:
                push = 0.0
                for j in range(n):
                    push += w.mass[i, j] * change[j]
                wrong = max(wrong, side[i] * push / w.mass[i, i])
            else:
                wrong = max(wrong, side[i] * ((1.0 + p.restitution) * v[i] + change[i]))
        if wrong < least:
            least = wrong
            for i in range(n):  # a slice's copy checks its shape with text, which takes seconds to compile
                best[i] = change[i]
    lost = 0.0
    for i in range(n):
        w.contact.held[i] = 0
        for j in range(n):
            lost -= w.mass[i, j] * best[j] * (v[i] + 0.5 * best[i])
    for i in range(n):
        v[i] += best[i]
    return lost
