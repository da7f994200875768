"""Compiled forces of contact: the operator's on the fingertip, the end stops' on the joints."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.compiled import call_force, entry, inner, vector
from mech.records import OPERATOR, OperatorKind, Touch

__all__ = ["operator_force", "pushed", "stop_torque"]

Vector = NDArray[np.float64]
Record = Any

_HAND = int(OperatorKind.HAND)
_USER = int(OperatorKind.USER)
_PUSHED = int(Touch.PUSHED)


@inner
def _row(table: Vector, rows: int, t: float) -> int:
    """Index of the last row whose time is <= t, or -1; rows are ordered by time."""
    low = -1
    high = rows
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@entry(OPERATOR, float, vector, vector, vector)
def operator_force(op: Record, t: float, r: Vector, rdot: Vector, f_out: Vector) -> None:
    """Force of the operator on the device [N], without weight and inertia of the operator's mass.

    A hand pulls with stiffness and damping towards an intended point that runs from waypoint to waypoint
    with minimum jerk (Flash and Hogan 1985: s = 10 x^3 - 15 x^4 + 6 x^5), and adds an intended force
    that is linear between the rows of its table. Before the first and after the last row both hold.
    """
    f_out[0] = 0.0
    f_out[1] = 0.0
    if op.kind == _USER:
        fx, fy = call_force(op.callback, t, r[0], r[1], rdot[0], rdot[1])
        f_out[0] = fx
        f_out[1] = fy
    elif op.kind == _HAND:
        s = 0.0
        sdot = 0.0
        if op.paths > 0:
            a = _row(op.path, op.paths, t)
            b = min(a + 1, op.paths - 1)
            a = max(a, 0)
            if b > a:
                span = op.path[b, 0] - op.path[a, 0]
                x = (t - op.path[a, 0]) / span
                s = x * x * x * (10.0 + x * (6.0 * x - 15.0))
                sdot = 30.0 * x * x * (1.0 - x) * (1.0 - x) / span
            for k in range(2):
                step = op.path[b, k + 1] - op.path[a, k + 1]
                f_out[k] += op.stiffness * (op.path[a, k + 1] + s * step - r[k])
                f_out[k] += op.damping * (sdot * step - rdot[k])
        else:
            for k in range(2):
                f_out[k] -= op.damping * rdot[k]
        if op.forces > 0:
            a = _row(op.force, op.forces, t)
            b = min(a + 1, op.forces - 1)
            a = max(a, 0)
            x = 0.0
            if b > a:
                x = (t - op.force[a, 0]) / (op.force[b, 0] - op.force[a, 0])
            for k in range(2):
                f_out[k] += op.force[a, k + 1] + x * (op.force[b, k + 1] - op.force[a, k + 1])


@inner
def stop_torque(p: Record, i: int, q: float, v: float) -> float:
    """Torque of the end stop on joint i: k x + c x x' at depth x, never pulling (Hunt and Crossley 1975).

    It starts from zero at the surface, and on the way out gives back less than it took, so that energy
    never grows.
    """
    if q < p.stop_low[i]:
        depth = p.stop_low[i] - q
        push = depth * (p.stop_stiffness - p.stop_damping * v)
        return float(max(push, 0.0))
    if q > p.stop_high[i]:
        depth = q - p.stop_high[i]
        push = depth * (p.stop_stiffness + p.stop_damping * v)
        return -float(max(push, 0.0))
    return 0.0


@inner
def pushed(p: Record, i: int, q: float, v: float, touch: int) -> float:
    """Torque of the end stop on joint i that is known to push (`Touch.PUSHED`), smooth in q and v."""
    if touch == -_PUSHED:
        return float((p.stop_low[i] - q) * (p.stop_stiffness - p.stop_damping * v))
    if touch == _PUSHED:
        return -float((q - p.stop_high[i]) * (p.stop_stiffness + p.stop_damping * v))
    return 0.0
