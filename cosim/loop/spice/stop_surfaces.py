"""Surfaces of compliant end stops in lockstep: a step ends where a joint enters its stop or leaves it.

The stop's torque is continuous there and its slope is not, so that no polynomial fits across. Nothing behind
an accepted point can be undone: the crossing is foreseen along the predictor of `adams.py`, and met in two
steps, the second from so near that the prediction is as good as exact.
"""

from __future__ import annotations

import math

from cosim.types import Record
from mech.compiled import inner, inner_inlined

#: A step that crosses ends this far [rad] behind the surface: that tells the side, and no tolerance sees it.
_BEHIND_RAD = 1e-11
#: A step goes this far towards an expected crossing, then to it: the second time it is known better.
_APPROACH, _CLOSE = 0.98, 0.05
#: Points at which the predicted path is checked, so that a dip within the step is seen; and halvings.
_LOOKS, _HALVINGS = 8, 50


@inner_inlined
def inside(s: Record) -> int:
    """Return a number that encodes which joints are in which of their stops."""
    code = 0
    for j in range(s.n):
        code = 3 * code + (1 if s.q[j] < s.p.stop_low[j] else (2 if s.q[j] > s.p.stop_high[j] else 0))
    return code


@inner_inlined
def _moved(s: Record, j: int, jerk: float, t: float) -> float:
    return float(t * (s.v[j] + t * (s.a[j] / 2 + t * jerk / 6)))


@inner
def edge(s: Record, h: float) -> float:
    """Step [s], at most `h`, that ends at or shortly before the next crossing of a stop's surface."""
    if s.p.rigid != 0:
        return h
    for j in range(s.n):
        jerk = (s.a[j] - s.a_old[j]) / s.h_old if s.history > 1 else 0.0
        for side in (-1, 1):
            stop = s.p.stop_low[j] if side < 0 else s.p.stop_high[j]
            if not abs(stop) < math.inf:
                continue
            depth = side * (s.q[j] - stop)
            way = -side if depth > 0.0 else side
            short = abs(depth) + _BEHIND_RAD
            low = 0.0
            for look in range(1, _LOOKS + 1):
                high = h * look / _LOOKS
                if way * _moved(s, j, jerk, high) <= short:
                    low = high
                    continue
                for _ in range(_HALVINGS):
                    middle = 0.5 * (low + high)
                    if way * _moved(s, j, jerk, middle) > short:
                        high = middle
                    else:
                        low = middle
                h = high if high < _CLOSE * h else _APPROACH * high
                break
    return float(max(h, s.steps.least))
