"""Impedance of a displayed wall at the tip over frequency, and how stiff a wall the board may display at all.

A hand that moves the tip sinusoidally along the wall's normal feels a force; its part of the same frequency
over the tip's speed is the impedance. Mass, viscosity and circuit answer as linear parts do. The computer's
part is sampled, delayed and held: its fundamental is exact at every frequency; the other
components of the staircase, at other frequencies, are not counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cosim.analysis.control_law import law_point
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.stability import border, held, stability
from cosim.circuits.design_constants import DesignConstants
from cosim.effects.dac_skew import skew_s
from cosim.errors import fail
from cosim.scene import Method
from cosim.types import Array, Complex

__all__ = ["Displayed", "displayed", "full_scale", "impedance", "largest"]


#: Range that is scanned for a border, in the unit of the key.
_RANGE = {"stiffness": (1e-1, 1e7), "damping": (1e-3, 1e5)}


def impedance(contact: HeldContact, frequency: Array) -> Complex:
    """Return force over speed at the tip along the wall's normal [N s/m] at the frequencies [Hz].

    The tip is moved along the normal, contact held at a wall that is just touched; all joints follow. The
    operator moves it: the hand's mass and damping are not included.
    """
    scene, constants, circuit = contact.scene, contact.constants, contact.circuit
    linkage, pose, normal = contact.linkage, contact.q, contact.normal
    n, c, effects = scene.joints, scene.computer, scene.effects
    jac = linkage.jacobian(pose)
    joint = np.linalg.pinv(jac) @ normal if n > 1 else np.array([1.0 / float(normal @ jac[:, 0])])
    law = law_point(scene, constants, linkage, pose)
    m = len(circuit.gain)
    s = 2j * np.pi * np.asarray(frequency, float)
    y = circuit.response(s, law.volts[n : n + m])
    per_amp = constants.torques_per_amp(n)
    viscous = np.diag(linkage.pack()[0]["viscous"][:n])
    moved = (s[:, None, None] * linkage.mass_matrix(pose) + viscous) @ joint
    # the circuit by itself: pot and motor speed
    moved = moved - per_amp * ((y[:, :, :n] / s[:, None, None] + constants.gear * y[:, :, 3 * n :]) @ joint)
    # the computer: sampled reading, its difference quotient, hold, delay, ramp of the DACs
    period = c.period_s
    z = np.exp(s * period)
    cutoff = c.velocity.filter_hz
    keep = 0.0 if cutoff is None else math.exp(-2.0 * math.pi * cutoff * period)
    speed = (1.0 - keep) / period * (1.0 - 1.0 / z) / (1.0 - keep / z)
    late = (c.delay_periods + c.delay_fraction) * period if effects.delay else 0.0
    late += skew_s(scene)
    path = -np.expm1(-s * period) / (s * period) * np.exp(-s * late)
    if effects.dac_settling and c.dac.settling_s > 0.0:
        path = path * -np.expm1(-s * c.dac.settling_s) / (s * c.dac.settling_s)
    channels = np.concatenate([np.arange(n), np.arange(n + m, 2 * n + m)])
    asked = law.by_angle[channels] @ joint + speed[:, None] * (law.by_speed[channels] @ joint)
    torque = per_amp * np.einsum("fij,fj->fi", y[:, :, n : 3 * n], asked)
    moved = moved - (path / s)[:, None] * torque
    out: Complex = moved @ joint
    return out


def full_scale(constants: DesignConstants, direction: Array) -> tuple[float, float]:
    """Return stiffness [N/m] and damping [N s/m] at the tip that bring a gain pin to full scale.

    Parameters
    ----------
    direction
        [n], joint torques of a unit force along the wall's normal [m]: gains are k w w'.
    """
    most = float(np.abs(np.outer(direction, direction)).max())
    volts = min(constants.v_fs, constants.dac_v) / constants.v_fs
    return volts * constants.k_fs / most, volts * constants.c_fs / most


@dataclass(frozen=True)
class Displayed:
    """A stiffness or damping that can be displayed; `by` names the limit."""

    value: float
    by: str


def largest(contact: HeldContact, key: str, *, cap: float = math.inf) -> Displayed:
    """Return the largest value of a key of ``[computer]`` that is stable, all others as they are.

    Parameters
    ----------
    cap
        Full scale of the board; where it is stable still, it is what ends the range.
    """
    low, high = _RANGE["stiffness" if "stiffness" in key else "damping"]
    edge = border(
        lambda value: held(contact.with_computer(**{key: value})),
        low, min(high, cap) if cap > low else high, rtol=1e-9,
    )  # fmt: skip
    if not edge.value:
        return Displayed(0.0, "nothing is stable")
    if edge.value >= cap:
        return Displayed(cap, "full scale")
    if math.isinf(edge.value):
        return Displayed(high, "end of the scan")
    return Displayed(edge.value, "stability")


def displayed(contact: HeldContact, *, spring: bool, damper: bool, margin: float = 1.0) -> HeldContact:
    """Return the contact with the stiffest wall that its device can display.

    Parameters
    ----------
    spring, damper
        Whether the analog path takes part; its gains go to full scale, or to `margin` of where the circuit
        itself oscillates, before the discrete stiffness is raised.
    margin
        Share of the border at which the wall is displayed, 0 to 1.

    Raises
    ------
    InputError
        When the wall is not stable there.
    """
    k, c = full_scale(contact.constants, contact.torques)
    out = contact.with_computer(
        method=Method.COMBINED if spring or damper else Method.DISCRETE,
        analog_stiffness_n_per_m=0.0, analog_damping_n_s_per_m=0.0, discrete_stiffness_n_per_m=0.0,
    )  # fmt: skip
    for key, wanted, cap in (
        ("analog_damping_n_s_per_m", damper, c),
        ("analog_stiffness_n_per_m", spring, k),
        ("discrete_stiffness_n_per_m", True, math.inf),
    ):
        if wanted:
            end = largest(out, key, cap=cap)
            share = margin if end.by == "stability" else 1.0
            out = out.with_computer(**{key: share * end.value})
    if margin < 1.0 and not stability(held(out)).stable:
        fail(
            f"at {margin:g} of its border the wall is not stable: its stable range does not begin at zero",
            file=contact.scene.file_name, key="computer",
        )  # fmt: skip
    return out
