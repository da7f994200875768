"""`Scene`: the whole of a scene file, checked and frozen."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import PrivateAttr

from cosim.scene.build import checked
from cosim.scene.choices import Linkage
from cosim.scene.layers import Layer, Origin, absolute_paths, override_layers
from cosim.scene.schema import SceneTables
from cosim.toml import toml_key, toml_value
from cosim.variants import Setting


class Scene(SceneTables):
    """A checked scene; attributes are the tables of the file (see `cosim.scene.schema`).

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> from cosim.scene import load_scene
    >>> scene = load_scene(scenes_folder() / 'slope.toml')
    >>> scene.joints, len(scene.digest())
    (2, 64)
    """

    _file: Path | None = PrivateAttr(default=None)
    _origin: Origin = PrivateAttr(default=Origin(()))
    # numbers of the device as designed, by key, where the computer knows these and not the device's own
    _designed: tuple[tuple[str, float], ...] = PrivateAttr(default=())

    @classmethod
    def of_layers(cls, layers: Sequence[Layer], file: Path | None) -> "Scene":
        """Return the scene that the layers state together; `InputError` with every problem of theirs."""
        scene = checked(cls, layers)
        scene._file, scene._origin = file, Origin(tuple(layers))
        return scene

    def with_values(self, values: Mapping[str, Any]) -> "Scene":
        """Return the scene with other values, the same as its file with them would give.

        Parameters
        ----------
        values
            Key of the scene (``computer.period_s``, ``wall.normal``, ``operator``) or name of the netlist
            (``r_sum_spring``, ``R12``, ``xdiff1.r1``) -> value: numbers in SI units, or text as in a netlist
            (``"24k"``); lists and tables as TOML has them.

        Raises
        ------
        InputError
            With every problem found, each naming key, value, unit and allowed range.

        Examples
        --------
        >>> from cosim.scene import load_scene
        >>> from cosim.assets import scenes_folder
        >>> scene = load_scene(scenes_folder() / "press.toml")
        >>> other = scene.with_values({"computer.period_s": 0.005, "r_sum_spring": "24k"})
        >>> other.computer.period_s, dict(other.device.values)
        (0.005, {'r_sum_spring': '24k'})
        >>> other == load_scene(scene.file, ["computer.period_s=0.005", "device.values.r_sum_spring=24k"])
        True
        """
        settings = [Setting.of(name, [value]) for name, value in values.items()]
        return self.changed(setting.override(setting.values[0]) for setting in settings)

    def changed(self, overrides: Iterable[str]) -> "Scene":
        """Return the scene with overrides as `load_scene` takes them."""
        base = self._origin.layers or (Layer("scene", self._stated()),)
        return Scene.of_layers([*base, *override_layers(overrides)], self._file)

    def _stated(self) -> dict[str, Any]:
        """Return the keys that were stated, for a scene whose layers are not known."""
        return absolute_paths(self.model_dump(mode="json", exclude_unset=True, exclude_none=True), Path.cwd())

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> "Scene":
        """Return a copy; with an `update` it is no longer what its layers state."""
        copied = super().model_copy(update=update, deep=deep)
        if update:
            copied._origin = Origin(())
        return copied

    @property
    def file(self) -> Path | None:
        """Scene file it was loaded from; ``None`` when it came from stored data."""
        return self._file

    @property
    def file_name(self) -> str | None:
        """Path of its file as errors tell it; ``None`` where there is none."""
        return str(self._file) if self._file else None

    @property
    def designed(self) -> tuple[tuple[str, float], ...]:
        """Numbers of the linkage, by key, that the computer takes for the device's own."""
        return self._designed

    def knowing(self, designed: Sequence[tuple[str, float]]) -> "Scene":
        """Return the scene with a computer that knows these numbers of the design, not the device's own."""
        scene = self.model_copy()
        scene._designed = tuple(designed)
        return scene

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

    def _code(self) -> tuple[object, ...]:
        own = (name for name in self.measures.names if ":" in name)
        return (self.computer.law, getattr(self.operator, "file", None), *own)

    def code(self) -> set[str]:
        """Return the user's own law, operator and measures, each ``file.py:Class``."""
        return {str(each) for each in self._code() if each}

    def code_digest(self) -> str:
        """Return the SHA-256 of the content of the user's own law and operator files.

        What these import from elsewhere is not looked at.
        """
        digest = hashlib.sha256()
        for where in self._code():
            path = Path(str(where).rpartition(":")[0]) if where else None
            digest.update(path.read_bytes() if path is not None and os.path.isfile(path) else b"")
            digest.update(b"\0")
        return digest.hexdigest()


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
        lines.append(f"\n[{'.'.join(toml_key(part) for part in path)}]")
    lines += [f"{toml_key(key)} = {toml_value(value)}" for key, value in values.items()]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _toml_table(value, (*path, key))
    return lines
