"""From a scene file to a checked `Scene`, or to an error that tells all that is wrong with it."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from cosim.errors import InputError, Problem
from cosim.scene.checks import cross_problems
from cosim.scene.device_checks import Skip
from cosim.scene.explain import clean_key, dotted, explain, field_at, is_real
from cosim.scene.layers import Key, Layer, absolute_paths, locate, merge, override_layers, read_layers
from cosim.scene.model import Scene


def load_scene(path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> Scene:
    """Load a scene file.

    Parameters
    ----------
    path
        TOML file; may extend one other file.
    overrides
        ``"computer.period_s=0.01"``: TOML values, bare words as text; they win over the files.

    Raises
    ------
    InputError
        With every problem found, each naming file, key, value, unit and allowed range.
    """
    file = Path(os.path.abspath(path))
    return _build([*read_layers(file), *override_layers(overrides)], file)


def scene_from_dict(data: dict[str, Any]) -> Scene:
    """Rebuild a stored scene (`Scene.as_dict`); the files it names need not exist any more."""
    try:
        return Scene.model_validate(absolute_paths(data, Path.cwd()))
    except ValidationError as error:
        raise InputError([explain(e, data) for e in error.errors(include_url=False)]) from None


def _build(layers: Sequence[Layer], file: Path) -> Scene:
    data = merge(layers)
    problems: list[Problem] = []
    refused: list[Key] = []
    scene = None
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        for entry in filter(is_real, error.errors(include_url=False)):
            refused.append(clean_key(entry))
            problems.append(_placed(explain(entry, data), layers, refused[-1]))
    for problem in cross_problems(_Values(data, refused).get):
        problems.append(_placed(problem, layers, _split(problem.key or "")))
    if problems or scene is None:
        raise InputError(sorted(problems, key=lambda problem: (problem.file or "", problem.line or 0)))
    scene._file = file
    return scene


def _placed(problem: Problem, layers: Sequence[Layer], key: Key) -> Problem:
    file, line = locate(layers, key)
    return replace(problem, file=file, line=line)


def _split(key: str) -> Key:
    return tuple(part.partition("[")[0] for part in key.split("."))


class _Values:
    """Values by dotted key for the cross checks: as written, or the default."""

    def __init__(self, data: dict[str, Any], refused: Sequence[Key]) -> None:
        self._data = data
        self._refused = refused

    def get(self, key: str) -> Any:
        path = tuple(key.split("."))
        if any(self._blocks(refused, path) for refused in self._refused):
            raise Skip
        value: Any = self._data
        for depth, name in enumerate(path):
            if isinstance(value, BaseModel):
                value = getattr(value, name)
            elif isinstance(value, dict) and name in value:
                value = value[name]
            elif isinstance(value, dict):
                value = self._default(path[: depth + 1])
            else:
                raise Skip  # a table that is not there has no keys
        return value

    def _default(self, path: tuple[str, ...]) -> Any:
        field = field_at(path, self._data)
        if field is None or field.info is None or field.info.is_required():
            raise Skip
        return field.info.default if field.info.default_factory is None else None

    @staticmethod
    def _blocks(refused: Key, path: tuple[str, ...]) -> bool:
        if refused[: len(path)] == path:  # at the key itself or inside its value
            return len(refused) == len(path) or isinstance(refused[len(path)], int)
        return path[: len(refused)] == refused


__all__ = ["dotted", "load_scene", "scene_from_dict"]
