"""Compiled kinematics: fingertip, Jacobian, pose for a fingertip. No allocation, one pose at a time.

The argument `p` is a record `LINKAGE` (`mech.records`); `q`, `v` and the outputs are contiguous float64
arrays of at least n elements.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.compiled import entry, inner, matrix, vector
from mech.records import LINKAGE

__all__ = ["inverse", "jacobian", "tip", "tip_velocity"]

Vector = NDArray[np.float64]
Record = Any


@entry(LINKAGE, vector, vector)
def tip(p: Record, q: Vector, r_out: Vector) -> None:
    """Fingertip position [m] at joint angles `q` [rad]."""
    if p.slider:
        r_out[0] = p.origin[0] + p.length[0] * p.direction[0] * q[0]
        r_out[1] = p.origin[1] + p.length[0] * p.direction[1] * q[0]
        return
    x = p.origin[0]
    y = p.origin[1]
    phi = 0.0
    for i in range(p.n):
        phi += q[i]
        x += p.length[i] * math.cos(phi)
        y += p.length[i] * math.sin(phi)
    r_out[0] = x
    r_out[1] = y


@entry(LINKAGE, vector, vector, vector)
def tip_velocity(p: Record, q: Vector, v: Vector, rdot_out: Vector) -> None:
    """Fingertip velocity J(q) v [m/s]."""
    if p.slider:
        rdot_out[0] = p.length[0] * p.direction[0] * v[0]
        rdot_out[1] = p.length[0] * p.direction[1] * v[0]
        return
    x = 0.0
    y = 0.0
    phi = 0.0
    rate = 0.0
    for i in range(p.n):
        phi += q[i]
        rate += v[i]
        x -= p.length[i] * math.sin(phi) * rate
        y += p.length[i] * math.cos(phi) * rate
    rdot_out[0] = x
    rdot_out[1] = y


@entry(LINKAGE, vector, matrix)
def jacobian(p: Record, q: Vector, jac_out: Vector) -> None:
    """Jacobian d r / d q [m/rad] into the first n columns of `jac_out`, shape (2, >= n)."""
    if p.slider:
        jac_out[0, 0] = p.length[0] * p.direction[0]
        jac_out[1, 0] = p.length[0] * p.direction[1]
        return
    phi = 0.0
    for i in range(p.n):
        phi += q[i]
        jac_out[0, i] = -p.length[i] * math.sin(phi)
        jac_out[1, i] = p.length[i] * math.cos(phi)
    for i in range(p.n - 2, -1, -1):
        jac_out[0, i] += jac_out[0, i + 1]
        jac_out[1, i] += jac_out[1, i + 1]


@inner
def _near(angle: float, seed: float) -> float:
    """Return the angle plus the multiple of 2 pi that brings it nearest to `seed`."""
    return angle - 2.0 * math.pi * math.floor((angle - seed) / (2.0 * math.pi) + 0.5)


@entry(LINKAGE, float, float, float, vector, result=float)
def inverse(p: Record, x: float, y: float, elbow: float, q: Vector) -> float:
    """Joint angles that put the fingertip on (x, y), into `q`; return the distance left over [m].

    Slider and chains of one and two links are solved in closed form, longer ones by damped least
    squares from the pose in `q`. Whole turns are chosen nearest to the `q` passed in. A target out of
    reach gives the nearest pose for up to two links.

    Parameters
    ----------
    p
        Record `LINKAGE`.
    x, y
        Target [m].
    elbow
        +1 or -1: sign of the second joint's angle of a two-link chain; not used otherwise.
    q
        Seed on entry, answer on return [rad].
    """
    x -= p.origin[0]
    y -= p.origin[1]
    if p.slider:
        q[0] = (x * p.direction[0] + y * p.direction[1]) / p.length[0]
        return float(abs(x * p.direction[1] - y * p.direction[0]))
    distance = math.hypot(x, y)
    if p.n == 1:
        q[0] = _near(math.atan2(y, x), q[0])
        return float(abs(distance - p.length[0]))
    if p.n == 2:
        a = p.length[0]
        b = p.length[1]
        # Half-angle form: exact at full stretch, where acos of the cosine law loses half the digits.
        outer = (a + b - distance) * (a + b + distance)
        inner = (distance - abs(a - b)) * (distance + abs(a - b))
        bend = 2.0 * math.atan2(math.sqrt(max(outer, 0.0)), math.sqrt(max(inner, 0.0)))
        if elbow < 0.0:
            bend = -bend
        first = math.atan2(y, x) - math.atan2(b * math.sin(bend), a + b * math.cos(bend))
        q[0] = _near(first, q[0])
        q[1] = _near(bend, q[1])
        return float(max(distance - (a + b), abs(a - b) - distance, 0.0))
    return float(_least_squares(p, x, y, q))


@inner
def _least_squares(p: Record, x: float, y: float, q: Vector) -> float:
    """Levenberg-Marquardt on the fingertip of a longer chain, target relative to the origin."""
    n = p.n
    reach = 0.0
    for i in range(n):
        reach += p.length[i]
    damping = 1e-3
    left = math.inf
    for _ in range(200):
        # J J^T, J^T e from the pose, columns by running sums from the tip
        phi = 0.0
        for i in range(n):
            phi += q[i]
        sx = 0.0
        sy = 0.0
        jxx = 0.0
        jxy = 0.0
        jyy = 0.0
        angle = phi
        for i in range(n - 1, -1, -1):
            sx += p.length[i] * math.cos(angle)
            sy += p.length[i] * math.sin(angle)
            angle -= q[i]
            jxx += sy * sy
            jxy -= sx * sy
            jyy += sx * sx
        ex = x - sx
        ey = y - sy
        left = math.hypot(ex, ey)
        if left <= 4e-16 * reach:
            break
        shift = damping * left / reach * reach * reach
        det = (jxx + shift) * (jyy + shift) - jxy * jxy
        if not det > 0.0:
            break
        fx = ((jyy + shift) * ex - jxy * ey) / det
        fy = ((jxx + shift) * ey - jxy * ex) / det
        sx = 0.0
        sy = 0.0
        angle = phi
        for i in range(n - 1, -1, -1):
            sx += p.length[i] * math.cos(angle)
            sy += p.length[i] * math.sin(angle)
            angle -= q[i]
            q[i] += max(-0.5, min(0.5, sx * fy - sy * fx))
    return left
