"""Compiled mechanics: kinematics and equations of motion. No allocation, one state at a time.

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
from numpy.typing import NDArray

from mech.compiled import entry, inner, inner_inlined, matrix, vector
from mech.contact import operator_force, pushed, stop_torque
from mech.kinematics import inverse, jacobian, tip, tip_velocity
from mech.records import LINKAGE, OPERATOR, WORK, OperatorKind
from mech.shaft import shaft_torque

__all__ = [
    "bias",
    "dynamics",
    "flow",
    "inverse",
    "jacobian",
    "mass_matrix",
    "operator_force",
    "solve",
    "solve_held",
    "stop_torque",
    "tip",
    "tip_velocity",
]

Vector = NDArray[np.float64]
Record = Any

_NONE = int(OperatorKind.NONE)


@inner_inlined
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
        w.pose.cos[i] = math.cos(phi)
        w.pose.sin[i] = math.sin(phi)
    x = 0.0
    y = 0.0
    for i in range(p.n - 1, -1, -1):
        x += p.length[i] * w.pose.cos[i]
        y += p.length[i] * w.pose.sin[i]
        w.jac[0, i] = -y
        w.jac[1, i] = x
    w.r[0] = p.origin[0] + x
    w.r[1] = p.origin[1] + y


@inner_inlined
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
            row += couple * (w.pose.cos[a] * w.pose.cos[b] + w.pose.sin[a] * w.pose.sin[b])
            if b > a:
                below = w.mass[a + 1, b]
            elif a + 1 < n:
                below = w.mass[a, a + 1]
            w.mass[a, b] = row + below
            w.mass[b, a] = row + below
    for a in range(n):
        w.mass[a, a] += p.armature[a]


@inner_inlined
def _bias(p: Record, v: Vector, tip_mass: float, w: Record) -> None:
    """Fill `w.bias` and `w.pose.rate` from the pose in `w`: M a + bias = applied torque."""
    n = p.n
    if p.slider:
        w.bias[0] = 0.0
        if p.heavy:
            w.bias[0] = -p.moment[0] * (p.gravity[0] * p.direction[0] + p.gravity[1] * p.direction[1])
        return
    rate = 0.0
    for i in range(n):
        rate += v[i]
        w.pose.rate[i] = rate
        w.bias[i] = 0.0
    if p.coriolis:
        for i in range(n):
            for j in range(i):
                couple = p.couple[i, j] + tip_mass * p.length[i] * p.length[j]
                twist = couple * (w.pose.sin[i] * w.pose.cos[j] - w.pose.cos[i] * w.pose.sin[j])
                w.bias[i] += twist * w.pose.rate[j] * w.pose.rate[j]
                w.bias[j] -= twist * w.pose.rate[i] * w.pose.rate[i]
    if p.heavy:
        for i in range(n):
            w.bias[i] += p.moment[i] * (p.gravity[0] * w.pose.sin[i] - p.gravity[1] * w.pose.cos[i])
    for i in range(n - 2, -1, -1):
        w.bias[i] += w.bias[i + 1]


@entry(int, matrix, vector, matrix, how=inner_inlined)
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


@inner
def solve_held(n: int, w: Record, x: Vector) -> None:
    """Solve `w.mass` x = x in place with x = 0 at the joints that `w.contact.held` marks.

    `w.contact.hold` receives the torques [N m] that hold them: M x = (right-hand side) + hold.
    """
    for i in range(n):
        w.contact.hold[i] = -x[i]
        for j in range(n):
            w.scratch.reduced[i, j] = 0.0 if w.contact.held[i] or w.contact.held[j] else w.mass[i, j]
        if w.contact.held[i]:
            w.scratch.reduced[i, i] = 1.0
            x[i] = 0.0
    solve(n, w.scratch.reduced, x, w.scratch.factor)
    for i in range(n):
        if not w.contact.held[i]:
            w.contact.hold[i] = 0.0
            continue
        for j in range(n):
            w.contact.hold[i] += w.mass[i, j] * x[j]


@inner
def _accelerate(p: Record, w: Record, x: Vector) -> None:
    """Turn torques into accelerations in place; what holds a held joint is its friction's or its stop's."""
    n = p.n
    if w.contact.holding == 0:
        solve(n, w.mass, x, w.scratch.factor)
        return
    solve_held(n, w, x)
    for i in range(n):
        if not w.contact.held[i]:
            continue
        if w.contact.touch[i] * w.contact.hold[i] < 0.0:
            w.tau_stop[i] = w.contact.hold[i]
        elif p.coulomb_on:
            w.tau_coul[i] = w.contact.hold[i]


@entry(LINKAGE, OPERATOR, float, vector, vector, vector, vector, WORK)
def dynamics(
    p: Record, op: Record, t: float, q: Vector, v: Vector, tau: Vector, a_out: Vector, w: Record
) -> None:
    """Joint acceleration a = M^-1 (tau - h + friction + stops + J^T F_op).

    With shafts q, v and a_out are [joints, motors] (`mech.shaft`): the shafts' torque stands for tau in the
    joints' equation, and each motor has its own, a = (tau - shaft) / rotor.

    M holds rotors and the operator's mass, h Coriolis and gravity. Friction is -viscous v -
    coulomb tanh(v / coulomb_speed): a smooth step, so a joint held by Coulomb friction creeps at
    coulomb_speed * atanh(torque / coulomb). With `coriolis` off the operator's mass, too, is taken at
    its instantaneous inertia only, so that M a = tau + J^T F_op holds to the letter in every setting.
    Where `w.mode.located` is set, friction is constant by the way that each joint slips
    (`w.contact.slide`), joints in `w.contact.held` do not accelerate, and, with `w.mode.stops_located`,
    a stop pushes as `w.contact.touch` says: whoever integrates sets these at the instants where they
    change (`mech.stiction`), and the accelerations are smooth between them.

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
        Record `WORK`, zeroed once: effects that are off do not touch their entries.
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
    if p.shaft_on:
        shaft_torque(p, q, v, w)
        for i in range(n):
            a_out[i] = w.tau_shaft[i] - w.bias[i]
            a_out[n + i] = (tau[i] - w.tau_shaft[i]) / p.rotor[i]
    if p.viscous_on:
        for i in range(n):
            w.tau_visc[i] = -p.viscous[i] * v[i]
            a_out[i] += w.tau_visc[i]
    if p.coulomb_on:
        for i in range(n):
            if w.mode.located:
                w.tau_coul[i] = -p.coulomb[i] * w.contact.slide[i]
            else:
                w.tau_coul[i] = -p.coulomb[i] * math.tanh(v[i] / p.coulomb_speed)
            a_out[i] += w.tau_coul[i]
    if p.stops_on:
        for i in range(n):
            if w.mode.stops_located:
                w.tau_stop[i] = pushed(p, i, q[i], v[i], w.contact.touch[i])
            else:
                w.tau_stop[i] = stop_torque(p, i, q[i], v[i])
            a_out[i] += w.tau_stop[i]
    if op.kind == _NONE:
        w.f_op[0] = 0.0
        w.f_op[1] = 0.0
        w.f_drive[0] = 0.0
        w.f_drive[1] = 0.0
        _accelerate(p, w, a_out)
        return
    operator_force(op, t, w.r, w.rdot, w.f_drive)
    w.f_op[0] = w.f_drive[0] + op.falls * mass * p.gravity[0]
    w.f_op[1] = w.f_drive[1] + op.falls * mass * p.gravity[1]
    for i in range(n):
        a_out[i] += w.jac[0, i] * w.f_op[0] + w.jac[1, i] * w.f_op[1]
    _accelerate(p, w, a_out)
    if mass > 0.0:
        x = 0.0
        y = 0.0
        for i in range(n):
            x += w.jac[0, i] * a_out[i]
            y += w.jac[1, i] * a_out[i]
        if p.coriolis and not p.slider:
            for i in range(n):
                pull = p.length[i] * w.pose.rate[i] * w.pose.rate[i]
                x -= pull * w.pose.cos[i]
                y -= pull * w.pose.sin[i]
        w.f_op[0] -= mass * x
        w.f_op[1] -= mass * y


