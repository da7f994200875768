"""Pydantic's errors in the words of a scene: key, value, unit, allowed range, nearest match."""

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from cosim.errors import Problem, nearest
from cosim.scene.quantities import Unit
from cosim.scene.schema import Effects, SceneTables
from cosim.scene.table import Table

Key = tuple[str | int, ...]


@dataclass(frozen=True)
class Field:
    """What the schema says about one key."""

    annotation: Any
    metadata: tuple[Any, ...]
    info: FieldInfo | None

    @property
    def unit(self) -> str | None:
        """Unit of the number, or of the numbers in a list."""
        units = {item.text for item in _deep_metadata(self) if isinstance(item, Unit)}
        return units.pop() if len(units) == 1 else None

    @property
    def allowed(self) -> str | None:
        """Allowed choices or range in words."""
        choices = self.choices
        if choices:
            return ", ".join(choices)
        bounds = [item for item in _deep_metadata(self) if isinstance(item, Gt | Ge | Lt | Le)]
        if len(bounds) > 2:  # a row of different quantities has no common range
            return None
        signs = {Gt: (">", "gt"), Ge: (">=", "ge"), Lt: ("<", "lt"), Le: ("<=", "le")}
        texts = [f"{signs[type(b)][0]} {getattr(b, signs[type(b)][1]):g}" for b in bounds]
        return " and ".join(texts) or None

    @property
    def choices(self) -> list[str]:
        """Words or numbers that may stand here; empty when there is no fixed list."""
        if isinstance(self.annotation, type) and issubclass(self.annotation, Enum):
            return [str(member.value) for member in self.annotation]
        if get_origin(self.annotation) is Literal:
            return [str(choice) for choice in get_args(self.annotation)]
        return []

    @property
    def noun(self) -> str:
        """What kind of value is expected, in words."""
        kind = get_origin(self.annotation) or self.annotation
        if kind is Effects:
            return 'a table or the word "auto"'
        if isinstance(kind, type) and issubclass(kind, BaseModel | Mapping):
            return "a table"
        nouns = {
            float: "a number",
            int: "a whole number",
            bool: "true or false",
            str: "text",
            tuple: "a list",
            Path: "the path of a file as text",
        }
        return nouns.get(kind, "text or a table")


def clean_key(error: Mapping[str, Any]) -> Key:
    """Return the place of an error without the tags that pydantic adds for unions."""
    key = [part for part in error["loc"] if not (isinstance(part, str) and part.startswith("<"))]
    if key[:1] == ["operator"] and key[1:2] and key[1] in ("none", "mass", "hand", "python"):
        del key[1]
    if error["type"].startswith("union_tag"):
        key.append("type")
    return tuple(key)


def is_real(error: Mapping[str, Any]) -> bool:
    """Tell real errors from those that only follow from another one."""
    if error["type"] == "too_short":  # pydantic counts only the items that were accepted
        return not error["input"]
    return bool(error["type"] != "default_factory_not_called")


def dotted(key: Key) -> str:
    """Write a key as ``computer.period_s`` or ``wall.normal[0]``."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")


def explain(
    error: Mapping[str, Any], data: Mapping[str, Any], root: type[BaseModel] = SceneTables
) -> Problem:
    """Turn one of pydantic's errors about `data`, of the kind `root`, into a problem without a file."""
    key, kind = clean_key(error), error["type"]
    if kind == "extra_forbidden":
        return _unknown_key(key, error["input"], data, root)
    path = key if kind != "missing" else key[:-1]
    if kind in ("missing", "too_long", "too_short") and _is_row(path, data, root):
        return _wrong_count(path, data, root)
    field = field_at(key, data, root)
    unit, allowed = (field.unit, field.allowed) if field else (None, None)
    value = None if kind in ("missing", "union_tag_not_found") else _plain(_value_at(key, data))
    message = _message(kind, error, field, value)
    if field is not None and field.choices and kind not in ("missing", "union_tag_not_found"):
        close = nearest(str(value), field.choices)
        message += f'; did you mean "{close}"?' if close else ""
    return Problem(message, key=dotted(key), value=value, unit=unit, allowed=allowed)


def _message(kind: str, error: Mapping[str, Any], field: Field | None, value: object) -> str:
    if kind in ("missing", "union_tag_not_found"):
        return "is required"
    if kind in ("enum", "literal_error", "union_tag_invalid"):
        return "is not one of the choices"
    if kind == "finite_number":
        return "must be a finite number"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return "is out of range"
    if kind in ("string_too_short", "too_short"):
        return "must not be empty"
    if kind == "too_long":
        return f"has more than {error['ctx']['max_length']} values"
    if field is not None and (kind.endswith(("_type", "_from_float", "_instance_of"))):
        written = field.unit and isinstance(value, str)
        return f"must be {field.noun}" + (f": write the bare number, in {field.unit}" if written else "")
    return str(error["msg"])


