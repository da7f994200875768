"""From layers of keys to a checked scene, or to an error that tells all that is wrong with them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from cosim.errors import InputError, Problem
from cosim.scene.checks import cross_problems
from cosim.scene.device_checks import Skip
from cosim.scene.explain import clean_key, explain, field_at, is_real
from cosim.scene.layers import Key, Layer, locate, merge

__all__ = ["checked"]

Tables = TypeVar("Tables", bound=BaseModel)


def checked(kind: type[Tables], layers: Sequence[Layer]) -> Tables:
    """Return the scene (of the class `kind`) that the layers state; `InputError` with all that is wrong."""
    data = merge(layers)
    problems: list[Problem] = []
    refused: list[Key] = []
    scene = None
    try:
        scene = kind.model_validate(data)
    except ValidationError as error:
        for entry in filter(is_real, error.errors(include_url=False)):
            refused.append(clean_key(entry))
            problems.append(_placed(explain(entry, data), layers, refused[-1]))
    for problem in cross_problems(_Values(data, refused).get):
        problems.append(_placed(problem, layers, _split(problem.key or "")))
    if problems or scene is None:
        raise InputError(sorted(problems, key=lambda problem: (problem.file or "", problem.line or 0)))
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
