"""Instants at which friction, an end stop or a gear's flank changes state: located and processed.

Between them every joint slips one way or is held, and touches its stops in one way (`mech.records.Touch`), so
that the accelerations are smooth. A step on trial is searched with its own polynomials: angles of degree four
in x = t/h, speeds of degree three, all their extremes and roots, so that two crossings inside one step are
both located. The torque that holds a joint at rest is checked at the nodes and the end.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cosim.loop.linear.backlash_events import first_change
from cosim.loop.linear.step_maps import COEFFICIENTS
from cosim.types import Record
from mech.compiled import inner, inner_inlined
from mech.records import Touch
from mech.shaft import engage
from mech.stiction import bounds, impact, settle, touching

_PUSHED, _INSIDE, _RESTING = int(Touch.PUSHED), int(Touch.INSIDE), int(Touch.RESTING)
#: The instant at which a held joint slips is located by halving.
_HALF = 0.75
#: A joint rests on a stop that does not give when its next flight were shorter than this share of the period
#: or than this time [s]: 64 and some thousand times the resolution of instants
#: (`stepper.py`). Two joints on their stops at once would take turns for ever at flights of some twenty times
#: it: each impact moves both, and comes late for the other.
_FLIGHT, _FLIGHT_S = 2.0**-30, 1e-9
_BISECTIONS = 60


@inner
def _value(c: Any, x: float) -> float:
    return float(c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))


@inner
def _root(c: Any, low: float, high: float) -> float:
    """Return the upper end of the bracket of a sign change of a polynomial between `low` and `high`."""
    rises = _value(c, high) > 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if (_value(c, middle) > 0.0) == rises:
            high = middle
        else:
            low = middle
    return high


@inner
def turns(c: Any, at: Any) -> int:
    """Fill `at` with the extremes inside (0, 1) of a polynomial of degree three `c` [5], ascending; count."""
    a, b, d = 3.0 * c[3], 2.0 * c[2], c[1]
    under = b * b - 4.0 * a * d
    if under < 0.0 or (a == 0.0 and b == 0.0):
        return 0
    # no cancellation in either root
    q = -0.5 * (b + math.copysign(math.sqrt(under), b))
    first = q / a if a != 0.0 else math.inf
    second = d / q if q != 0.0 else math.inf
    count = 0
    for x in (min(first, second), max(first, second)):
        if 0.0 < x < 1.0:
            at[count] = x
            count += 1
    return count


@inner
def roots(c: Any, pieces: Any, count: int, at: Any) -> int:
    """Fill `at` with the sign changes in (0, 1) of a polynomial with extremes `pieces[:count]`; count."""
    crossings = 0
    low = 0.0
    before = _value(c, 0.0)
    for i in range(count + 1):
        high = pieces[i] if i < count else 1.0
        now = _value(c, high)
        if before * now < 0.0:
            at[crossings] = _root(c, low, high)
            crossings += 1
        low, before = high, now
    return crossings


@inner
def below(c: Any, pieces: Any, count: int) -> float:
    """Return the first x in (0, 1] from which a polynomial with extremes `pieces[:count]` is negative.

    2 when it stays positive or zero.
    """
    low = 0.0
    for i in range(count + 1):
        high = pieces[i] if i < count else 1.0
        if _value(c, high) < 0.0:
            return _root(c, low, high) if _value(c, low) >= 0.0 else low
        low = high
    return 2.0


@inner
def first_crossing(s: Record, b: Any, h: float) -> float:
    """Return the share of the step on trial, of length `h` [s], at which something changes; 2 for nothing."""
    p, w = s.p, s.w
    first = 2.0
    v, q, guard = np.zeros(5), np.zeros(5), np.zeros(5)
    fast, still = np.zeros(2), np.zeros(3)
    for j in range(s.n):
        if w.contact.held[j]:
            low, high = bounds(p, w, j)
            for i in range(4):
                if not low <= b.holds[i, j] <= high:
                    first = min(first, _HALF)
            continue
        v[0], q[0], q[1] = s.v[j], s.q[j], h * s.v[j]
        for power in range(3):
            a = 0.0
            for i in range(3):
                a += COEFFICIENTS[power, i] * b.a[i, j]
            v[power + 1] = h * a / (power + 1)
            q[power + 2] = h * v[power + 1] / (power + 2)
        extremes = turns(v, fast)
        if p.coulomb_on and p.coulomb[j] > 0.0:
            for i in range(4):
                guard[i] = w.contact.slide[j] * v[i]
            first = min(first, below(guard, fast, extremes))
        if not p.stops_on:
            continue
        rests = roots(v, fast, extremes, still)
        for side in (-1, 1):
            stop = p.stop_low[j] if side < 0 else p.stop_high[j]
            if not abs(stop) < math.inf:
                continue
            inside = side * w.contact.touch[j] > 0
            sign = side if inside else -side
            for i in range(5):
                guard[i] = sign * q[i]
            guard[0] = sign * ((s.q[j] - stop) + b.low[j])
            first = min(first, below(guard, still, rests))
            if inside and p.stop_damping > 0.0:
                sign = 1 if abs(w.contact.touch[j]) == _PUSHED else -1
                for i in range(4):
                    guard[i] = sign * side * p.stop_damping * v[i]
                guard[0] += sign * p.stop_stiffness
                guard[4] = 0.0
                first = min(first, below(guard, fast, extremes))
    return min(first, first_change(s, b, h)) if p.backlash_on else first


@inner_inlined
def _put_back(s: Record, b: Any, j: int, stop: float) -> None:
    """Put a joint on the surface that it has crossed, with the speed that it had there."""
    late = ((s.q[j] - stop) + b.low[j]) / s.v[j]
    # a bounce would gain as much at every impact, and never end
    if abs(s.a[j] * late) < 0.5 * abs(s.v[j]):
        s.v[j] -= s.a[j] * late
    s.q[j] = stop
    b.low[j] = 0.0


@inner
def _carried(s: Record) -> float:
    """Kinetic energy of the operator's mass [J]."""
    x = y = 0.0
    for j in range(s.n):
        x += s.w.jac[0, j] * s.v[j]
        y += s.w.jac[1, j] * s.v[j]
    return float(0.5 * s.op.mass * (x * x + y * y))