@entry(LINKAGE, OPERATOR, float, vector, vector, vector, WORK)
def flow(p: Record, op: Record, t: float, y: Vector, tau: Vector, rate_out: Vector, w: Record) -> None:
    """Rate of the state and of the energy ledger, for an integrator that owns time.

    `y` holds q [rad], v [rad/s] and six works [J]: motors, operator (without weight and inertia of its
    mass), viscous friction, Coulomb friction, end stops, shafts; shape (2 m + 6,), as `rate_out`, with m
    coordinates: n joints, and n motors where there are shafts.
    """
    n = p.n
    motor = n if p.shaft_on else 0
    m = n + motor
    q = y[:m]
    v = y[m : 2 * m]
    dynamics(p, op, t, q, v, tau, rate_out[m : 2 * m], w)
    power = rate_out[2 * m :]
    power[0] = 0.0
    power[1] = w.f_drive[0] * w.rdot[0] + w.f_drive[1] * w.rdot[1]
    power[2] = 0.0
    power[3] = 0.0
    power[4] = 0.0
    power[5] = 0.0
    for i in range(m):
        rate_out[i] = v[i]
    for i in range(n):
        power[0] += tau[i] * v[motor + i]
        if p.shaft_on:
            power[5] -= w.tau_loss[i] * (v[n + i] - v[i])
        power[2] += w.tau_visc[i] * v[i]
        power[3] += w.tau_coul[i] * v[i]
        power[4] += w.tau_stop[i] * v[i]


@entry(LINKAGE, OPERATOR, vector, WORK)
def mass_matrix(p: Record, op: Record, q: Vector, w: Record) -> None:
    """Leave the joint-space mass matrix [kg m^2], operator's mass included, in ``w.mass``.

    Rotors are part of it unless a shaft lies between them and the joint.
    """
    _pose(p, q, w)
    _inertia(p, op.mass, w)


@entry(LINKAGE, OPERATOR, vector, vector, WORK)
def bias(p: Record, op: Record, q: Vector, v: Vector, w: Record) -> None:
    """Leave the bias torque h [N m] in ``w.bias``: Coriolis and gravity, M a + h = tau.

    The weight of the operator's mass is a force of the operator, hence not part of it; the Coriolis part
    of that mass is.
    """
    _pose(p, q, w)
    _bias(p, v, op.mass, w)
