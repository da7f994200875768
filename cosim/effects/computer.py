"""Effects of the computer: converters and time."""

from __future__ import annotations

from cosim.effects.effect import ALL, Effect
from cosim.scene import Scene


def _dac(scene: Scene) -> str:
    return "1.45 mrad a step of u at 12 bits and ±10 V; settling and skew as stated"


def _delay(scene: Scene) -> str:
    lag = (scene.computer.delay_periods + scene.computer.delay_fraction) * scene.computer.period_s
    return f"{lag * 1e3:.3g} ms: passivity needs K t_d more damping (Colgate and Schenkel, with delay)"


#: In the order in which a plan lists them.
COMPUTER = (
    Effect("dac", False, (True,), "computer", ALL, "one point a sample when settling", _dac),
    Effect("delay", False, (True,), "computer", ALL, "one restart a sample when fractional", _delay),
)
