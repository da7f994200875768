"""The sampled computer: encoders, the control algorithm of section III, DAC codes.

Everything here runs once per sample, compiled. The law works in physical units (rad, N m/rad, N m s/rad,
N m at the joints); `to_volts` converts its outputs to DAC voltages with the *nominal* design constants only,
so that a changed resistor changes what the device renders and not what the computer believes.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cosim.types import Record
from mech.compiled import entry, inner, vector
from mech.kernels import jacobian, tip
from mech.records import LINKAGE, NMAX

Vector = NDArray[np.float64]


class Method(IntEnum):
    """What the computer displays at a contact (paper, section III; joint PD: Fig. 18)."""

    DISCRETE = 0
    CONTINUOUS = 1
    COMBINED = 2
    JOINT_PD = 3


class Path(IntEnum):
    """Which DAC carries the discrete force: the equilibrium `u` or the direct command `cmd`."""

    U = 0
    CMD = 1


#: As compiled code compares them.
_DISCRETE, _CONTINUOUS, _COMBINED, _JOINT_PD = (int(method) for method in Method)
_PATH_U = int(Path.U)

#: Settings of a computer. Units: s, N/m, N s/m, m, N m/rad, rad, V; `encoder_step`, `dac_step` = 0 and
#: `dac_range` = inf are the null forms of encoder and DAC, `ramp` = `anchored` = 0 those of what softens
#: the onset of a contact.
COMPUTER = np.dtype(
    [
        ("n", "i8"),
        ("method", "i8"),
        ("path", "i8"),
        ("period", "f8"),
        ("kp", "f8"),
        ("kd", "f8"),
        ("k_dp", "f8"),
        ("k_dd", "f8"),
        ("geometric", "i8"),
        ("ramp", "i8"),
        ("anchored", "i8"),
        ("point", "f8", 2),
        ("normal", "f8", 2),
        ("joint_gain", "f8", NMAX),
        ("joint_damper", "f8", NMAX),
        ("encoder_step", "f8"),
        ("velocity_keep", "f8"),
        ("v_rad", "f8"),
        ("volts_per_stiffness", "f8"),
        ("volts_per_damping", "f8"),
        ("v_nm", "f8"),
        ("dac_step", "f8"),
        ("dac_range", "f8"),
    ],
    align=True,
)

#: Inputs and outputs of the law at a sample (matrices row-major, k[i, j]: joint j to motor i).
#: `held` counts the samples of the present contact; its springs are relaxed at the depth `anchor` [m].
#: Per joint: `normal_torque` of a unit force along the wall's normal, row of J^T n [N m/N], and `lever`, the
#: tip's distance from the joint along the normal [m].
SAMPLE = np.dtype(
    [
        ("tick", "i8"),
        ("time", "f8"),
        ("q", "f8", NMAX),
        ("v", "f8", NMAX),
        ("q_last", "f8", NMAX),
        ("contact", "i8"),
        ("pen", "f8"),
        ("held", "i8"),
        ("anchor", "f8"),
        ("u", "f8", NMAX),
        ("ksp", "f8", (NMAX, NMAX)),
        ("ksd", "f8", (NMAX, NMAX)),
        ("cmd", "f8", NMAX),
        ("saturated", "i8"),
        ("unsolved", "i8"),
        ("jac", "f8", (2, NMAX)),
        ("r", "f8", 2),
        ("normal_torque", "f8", NMAX),
        ("lever", "f8", NMAX),
    ],
    align=True,
)

#: Newton steps to the contact point: quadratic convergence from a few millimetres needs four.
_NEWTON_STEPS = 30
#: The fingertip of q_d is on the wall to this distance [m]; a thousandth of what an encoder step moves it.
_ON_THE_WALL_M = 1e-9


@entry(COMPUTER, SAMPLE, int, vector)
def read_encoders(c: Record, x: Record, tick: int, q: Vector) -> None:
    """Joint angles as the encoders show them, and their backward difference as velocity [rad, rad/s]."""
    x.tick = tick
    x.time = tick * c.period
    for j in range(c.n):
        seen = q[j]
        if c.encoder_step > 0.0:
            seen = np.floor(seen / c.encoder_step + 0.5) * c.encoder_step
        if tick == 0:
            x.q_last[j] = seen
            x.v[j] = 0.0
        x.v[j] = c.velocity_keep * x.v[j] + (1.0 - c.velocity_keep) * (seen - x.q_last[j]) / c.period
        x.q_last[j] = seen
        x.q[j] = seen


@inner
def equilibrium(c: Record, p: Record, x: Record) -> None:
    """q_d of (9): joint angles that put the fingertip on its projection on the wall, nearest to the pose.

    Newton's method with the least-norm step; a redundant arm keeps its posture, a one-joint arm solves the
    normal direction only. Sets `x.unsolved` when the wall cannot be reached and leaves the pose there.
    """
    n0, n1 = c.normal[0], c.normal[1]
    depth = x.pen - x.anchor
    tx = x.r[0] + depth * n0
    ty = x.r[1] + depth * n1
    for j in range(c.n):
        x.u[j] = x.q[j]
    x.unsolved = 1
    for _ in range(_NEWTON_STEPS):
        tip(p, x.u, x.r)
        ex, ey = tx - x.r[0], ty - x.r[1]
        along = n0 * ex + n1 * ey
        miss = abs(along) if c.n == 1 else np.sqrt(ex * ex + ey * ey)
        if miss < _ON_THE_WALL_M:
            x.unsolved = 0
            break
        jacobian(p, x.u, x.jac)
        if c.n == 1:
            w = n0 * x.jac[0, 0] + n1 * x.jac[1, 0]
            if w == 0.0:
                break
            x.u[0] += along / w
        else:
            a = b = d = 0.0
            for j in range(c.n):
                a += x.jac[0, j] * x.jac[0, j]
                b += x.jac[0, j] * x.jac[1, j]
                d += x.jac[1, j] * x.jac[1, j]
            det = a * d - b * b
            if not det > 1e-14 * (a + d) * (a + d):
                break
            fx, fy = (d * ex - b * ey) / det, (a * ey - b * ex) / det
            for j in range(c.n):
                x.u[j] += x.jac[0, j] * fx + x.jac[1, j] * fy
    if x.unsolved:
        for j in range(c.n):
            x.u[j] = x.q[j]
    tip(p, x.q, x.r)
    jacobian(p, x.q, x.jac)


@entry(COMPUTER, LINKAGE, SAMPLE)
def law(c: Record, p: Record, x: Record) -> None:
    """Run the control algorithm of section III: (6) out of contact, (7)-(9) and (12) in contact.

    Ksp is rank one for a frictionless wall (22) and is never inverted: the discrete force that the path `u`
    must carry lies in its range, along w = J^T n, and needs only a division by w.w.
    """
    n = c.n
    tip(p, x.q, x.r)
    x.pen = c.normal[0] * (c.point[0] - x.r[0]) + c.normal[1] * (c.point[1] - x.r[1])
    x.contact = 1 if x.pen > 0.0 else 0
    x.unsolved = 0
    for i in range(n):
        x.u[i] = x.q[i]
        x.cmd[i] = 0.0
        for j in range(n):
            x.ksp[i, j] = 0.0
            x.ksd[i, j] = 0.0
    if x.contact == 0:
        x.held = 0
        x.anchor = 0.0
        return
    x.held += 1
    if c.anchored:
        # the springs start relaxed and follow the tip back: no sample ever adds to their energy
        x.anchor = x.pen if x.held == 1 else min(x.anchor, x.pen)
    depth = x.pen - x.anchor
    if c.method == _DISCRETE:
        jacobian(p, x.q, x.jac)
    else:
        equilibrium(c, p, x)
    w, lever = x.normal_torque, x.lever
    speed = 0.0
    for j in range(n):
        jx, jy = x.jac[0, j], x.jac[1, j]
        w[j] = c.normal[0] * jx + c.normal[1] * jy
        lever[j] = c.normal[0] * jy - c.normal[1] * jx
        speed += w[j] * x.v[j]
    if c.method == _JOINT_PD:
        for i in range(n):
            x.ksp[i, i] = c.joint_gain[i] if c.joint_gain[i] >= 0.0 else c.k_dp * w[i] * w[i]
            x.ksd[i, i] = c.joint_damper[i] if c.joint_damper[i] >= 0.0 else c.k_dd * w[i] * w[i]
    elif c.method != _DISCRETE:
        for i in range(n):
            for j in range(n):
                x.ksp[i, j] = c.k_dp * w[i] * w[j]
                x.ksd[i, j] = c.k_dd * w[i] * w[j]
    force = 0.0 if c.method == _CONTINUOUS else c.kp * depth - c.kd * speed
    held = force  # what the springs do not carry
    if c.method != _CONTINUOUS and (c.kp != 0.0 or c.kd != 0.0):
        held = _push(c, x, w, force)
    if c.geometric:
        _stiffen(c, x, w, lever, held)
    if x.held <= c.ramp:
        _weaken(c, x, x.held / (c.ramp + 1.0))


@inner
def _weaken(c: Record, x: Record, share: float) -> None:
    """Scale all outputs by a share while the wall's gains are ramped up."""
    for i in range(c.n):
        x.cmd[i] *= share
        for j in range(c.n):
            x.ksp[i, j] *= share
            x.ksd[i, j] *= share


