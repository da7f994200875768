"""How stiff a scene's wall may be: modes, exact border, passivity and a rule of thumb, side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.analysis.board_range import board_range
from cosim.analysis.closed_form_limits import gil_hulin
from cosim.analysis.device_passivity import device_of, law_of
from cosim.analysis.held_contact import HeldContact, with_computer
from cosim.analysis.passivity import Device, least_damping, needed_damping, share_used
from cosim.analysis.period_map import Lifted
from cosim.analysis.stability import (
    Border,
    Stability,
    border,
    held,
    monodromy,
    stability,
)
from cosim.scene import Method, Scene
from cosim.types import Array

__all__ = ["RANGE", "Limits", "largest_passive", "limits", "locus", "varied"]


#: Stiffness that is scanned for the border [N/m].
RANGE = (1.0, 1e7)
#: A damping that is negative by this share of that at rest is rounding: behind a winding's lag all damping
#: goes to zero with frequency.
_NOTHING = 1e-9
#: At this rate [rad/s] the device's damping counts as that at rest.
_SLOW = 1e-2


@dataclass(frozen=True)
class Limits:
    """Limits of a scene at one pose of its wall, contact held.

    Attributes
    ----------
    key
        Key of ``[computer]`` whose border is looked for: the discrete stiffness, or the analog one where the
        computer displays none.
    stiffness
        Its value in the scene [N/m].
    stability
        Modes at this value.
    border
        Exact border over it [N/m].
    viscosity_n_s_per_m
        Damping that the device shows along the wall's normal at low frequency, held by nobody.
    least_damping_n_m_s
        Least damping of its joints over all frequencies; below zero its analog part alone is active.
    needed_n_s_per_m
        Colgate and Schenkel: viscosity that the discrete law needs on a plain device (delay in whole
        periods only); None for a late hold.
    passive_n_per_m
        Largest passive discrete stiffness on this device, None without a discrete part.
    gil_hulin_n_per_m
        Rule of thumb (b + B)/(T/2 + t_d) for a sampled wall, for b T/m well below one; None for an analog.
    board_n_per_m
        Analog stiffness at which a spring gain is at the range of its DAC; None where the border is that of
        the discrete stiffness, or the scene states the joints' gains.
    """

    key: str
    stiffness: float
    stability: Stability
    border: Border
    viscosity_n_s_per_m: float
    least_damping_n_m_s: float
    needed_n_s_per_m: float | None
    passive_n_per_m: float | None
    gil_hulin_n_per_m: float | None
    board_n_per_m: float | None

    @property
    def design(self) -> tuple[float, str]:
        """The stiffness to design for [N/m], and which limit it is; 0 where nothing is stable."""
        known = {
            "the exact border": self.border.value,
            "the largest passive stiffness": self.passive_n_per_m,
            "the board's range": self.board_n_per_m,
        }
        finite = {name: value for name, value in known.items() if value is not None}
        name = min(finite, key=lambda each: finite[each])
        return finite[name], name

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready; what is infinite or missing is None."""
        modes = [
            {
                "re": mode.z.real, "im": mode.z.imag, "growth": mode.growth,
                "frequency_hz": mode.frequency_hz, "damping": mode.damping,
                "ambiguous": mode.ambiguous,
            }
            for mode in self.stability.modes
        ]  # fmt: skip
        edge, critical = self.border, self.stability.critical
        design, which = self.design
        at_edge = edge.stability.critical if edge.stability is not None else None
        return {
            "key": f"computer.{self.key}",
            "stiffness_n_per_m": self.stiffness,
            "stable": self.stability.stable,
            "critical_growth": critical.growth if critical else None,
            "critical_frequency_hz": critical.frequency_hz if critical else None,
            "free_directions": self.stability.free,
            "modes": modes,
            "border_n_per_m": edge.value if math.isfinite(edge.value) else None,
            "border_frequency_hz": at_edge.frequency_hz if at_edge else None,
            "stable_from_n_per_m": edge.from_value if math.isfinite(edge.from_value) else None,
            "viscosity_n_s_per_m": self.viscosity_n_s_per_m,
            "least_damping_n_m_s": self.least_damping_n_m_s,
            "needed_n_s_per_m": self.needed_n_s_per_m,
            "passive_n_per_m": self.passive_n_per_m,
            "gil_hulin_n_per_m": self.gil_hulin_n_per_m,
            "board_n_per_m": self.board_n_per_m,
            "design_for_n_per_m": design if math.isfinite(design) else None,
            "design_for": which,
            "left_out": list(self.stability.notes),
        }


