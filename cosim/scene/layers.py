"""Where the keys of a scene come from: files, the file they extend, and overrides.

Layers are merged into one dictionary; each keeps what it stated, so that a problem names the file
and the line to be mended.
"""

import json
import os
import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.errors import InputError, Problem, fail
from cosim.scene.schema import CHOICES
from cosim.storage.bounded_read import read_regular

Key = tuple[str | int, ...]


MOST_BYTES = 4 << 20
"""Size of a scene file; one with the most waypoints that are allowed has 20 kB."""


@dataclass(frozen=True)
class Layer:
    """What one file, or one override, states."""

    name: str
    data: dict[str, Any]
    text: str = field(repr=False, default="")


@dataclass(frozen=True, eq=False)
class Origin:
    """The layers that a scene was made of; where a scene comes from is no part of what it says."""

    layers: tuple[Layer, ...]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin)

    def __hash__(self) -> int:
        return hash(Origin)


def read_layer(path: Path) -> Layer:
    """Read one TOML file with its own paths made absolute."""
    try:
        text = read_regular(path, MOST_BYTES).decode("utf-8-sig")  # editors of Windows begin with a mark
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        fail("no such scene file", file=str(path))
    except UnicodeDecodeError as error:
        fail(f"is not UTF-8 text (byte {error.start})", file=str(path))
    except OSError as error:
        fail(f"cannot be read: {error.strerror}", file=str(path))
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        line = re.search(r"at line (\d+)", message)
        fail(f"TOML syntax: {message}", file=str(path), line=int(line[1]) if line else len(text.splitlines()))
    return Layer(str(path), absolute_paths(data, path.parent), text)


def read_layers(path: Path) -> list[Layer]:
    """Return the layers of a scene file, the weakest first: the file it extends, then itself."""
    layer = read_layer(path)
    parent = layer.data.pop("extends", None)
    if parent is None:
        return [layer]
    line = line_of(layer.text, ("extends",))
    if not isinstance(parent, str):
        fail("must be the path of a scene file", file=layer.name, key="extends", value=parent, line=line)
    base_path = Path(os.path.abspath(path.parent / parent))
    if not os.path.isfile(base_path):
        fail("no such scene file", file=layer.name, key="extends", value=parent, line=line)
    base = read_layer(base_path)
    if "extends" in base.data:
        fail(
            "an extended scene may not extend another one: only one step is allowed",
            file=base.name,
            key="extends",
            value=base.data["extends"],
            line=line_of(base.text, ("extends",)),
        )
    return [base, layer]


def override_layers(overrides: Iterable[str]) -> list[Layer]:
    """Parse overrides ``a.b=value``: TOML values, bare words as text, paths from the current folder."""
    layers, problems = [], []
    for text in overrides:
        key, separator, value = text.partition("=")
        data = _parse_override(key.strip(), value.strip()) if separator else None
        if data is None:
            problems.append(Problem("must look like computer.period_s=0.01", file="override", value=text))
        elif "extends" in data:
            problems.append(Problem("cannot be overridden", file="override", key="extends", value=value))
        else:
            layers.append(Layer("override", absolute_paths(data, Path.cwd())))
    if problems:
        raise InputError(problems)
    return layers


def _parse_override(key: str, value: str) -> dict[str, Any] | None:
    if not key or "\n" in key or "\n" in value:
        return None
    for written in (value, json.dumps(value, ensure_ascii=False)):
        try:
            return tomllib.loads(f"{key} = {written}")
        except tomllib.TOMLDecodeError:
            continue
    return None


