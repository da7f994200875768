"""A draw of components put into a plan: elements and parts of the board, numbers of the scene."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.circuits.draws.admittances import nominal_values
from cosim.errors import InputError, Problem
from cosim.plan import Plan
from cosim.scene import Scene
from cosim.scene.numbers import number_of, with_number

__all__ = ["SCENE", "motor_constant", "nominal", "of_board", "with_numbers"]

#: How the key of a number of the scene begins.
SCENE = "scene:"
#: Parameter of a motor that its board states as a design number as well.
MOTOR_CONSTANT = "motor_k"
#: Numbers of the linkage that the computer's law is written in.
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


def motor_constant(plan: Plan, keys: Sequence[str]) -> int | None:
    """Return the place of the motor's own torque constant, which turns current into torque as well.

    Raises
    ------
    InputError
        Where it is one of several motors: all joints of a device share one constant.
    """
    found = [k for k, key in enumerate(keys) if key.endswith(f":{MOTOR_CONSTANT}")]
    if found and plan.scene.joints > 1:
        raise InputError(
            Problem("the torque constants of single motors vary on devices of one joint only", key=keys[k])
            for k in found
        )
    return found[0] if found else None


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