@inner
def _push(c: Record, x: Record, w: Vector, force: float) -> float:
    """Command the discrete force [N] along the normal; return the part that the springs do not carry."""
    n = c.n
    if c.path == _PATH_U and c.method == _COMBINED:
        ww = 0.0
        for j in range(n):
            ww += w[j] * w[j]
        if ww > 0.0:  # at full stretch no torque pushes along the arm
            for j in range(n):
                x.u[j] += w[j] * force / (c.k_dp * ww)
        return 0.0
    for j in range(n):
        x.cmd[j] = w[j] * force
    return force


@inner
def _stiffen(c: Record, x: Record, w: Vector, lever: Vector, held: float) -> None:
    """Add the geometric stiffness of the present force to Ksp (footnote 2; Chen and Kao 2000).

    Where the tip moves under a force F on the device, J^T F changes although F does not: without the term
    K_g = [dJ^T/dq1 F, dJ^T/dq2 F, ...] the rendered stiffness is K - J^-T K_g J^-1. For a planar chain
    K_g[i, j] = -(r - r_m) . F, r_m the joint m = max(i, j). The device pushes along the normal with the force
    of its springs and `held` [N], so that F is its opposite. The torque at the sample stays as it was: the
    commands take away what the stiffer springs would add.
    """
    n = c.n
    push = held
    for j in range(n):
        push += c.k_dp * w[j] * (x.u[j] - x.q[j])
    for i in range(n):
        for j in range(n):
            added = push * lever[max(i, j)]
            x.ksp[i, j] += added
            x.cmd[i] -= added * (x.u[j] - x.q[j])


