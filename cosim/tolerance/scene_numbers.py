"""Numbers of the mechanics that can vary from device to device."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from cosim.scene import Scene

__all__ = ["Mechanical", "numbers"]

#: Keys below ``device.chain`` or ``device.slider`` -> class in the scene's ``[tolerance]``, unit, effect.
_KEYS = {
    "lengths_m": ("link_length", "m", ""),
    "radius_m": ("link_length", "m", ""),
    "masses_kg": ("mass", "kg", ""),
    "mass_kg": ("mass", "kg", ""),
    "viscous_n_m_s": ("friction", "N m s/rad", "viscous"),
    "coulomb_n_m": ("friction", "N m", "coulomb"),
    "coms_m": ("", "m", ""),
    "inertias_kg_m2": ("", "kg m^2", ""),
    "rotor_inertia_kg_m2": ("", "kg m^2", "rotor_inertia"),
    "shaft_stiffness_n_m_per_rad": ("", "N m/rad", "shaft"),
    "backlash_rad": ("", "rad", "backlash"),
}


@dataclass(frozen=True)
class Mechanical:
    """A number of the scene: its key, class ('' for none), value and unit."""

    path: str
    kind: str
    value: float
    unit: str


def numbers(scene: Scene) -> Iterator[Mechanical]:
    """Yield what can vary and matters: other than 0, and of an effect in force."""
    kind = scene.device.linkage.value
    table = getattr(scene.device, kind)
    for key, (name, unit, effect) in _KEYS.items():
        held = getattr(table, key, None)
        if held is None or (effect and not getattr(scene.effects, effect)):
            continue
        several = isinstance(held, tuple)
        for place, value in enumerate(held if several else (held,)):
            if value != 0.0:
                yield Mechanical(
                    f"device.{kind}.{key}" + (f"[{place}]" if several else ""), name, value, unit
                )
    if scene.effects.pot_linearity:
        value = scene.device.potentiometer.linearity_rad
        yield Mechanical("device.potentiometer.linearity_rad", "pot_linearity", value, "rad")
