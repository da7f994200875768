"""The control law held in contact: its voltages at a pose, their slopes there, and the pose of rest.

The law is taken as bilateral: what it does inside the wall is continued to the surface, where a wall that is
just touched has no force yet but already its stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used

from cosim.analysis.held_contact import HeldContact
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import fail
from cosim.scene import CommandPath, Method, Scene
from cosim.scene.mechanism import known_mechanism, operator
from cosim.types import Array
from mech.contact import operator_force
from mech.linkage import Linkage

__all__ = ["LawPoint", "external_force", "law_point", "resting_pose", "rests"]


#: Newton's steps to the contact point, as the computer takes them.
_STEPS = 30
#: A pose counts as at rest when the residual torque is below this share of the largest torque.
_BALANCED = 1e-9
#: Newton's steps to the pose of rest, half the base of their slopes [rad], and a step that ends them [rad].
_NEWTON, _NEARBY_RAD, _SETTLED_RAD = 20, 1e-6, 1e-11


@dataclass(frozen=True)
class LawPoint:
    """Voltages of all DAC channels at a pose held in contact, in the order of `dac_channels.channels`.

    Attributes
    ----------
    volts
        [channels] V, without rounding to codes.
    by_angle
        [channels, n] V/rad, change with the angles that the encoders show.
    by_speed
        [channels, n] V per rad/s, change with the computer's estimate of the joint speeds.
    penetration_m
        Depth of the tip inside the wall; negative outside, where a real wall lets go.
    """

    volts: Array
    by_angle: Array
    by_speed: Array
    penetration_m: float


def law_point(scene: Scene, constants: DesignConstants, linkage: Linkage, q: Array) -> LawPoint:
    """Return the law of the scene at the angles `q` [rad] and its slopes, as if contact never ended.

    Raises
    ------
    InputError
        For a scene without a wall, with shafts, or with a law of the user's own.
    """
    c, n = scene.computer, scene.joints
    file = scene.file_name
    if scene.wall is None:
        fail("there is no contact to be held without a wall", file=file, key="wall")
    if c.law is not None:
        fail("a control law in Python has no slopes to study", file=file, key="computer.law", value=c.law)
    if scene.effects.shaft:
        fail(
            "this analysis takes the encoder's angle for the joint's: it knows no shafts",
            file=file,
            key="effects.shaft",
            value=True,
            allowed="false",
        )
    normal, point = np.array(scene.wall.normal), np.array(scene.wall.point_m)
    if scene.designed:
        linkage = known_mechanism(scene, constants.gear)
    jac = linkage.jacobian(q)
    w, dw = jac.T @ normal, linkage.geometric_stiffness(q, normal)  # dw[:, j] = dw / dq_j
    depth = float(normal @ (point - linkage.forward(q)))
    u, du = q.copy(), np.eye(n)
    if c.method is not Method.DISCRETE:
        u = _equilibrium(linkage, q, normal, depth)
        there = linkage.jacobian(u)
        du = np.eye(n) - _to_wall(there, normal, n) @ (there - jac + np.outer(normal, w))
    spring, damper = np.zeros((2, n, n))
    dspring, ddamper = np.zeros((2, n, n, n))
    k, d = c.analog_stiffness_n_per_m, c.analog_damping_n_s_per_m
    if c.method is not Method.DISCRETE:
        square = np.outer(w, w)
        slope = dw[:, None, :] * w[None, :, None] + w[:, None, None] * dw[None, :, :]
        if c.method is Method.JOINT_PD:
            square, slope = square * np.eye(n), slope * np.eye(n)[:, :, None]
        spring, dspring, damper, ddamper = k * square, k * slope, d * square, d * slope
        if c.method is Method.JOINT_PD and c.joint_stiffness_n_m_per_rad:
            spring, dspring = np.diag(c.joint_stiffness_n_m_per_rad), np.zeros((n, n, n))
        if c.method is Method.JOINT_PD and c.joint_damping_n_m_s_per_rad:
            damper, ddamper = np.diag(c.joint_damping_n_m_s_per_rad), np.zeros((n, n, n))
    cmd, dcmd, dcmd_v = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    du_v = np.zeros((n, n))
    kp, kd = c.discrete_stiffness_n_per_m, c.discrete_damping_n_s_per_m
    if c.method is not Method.CONTINUOUS and (kp or kd):
        if c.command_path is CommandPath.U and c.method is Method.COMBINED:
            along = w / (w @ w)
            turned = dw / (w @ w) - 2.0 * np.outer(w, w @ dw) / (w @ w) ** 2
            u = u + along * kp * depth / k
            du = du - kp / k * np.outer(along, w) + kp * depth / k * turned
            du_v = -kd / k * np.outer(along, w)
        else:
            cmd, dcmd = w * kp * depth, dw * kp * depth - kp * np.outer(w, w)
            dcmd_v = -kd * np.outer(w, w)
    per_spring, per_damper = constants.v_fs / constants.k_fs, constants.v_fs / constants.c_fs
    zeros = np.zeros((2 * n * n, n))
    return LawPoint(
        np.concatenate(
            [
                constants.v_rad * u,
                per_spring * spring.ravel(),
                per_damper * damper.ravel(),
                constants.v_nm * cmd,
            ]
        ),
        np.concatenate(
            [
                constants.v_rad * du,
                per_spring * dspring.reshape(n * n, n),
                per_damper * ddamper.reshape(n * n, n),
                constants.v_nm * dcmd,
            ]
        ),
        np.concatenate([constants.v_rad * du_v, zeros, constants.v_nm * dcmd_v]),
        depth,
    )


def _to_wall(jac: Array, normal: Array, n: int) -> Array:
    """Return the least joint motion for a motion of the tip [n, 2]; of one joint, along the normal only."""
    if n == 1:
        w = float(normal @ jac[:, 0])
        return normal[None, :] / w
    return np.asarray(np.linalg.pinv(jac), np.float64)


def _equilibrium(linkage: Linkage, q: Array, normal: Array, depth: float) -> Array:
    """Return the angles that put the tip on its projection on the wall, nearest to the pose."""
    target = linkage.forward(q) + depth * normal
    u: Array = q.copy()
    for _ in range(_STEPS):
        miss = target - linkage.forward(u)
        step = _to_wall(linkage.jacobian(u), normal, len(q)) @ miss
        u = u + step
        if np.abs(step).max() < 1e-15 * (1.0 + np.abs(u).max()):
            break
    return u


def external_force(scene: Scene, linkage: Linkage, q: Array, t: float) -> Array:
    """Return the operator's force on the fingertip at rest [N], weight of its mass included; shape (2,)."""
    person = operator(scene)
    op = person.pack()[0]
    if not person.compiled:
        fail(
            "an operator in Python has no slopes to study",
            file=scene.file_name,
            key="operator",
        )
    force = np.zeros(2)
    operator_force(op, t, linkage.forward(q), np.zeros(2), force)
    weight: Array = float(op["falls"] * op["mass"]) * np.asarray(linkage.gravity_m_per_s2)
    return force + weight


