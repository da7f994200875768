"""`Scene`: the whole of a scene file, checked and frozen."""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import PrivateAttr

from cosim.scene.choices import Linkage
from cosim.scene.schema import SceneTables


class Scene(SceneTables):
    """A checked scene; attributes are the tables of the file (see `cosim.scene.schema`)."""

    _file: Path | None = PrivateAttr(default=None)

    @property
    def file(self) -> Path | None:
        """Scene file it was loaded from; ``None`` when it came from stored data."""
        return self._file

    @property
    def joints(self) -> int:
        """Number of joints of the linkage."""
        return len(self.device.chain.lengths_m) if self.device.chain is not None else 1

    @property
    def start_speed_rad_per_s(self) -> tuple[float, ...]:
        """Joint speeds at the start [rad/s]: the stated ones, or zero."""
        return self.device.start.v_rad_per_s or (0.0,) * self.joints

    @property
    def is_slider(self) -> bool:
        """Whether the linkage is the one-joint slider."""
        return self.device.linkage is Linkage.SLIDER

    def as_dict(self) -> dict[str, Any]:
        """Return every key, defaults included, as JSON-ready values; files by absolute path."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """Return the resolved scene as TOML that loads to the same content."""
        return "\n".join(_toml_table(self.as_dict(), ())).lstrip("\n") + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of the scene's content.

        Files enter by their path relative to the scene, so a project keeps its digest when it moves.
        """
        data = self.as_dict()
        if self._file is not None:
            data = _relative(data, self._file.parent)
        canonical = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def code_digest(self) -> str:
        """Return the SHA-256 of the content of the user's own law and operator files.

        What these import from elsewhere is not looked at.
        """
        found = hashlib.sha256()
        own = (name for name in self.measures.names if ":" in name)
        for where in (self.computer.law, getattr(self.operator, "file", None), *own):
            path = Path(str(where).rpartition(":")[0]) if where else None
            found.update(path.read_bytes() if path is not None and os.path.isfile(path) else b"")
            found.update(b"\0")
        return found.hexdigest()


def _relative(value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return {key: _relative(item, folder) for key, item in value.items()}
    if isinstance(value, str) and os.path.isabs(value):
        return Path(os.path.relpath(value, folder)).as_posix()
    return value


def _toml_table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    values = {key: value for key, value in table.items() if not isinstance(value, dict)}
    lines = []
    if path and values:
        lines.append(f"\n[{'.'.join(_toml_key(part) for part in path)}]")
    lines += [f"{_toml_key(key)} = {_toml_value(value)}" for key, value in values.items()]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _toml_table(value, (*path, key))
    return lines


def _toml_key(key: str) -> str:
    bare = key.replace("_", "").replace("-", "")
    return key if bare.isalnum() and bare.isascii() else json.dumps(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        assert math.isfinite(value)
        return repr(value)
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    # JSON's escapes are TOML's too, except for the surrogate pairs of ensure_ascii; DEL is missing.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
