"""A draw of components applied to a plan: elements and parts of the board, numbers of the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from cosim.circuits.design_constants import Stated
from cosim.circuits.draws.admittances import nominal_values
from cosim.ngspice.placed_values import board_netlist, split, walk
from cosim.plan import Plan
from cosim.scene import Scene
from cosim.scene.numbers import number_of, with_number
from cosim.types import Array

__all__ = ["SCENE", "motors", "nominal", "of_board", "with_motors", "with_numbers"]

#: How the key of a number of the scene begins.
SCENE = "scene:"
#: Parameter of a motor that its board also states as a design constant.
MOTOR_CONSTANT = "motor_k"
#: Numbers of the linkage that the computer's law uses.
_LENGTHS = ("device.chain.lengths_m", "device.slider.radius_m")


def of_board(keys: Sequence[str]) -> list[int]:
    """Return the places of the keys that are components of the board."""
    return [k for k, key in enumerate(keys) if not key.startswith(SCENE)]


def nominal(plan: Plan, keys: Sequence[str]) -> list[float]:
    """Return the values of components as designed, SI.

    Raises
    ------
    InputError
        For what is no component of the board and no number of the scene.
    """
    places = of_board(keys)
    board = dict(zip(places, nominal_values(plan.board, [keys[k] for k in places]), strict=True))
    scene = plan.scene
    return [
        board[k] if k in board else number_of(scene, key.removeprefix(SCENE)) for k, key in enumerate(keys)
    ]


def motors(plan: Plan, keys: Sequence[str]) -> dict[int, int]:
    """Return the joint, from 0, that each key turns which is a motor's torque constant.

    It turns current into torque as well as speed into back-EMF; only the second is an element of the board.
    """
    columns = {}
    places = {".".join(split(key)[0]): k for k, key in enumerate(keys) if key.endswith(f":{MOTOR_CONSTANT}")}
    board = plan.board
    for path, _block, _instance, nets in walk(board_netlist(board), board.board) if places else ():
        place = places.get(path.removeprefix("xboard."))
        for node in nets.values():
            if place is not None and node.startswith("imot") and node[4:].isdigit():
                columns[place] = int(node[4:]) - 1
    return columns


def with_motors(
    constants: Stated, drawn: Mapping[int, int], values: Sequence[float] | Array, joints: int
) -> Stated:
    """Return constants with the torque constants of the motors as drawn; `drawn` as of `motors`."""
    if not drawn:
        return constants
    each = [constants.motor_k or constants.kt] * joints
    for place, joint in drawn.items():
        each[joint] = float(values[place])
    return replace(constants, motors=tuple(each))


def with_numbers(scene: Scene, keys: Sequence[str], values: Sequence[float]) -> Scene:
    """Return a scene with other numbers; `keys` are ``scene:device.chain.masses_kg[0]``, others are left.

    A computer that is not calibrated goes on with the lengths of the design.
    """
    designed = list(scene.designed)
    for key, value in zip(keys, values, strict=True):
        if key.startswith(SCENE):
            name = key.removeprefix(SCENE)
            if name.startswith(_LENGTHS) and scene.tolerance.calibration == "none":
                designed.append((name, number_of(scene, name)))
            scene = with_number(scene, name, value)
    return scene.knowing(designed) if designed else scene
