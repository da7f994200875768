"""A contact that is held: what every analysis of it starts from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from cosim.analysis.extracted import circuit_of
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError, Problem, fail
from cosim.ngspice.child import Child
from cosim.plan import Plan
from cosim.scene import Scene
from cosim.scene.mechanism import mechanism
from cosim.types import Array
from mech import Chain, Slider

__all__ = ["HeldContact", "touching", "with_computer"]


@dataclass(frozen=True)
class HeldContact:
    """A scene with its board, the tip held in contact with the wall at a pose.

    Attributes
    ----------
    scene
        Has a wall.
    constants, circuit
        What its board states, and the board's linear circuit.
    q
        [n], pose [rad].
    """

    scene: Scene
    constants: DesignConstants
    circuit: LinearCircuit
    q: Array

    @classmethod
    def at_wall(cls, scene: Scene, constants: DesignConstants, circuit: LinearCircuit) -> Self:
        """Return the contact with the tip on the wall's point; errors as of `touching`."""
        return cls(scene, constants, circuit, touching(scene, constants))

    @classmethod
    def of(cls, plan: Plan, *, reduced: bool = False, child: Child | None = None) -> Self:
        """Return a plan's contact at the wall, its circuit as `circuit_of` gives it."""
        circuit, constants = circuit_of(plan, reduced=reduced, child=child)
        return cls.at_wall(plan.scene, constants, circuit)

    @cached_property
    def linkage(self) -> Chain | Slider:
        """The scene's linkage, with the effects that are off left out."""
        return mechanism(self.scene, self.constants.gear)

    @cached_property
    def normal(self) -> Array:
        """Unit vector that points out of the wall; shape (2,)."""
        assert self.scene.wall is not None
        return np.array(self.scene.wall.normal)

    @cached_property
    def torques(self) -> Array:
        """Joint torques of a unit force along the normal, w = J^T n [n] m/rad."""
        out: Array = self.linkage.jacobian(self.q).T @ self.normal
        return out

    def at(self, q: Array) -> Self:
        """Return the same at another pose."""
        return replace(self, q=np.asarray(q, float))

    def of_scene(self, scene: Scene) -> Self:
        """Return the same board and pose in another scene."""
        return replace(self, scene=scene)

    def with_computer(self, **changes: Any) -> Self:
        """Return the same with keys of ``[computer]`` changed."""
        return self.of_scene(with_computer(self.scene, **changes))


def touching(scene: Scene, constants: DesignConstants) -> Array:
    """Return the angles [rad] that put the tip on the wall's point; of one joint, on the wall.

    Raises
    ------
    InputError
        Without a wall, or where it is out of reach.
    """
    file = scene.file_name
    if scene.wall is None:
        fail("there is no contact to be held without a wall", file=file, key="wall")
    linkage = mechanism(scene, constants.gear)
    normal, point = np.array(scene.wall.normal), np.array(scene.wall.point_m)
    if scene.is_slider:
        along = float(normal @ linkage.jacobian(np.zeros(1))[:, 0])
        if along == 0.0:
            fail("the slider moves along the wall and never touches it", file=file, key="wall.normal")
        return np.array([float(normal @ (point - linkage.forward(np.zeros(1)))) / along])
    try:
        return np.asarray(linkage.inverse(point, elbow=scene.device.start.elbow), float)
    except ValueError as error:
        raise InputError(
            Problem(str(error), file=file, key="wall.point_m", value=scene.wall.point_m, unit="m")
        ) from error


def with_computer(scene: Scene, **changes: Any) -> Scene:
    """Return the scene with keys of ``[computer]`` changed."""
    return scene.model_copy(update={"computer": scene.computer.model_copy(update=changes)})