def rests(contact: HeldContact, q: Array, t: float) -> tuple[Array, float, Array]:
    """Return the residual torques at `q` [N m], the largest of their terms, and the currents [A]."""
    scene, constants, circuit, linkage = contact.scene, contact.constants, contact.circuit, contact.linkage
    n = scene.joints
    law = law_point(scene, constants, linkage, q)
    before, after = circuit.before(0.0)[0].real, circuit.after(0.0)[0].real
    m = len(circuit.gain)
    inner = before @ np.concatenate([q, law.volts[:n]]) + circuit.x_offset
    products = circuit.gain * (law.volts[n : n + m] + circuit.y_offset) * inner
    current = after @ np.concatenate([products, law.volts[n + m :], np.zeros(n)]) + circuit.offset
    motors = constants.torques_per_amp(n) * current
    outer = linkage.jacobian(q).T @ external_force(scene, linkage, q, t)
    bias = linkage.bias(q, np.zeros(n))
    scale = max(float(np.abs(part).max()) for part in (motors, outer, bias))
    return motors + outer - bias, scale, current


def resting_pose(contact: HeldContact, t: float | None = None) -> Array:
    """Return the angles [rad] at which the scene rests in contact, with the operator as at the time `t`.

    Parameters
    ----------
    contact
        Its pose is where the search begins.
    t
        By default the end of the scene.

    Raises
    ------
    InputError
        When there is no pose of rest, or only outside the wall.
    """
    scene = contact.scene
    at = scene.duration_s if t is None else t
    file = scene.file_name

    def torques(q: Array) -> Array:
        return rests(contact, q, at)[0]

    rest = _by_newton(torques, contact.q)
    if rest is None:  # loading this takes 0.2 s
        rest = np.asarray(scipy.optimize.root(torques, contact.q, tol=1e-13).x, float)
    left, scale, _ = rests(contact, rest, at)
    if not (math.isfinite(scale) and np.abs(left).max() <= _BALANCED * max(scale, 1e-9)):
        fail("no pose of rest in contact was found for this scene", file=file)
    law = law_point(scene, contact.constants, contact.linkage, rest)
    if not law.penetration_m > 0.0:
        fail(
            "the scene ends out of contact: nothing presses the tip into the wall",
            file=file,
            key="operator",
            value=f"rest {-1e3 * law.penetration_m:.3g} mm outside",
        )
    return rest


def _by_newton(torques: Callable[[Array], Array], q: Array) -> Array | None:
    """Return the pose without torques that Newton's iteration reaches; None where it does not go straight."""
    left = torques(q)
    for _ in range(_NEWTON):
        slopes = np.column_stack(
            [(torques(q + d) - torques(q - d)) / (2.0 * _NEARBY_RAD) for d in _NEARBY_RAD * np.eye(len(q))]
        )
        try:
            step = np.linalg.solve(slopes, -left)
        except np.linalg.LinAlgError:
            return None
        q, before, left = q + step, np.abs(left).max(), torques(q + step)
        if np.abs(step).max() <= _SETTLED_RAD:
            return q
        if not np.abs(left).max() < before:
            return None
    return None
