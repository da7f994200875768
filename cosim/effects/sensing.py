"""Effects of the potentiometers and the encoders: what is measured is not what is."""

from __future__ import annotations

from cosim.effects.effect import ALL, Effect
from cosim.scene import Scene


def _pot(scene: Scene) -> str:
    rad = scene.device.potentiometer.noise_rad
    k = scene.computer.analog_stiffness_n_per_m
    return f"{rad * 0.1333 * 1e3:.2g} mm and {rad * 0.1333 * k:.2g} N at a reach of 133 mm"


def _encoder(scene: Scene) -> str:
    encoder = scene.computer.encoder
    step = 6.283185307 / (encoder.pulses_per_rev * encoder.decoding)
    return f"{step * 1e3 / 8:.3g} mrad at the joint with a gear of 8"


#: In the order in which a plan lists them.
SENSING = (
    Effect(
        "pot_noise",
        "none",
        ("white", "peak_to_peak", "static", "position"),
        "potentiometer",
        ALL,
        "one point each 1 / (2 bandwidth)",
        _pot,
    ),
    Effect("encoder", False, (True,), "computer", ALL, "nothing", _encoder),
)