def absolute_paths(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return `data` with the files it names made absolute from `folder`, lists made tuples."""
    data = freeze(data)
    if data.get("effects") == "auto":
        data["effects"] = {"auto": True}
    device, operator, computer = (data.get(name) for name in ("device", "operator", "computer"))
    if isinstance(device, dict):
        _set_path(device, "board", folder)
        parts, values = device.get("parts"), device.get("values")
        for part in parts.values() if isinstance(parts, dict) else ():
            if isinstance(part, dict):
                _set_path(part, "file", folder)
        if isinstance(values, dict):
            device["values"] = _flat_values(values)
    tolerance = data.get("tolerance")
    if isinstance(tolerance, dict) and isinstance(tolerance.get("components"), dict):
        tolerance["components"] = _flat_tolerances(tolerance["components"])
    measures = data.get("measures")
    if isinstance(measures, dict) and isinstance(measures.get("names"), tuple):
        measures["names"] = tuple(_own_measure(name, folder) for name in measures["names"])
    for table, name in ((operator, "file"), (computer, "law")):
        if isinstance(table, dict) and isinstance(table.get(name), str):
            table[name] = os.path.abspath(folder / table[name])
    return data


def _own_measure(name: Any, folder: Path) -> Any:
    return os.path.abspath(folder / name) if isinstance(name, str) and ":" in name else name


def _set_path(table: dict[str, Any], name: str, folder: Path) -> None:
    if isinstance(table.get(name), str):
        table[name] = Path(os.path.abspath(folder / table[name]))


def _flat_values(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Join nested keys: ``values.xdiff1.r1 = "10k"`` names an instance. SPICE knows no letter case."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat_values(value, f"{prefix}{name}.")
        else:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            flat[(prefix + name).lower()] = repr(value) if number else value
    return flat


def _flat_tolerances(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Join nested keys as `_flat_values`; a number is a share and stays one."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        inner = _flat_tolerances(value, f"{prefix}{name}.") if isinstance(value, dict) else None
        flat |= {(prefix + name).lower(): value} if inner is None else inner
    return flat


def freeze(value: Any) -> Any:
    """Return a copy of TOML data with tuples for lists."""
    if isinstance(value, dict):
        return {key: freeze(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(freeze(item) for item in value)
    return value


def merge(layers: Sequence[Layer]) -> dict[str, Any]:
    """Merge the layers table by table; later ones win."""
    merged: dict[str, Any] = {}
    for layer in layers:
        merged = _merge(merged, layer.data, ())
    return merged


def _merge(base: dict[str, Any], top: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    # Another type of operator has other keys: the old ones would only be in the way.
    if path == ("operator",) and top.get("type", base.get("type")) != base.get("type"):
        return top
    # What is to be chosen is not what the file below has already stated; what is never chosen is.
    if path == ("effects",) and top.get("auto") is True and base.get("auto") is not True:
        base = {key: value for key, value in base.items() if key in CHOICES}
    # q_rad and tip_m are two ways of saying one thing: the later way replaces the earlier.
    if path == ("device", "start") and {"q_rad", "tip_m"} & top.keys():
        base = {key: value for key, value in base.items() if key not in ("q_rad", "tip_m", "elbow")}
    merged = dict(base)
    for key, value in top.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = _merge(old, value, (*path, key))
        merged[key] = value
    return merged


def locate(layers: Sequence[Layer], key: Key) -> tuple[str, int | None]:
    """Return name and line of the layer that states `key`, or its nearest enclosing table."""
    names = tuple(part for part in key if isinstance(part, str))
    for depth in range(len(names), 0, -1):
        for layer in reversed(layers):
            if _states(layer.data, names[:depth]):
                return layer.name, line_of(layer.text, names[:depth])
    files = [layer for layer in layers if layer.text]
    return (files[-1].name if files else layers[-1].name), None


def _states(data: Any, names: Sequence[str]) -> bool:
    for name in names:
        if not isinstance(data, dict) or name not in data:
            return False
        data = data[name]
    return True


_HEADER = re.compile(r"^\s*\[\s*([^\[\]]+?)\s*\]\s*(#.*)?$")
_ASSIGN = re.compile(r"^\s*([A-Za-z0-9_\-.\"']+(?:\s*\.\s*[A-Za-z0-9_\-\"']+)*)\s*=")


def line_of(text: str, names: Sequence[str]) -> int | None:
    """Return the line that states a key, else the line of its nearest enclosing table or key.

    A plain scan: tomllib keeps no positions. Written in another way than ``[table]`` and
    ``key = value`` a key is simply not found, and only the file is named.
    """
    wanted, best, depth = tuple(names), None, 0
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = here = _split_key(header[1])
        elif assign := _ASSIGN.match(line):
            here = table + _split_key(assign[1])
        else:
            continue
        if len(here) > depth and here == wanted[: len(here)]:
            best, depth = number, len(here)
    return best


def _split_key(text: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in text.split("."))
