"""Every key of a scene file, from the schema: unit, range, default, and what it means.

`KEYS` are listed by the path that a scene writes; where the name of a table is the user's own it stands in
angle brackets (``device.parts.<part>.file``).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from cosim.errors import fail, nearest
from cosim.scene.explain import Field, unwrapped
from cosim.scene.meanings import MEANINGS
from cosim.scene.schema import SceneTables

__all__ = ["Key", "keys", "section"]

#: Names of a table that the user chooses, by the path of the table.
_NAMES = {"device.parts": "<part>", "device.values": "<name>", "tolerance": "<measure>",
          "tolerance.components": "<name>", "tolerance.trim": "<name>"}  # fmt: skip


@dataclass(frozen=True)
class Key:
    """One key of a scene.

    Attributes
    ----------
    path : as a scene or ``--set`` writes it
    unit : of the number, or of those in a list; empty for what has none
    allowed : range or choices in words; empty where the type says all
    kind : what is written there, in words
    default : as TOML writes it; ``required`` or ``none``
    meaning : what it is
    """

    path: str
    unit: str
    allowed: str
    kind: str
    default: str
    meaning: str


def keys() -> list[Key]:
    """Return every key, in the order of the schema."""
    return [
        Key("extends", "", "", "the path of a file as text", "none", MEANINGS["extends"]),
        *_walk(SceneTables, ""),
    ]


def section(name: str) -> list[Key]:
    """Return the keys of a table (``computer``, ``device.chain``) or one key; all for an empty name.

    Where there is no such table or key, those that have the word in their name or meaning.

    Raises
    ------
    InputError
        For a name that there is not.

    Examples
    --------
    >>> [key.unit for key in section('computer.period_s')]
    ['s']
    >>> [key.path for key in section('gravity')][-1]
    'effects.gravity'
    """
    every = keys()
    chosen = [key for key in every if not name or key.path == name or key.path.startswith(f"{name}.")]
    words = re.split(r"[\s_]+", name.lower().strip())
    chosen = chosen or [
        key for key in every if all(word in f"{key.path} {key.meaning}".lower() for word in words)
    ]
    if not chosen:
        tables = {key.path.rpartition(".")[0] for key in every} | {k.path.partition(".")[0] for k in every}
        ends = {key.path.rpartition(".")[2].partition("_")[0]: key.path for key in reversed(every)}
        near = nearest(name, [*tables, *(key.path for key in every), *ends])
        near = ends.get(near or "", near)
        fail(
            "no section, key or meaning of a scene has this word" + (f"; nearest is {near}" if near else ""),
            key="WORD",
            value=name,
            allowed=", ".join(sorted(table for table in tables if table)),
        )
    return chosen


def _walk(table: type[BaseModel], path: str) -> Iterator[Key]:
    for name, info in table.model_fields.items():
        here = f"{path}.{name}".lstrip(".")
        field = unwrapped(info.annotation, tuple(info.metadata), info)
        inner = _tables(field)
        origin = get_origin(field.annotation)
        if isinstance(origin, type) and issubclass(origin, Mapping):
            value = unwrapped(get_args(field.annotation)[1], (), None)
            here = f"{here}.{_NAMES[here]}"
            yield _key(here, value, "none")
            for each in _tables(value):
                yield from _walk(each, here)
        elif inner:
            seen: set[str] = set()
            for each in inner:  # the kinds of operator share some of their keys
                for key in _walk(each, here):
                    if key.path not in seen:
                        seen.add(key.path)
                        yield key
        else:
            yield _key(here, field, _default(info))
    if table.model_config.get("extra") == "allow":
        extra = get_args(get_type_hints(table, include_extras=True)["__pydantic_extra__"])[1]
        yield _key(f"{path}.{_NAMES[path]}", unwrapped(extra, (), None), "none")


def _key(path: str, field: Field, default: str) -> Key:
    allowed = field.allowed or ""
    if path == "operator.type":
        allowed = ", ".join(sorted({"none", "mass", "hand", "python"}))
    return Key(
        path,
        field.unit or "",
        allowed,
        field.noun if not field.choices else "a choice",
        default,
        MEANINGS.get(path, ""),
    )


def _tables(field: Field) -> list[type[BaseModel]]:
    """Return the tables that may stand at a field; a union of them for the kinds of one thing."""
    kinds = [unwrapped(kind, (), None).annotation for kind in (field.annotation, *get_args(field.annotation))]
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _default(info: Any) -> str:
    if info.is_required():
        return "required"
    value = info.default
    if value is PydanticUndefined:
        return "0 for each joint"  # the factories fill in a list of zeros
    return _toml(value)


def _toml(value: Any) -> str:
    if value is None or value == ():
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
