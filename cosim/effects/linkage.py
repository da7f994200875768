"""Effects of the mechanism."""

from __future__ import annotations

from cosim.effects.effect import ALL, Effect
from cosim.scene import Scene


def _gravity(scene: Scene) -> str:
    device = scene.device
    mass = sum(device.chain.masses_kg) if device.chain else device.slider.mass_kg if device.slider else 0.0
    return f"{mass * 9.81:.2g} N of weight"


def _coriolis(scene: Scene) -> str:
    return "m l v²/r², a few mN at 0.1 m/s"


def _viscous(scene: Scene) -> str:
    return "bearings only, as stated in viscous_n_m_s"


def _coulomb(scene: Scene) -> str:
    device = scene.device
    torque = (
        max(device.chain.coulomb_n_m) if device.chain else device.slider.coulomb_n_m if device.slider else 0.0
    )
    return f"{torque / 0.1333:.2g} N at a reach of 133 mm"


#: In the order in which a plan lists them.
LINKAGE = (
    Effect("gravity", False, (True,), "linkage", ALL, "nothing", _gravity),
    Effect("coriolis", False, (True,), "linkage", ALL, "nothing", _coriolis),
    Effect("viscous", False, (True,), "linkage", ALL, "nothing", _viscous),
    Effect("coulomb", False, (True,), "linkage", ALL, "short steps near rest", _coulomb),
)
