"""From a scene file to a checked `Scene`, or to an error that tells all that is wrong with it."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from cosim.errors import InputError
from cosim.scene.explain import dotted, explain
from cosim.scene.layers import absolute_paths, override_layers, read_layers
from cosim.scene.model import Scene

#: What stands for a scene: itself, or its file.
SceneLike = str | os.PathLike[str] | Scene


def load_scene(path: SceneLike, overrides: Iterable[str] = ()) -> Scene:
    """Load a scene file.

    Parameters
    ----------
    path
        TOML file, which may extend one other file; or a scene that is there already.
    overrides
        ``"computer.period_s=0.01"``: TOML values, bare words as text; they win over the files.

    Raises
    ------
    InputError
        With every problem found, each naming file, key, value, unit and allowed range.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> scene = load_scene(scenes_folder() / "press.toml", ["computer.period_s=0.005"])
    >>> scene.computer.period_s, scene.joints
    (0.005, 2)
    >>> load_scene(scene, ["seed=3"]).seed
    3
    """
    if isinstance(path, Scene):
        return path.changed(overrides)
    file = Path(os.path.abspath(path))
    return Scene.of_layers([*read_layers(file), *override_layers(overrides)], file)


def scene_from_dict(data: dict[str, Any]) -> Scene:
    """Rebuild a stored scene (`Scene.as_dict`); the files it names need not exist any more."""
    try:
        return Scene.model_validate(absolute_paths(data, Path.cwd()))
    except ValidationError as error:
        raise InputError([explain(e, data) for e in error.errors(include_url=False)]) from None


__all__ = ["SceneLike", "dotted", "load_scene", "scene_from_dict"]
