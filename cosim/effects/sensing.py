"""Effects of the potentiometers and the encoders: errors of measured angles."""

from __future__ import annotations

import math

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import PotNoise, Scene

#: Peak of a normal distribution over its rms that is passed once in some 400 values.
_PEAK = 3.0


def _pot_noise(scene: Scene, constants: Stated) -> Size:
    at, pot = scale(scene, constants), scene.device.potentiometer
    rad = pot.noise_rad if scene.effects.pot_noise is PotNoise.PEAK_TO_PEAK else _PEAK * pot.noise_rad
    rate = 2.0 * math.pi * pot.noise_bandwidth_hz
    force = at.capped((at.analog_n_per_m + at.analog_n_s_per_m * rate) * at.reach_m * rad)
    return Size(pot.noise_rad, "rad", force, "of potentiometer noise", "k r e + c r w e")


def _pot_cost(scene: Scene, constants: Stated) -> Cost:
    if scene.effects.pot_noise in (PotNoise.STATIC, PotNoise.POSITION):
        return Cost(0.0, 0, "a table over the angle")
    ticks = 2.0 * scene.device.potentiometer.noise_bandwidth_hz
    return Cost(ticks, 0, "points at every 1 / (2 bandwidth)")


def _encoder(scene: Scene, constants: Stated) -> Size:
    at, encoder = scale(scene, constants), scene.computer.encoder
    step = 2.0 * math.pi / (encoder.pulses_per_rev * encoder.decoding * constants.gear)
    force = (at.stiffness_n_per_m / 2.0 + at.discrete_n_s_per_m / at.period_s) * at.reach_m * step
    return Size(
        step, "rad", at.capped(force), "a count at the joint", "k r D/2 + B r D/T, Abbott and Okamura 2005"
    )


def _linearity(scene: Scene, constants: Stated) -> Size:
    at, rad = scale(scene, constants), scene.device.potentiometer.linearity_rad
    force = at.capped(at.analog_n_per_m * at.reach_m * rad)
    return Size(rad, "rad", force, "off the straight line", "k r e; data sheet of the potentiometer")


def _calibration(scene: Scene, constants: Stated) -> Size:
    at, pot = scale(scene, constants), scene.device.potentiometer
    far = constants.numbers.get("pot_travel", 2.0 * math.pi) / 2.0
    rad = abs(pot.zero_rad) + abs(pot.gain_error) * far
    force = at.capped(at.analog_n_per_m * at.reach_m * rad)
    return Size(rad, "rad", force, "between potentiometer and encoder at the end of travel", "k r (e0 + g q)")


def _table_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, 0, "a table over the angle; a slider is no more solved exactly")


#: In the order in which a plan lists them.
SENSING = (
    Effect(
        "pot_noise", "none", ("white", "peak_to_peak", "static", "position"), "potentiometer", ALL,
        size=_pot_noise, cost=_pot_cost, not_monolithic="noise",
        keys=(
            "device.potentiometer.noise_rad",
            "device.potentiometer.noise_bandwidth_hz",
            "device.potentiometer.position_period_rad",
        ),
    ),
    Effect(
        "pot_linearity", False, (True,), "potentiometer", ALL, size=_linearity, cost=_table_cost,
        keys=("device.potentiometer.linearity_rad", "device.potentiometer.linearity_period_rad"),
        not_monolithic="errors that belong to the angle",
    ),
    Effect(
        "pot_calibration", False, (True,), "potentiometer", ALL, size=_calibration, cost=_table_cost,
        keys=("device.potentiometer.gain_error", "device.potentiometer.zero_rad"),
        not_monolithic="errors that belong to the angle",
    ),
    Effect(
        "encoder", False, (True,), "computer", ALL, size=_encoder,
        keys=("computer.encoder.pulses_per_rev", "computer.encoder.decoding"),
        not_held="the steps of the encoders",
    ),
)  # fmt: skip
