"""``cosim new``: lay out a folder with a board, its blocks and parts, and scenes to start from."""

import math
import os
import shutil
import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

from cosim.assets import netlists_folder, scenes_folder
from cosim.circuits.boardgen import board_text
from cosim.errors import fail
from cosim.storage.staging import Staging, disk_errors

_MAX_JOINTS = 6
#: What the studies of a folder are to judge, see `cosim.studies.claims`.
CLAIMS = "claims.toml"


def new_project(folder: str | os.PathLike[str], joints: int = 2) -> list[Path]:
    """Lay out a project.

    Parameters
    ----------
    folder
        Must not exist, or be empty.
    joints
        Number of joints of the board, 1 to 6.

    Returns
    -------
    list of Path
        The files written, relative to `folder`, sorted.

    Raises
    ------
    InputError
        When the folder is in use or cannot be written, or the number of joints is not possible;
        nothing is left behind then.
    """
    if not 1 <= joints <= _MAX_JOINTS:
        fail("is out of range", key="--joints", value=joints, allowed=f"1 to {_MAX_JOINTS}")
    with Staging(folder) as stage:
        with disk_errors(stage.target):
            _lay_out(stage.path, stage.target.name, joints)
        written = sorted(path.relative_to(stage.path) for path in stage.path.rglob("*") if path.is_file())
        stage.publish()
    return written


def _lay_out(folder: Path, name: str, joints: int) -> None:
    board, scenes = folder / "netlists" / f"board{joints}.cir", folder / "scenes"
    for part in ("blocks", "parts"):
        shutil.copytree(netlists_folder() / part, board.parent / part)
    shutil.copyfile(netlists_folder() / "README.md", board.parent / "README.md")
    board.write_text(board_text(joints), encoding="utf-8")
    for bench in sorted((netlists_folder() / "tb").glob("*.cir")):
        if f"'../{board.name}'" in bench.read_text(encoding="utf-8"):
            (board.parent / "tb").mkdir(exist_ok=True)
            shutil.copyfile(bench, board.parent / "tb" / bench.name)
    scenes.mkdir()
    copied = _scenes_for(board.name)
    for source in copied:
        shutil.copyfile(source, scenes / source.name)
    _copy_studies(scenes, {source.name for source in copied})
    if not copied:
        (scenes / "press.toml").write_text(_press_scene(joints), encoding="utf-8")
    first = min(scenes.glob("*.toml")).name
    text = _README.format(name=name, board=board.name, scene=first)
    if (scenes / "paper").is_dir():
        text += _STUDIES.format(study=min((scenes / "paper").glob("[0-9]*.toml")).name)
    (folder / "README.md").write_text(text, encoding="utf-8")


def _copy_studies(scenes: Path, known: Collection[str]) -> None:
    """Copy the paper's studies of these scenes, and the list of its claims beside them."""
    shipped = scenes_folder() / "paper"
    for source in sorted(shipped.glob("*.toml")):
        about = tomllib.loads(source.read_text("utf-8")).get("scene")
        if about is not None and Path(about).name in known:
            (scenes / "paper").mkdir(exist_ok=True)
            shutil.copyfile(source, scenes / "paper" / source.name)
    if (scenes / "paper").is_dir() and (shipped / CLAIMS).is_file():
        shutil.copyfile(shipped / CLAIMS, scenes / "paper" / CLAIMS)


def _scenes_for(board: str) -> list[Path]:
    """Return the shipped scenes that run on a board of this file name."""
    scenes = {path.name: tomllib.loads(path.read_text("utf-8")) for path in scenes_folder().glob("*.toml")}
    return [scenes_folder() / name for name in sorted(scenes) if _board_of(name, scenes) == board]


def _board_of(name: str, scenes: dict[str, dict[str, Any]]) -> str | None:
    scene = scenes.get(name, {})
    board = scene.get("device", {}).get("board")
    if board is None and "extends" in scene:
        return _board_of(scene["extends"], scenes)
    return Path(board).name if board else None


