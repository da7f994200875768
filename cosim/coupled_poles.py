"""Board and linkage as one system: poles to the right that the steps of a run would hide.

About a pose the linkage is its inertia and friction, M s^2 + B s, and the board a force in terms of angles
and speeds. Zeros of the determinant of their sum in the right half plane are poles of the system. A slow
growth shows in a run; one within a step of the integration may be damped away by it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cosim.caution import Caution
from cosim.circuits.extraction.motor_response import MotorResponse
from cosim.circuits.instability.encirclements import pivots, winding
from cosim.types import Array

__all__ = ["growing", "hidden"]


#: Two fits of different order agree to this; a pole is hidden if it grows within this share of a step.
_AGREE, _HIDDEN = 0.05, 0.5


def growing(
    response: MotorResponse,
    volts: Mapping[str, float],
    mass: Array,
    viscosity: Array,
    torque: Array,
    gear: float,
) -> list[complex]:
    """Return the poles [rad/s] in the right half plane of board and linkage, fastest growing first.

    Parameters
    ----------
    response, volts
        The board's motors, and the gain pins [V].
    mass, viscosity
        [n, n] kg m^2 and N m s/rad at the joints.
    torque, gear
        [n] torque at each joint per ampere of its motor [N m/A]; motor turns per joint turn.
    """
    s = 2j * np.pi * response.hz.astype(complex)
    n = len(mass)
    h = response.at(volts)
    stiff = torque[:, None] * (h[:, :, :n] + gear * s[:, None, None] * h[:, :, n:])
    mechanics = s[:, None, None] ** 2 * mass + s[:, None, None] * viscosity - stiff
    shown = pivots(mechanics)
    if round(-sum(winding(response.hz, shown[:, k]) for k in range(n))) <= 0:
        return []
    from cosim.circuits.fitting.aaa import poles_of  # loads scipy, for what few boards need

    mobility = (s[:, None, None] * np.linalg.inv(mechanics)).reshape(len(s), n * n)
    f = mobility[:, np.abs(mobility).max(axis=0) > 0.0]  # joints may not reach each other
    f /= np.abs(f).max(axis=0)
    first, second = (
        poles[(poles.real > 0.0) & (np.abs(poles) < np.abs(s[-1]))]
        for poles in (poles_of(s, f, 1e-6, True), poles_of(s[::2], f[::2], 1e-10, False))
    )
    sure = [p for p in first.tolist() if second.size and np.abs(second - p).min() <= _AGREE * abs(p)]
    return sorted(sure, key=lambda p: -p.real)


def hidden(poles: list[complex], step_s: float, where: str = "") -> list[Caution]:
    """Say which poles steps of `step_s` may hide; `where` tells the pose."""
    return [
        Caution(
            "coupling-unstable",
            f"board and linkage together{where} have a pole at {p.real:+.4g} +- {abs(p.imag):.4g}j rad/s, "
            f"which steps of {step_s:.3g} s may hide",
            f"shorten solver.max_step_s to {0.1 / abs(p):.2g} s to see it grow, or soften the analog wall",
        )
        for p in poles
        if abs(p) * step_s > _HIDDEN
    ]
