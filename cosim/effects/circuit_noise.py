"""Noise of the components: resistors, amplifiers and multipliers."""

from __future__ import annotations

import math

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import Scene
from cosim.units import quantity

#: Peak of a normal distribution over its rms that is passed once in some 400 values.
_PEAK = 3.0
#: Density at the multiplier's output [V/sqrt(Hz)] where its part states none: AD633 data sheet.
_AD633 = 0.8e-6
#: A damper's product weighs so much more than a spring's: r_sum_spring / r_sum_damper as shipped.
_DAMPER = 4.0


def _size(scene: Scene, constants: Stated) -> Size:
    """Of the multipliers' outputs: n springs and n dampers on every motor, at any gain; all else is below."""
    at, band = scale(scene, constants), scene.device.component_noise_bandwidth_hz
    density = max(constants.of("vca", "en"), default=_AD633)
    volts = density * math.sqrt(band * scene.joints * (1.0 + _DAMPER**2))
    force = volts / constants.w_rated * constants.i_rated * constants.kt * constants.gear / at.reach_m
    return Size(
        force, "N", at.capped(_PEAK * force),
        f"rms of the multipliers' noise up to {quantity(band, 'Hz', 4)}",
        "e_n sqrt(B n (1 + 4^2)) i_rated kt gear/(w_rated r)",
    )  # fmt: skip


def _cost(scene: Scene, constants: Stated) -> Cost:
    ticks = 2.0 * scene.device.component_noise_bandwidth_hz
    return Cost(ticks, 0, "points at every 1 / (2 bandwidth)")


#: In the order in which a plan lists them.
NOISE = (
    Effect(
        "component_noise", False, (True,), "netlist", ALL, size=_size, cost=_cost,
        keys=("device.component_noise_bandwidth_hz",),
    ),
)  # fmt: skip
