"""Converters write one channel after the other: equilibria and commands follow the gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import Scene

__all__ = ["DAC_SKEW", "skew_s"]


def skew_s(scene: Scene) -> float:
    """Return by how much the later channels follow [s]; 0 where the effect is off."""
    return scene.computer.dac.skew_s if scene.effects.dac_skew else 0.0


def _size(scene: Scene, constants: Stated) -> Size:
    at, skew = scale(scene, constants), scene.computer.dac.skew_s
    glitch = at.capped(at.analog_n_per_m * at.speed_m_per_s * (at.period_s + skew))
    return Size(skew, "s", glitch, "of glitch when a contact begins", "k v T: new gain, old equilibrium")


def _cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(1.0 / scene.computer.period_s, 0, "one more jump a sample")


def _lacks(scene: Scene) -> str:
    return "computer.dac.skew_s is zero" if scene.computer.dac.skew_s == 0.0 else ""


def _pack(state: np.void, scene: Scene) -> NDArray[np.float64]:
    state["dac"]["skew"] = skew_s(scene)  # `cosim.loop.events` delays the group of these channels by it
    return np.zeros(0)


DAC_SKEW = Effect(
    "dac_skew", False, (True,), "computer", ALL,
    size=_size, cost=_cost, lacks=_lacks, keys=("computer.dac.skew_s",), pack=_pack,
)  # fmt: skip