def _press_scene(joints: int) -> str:
    # The paper's arm of 0.2 m and 0.2 kg, cut into more links; its bend of 1.1 rad is shared by the
    # joints after the first, so that the pose stays far from full stretch.
    length, mass = 0.2 / joints, 0.2 / joints
    pose = [0.6] + [1.1 / (joints - 1)] * (joints - 1)
    angles = [sum(pose[: i + 1]) for i in range(joints)]
    x = sum(length * math.cos(angle) for angle in angles)
    y = sum(length * math.sin(angle) for angle in angles)

    def listed(value: float) -> str:
        return "[" + ", ".join([f"{value:.5g}"] * joints) + "]"

    return _PRESS.format(
        joints=joints,
        lengths=listed(length),
        masses=listed(mass),
        coms=listed(length / 2),
        inertias=listed(mass * length**2 / 12),
        rotors=listed(2e-6),
        viscous=listed(5e-4),
        pose="[" + ", ".join(f"{q:.6g}" for q in pose) + "]",
        x=f"{x:.5f}",
        y=f"{y:.5f}",
        wall_y=f"{y - 0.002:.5f}",
    )


_PRESS = """\
# A hand presses on a wall and holds still: does the wall push back along its normal as commanded?

title = "Static push on a wall, {joints} joints"
duration_s = 2.0
seed = 1

[device]
board = "../netlists/board{joints}.cir"
linkage = "chain"

[device.chain]
# Assumptions to replace by your device's values: uniform rods, 0.2 m and 0.2 kg in all.
lengths_m = {lengths}
masses_kg = {masses}
coms_m = {coms}
inertias_kg_m2 = {inertias}
rotor_inertia_kg_m2 = {rotors}
viscous_n_m_s = {viscous}

[device.start]
q_rad = {pose}  # 2 mm above the wall

[computer]
period_s = 0.025
method = "continuous"
analog_stiffness_n_per_m = 100.0

[wall]
point_m = [{x}, {wall_y}]
normal = [0.0, 1.0]

[operator]
type = "hand"
waypoints_s_m = [[0.0, {x}, {y}], [0.2, {x}, {wall_y}]]
# At 10 mm the hand's own 135 N/m take 1.35 N back: 1 N on 100 N/m is left.
force_s_n = [[0.2, 0.0, 0.0], [0.7, 0.0, -2.35]]

[effects]
opamp = "gbw"
vca = "gbw"
differentiator = "corner"
driver = "voltage"
driver_level = "gbw"
motor = "full"
encoder = true
dac = true
dac_settling = true
coriolis = true
viscous = true
rotor_inertia = true
operator_dynamics = true

[solver]
model = "spice"  # the circuit as built; "auto" takes the cheapest model that carries the effects
"""

_README = """\
# {name}

| folder | what it holds |
|---|---|
| `netlists/{board}` | the board; its pins are the interface, its `.csparam`s are what the computer believes |
| `netlists/README.md` | the board for who edits it: signals, pins, design values and their reasons |
| `netlists/blocks/` | amplifiers, multiplier, driver: component values are named `.param` lines to edit |
| `netlists/parts/` | op-amps, multiplier, motor, potentiometer, each in levels `ideal`, `gbw`, `full` |
| `scenes/` | what is simulated: device, computer, wall, operator, effects |

Run a scene and write its report:

    cosim run scenes/{scene} -o out/first
    cosim report out/first

Edit a value in `netlists/blocks/` and run again, or try values without editing:

    cosim run scenes/{scene} -o out/tried --set r_diff_in=9k,10k,11k
"""

_STUDIES = """
The paper's studies on your board (minutes each), one page for all, or one study with a changed resistor:

    cosim report scenes/paper/ -o out/paper
    cosim report scenes/paper/{study} -o out/changed --set r_sum_spring=24k
"""