def _unknown_key(key: Key, value: object, data: Mapping[str, Any], root: type[BaseModel]) -> Problem:
    table = field_at(key[:-1], data, root)
    names = _keys_of(table.annotation, key[:-1], data) if table else []
    close = nearest(str(key[-1]), names)
    if close is None:
        return Problem("unknown key", key=dotted(key), value=_plain(value), allowed=", ".join(names) or None)
    meant = field_at((*key[:-1], close), data, root)
    unit = f" (in {meant.unit})" if meant and meant.unit else ""
    return Problem(f'unknown key; did you mean "{close}"{unit}?', key=dotted(key), value=_plain(value))


def _is_row(key: Key, data: Mapping[str, Any], root: type[BaseModel]) -> bool:
    field = field_at(key, data, root)
    return (
        field is not None and get_origin(field.annotation) is tuple and ... not in get_args(field.annotation)
    )


def _wrong_count(key: Key, data: Mapping[str, Any], root: type[BaseModel]) -> Problem:
    field = field_at(key, data, root)
    assert field is not None
    count, value = len(get_args(field.annotation)), _value_at(key, data)
    return Problem(
        f"has {len(value)} value{'s' if len(value) != 1 else ''} instead of {count}",
        key=dotted(key),
        value=_plain(value),
    )


def field_at(
    key: Sequence[str | int], data: Mapping[str, Any], root: type[BaseModel] = SceneTables
) -> Field | None:
    """Return what the schema `root` says about `key`; `data` decides between the kinds of operator."""
    field = Field(root, (), None)
    for depth, part in enumerate(key):
        reached = _item(field, part) if isinstance(part, int) else _child(field, part, key[:depth], data)
        if reached is None:
            return None
        field = reached
    return field


def _child(field: Field, name: str, key: Sequence[str | int], data: Mapping[str, Any]) -> Field | None:
    origin = get_origin(field.annotation)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return unwrapped(get_args(field.annotation)[1], (), None)
    for model in _models(field.annotation, key, data):
        if name in model.model_fields:
            info = model.model_fields[name]
            return unwrapped(info.annotation, tuple(info.metadata), info)
        if model.model_config.get("extra") == "allow":
            extra = get_type_hints(model, include_extras=True)["__pydantic_extra__"]
            return unwrapped(get_args(extra)[1], (), None)
    return None


def _models(annotation: Any, key: Sequence[str | int], data: Mapping[str, Any]) -> list[type[BaseModel]]:
    kinds = [unwrapped(kind, (), None).annotation for kind in (annotation, *get_args(annotation))]
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    if tuple(key) == ("operator",):
        kind = _value_at(("operator", "type"), data)
        exact = [m for m in models if kind in get_args(m.model_fields["type"].annotation)]
        if exact:
            return exact
        # Without a known type only the type itself can be spoken of, with all choices.
        return [_AnyOperator]
    return models


class _AnyOperator(Table):
    type: Literal["none", "mass", "hand", "python"]


def _keys_of(annotation: Any, key: Key, data: Mapping[str, Any]) -> list[str]:
    names = [name for model in _models(annotation, key, data) for name in model.model_fields]
    return names + (["extends"] if not key and "device" in names else [])


def _item(field: Field, index: int) -> Field | None:
    if get_origin(field.annotation) is not tuple:
        return None
    items = get_args(field.annotation)
    if len(items) == 2 and items[1] is ...:
        return unwrapped(items[0], (), None)
    return unwrapped(items[index], (), None) if index < len(items) else None


def unwrapped(annotation: Any, metadata: tuple[Any, ...], info: FieldInfo | None) -> Field:
    """Take off ``Annotated`` and ``| None``, keeping the metadata."""
    while True:
        origin, args = get_origin(annotation), get_args(annotation)
        if origin is Annotated:
            annotation, metadata = args[0], (*metadata, *args[1:])
        elif origin in (Union, types.UnionType) and types.NoneType in args and len(args) == 2:
            annotation = next(arg for arg in args if arg is not types.NoneType)
        else:
            return Field(annotation, metadata, info)


def _deep_metadata(field: Field) -> Iterator[Any]:
    for item in field.metadata:
        yield from item.metadata if isinstance(item, FieldInfo) else (item,)
    if get_origin(field.annotation) is tuple:
        for kind in dict.fromkeys(get_args(field.annotation)):
            if kind is not ...:
                yield from _deep_metadata(unwrapped(kind, (), None))


def _value_at(key: Sequence[str | int], data: Any) -> Any:
    for part in key:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def _plain(value: object) -> object:
    """Return a value as the user wrote it: lists for tuples, text for paths."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
