"""Compiled mechanics: kinematics, equations of motion, energy. No allocation, one state at a time.

The arguments `p`, `op` and `w` are records `LINKAGE`, `OPERATOR` and `WORK` (`mech.records`); `q`, `v`,
`tau` and the outputs are contiguous float64 arrays of at least n elements (Jacobians: 2 by NMAX).

A planar chain is written in absolute link angles phi_i = q_1 + ... + q_i and rates w_i:

    M_ij = A_ij cos(phi_i - phi_j),   h_i = sum_j A_ij sin(phi_i - phi_j) w_j^2

(A is `couple`), and brought to joint coordinates by sums over the links beyond a joint. A mass m at the
fingertip adds m l_i l_j to A.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from mech.records import OperatorKind

__all__ = [
    "bias",
    "dynamics",
    "energy",
    "inverse",
    "jacobian",
    "mass_matrix",
    "operator_force",
    "solve",
    "tip",
    "tip_velocity",
]

Vector = NDArray[np.float64]
Record = Any

_NONE = int(OperatorKind.NONE)
_HAND = int(OperatorKind.HAND)
_USER = int(OperatorKind.USER)


@intrinsic
def _call_force(typingctx: Any, address: Any, t: Any, x: Any, y: Any, vx: Any, vy: Any) -> Any:
    """Call ``void f(double t, x, y, vx, vy, double force[2])`` at an address; return the two forces."""
    import llvmlite.ir as ir

    pair = types.UniTuple(types.float64, 2)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        function = ir.FunctionType(ir.VoidType(), [double] * 5 + [double.as_pointer()])
        force = cgutils.alloca_once(builder, double, size=2)
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [*args[1:], force])
        values = [builder.load(cgutils.gep_inbounds(builder, force, i)) for i in range(2)]
        return context.make_tuple(builder, pair, values)

    return pair(types.int64, *([types.float64] * 5)), codegen


@njit(cache=True, error_model="numpy")
def _pose(p: Record, q: Vector, w: Record) -> None:
    """Fill cos, sin, r and jac of `w`."""
    if p.slider:
        for k in range(2):
            w.jac[k, 0] = p.length[0] * p.direction[k]
            w.r[k] = p.origin[k] + w.jac[k, 0] * q[0]
        return
    phi = 0.0
    for i in range(p.n):
        phi += q[i]
        w.cos[i] = math.cos(phi)
        w.sin[i] = math.sin(phi)
    x = 0.0
    y = 0.0
    for i in range(p.n - 1, -1, -1):
        x += p.length[i] * w.cos[i]
        y += p.length[i] * w.sin[i]
        w.jac[0, i] = -y
        w.jac[1, i] = x
    w.r[0] = p.origin[0] + x
    w.r[1] = p.origin[1] + y


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _inertia(p: Record, tip_mass: float, w: Record) -> None:
    """Fill `w.mass` from the pose in `w`, with rotors and a mass at the fingertip."""
    n = p.n
    if p.slider:
        w.mass[0, 0] = p.couple[0, 0] + tip_mass * p.length[0] * p.length[0] + p.armature[0]
        return
    # M_ab = sum over i >= a, j >= b of the absolute entries: a running sum along the row, plus the row
    # below, which for b = a is the entry just written, mirrored.
    for a in range(n - 1, -1, -1):
        row = 0.0
        below = 0.0
        for b in range(n - 1, a - 1, -1):
            couple = p.couple[a, b] + tip_mass * p.length[a] * p.length[b]
            row += couple * (w.cos[a] * w.cos[b] + w.sin[a] * w.sin[b])
            if b > a:
                below = w.mass[a + 1, b]
            elif a + 1 < n:
                below = w.mass[a, a + 1]
            w.mass[a, b] = row + below
            w.mass[b, a] = row + below
    for a in range(n):
        w.mass[a, a] += p.armature[a]


@njit(cache=True, error_model="numpy")
def _bias(p: Record, v: Vector, tip_mass: float, w: Record) -> None:
    """Fill `w.bias` and `w.rate` from the pose in `w`: M a + bias = applied torque."""
    n = p.n
    if p.slider:
        w.bias[0] = 0.0
        if p.heavy:
            w.bias[0] = -p.moment[0] * (p.gravity[0] * p.direction[0] + p.gravity[1] * p.direction[1])
        return
    rate = 0.0
    for i in range(n):
        rate += v[i]
        w.rate[i] = rate
        w.bias[i] = 0.0
    if p.coriolis:
        for i in range(n):
            for j in range(i):
                couple = p.couple[i, j] + tip_mass * p.length[i] * p.length[j]
                twist = couple * (w.sin[i] * w.cos[j] - w.cos[i] * w.sin[j])
                w.bias[i] += twist * w.rate[j] * w.rate[j]
                w.bias[j] -= twist * w.rate[i] * w.rate[i]
    if p.heavy:
        for i in range(n):
            w.bias[i] += p.moment[i] * (p.gravity[0] * w.sin[i] - p.gravity[1] * w.cos[i])
    for i in range(n - 2, -1, -1):
        w.bias[i] += w.bias[i + 1]


@njit(cache=True, error_model="numpy")
def solve(n: int, matrix: Vector, x: Vector, factor: Vector) -> None:
    """Solve matrix x = x in place for a symmetric positive definite matrix.

    A matrix that is not positive definite gives NaN, never a wrong number.

    Parameters
    ----------
    n
        Size in use.
    matrix
        Shape (>= n, >= n), kept.
    x
        Right-hand side on entry, solution on return.
    factor
        Scratch, shape (>= n, >= n), receives the Cholesky factor when n > 2.
    """
    if n == 1:
        m = matrix[0, 0]
        x[0] = x[0] / m if m > 0.0 else math.nan
        return
    if n == 2:
        # Eliminate, rather than divide by the determinant: no cancellation of the large products.
        m00 = matrix[0, 0]
        ratio = matrix[1, 0] / m00
        pivot = matrix[1, 1] - ratio * matrix[0, 1]
        if not (m00 > 0.0 and pivot > 0.0):
            x[0] = math.nan
            x[1] = math.nan
            return
        x[1] = (x[1] - ratio * x[0]) / pivot
        x[0] = (x[0] - matrix[0, 1] * x[1]) / m00
        return
    for j in range(n):
        for i in range(j, n):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[j, j] = math.sqrt(total) if total > 0.0 else math.nan
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def operator_force(op: Record, t: float, r: Vector, rdot: Vector, f_out: Vector) -> None:
    """Force of the operator on the device [N], without weight and inertia of the operator's mass.

    A hand pulls with stiffness and damping towards an intended point that runs from waypoint to waypoint
    with minimum jerk (Flash and Hogan 1985: s = 10 x^3 - 15 x^4 + 6 x^5), and adds an intended force
    that is linear between the rows of its table. Before the first and after the last row both hold.
    """
    f_out[0] = 0.0
    f_out[1] = 0.0
    if op.kind == _USER:
        fx, fy = _call_force(op.callback, t, r[0], r[1], rdot[0], rdot[1])
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


@njit(cache=True, error_model="numpy")
def _stop_torque(p: Record, i: int, q: float, v: float) -> float:
    """Torque of the end stop on joint i: k x + c x x' at depth x, never pulling (Hunt and Crossley 1975).

    It starts from zero at the surface, and on the way out gives back less than it took, so that energy
    never grows.
    """
    if q < p.stop_low[i]:
        depth = p.stop_low[i] - q
        push = depth * (p.stop_stiffness - p.stop_damping * v)
        return max(push, 0.0)
    if q > p.stop_high[i]:
        depth = q - p.stop_high[i]
        push = depth * (p.stop_stiffness + p.stop_damping * v)
        return -max(push, 0.0)
    return 0.0


@njit(cache=True, error_model="numpy")
def dynamics(
    p: Record, op: Record, t: float, q: Vector, v: Vector, tau: Vector, a_out: Vector, w: Record
) -> None:
    """Joint acceleration a = M^-1 (tau - h + friction + stops + J^T F_op).

    M holds rotors and the operator's mass, h Coriolis and gravity. Friction is -viscous v -
    coulomb tanh(v / coulomb_speed): a smooth step, so a joint held by Coulomb friction creeps at
    coulomb_speed * atanh(torque / coulomb). With `coriolis` off the operator's mass, too, is taken at
    its instantaneous inertia only, so that M a = tau + J^T F_op holds to the letter in every setting.

    Left in `w`: r, rdot, jac, mass, bias, tau_visc, tau_coul, tau_stop (torques on the joints),
    f_op (operator on device, with weight and inertia of its mass), f_drive (without both).

    Parameters
    ----------
    p, op
        Records `LINKAGE` and `OPERATOR`.
    t
        Time [s], for the operator's tables.
    q, v, tau
        Joint angles [rad], speeds [rad/s] and motor torques [N m].
    a_out
        Joint accelerations [rad/s^2]; NaN if the mass matrix is not positive definite.
    w
        Record `WORK`.
    """
    n = p.n
    mass = op.mass
    _pose(p, q, w)
    _inertia(p, mass, w)
    _bias(p, v, mass, w)
    x = 0.0
    y = 0.0
    for i in range(n):
        x += w.jac[0, i] * v[i]
        y += w.jac[1, i] * v[i]
        a_out[i] = tau[i] - w.bias[i]
    w.rdot[0] = x
    w.rdot[1] = y
    if p.viscous_on:
        for i in range(n):
            w.tau_visc[i] = -p.viscous[i] * v[i]
            a_out[i] += w.tau_visc[i]
    if p.coulomb_on:
        for i in range(n):
            w.tau_coul[i] = -p.coulomb[i] * math.tanh(v[i] / p.coulomb_speed)
            a_out[i] += w.tau_coul[i]
    if p.stops_on:
        for i in range(n):
            w.tau_stop[i] = _stop_torque(p, i, q[i], v[i])
            a_out[i] += w.tau_stop[i]
    if op.kind == _NONE:
        w.f_op[0] = 0.0
        w.f_op[1] = 0.0
        w.f_drive[0] = 0.0
        w.f_drive[1] = 0.0
        solve(n, w.mass, a_out, w.factor)
        return
    operator_force(op, t, w.r, w.rdot, w.f_drive)
    w.f_op[0] = w.f_drive[0] + op.falls * mass * p.gravity[0]
    w.f_op[1] = w.f_drive[1] + op.falls * mass * p.gravity[1]
    for i in range(n):
        a_out[i] += w.jac[0, i] * w.f_op[0] + w.jac[1, i] * w.f_op[1]
    solve(n, w.mass, a_out, w.factor)
    if mass > 0.0:
        x = 0.0
        y = 0.0
        for i in range(n):
            x += w.jac[0, i] * a_out[i]
            y += w.jac[1, i] * a_out[i]
        if p.coriolis and not p.slider:
            for i in range(n):
                pull = p.length[i] * w.rate[i] * w.rate[i]
                x -= pull * w.cos[i]
                y -= pull * w.sin[i]
        w.f_op[0] -= mass * x
        w.f_op[1] -= mass * y


@njit(cache=True, error_model="numpy")
def mass_matrix(p: Record, op: Record, q: Vector, w: Record) -> None:
    """Leave the joint-space mass matrix [kg m^2], rotors and operator's mass included, in ``w.mass``."""
    _pose(p, q, w)
    _inertia(p, op.mass, w)


