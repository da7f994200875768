"""Keys stated in vain: those that act only through an effect (`Effect.keys`) that is off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from cosim.effects.effect import Effect
from cosim.scene import Scene

__all__ = ["forgotten", "stated_in_vain"]


def stated_in_vain(scene: Scene, effects: tuple[Effect, ...]) -> list[str]:
    """Say of each key that the scene states, other than by its default, that its effect is off."""
    return [text for _, text in _in_vain(scene, effects)]


def forgotten(scene: Scene, effects: tuple[Effect, ...]) -> list[str]:
    """Say the same of keys whose effect the scene does not mention; one that states "off" means it."""
    mentioned = scene.effects.model_fields_set
    return [text for effect, text in _in_vain(scene, effects) if effect not in mentioned]


def _in_vain(scene: Scene, effects: tuple[Effect, ...]) -> Iterator[tuple[str, str]]:
    """Yield the effect that is off, and the remark on a key that needs it."""
    if scene.effects.auto:
        return  # an effect that is off may still be chosen
    for effect in effects:
        if effect.is_in_force(scene):
            continue
        if effect.name == "operator_dynamics" and scene.operator.type != "hand":
            continue  # a fixed mass is always there
        for key in effect.keys:
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
