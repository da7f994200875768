"""Effects of the mechanism."""

from __future__ import annotations

import math

from cosim.circuits.port import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import Scene
from cosim.scene.schema import Chain, Slider


def _table(scene: Scene) -> Chain | Slider:
    table = scene.device.chain or scene.device.slider
    assert table is not None  # the scene's checks hold this
    return table


def _largest(value: float | tuple[float, ...]) -> float:
    return max(value) if isinstance(value, tuple) else value


def _gravity(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    pull = math.hypot(*_table(scene).gravity_m_per_s2)
    weight = (at.device_kg + at.person_kg) * pull
    return Size(weight, "N", weight, "of weight", "m g, all of it at the tip")


def _coriolis(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    force = at.mass_kg * at.speed_m_per_s**2 / at.reach_m
    return Size(force, "N", force, "of velocity products", "m v^2 / r")


def _lacks_bends(scene: Scene) -> str:
    return "a slider moves along a straight line" if scene.is_slider else ""


def _viscous(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    b = _largest(_table(scene).viscous_n_m_s) / at.reach_m**2
    return Size(b, "N s/m", b * at.speed_m_per_s, "of bearings at the tip", "b v")


def _lacks_viscous(scene: Scene) -> str:
    return "" if _largest(_table(scene).viscous_n_m_s) > 0.0 else "viscous_n_m_s is zero"


def _coulomb(scene: Scene, constants: Stated) -> Size:
    force = _largest(_table(scene).coulomb_n_m) / scale(scene, constants).reach_m
    return Size(force, "N", force, "of dry friction at the tip", "f_c / r")


def _coulomb_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(10.0, 0, "short steps near rest")


def _lacks_coulomb(scene: Scene) -> str:
    return "" if _largest(_table(scene).coulomb_n_m) > 0.0 else "coulomb_n_m is zero"


#: In the order in which a plan lists them.
LINKAGE = (
    Effect("gravity", False, (True,), "linkage", ALL, size=_gravity),
    Effect("coriolis", False, (True,), "linkage", ALL, size=_coriolis, lacks=_lacks_bends),
    Effect("viscous", False, (True,), "linkage", ALL, size=_viscous, lacks=_lacks_viscous),
    Effect(
        "coulomb", False, (True,), "linkage", ALL,
        size=_coulomb, cost=_coulomb_cost, lacks=_lacks_coulomb,
    ),
)  # fmt: skip