@njit(cache=True, error_model="numpy")
def bias(p: Record, op: Record, q: Vector, v: Vector, w: Record) -> None:
    """Leave the bias torque h [N m] in ``w.bias``: Coriolis and gravity, M a + h = tau.

    The weight of the operator's mass is a force of the operator, hence not part of it; the Coriolis part
    of that mass is.
    """
    _pose(p, q, w)
    _bias(p, v, op.mass, w)


@njit(cache=True, error_model="numpy")
def energy(p: Record, op: Record, q: Vector, v: Vector) -> tuple[float, float]:
    """Kinetic and gravity energy [J], rotors and operator's mass included.

    Their sum changes by the work of tau, w.f_drive and w.tau_*. For the device alone pass a
    `NoOperator` record; the operator's work is then that of w.f_op. The weight of the operator's mass
    counts when the operator `falls`. Zero of the gravity energy: the robot's origin.
    """
    tip_mass = op.mass
    heavy_mass = op.mass * op.falls
    if p.slider:
        r = p.length[0]
        inertia = p.couple[0, 0] + tip_mass * r * r + p.armature[0]
        along = p.gravity[0] * p.direction[0] + p.gravity[1] * p.direction[1]
        lift = -(p.moment[0] + heavy_mass * r) * q[0] * along
        lift -= heavy_mass * (p.gravity[0] * p.origin[0] + p.gravity[1] * p.origin[1])
        return 0.5 * inertia * v[0] * v[0], lift
    kinetic = 0.0
    potential = -heavy_mass * (p.gravity[0] * p.origin[0] + p.gravity[1] * p.origin[1])
    phi = 0.0
    rate = 0.0
    for i in range(p.n):
        phi += q[i]
        rate += v[i]
        moment = p.moment[i] + heavy_mass * p.length[i]
        potential -= moment * (p.gravity[0] * math.cos(phi) + p.gravity[1] * math.sin(phi))
        kinetic += 0.5 * p.armature[i] * v[i] * v[i]
        kinetic += 0.5 * (p.couple[i, i] + tip_mass * p.length[i] * p.length[i]) * rate * rate
        turn = 0.0  # phi_i - phi_j, from the joint angles between them: no cancellation
        other = rate
        for j in range(i - 1, -1, -1):
            turn += q[j + 1]
            other -= v[j + 1]
            couple = p.couple[i, j] + tip_mass * p.length[i] * p.length[j]
            kinetic += couple * math.cos(turn) * rate * other
    return kinetic, potential


@njit(cache=True, error_model="numpy")
def _near(angle: float, seed: float) -> float:
    """Return the angle plus the multiple of 2 pi that brings it nearest to `seed`."""
    return angle - 2.0 * math.pi * math.floor((angle - seed) / (2.0 * math.pi) + 0.5)


@njit(cache=True, error_model="numpy")
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
        return abs(x * p.direction[1] - y * p.direction[0])
    distance = math.hypot(x, y)
    if p.n == 1:
        q[0] = _near(math.atan2(y, x), q[0])
        return abs(distance - p.length[0])
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
        return max(distance - (a + b), abs(a - b) - distance, 0.0)
    return _least_squares(p, x, y, q)


@njit(cache=True, error_model="numpy")
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
