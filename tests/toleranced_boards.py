"""The shipped netlists with some lines written otherwise, and what varies on them."""

import shutil
from pathlib import Path

import numpy as np
from support import ROOT, SCENES

from cosim.ngspice.deck import load_deck
from cosim.scene import load_scene
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.scene_variables import tolerances
from cosim.tolerance.unit_cube import sampling

PRESS = SCENES / "press.toml"
DIFFAMP, SUMMER = "blocks/diffamp.cir", "blocks/summer.cir"


def board(folder: Path, *edits: tuple[str, str, str]) -> Path:
    """The shipped netlists with some lines written otherwise."""
    there = folder / "netlists"
    shutil.copytree(ROOT / "netlists", there)
    for name, old, new in edits:
        file = there / name
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))
    return there / "board2.cir"


def read(folder: Path, *edits: tuple[str, str, str], overrides: tuple[str, ...] = ()) -> Tolerances:
    scene = load_scene(PRESS, [f"device.board={board(folder, *edits)}", *overrides])
    return tolerances(scene, board=load_deck(scene.device.board, overrides=scene.device.values))


def values(drawn_tolerances: Tolerances, n: int = 4000) -> dict[str, np.ndarray]:
    drawn = drawn_tolerances.values(sampling("plain", n, len(drawn_tolerances.variables), 1).uniforms(0, n))
    return dict(zip(drawn_tolerances.keys, drawn.T, strict=True))
