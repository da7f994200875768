"""Computer, circuit, linkage, operator and motor as one linear system about a contact that is held.

    x' = A x + B i + E r,   x = (q, v, states before the multipliers, states behind them)

with i the DAC channels [V] followed by the noise of the potentiometers [rad], and r the rate of that noise
[rad/s], which only the model `ideal` passes on. All are deviations from the pose of rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cosim.analysis.control_law import LawPoint, external_force, law_point, rests
from cosim.analysis.held_contact import HeldContact
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.effects.dac_skew import skew_s
from cosim.effects.linkage import LINKAGE
from cosim.effects.sampling import COMPUTER
from cosim.effects.sensing import SENSING
from cosim.loop.dac_channels import is_geometric
from cosim.scene import Onset, Scene
from cosim.scene.mechanism import operator
from cosim.types import Array
from mech import Chain
from mech.linkage import Linkage

__all__ = ["Output", "System", "linearise"]


@dataclass(frozen=True)
class Output:
    """y = c x + d i + e r; `unit` of its components."""

    c: Array
    d: Array
    e: Array
    unit: str


@dataclass(frozen=True)
class System:
    """A scene in contact, linear.

    Attributes
    ----------
    joints
        n.
    q
        Pose of rest [rad].
    a, b, e
        [N, N], [N, channels + n], [N, n].
    law
        The computer's law at the pose.
    keep
        What its estimate of speed keeps from sample to sample.
    period_s, lag_s, settle_s, skew_s
        Sampling period; computing delay; how long the DACs take; how much later equilibria and commands are
        than gains.
    outputs
        By name: 'motor_force' and 'operator_force' [2] N, 'tip' [2] m, of these three their part along the
        wall's normal, 'motor_normal', 'operator_normal', 'penetration'; 'angles' [n] rad, 'currents' [n] A.
    current_a
        [n], motor currents at rest.
    notes
        What the scene asks for but a linear system leaves out.
    """

    joints: int
    q: Array
    a: Array
    b: Array
    e: Array
    law: LawPoint
    keep: float
    period_s: float
    lag_s: float
    settle_s: float
    skew_s: float
    outputs: dict[str, Output]
    current_a: Array
    notes: tuple[str, ...]


def linearise(contact: HeldContact, *, preload: bool = True, t: float | None = None) -> System:
    """Return the scene linearised about the pose of a permanent contact.

    Parameters
    ----------
    preload
        Whether the forces of the pose count: the operator's at the time `t` (the scene's end by default),
        weight, and what the law asks for at this depth. Without, all are zero: a wall just touched.

    Raises
    ------
    InputError
        For a scene without a wall, or with a law or an operator in Python.
    """
    scene, constants, circuit = contact.scene, contact.constants, contact.circuit
    linkage, q = contact.linkage, contact.q
    n, m = scene.joints, len(circuit.gain)
    person = operator(scene)
    op = person.pack()[0]
    law = law_point(scene, constants, linkage, q)
    at = scene.duration_s if t is None else t
    outer = external_force(scene, linkage, q, at)
    current = np.zeros(n)
    inner = np.zeros(m)
    if preload:
        _, _, current = rests(contact, q, at)
        inner = circuit.before(0.0)[0].real @ np.concatenate([q, law.volts[:n]]) + circuit.x_offset
    a, b, e, c, d, feed = _electric(circuit, constants.gear, law.volts[n : n + m], inner)
    per_amp = constants.torques_per_amp(n)[:, None]
    jac = linkage.jacobian(q)
    inverse = np.linalg.inv(linkage.mass_matrix(q, person))
    viscous = np.diag(linkage.pack()[0]["viscous"][:n]) + op["damping"] * jac.T @ jac
    stiff = op["stiffness"] * jac.T @ jac
    if preload:
        stiff = stiff - linkage.geometric_stiffness(q, outer) + _weight_stiffness(linkage, q)
    a[:n, n : 2 * n] = np.eye(n)
    motion = slice(n, 2 * n)
    a[motion] = inverse @ (per_amp * c)
    a[motion, :n] -= inverse @ stiff
    a[motion, n : 2 * n] -= inverse @ viscous
    b[motion], e[motion] = inverse @ (per_amp * d), inverse @ (per_amp * feed)
    outputs = _outputs(scene, linkage, q, op, a, b, e, per_amp, (c, d, feed), per_amp[:, 0] * current)
    effects = scene.effects
    computer = scene.computer
    late = computer.delay_periods + computer.delay_fraction
    left_out = _left_out(scene, circuit, linkage, q, current)
    cutoff = computer.velocity.filter_hz
    return System(
        joints=n, q=np.asarray(q, float), a=a, b=b, e=e, law=law,
        keep=0.0 if cutoff is None else math.exp(-2.0 * math.pi * cutoff * computer.period_s),
        period_s=computer.period_s,
        lag_s=late * computer.period_s if effects.delay else 0.0,
        settle_s=computer.dac.settling_s if effects.dac_settling else 0.0,
        skew_s=skew_s(scene),
        outputs=outputs, current_a=current, notes=left_out,
    )  # fmt: skip


def _electric(
    circuit: LinearCircuit, gear: float, gains_v: Array, inner: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return A, B, E with the rows of the motion still empty, and C, D, F of the motors' currents.

    `inner` [m] are the inputs X of the multipliers at rest: what a change of the gains multiplies.
    """
    n, m = circuit.joints, len(circuit.gain)
    before, after = len(circuit.a_pre), len(circuit.a_post)
    size, channels = 2 * n + before + after, 2 * n + m
    z, w = slice(2 * n, 2 * n + before), slice(2 * n + before, size)
    a, b, e = np.zeros((size, size)), np.zeros((size, channels + n)), np.zeros((size, n))
    pins, pin_inputs = np.zeros((2 * n, size)), np.zeros((2 * n, channels + n))  # pot, u
    pins[:n, :n] = np.eye(n)
    pin_inputs[:n, channels:], pin_inputs[n:, :n] = np.eye(n), np.eye(n)
    a[z], b[z] = circuit.b_pre @ pins, circuit.b_pre @ pin_inputs
    a[z, z] += circuit.a_pre
    x, x_inputs = circuit.d_pre @ pins, circuit.d_pre @ pin_inputs
    x[:, z] += circuit.c_pre
    x[:, n : 2 * n] += circuit.e_pre
    held = (circuit.gain * (gains_v + circuit.y_offset))[:, None]
    behind, behind_inputs = np.zeros((m + 2 * n, size)), np.zeros((m + 2 * n, channels + n))
    behind[:m], behind_inputs[:m] = held * x, held * x_inputs
    behind_inputs[:m, n : n + m] += np.diag(circuit.gain * inner)
    behind_inputs[m : m + n, n + m : channels] = np.eye(n)
    behind[m + n :, n : 2 * n] = gear * np.eye(n)
    behind_rates = np.zeros((m + 2 * n, n))
    behind_rates[:m] = held * circuit.e_pre
    a[w], b[w], e[w] = (circuit.b_post @ part for part in (behind, behind_inputs, behind_rates))
    a[w, w] += circuit.a_post
    c, d, feed = (circuit.d_post @ part for part in (behind, behind_inputs, behind_rates))
    c[:, w] += circuit.c_post
    return a, b, e, c, d, feed


