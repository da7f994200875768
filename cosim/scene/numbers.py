"""Numbers of a checked scene by their key, such as ``device.chain.masses_kg[0]``: read, and replaced."""

import re
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from cosim.errors import fail
from cosim.scene.model import Scene

__all__ = ["number_of", "with_number"]

_STEP = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


def number_of(scene: Scene, key: str) -> float:
    """Return a number of a scene.

    Raises
    ------
    InputError
        Where there is none of that key.
    """
    value: Any = scene
    try:
        for step in _steps(key):
            value = value[step] if isinstance(step, int) else getattr(value, step)
    except (AttributeError, IndexError, TypeError):
        value = None
    if isinstance(value, bool) or not isinstance(value, float | int):
        file = scene.file_name
        fail("is not a number of this scene", file=file, key=key)
    return float(value)


def with_number(scene: Scene, key: str, value: float) -> Scene:
    """Return a copy of a scene with another number, which is not checked again."""
    replaced: Scene = _replaced(scene, _steps(key), float(value))
    return replaced


def _steps(key: str) -> list[str | int]:
    return [int(place) if place else name for name, place in _STEP.findall(key)]


def _replaced(value: Any, steps: Sequence[str | int], number: float) -> Any:
    if not steps:
        return number
    first, *rest = steps
    if isinstance(value, BaseModel):
        return value.model_copy(update={str(first): _replaced(getattr(value, str(first)), rest, number)})
    items = list(value)
    items[int(first)] = _replaced(items[int(first)], rest, number)
    return type(value)(items)
