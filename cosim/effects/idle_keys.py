"""Keys of a scene that act through an effect only, and which of them a scene states in vain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cosim.effects.effect import Effect
from cosim.scene import Scene

__all__ = ["ACTS_THROUGH", "forgotten", "stated_in_vain"]

_JOINTS = ("device.chain", "device.slider")

#: Effect -> keys that it alone uses; of a mechanism, those of both linkages.
ACTS_THROUGH: Mapping[str, tuple[str, ...]] = {
    "delay": ("computer.delay_periods", "computer.delay_fraction"),
    "period_jitter": ("computer.jitter_share",),
    "encoder": ("computer.encoder.pulses_per_rev", "computer.encoder.decoding"),
    "dac": ("computer.dac.bits", "computer.dac.range_v"),
    "dac_settling": ("computer.dac.settling_s",),
    "dac_skew": ("computer.dac.skew_s",),
    "pot_noise": (
        "device.potentiometer.noise_rad",
        "device.potentiometer.noise_bandwidth_hz",
        "device.potentiometer.position_period_rad",
    ),
    "pot_linearity": ("device.potentiometer.linearity_rad", "device.potentiometer.linearity_period_rad"),
    "pot_calibration": ("device.potentiometer.gain_error", "device.potentiometer.zero_rad"),
    "component_noise": ("device.component_noise_bandwidth_hz",),
    "temperature": ("device.temperature_c",),
    "operator_dynamics": ("operator.mass_kg", "operator.damping_n_s_per_m"),
    **{
        effect: tuple(f"{joint}.{key}" for joint in _JOINTS for key in keys)
        for effect, keys in {
            "gravity": ("gravity_m_per_s2",),
            "viscous": ("viscous_n_m_s",),
            "coulomb": ("coulomb_n_m", "coulomb_speed_rad_per_s"),
            "rotor_inertia": ("rotor_inertia_kg_m2",),
            "end_stops": (
                "stops_rad",
                "stop_stiffness_n_m_per_rad",
                "stop_damping_n_m_s",
                "stop_restitution",
            ),
            "shaft": ("shaft_stiffness_n_m_per_rad", "shaft_damping_n_m_s"),
            "backlash": ("backlash_rad",),
        }.items()
    },
}


def stated_in_vain(scene: Scene, effects: tuple[Effect, ...]) -> list[str]:
    """Say of each key that the scene states, other than by its default, that its effect is off."""
    return [said for _, said in _in_vain(scene, effects)]


def forgotten(scene: Scene, effects: tuple[Effect, ...]) -> list[str]:
    """Say the same of the keys whose effect the scene does not mention: one that says "off" knows it."""
    mentioned = scene.effects.model_fields_set
    return [said for effect, said in _in_vain(scene, effects) if effect not in mentioned]


def _in_vain(scene: Scene, effects: tuple[Effect, ...]) -> Iterator[tuple[str, str]]:
    """Yield the effect that is off, and what to say of a key that needs it."""
    if scene.effects.auto:
        return  # what is off now may be chosen
    for effect in effects:
        if effect.is_in_force(scene):
            continue
        if effect.name == "operator_dynamics" and scene.operator.type != "hand":
            continue  # a fixed mass is always there
        for key in ACTS_THROUGH.get(effect.name, ()):
            value = _stated(scene, key)
            if value is not None:
                yield effect.name, f"{key} = {_shown(value)} has no effect: effects.{effect.name} is off"


def _stated(scene: Scene, key: str) -> Any:
    """Return the value that the scene states for `key`; ``None`` where it states none, or the default."""
    table: Any = scene
    *path, name = key.split(".")
    for part in path:
        table = getattr(table, part, None)
    if table is None or name not in getattr(table, "model_fields_set", ()):
        return None
    value = getattr(table, name)
    field = type(table).model_fields[name]
    if not field.is_required() and value == field.get_default(
        call_default_factory=True, validated_data={k: getattr(table, k) for k in type(table).model_fields}
    ):
        return None
    return value


def _shown(value: Any) -> str:
    return str(list(value) if isinstance(value, tuple) else value)
