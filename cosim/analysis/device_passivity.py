"""Passivity of a scene: its device and its law from netlist and scene, and the energy of a finished run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.analysis.control_law import law_point
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.passivity import Device, Law, wall
from cosim.effects.dac_skew import skew_s
from cosim.scene import CommandPath, Method, Scene
from cosim.types import Array, Complex

__all__ = ["Delivered", "delivered", "device_of", "law_of"]


def device_of(contact: HeldContact) -> Device:
    """Return the device at the pose of a contact, its analog springs and dampers in force, held by nobody.

    Its damping: viscous friction, the motors' back-EMF, the analog dampers, and the (negative) part that the
    circuit's lags add to its springs. Coulomb friction is left out.
    """
    scene, constants, circuit, linkage = contact.scene, contact.constants, contact.circuit, contact.linkage
    n, m = scene.joints, len(circuit.gain)
    law = law_point(scene, constants, linkage, contact.q)
    gains = law.volts[n : n + m]
    viscous = np.diag(linkage.pack()[0]["viscous"][:n]).astype(complex)
    per_amp = constants.torques_per_amp(n)[:, None]
    w = contact.torques

    def damping(omega: Array) -> Complex:
        y = circuit.response(1j * omega, gains)
        impedance = -per_amp * (y[:, :, :n] / (1j * omega)[:, None, None] + constants.gear * y[:, :, 3 * n :])
        out: Complex = viscous + 0.5 * (impedance + impedance.conj().transpose(0, 2, 1))
        return out

    by_u = scene.computer.command_path is CommandPath.U and scene.computer.method is Method.COMBINED

    def command(omega: Array) -> Complex:
        y = circuit.response(1j * omega, gains)
        if by_u:
            asked = constants.v_rad * w / (scene.computer.analog_stiffness_n_per_m * (w @ w))
            return np.asarray(per_amp * y[:, :, n : 2 * n] @ asked)
        return np.asarray(per_amp * y[:, :, 2 * n : 3 * n] @ (constants.v_nm * w))

    return Device(w, damping, command)


def law_of(scene: Scene) -> Law:
    """Return the discrete part of the scene's law with its delay, half of the DACs' settling included."""
    c = scene.computer
    late = 0.0
    if scene.effects.delay:
        late += (c.delay_periods + c.delay_fraction) * c.period_s
    late += skew_s(scene)
    if scene.effects.dac_settling:
        late += 0.5 * c.dac.settling_s
    periods, rest = divmod(late, c.period_s)
    if c.period_s - rest < 1e-12 * c.period_s:
        periods, rest = periods + 1, 0.0
    if rest < 1e-12 * c.period_s:
        rest = 0.0
    cutoff = c.velocity.filter_hz
    continuous = c.method is Method.CONTINUOUS
    return wall(
        0.0 if continuous else c.discrete_stiffness_n_per_m,
        0.0 if continuous else c.discrete_damping_n_s_per_m,
        c.period_s,
        keep=0.0 if cutoff is None else math.exp(-2.0 * math.pi * cutoff * c.period_s),
        periods=int(periods),
        lag_s=float(rest),
    )


@dataclass(frozen=True)
class Delivered:
    """Energy that the display - computer, circuit and motors - gave to the linkage in a run.

    Attributes
    ----------
    most_j
        Largest net energy delivered up to any time, beyond what its springs held at the start. A passive
        display delivers none: above `doubt_j` it was active.
    at_s
        When.
    end_j
        Net energy delivered over the run; negative where it took more than it gave.
    doubt_j
        What the run's energy ledger does not explain.
    contacts
        For each contact from its first sample to its end: start [s], length [s], energy delivered [J].
    """

    most_j: float
    at_s: float
    end_j: float
    doubt_j: float
    contacts: tuple[tuple[float, float, float], ...]

    @property
    def passive(self) -> bool:
        """Whether the display delivered no more than it had been given, as far as the ledger can tell."""
        return self.most_j <= self.doubt_j

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "passive": self.passive,
            "delivered_most_j": self.most_j,
            "delivered_at_s": self.at_s,
            "delivered_end_j": self.end_j,
            "doubt_j": self.doubt_j,
            "contacts": [
                {"start_s": start, "length_s": length, "delivered_j": energy}
                for start, length, energy in self.contacts
            ],
        }


def delivered(
    signals: Mapping[str, Array], events: Sequence[Mapping[str, Any]], ledger: Mapping[str, Any]
) -> Delivered:
    """Return what the display gave in a run, from `Run.signals`, `Run.events` and `Run.ledger`.

    The motors' power is integrated between the recorded points and scaled to the work in the ledger, which
    was integrated with the run itself; the difference of both counts as doubt.

    Notes
    -----
    A passivity observer (B. Hannaford and J.-H. Ryu, IEEE Trans. Robotics and Automation 18, 1, 2002) at the
    motors instead of at the hand: kinetic and gravity energy lie beyond it.
    """
    t, power = np.asarray(signals["time"]), np.asarray(signals["p_mot"])
    steps = 0.5 * np.diff(t) * (power[1:] + power[:-1])
    given = np.concatenate([[0.0], np.cumsum(steps)])
    exact = float(ledger["work_j"]["motors"])
    held = float(np.asarray(signals["e_spring"])[0])
    doubt = abs(float(given[-1]) - exact) + abs(float(ledger["residual_j"]))
    best = int(np.argmax(given))
    bounds = [float(event["time_s"]) for event in events if event["kind"] in ("contact", "release")]
    if len(bounds) % 2:
        bounds.append(float(t[-1]))
    contacts = []
    for start, end in zip(bounds[::2], bounds[1::2], strict=True):
        a, b = np.interp([start, end], t, given)
        contacts.append((start, end - start, float(b - a)))
    return Delivered(float(given[best]) - held, float(t[best]), exact, doubt, tuple(contacts))