@inner
def strike(s: Record, b: Any) -> bool:
    """Change what is due at the accepted point; whether there was anything.

    Angles are put on the surface of the stop that they crossed, speeds that crossed zero on zero: both are
    off by the resolution of the instant. Accelerations are not updated.
    """
    p, w = s.p, s.w
    changed = hits = False
    if p.backlash_on:
        changed, lost = engage(p, s.t, s.q, s.v, w)
        b.total[5] -= lost
    for j in range(s.n):
        b.hit[j] = 0
        if w.contact.held[j]:
            low, high = bounds(p, w, j)
            changed = changed or not low <= b.holds[3, j] <= high
            continue
        if p.coulomb_on and p.coulomb[j] > 0.0 and w.contact.slide[j] * s.v[j] < 0.0:
            s.v[j] = 0.0
            changed = True
        if not p.stops_on:
            continue
        for side in (-1, 1):
            stop = p.stop_low[j] if side < 0 else p.stop_high[j]
            deep = side * ((s.q[j] - stop) + b.low[j])
            if side * w.contact.touch[j] > 0:
                pushing = p.stop_stiffness + side * p.stop_damping * s.v[j]
                if deep < 0.0:
                    _put_back(s, b, j, stop)
                    w.contact.touch[j] = 0
                    changed = True
                elif (abs(w.contact.touch[j]) == _PUSHED) != (pushing >= 0.0):
                    w.contact.touch[j] = side * (_PUSHED if pushing >= 0.0 else _INSIDE)
                    changed = True
            elif deep > 0.0:
                _put_back(s, b, j, stop)
                changed = True
                if p.rigid == 0:
                    w.contact.touch[j] = side * _PUSHED
                elif side * s.v[j] > 0.0:
                    b.hit[j] = side
                    hits = True
    if hits:
        for j in range(s.n):
            if abs(w.contact.touch[j]) == _RESTING:
                b.hit[j] = -1 if w.contact.touch[j] < 0 else 1
        carried = _carried(s)
        b.total[4] -= impact(p, w, s.v, b.hit)
        b.total[1] += carried - _carried(s)  # what the operator's mass has given up went through the device
        for j in range(s.n):
            if abs(w.contact.touch[j]) == _RESTING:
                w.contact.touch[j] = 0
    return changed


@inner
def find(s: Record, b: Any) -> None:
    """Find the accelerations just behind the accepted point, the torques given, and who is held there."""
    settle(s.p, s.op, s.t, s.q, s.v, s.tau, s.a, s.w)
    shortest = max(_FLIGHT * s.c.period, _FLIGHT_S)
    # again for every joint that comes to rest: it changes the torques on the others
    for _ in range(s.n):
        again = False
        for j in range(s.n):
            side = b.hit[j]
            if side == 0:
                continue
            back = side * s.a[j]
            # too slow to fly, or driven in by what rounding leaves
            if side * s.v[j] >= 0.0 or (back > 0.0 and 2.0 * abs(s.v[j]) < back * shortest):
                s.v[j] = 0.0
                s.w.contact.touch[j] = side * _RESTING
                b.hit[j] = 0
                again = True
        if not again:
            break
        settle(s.p, s.op, s.t, s.q, s.v, s.tau, s.a, s.w)
    for j in range(s.n):
        b.hit[j] = 0


@inner
def meet(s: Record) -> None:
    """Say how the joints touch their stops at the start."""
    for j in range(s.n):
        s.w.contact.touch[j] = touching(s.p, j, s.q[j], s.v[j])
