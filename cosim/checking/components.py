"""Noise of the circuit device by device, through the multipliers, in the band of the mechanics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.noise_contributions import ComponentNoise

#: What the mechanics can see, and a scene's default for `device.component_noise_bandwidth_hz` [Hz].
BAND_HZ = (0.1, 1e3)


@dataclass(frozen=True)
class DeviceNoise:
    """What one device adds to the motor that hears most of it, rms over `BAND_HZ`.

    Attributes
    ----------
    rest_a, rest_n : motor current, and force at the reach `r_tip`, with all gains zero
    spring_a, spring_n : the same with each joint's own spring at full scale
    """

    device: str
    rest_a: float
    rest_n: float
    spring_a: float
    spring_n: float


@dataclass(frozen=True)
class ComponentBudget:
    """All devices, the largest first.

    Attributes
    ----------
    rest_n, spring_n : sum over devices at the noisiest motor, in the two states of `DeviceNoise`
    above_n : what lies above the band, up to `top_hz`, in the second state
    notes : what `.noise` or the netlist does not tell
    """

    devices: tuple[DeviceNoise, ...]
    rest_n: float
    spring_n: float
    above_n: float
    top_hz: float
    notes: tuple[str, ...]


NO_BUDGET = ComponentBudget((), 0.0, 0.0, 0.0, 0.0, ())
"""Of a board whose components' noise is not known."""


def component_budget(noise: ComponentNoise, constants: DesignConstants) -> ComponentBudget:
    """Sum a board's noise by device."""
    to_force = constants.kt * constants.gear / constants.r_tip
    rest, full = noise.springs(0.0), noise.springs(1.0)
    still = {share.device: float(share.current_a.max()) for share in noise.budget(rest, BAND_HZ)}
    rows = []
    for share in noise.budget(full, BAND_HZ):
        a, b = still[share.device], float(share.current_a.max())
        rows.append(DeviceNoise(share.device, a, a * to_force, b, b * to_force))
    top = float(noise.hz[-1])
    return ComponentBudget(
        tuple(rows),
        float(np.max(noise.rms(rest, BAND_HZ))) * to_force,
        float(np.max(noise.rms(full, BAND_HZ))) * to_force,
        float(np.max(noise.rms(full, (BAND_HZ[1], top)))) * to_force,
        top,
        noise.notes,
    )