def _outputs(
    scene: Scene,
    linkage: Linkage,
    q: Array,
    op: np.void,
    a: Array,
    b: Array,
    e: Array,
    per_amp: Array,
    currents: tuple[Array, Array, Array],
    torque: Array,
) -> dict[str, Output]:
    assert scene.wall is not None
    n, size = scene.joints, len(a)
    jac, normal = linkage.jacobian(q), np.array(scene.wall.normal)[None, :]
    back = np.linalg.pinv(jac.T)  # J^T F = tau, as the reports show the motors' force
    c, d, feed = (back @ (per_amp * part) for part in currents)
    c[:, :n] -= back @ linkage.geometric_stiffness(q, back @ torque)
    motion = slice(n, 2 * n)
    pull = np.zeros((2, size))
    pull[:, :n], pull[:, motion] = -op["stiffness"] * jac, -op["damping"] * jac
    mass = op["mass"]
    push = Output(pull - mass * jac @ a[motion], -mass * jac @ b[motion], -mass * jac @ e[motion], "N")
    where = np.zeros((2, size))
    where[:, :n] = jac
    nothing, still = np.zeros((2, b.shape[1])), np.zeros((2, n))
    motor, tip = Output(c, d, feed, "N"), Output(where, nothing, still, "m")
    angles = Output(np.eye(n, size), np.zeros((n, b.shape[1])), np.zeros((n, n)), "rad")

    def along(out: Output, sign: float = 1.0) -> Output:
        return Output(sign * normal @ out.c, sign * normal @ out.d, sign * normal @ out.e, out.unit)

    return {
        "motor_force": motor, "motor_normal": along(motor), "operator_force": push,
        "operator_normal": along(push), "tip": tip, "penetration": along(tip, -1.0), "angles": angles,
        "currents": Output(*currents, "A"),
    }  # fmt: skip


def _weight_stiffness(linkage: Linkage, q: Array) -> Array:
    """Return the slope of the device's weight [N m/rad], shape [n, n], in M a + h = tau."""
    p = linkage.pack()[0]
    n = linkage.n
    if not p["heavy"] or not isinstance(linkage, Chain):
        return np.zeros((n, n))
    phi, (gx, gy) = np.cumsum(q), p["gravity"]
    each = p["moment"][:n] * (gx * np.cos(phi) + gy * np.sin(phi))
    beyond = np.cumsum(each[::-1])[::-1]  # h_i sums the links from i on, each turns with all joints before it
    out: Array = beyond[np.maximum.outer(np.arange(n), np.arange(n))]
    return out


def _left_out(
    scene: Scene, circuit: LinearCircuit, linkage: Linkage, q: Array, current: Array
) -> tuple[str, ...]:
    effects = (*LINKAGE, *SENSING, *COMPUTER)
    notes = [each.not_held for each in effects if each.not_held and each.is_in_force(scene)]
    if scene.computer.onset is Onset.ANCHORED:
        notes.append("that the springs are relaxed where the contact began, not at the wall")
    if is_geometric(scene):
        notes.append("the geometric stiffness that the law adds")
    if scene.effects.pot_linearity or scene.effects.pot_calibration:
        notes.append("the potentiometers' errors over the angle")
    if scene.effects.coriolis and not scene.is_slider:
        notes.append("Coriolis forces, which are of second order about rest")
    p = linkage.pack()[0]
    if p["stops_on"] and ((q <= p["stop_low"][: len(q)]) | (q >= p["stop_high"][: len(q)])).any():
        notes.append("an end stop that the pose lies in")
    if ((current <= circuit.limit[:, 0]) | (current >= circuit.limit[:, 1])).any():
        notes.append("the driver's current limit, which the pose is beyond")
    return tuple(notes)