@inner
def _code(c: Record, volts: float) -> tuple[float, int]:
    """One DAC: the voltage of the nearest code, and whether it was clipped to the range."""
    if c.dac_step > 0.0:
        volts = np.floor(volts / c.dac_step + 0.5) * c.dac_step
        top = c.dac_range - c.dac_step
    else:
        top = c.dac_range
    if volts > top:
        return top, 1
    if volts < -c.dac_range:
        return -c.dac_range, 1
    return volts, 0


@entry(COMPUTER, SAMPLE, vector)
def to_volts(c: Record, x: Record, volts: Vector) -> None:
    """Convert the outputs in `x` to DAC voltages [V], in the order of `cosim.loop.dac_channels.channels`.

    Channels that the range clips are counted in `x.saturated`.
    """
    n = c.n
    x.saturated = 0
    at = 0
    for j in range(n):
        volts[at], over = _code(c, c.v_rad * x.u[j])
        x.saturated += over
        at += 1
    for i in range(n):
        for j in range(n):
            volts[at], over = _code(c, c.volts_per_stiffness * x.ksp[i, j])
            x.saturated += over
            at += 1
    for i in range(n):
        for j in range(n):
            volts[at], over = _code(c, c.volts_per_damping * x.ksd[i, j])
            x.saturated += over
            at += 1
    for i in range(n):
        volts[at], over = _code(c, c.v_nm * x.cmd[i])
        x.saturated += over
        at += 1
