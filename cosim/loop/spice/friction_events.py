"""Coulomb friction in lockstep: a step ends where a joint comes to rest, or where one that is held starts.

Between these instants every joint slips one way or is held (`mech.stiction`), so that accelerations are
smooth. Nothing behind an accepted point can be undone: the instants are foreseen, along the predictor of
`adams.py` and along the last slope of the torque that holds, and met in two steps, the second from so near
that the prediction is as good as exact. The circuit knows nothing of it.
"""

from __future__ import annotations

import math

import numpy as np

from cosim.loop.equations_of_motion import evaluate
from cosim.types import Record
from mech.compiled import inner, inner_inlined
from mech.records import NMAX
from mech.stiction import bounds, settle

#: A joint that slows down is at rest below this speed [rad/s]: over a second it moves as far as the tightest
#: tolerances of the coupling let a step be wrong.
_REST_RAD_PER_S = 1e-9
#: A held joint starts at this share of its friction beyond it, so that rounding does not hold it at the edge.
_BEYOND = 1e-9
#: A step goes this far towards an expected instant, then to it: the second time it is known better.
_APPROACH, _CLOSE = 0.98, 0.05


@inner_inlined
def _rests(s: Record, j: int) -> float:
    """Time [s] after the last accepted point at which a slipping joint comes to rest, along the predictor."""
    jerk = (s.a[j] - s.a_old[j]) / s.h_old if s.history > 1 else 0.0
    way = float(s.w.contact.slide[j])
    # way (v + a t + jerk t^2 / 2) = 0, neither root by a difference of nearly equal numbers
    c, b, a = way * s.v[j], way * s.a[j], way * jerk / 2
    under = b * b - 4.0 * a * c
    if under < 0.0:
        return math.inf
    half = -0.5 * (b + math.copysign(math.sqrt(under), b))
    one = half / a if a != 0.0 else math.inf
    other = c / half if half != 0.0 else math.inf
    one = one if one > 0.0 else math.inf
    other = other if other > 0.0 else math.inf
    return float(min(one, other))


@inner_inlined
def _starts(s: Record, j: int) -> float:
    """Time [s] after the last accepted point at which a held joint starts, along its torque's last slope."""
    if s.history < 2:
        return math.inf
    slope = (s.hold[j] - s.hold_old[j]) / s.h_old
    low, high = bounds(s.p, s.w, j)
    room = high - s.hold[j] if slope > 0.0 else s.hold[j] - low
    if slope == 0.0:
        return math.inf
    return float((room + _BEYOND * s.p.coulomb[j]) / abs(slope))


@inner
def edge(s: Record, h: float) -> float:
    """Step [s], at most `h`, that ends at or shortly before the next instant at which friction changes."""
    for j in range(s.n):
        if not s.p.coulomb[j] > 0.0:
            continue
        at = _starts(s, j) if s.w.contact.held[j] else _rests(s, j)
        if at < h:
            h = at if at < _CLOSE * h else _APPROACH * at
    return float(max(h, s.steps.least))


@inner
def _overcome(s: Record) -> bool:
    """Whether a held joint needs more than its friction, as the accelerations were found last."""
    for j in range(s.n):
        if s.w.contact.held[j]:
            low, high = bounds(s.p, s.w, j)
            if not low <= s.w.contact.hold[j] <= high:
                return True
    return False


@inner
def trial(s: Record, t: float) -> None:
    """Find the accelerations at the trial point, where held joints start within the step if they must.

    Who slips and who is held stays noted as it was: the point is not accepted yet.
    """
    evaluate(s, t, s.q_trial, s.v_trial, s.a_trial)
    if s.w.contact.holding == 0 or not _overcome(s):
        return
    w = s.w
    v = np.zeros(NMAX)
    slide, held, holding = np.zeros(NMAX, np.int64), np.zeros(NMAX, np.int64), w.contact.holding
    for j in range(s.n):
        slide[j], held[j] = w.contact.slide[j], w.contact.held[j]
        v[j] = s.v_trial[j]
        if not held[j] and slide[j] * v[j] <= 0.0:  # within the step it slips as at its start
            v[j] = 1e-300 * slide[j]
    for j in range(s.n, s.coordinates):
        v[j] = s.v_trial[j]
    settle(s.p, s.op, t, s.q_trial, v, s.tau, s.a_trial, w)
    for j in range(s.n):
        w.contact.slide[j], w.contact.held[j] = slide[j], held[j]
    w.contact.holding = holding


@inner
def meet(s: Record, t: float) -> bool:
    """Find the accelerations just behind the accepted point; whether friction has changed there."""
    changed = False
    way = np.zeros(NMAX, np.int64)
    for j in range(s.n):
        way[j] = s.w.contact.slide[j]
        slows = way[j] * s.v[j] < 0.0 or (way[j] * s.a[j] < 0.0 and abs(s.v[j]) < _REST_RAD_PER_S)
        if s.p.coulomb[j] > 0.0 and way[j] != 0 and slows:
            s.v[j] = 0.0
            changed = True
    settle(s.p, s.op, t, s.q, s.v, s.tau, s.a, s.w)
    for j in range(s.n):
        changed = changed or way[j] != s.w.contact.slide[j]
        s.hold_old[j] = s.hold[j]
        s.hold[j] = s.w.contact.hold[j]
    return changed