def varied(scene: Scene) -> str:
    """Return the key of the stiffness that limits are about."""
    analog = scene.computer.method in (Method.CONTINUOUS, Method.JOINT_PD)
    return "analog_stiffness_n_per_m" if analog else "discrete_stiffness_n_per_m"


def limits(contact: HeldContact) -> Limits:
    """Return the limits of a contact that is held at a wall just touched.

    Raises
    ------
    InputError
        For a scene with a law or an operator in Python.
    """
    scene = contact.scene
    c, key = scene.computer, varied(scene)

    def at(value: float) -> Lifted:
        return held(contact.with_computer(**{key: value}))

    edge = border(at, *RANGE, rtol=1e-9)
    device = device_of(contact)
    least, _ = least_damping(device)
    viscosity = device.viscosity(_SLOW)
    law = law_of(scene)
    passive = None
    if key == "discrete_stiffness_n_per_m" and least > 0.0:
        passive = _largest_passive(scene, device)
    continuous = c.method is Method.CONTINUOUS
    damping = 0.0 if continuous else c.discrete_damping_n_s_per_m
    late = _delay(scene)
    ranged = key == "analog_stiffness_n_per_m" and not c.joint_stiffness_n_m_per_rad
    return Limits(
        key=key,
        stiffness=float(getattr(c, key)),
        stability=stability(held(contact)),
        border=edge,
        viscosity_n_s_per_m=viscosity,
        least_damping_n_m_s=least,
        needed_n_s_per_m=None if law.lag_s else needed_damping(law).value,
        passive_n_per_m=passive,
        gil_hulin_n_per_m=gil_hulin(viscosity, c.period_s, damping, late)
        if key == "discrete_stiffness_n_per_m"
        else None,
        board_n_per_m=board_range(scene, contact.constants, contact.q)[0] if ranged else None,
    )


def largest_passive(contact: HeldContact) -> float:
    """Return the largest passive stiffness of a contact [N/m], of the part that `varied` names.

    0 where the device is active whatever that stiffness is; infinite for an analog spring that no lag makes
    active within `RANGE`.
    """
    key = varied(contact.scene)

    def left(k: float) -> float:
        """Return the least damping left, beyond what is nothing beside that at rest without a spring."""
        moved = contact if key == "discrete_stiffness_n_per_m" else contact.with_computer(**{key: k})
        device = device_of(moved)
        at_rest = device_of(contact.with_computer(analog_stiffness_n_per_m=0.0))
        nothing = _NOTHING * float(np.linalg.norm(at_rest.damping(np.array([1.0]))))
        return least_damping(device, lowest=1.0)[0] + nothing

    low, high = RANGE
    if left(low) <= 0.0:
        return 0.0
    if key == "discrete_stiffness_n_per_m":
        return _largest_passive(contact.scene, device_of(contact))
    if left(high) > 0.0:
        return math.inf
    return math.exp(
        scipy.optimize.brentq(lambda x: left(math.exp(x)), math.log(low), math.log(high), rtol=1e-12)
    )


def _delay(scene: Scene) -> float:
    law = law_of(scene)
    c = scene.computer
    delay = (c.delay_periods + c.delay_fraction) * c.period_s if scene.effects.delay else 0.0
    return max(delay, law.lag_s)


def _largest_passive(scene: Scene, device: Device) -> float:
    """Return the largest passive discrete stiffness [N/m], the discrete damping as it is."""

    def used(k: float) -> float:
        return share_used(law_of(with_computer(scene, discrete_stiffness_n_per_m=k)), device).value

    if scene.computer.discrete_damping_n_s_per_m == 0.0 or scene.computer.method is Method.CONTINUOUS:
        return 1.0 / used(1.0)
    if used(1e-6) >= 1.0:
        return 0.0
    high = 1.0
    while used(high) < 1.0:
        high *= 4.0
    return float(scipy.optimize.brentq(lambda k: used(k) - 1.0, 1e-6, high, rtol=1e-6))


def locus(contact: HeldContact, values: Array) -> list[NDArray[np.complex128]]:
    """Return the eigenvalues above 1e-6 of the map of a period for each stiffness of `values` [N/m]."""
    key = varied(contact.scene)
    out = []
    for value in values:
        z = np.linalg.eigvals(monodromy(held(contact.with_computer(**{key: float(value)}))))
        out.append(z[np.abs(z) > 1e-6].astype(complex))
    return out
