"""How stiff and how damped an analog wall a board's gain DACs can show, and whether a scene asks for more."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cosim.analysis.held_contact import touching
from cosim.caution import Caution
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import InputError
from cosim.scene import Method, Scene
from cosim.scene.mechanism import known_mechanism
from cosim.types import Array

__all__ = ["board_range", "of_asked"]


def board_range(scene: Scene, constants: DesignConstants, q: Array) -> tuple[float, float]:
    """Return the analog stiffness [N/m] and damping [N s/m] that bring a gain DAC to the end of its range.

    Gains are k w w', w the joint torques of a unit force along the wall's normal: the largest is that of the
    largest lever, for joint springs as well.

    Parameters
    ----------
    q
        Pose [rad] of the scene, which has a wall.
    """
    assert scene.wall is not None
    lever = known_mechanism(scene, constants.gear).jacobian(q).T @ np.array(scene.wall.normal)
    most = float(np.abs(lever).max()) ** 2
    if most == 0.0:
        return math.inf, math.inf
    dac = scene.computer.dac.range_v
    share = (dac if dac is not None else constants.dac_v) / constants.v_fs
    return share * constants.k_fs / most, share * constants.c_fs / most


def of_asked(scene: Scene, constants: DesignConstants) -> Iterator[Caution]:
    """Yield where the analog wall that is asked for is beyond the board's range with the tip on its point."""
    computer = scene.computer
    analog = computer.method in (Method.CONTINUOUS, Method.COMBINED) and computer.law is None
    if scene.wall is None or not analog:
        return
    try:
        pose = touching(scene, constants)
    except InputError:
        return  # the wall's point may be out of reach: the tip may meet the wall elsewhere
    shown = board_range(scene, constants, pose)
    for (what, key, asked, unit), most in zip(
        (
            ("stiffness", "stiffness_n_per_m", computer.analog_stiffness_n_per_m, "N/m"),
            ("damping", "damping_n_s_per_m", computer.analog_damping_n_s_per_m, "N s/m"),
        ),
        shown,
        strict=True,
    ):
        if asked > most * (1.0 + 1e-9):
            yield Caution(
                "gain-beyond-full-scale",
                f"an analog {what} of {asked:.4g} {unit} is asked for, the board shows at most {most:.4g} "
                f"{unit} at the wall's point",
                f"lower computer.analog_{key}, or raise the board's gain",
            )
