"""Instants at which a gear's flank makes or loses contact, located within a step of the linear loop."""

from __future__ import annotations

from typing import Any

from cosim.loop.linear.step_maps import COEFFICIENTS
from cosim.types import Record
from mech.compiled import inner
from mech.shaft import EDGE_RAD, margin

#: Points of a step at which the twist is checked: it is smooth, and a step is short against its period.
_LOOKS = 8
_BISECTIONS = 60


@inner
def first_change(s: Record, b: Any, h: float) -> float:
    """Return the share of the step on trial, of length `h` [s], at which a flank changes; 2 for none."""
    first = 2.0
    for j in range(s.n):
        if s.p.half_gap[j] == 0.0:
            continue
        i = s.n + j
        c0 = c1 = c2 = 0.0
        for node in range(3):
            a = h * h * (b.a[node, i] - b.a[node, j])
            c0 += COEFFICIENTS[0, node] * a / 2
            c1 += COEFFICIENTS[1, node] * a / 6
            c2 += COEFFICIENTS[2, node] * a / 12
        low = 0.0
        for look in range(1, _LOOKS + 1):
            high = look / _LOOKS
            if _margin(s, j, h, high, c0, c1, c2) >= -EDGE_RAD:
                low = high
                continue
            for _ in range(_BISECTIONS):
                middle = 0.5 * (low + high)
                if _margin(s, j, h, middle, c0, c1, c2) < -EDGE_RAD:
                    high = middle
                else:
                    low = middle
            first = min(first, high)
            break
    return first


@inner
def _margin(s: Record, j: int, h: float, x: float, c0: float, c1: float, c2: float) -> float:
    i = s.n + j
    rate = h * (s.v[i] - s.v[j])
    twist = s.q[i] - s.q[j] + x * (rate + x * (c0 + x * (c1 + x * c2)))
    turning = (rate + x * (2 * c0 + x * (3 * c1 + x * 4 * c2))) / h
    return float(margin(s.p, j, s.t + x * h, twist, turning, s.w))
