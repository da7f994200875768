"""The mechanics linearised about a pose, for the verdict on stability.

A few small matrices, but the compiled code behind them takes longer to load than all else that a run does
beside its simulation: those of the start are kept by content, those of other poses come from the child.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.circuits.cache import load_arrays, store_arrays
from cosim.circuits.design_constants import DesignConstants
from cosim.ngspice.child import Child, call
from cosim.scene import Method, PythonOperator, Scene
from cosim.scene.mechanism import mechanism, operator, start
from cosim.types import Array
from mech.library_files import ready
from mech.library_files import stamp as code_stamp

__all__ = ["Pose", "at_poses", "at_start"]


_VERSION = 1


@dataclass(frozen=True)
class Pose:
    """What the mechanics are about a pose.

    Attributes
    ----------
    q : [n] angles of the joints [rad]
    mass : [n, n] inertia at the joints, operator included [kg m^2]
    viscosity : [n, n] friction at the joints [N m s/rad]
    along : [n, n] J^T N N^T J of the wall's normal N: what a stiffness along it is at the joints [m^2/rad^2];
        zero without a wall
    """

    q: Array
    mass: Array
    viscosity: Array
    along: Array

    def gain_volts(self, scene: Scene, constants: DesignConstants) -> dict[str, float]:
        """Return the voltages [V] at the gain pins in contact."""
        c = scene.computer
        if c.method is Method.DISCRETE or c.law is not None:
            return {}
        n = len(self.along)
        spring, damper = (
            gain * self.along for gain in (c.analog_stiffness_n_per_m, c.analog_damping_n_s_per_m)
        )
        if c.method is Method.JOINT_PD:
            spring, damper = spring * np.eye(n), damper * np.eye(n)
            if c.joint_stiffness_n_m_per_rad:
                spring = np.diag(c.joint_stiffness_n_m_per_rad)
        volts: dict[str, float] = {}
        for kind, gain, scale in (("ksp", spring, constants.k_fs), ("ksd", damper, constants.c_fs)):
            wanted = np.clip(gain * constants.v_fs / scale, -constants.v_fs, constants.v_fs)
            volts |= {f"{kind}{i + 1}{j + 1}": float(wanted[i, j]) for i in range(n) for j in range(n)}
        return volts


def at_start(scene: Scene, gear: float) -> Pose:
    """Return the mechanics about the start, from the cache or computed.

    Raises
    ------
    InputError
        When the tip cannot reach its start.
    """
    name = _name(scene, gear)
    stored, n = load_arrays(name), scene.joints
    shapes = {"q": (n,), "mass": (n, n), "viscosity": (n, n), "along": (n, n)}
    if stored is not None and all(
        key in stored[1] and stored[1][key].shape == shape for key, shape in shapes.items()
    ):
        return Pose(*(stored[1][key] for key in shapes))
    pose = _about(scene, gear, np.asarray(start(scene, mechanism(scene, gear))[0]))
    store_arrays(name, {}, vars(pose))
    return pose


def at_poses(scene: Scene, gear: float, poses: Sequence[Array], child: Child | None) -> list[Pose]:
    """Return the mechanics about `poses` ([n] rad each), from the child, which has the compiled code."""
    asked = {"scene": scene, "gear": gear, "poses": list(poses)}
    limit = scene.solver.time_limit_s
    ready()
    computed_poses: list[Pose] = call("cosim.pose_matrices:computed", asked, time_limit_s=limit, child=child)
    return computed_poses


def computed(payload: dict[str, Any], report: object) -> list[Pose]:
    """Return the mechanics about 'poses' [n] rad of a 'scene' with a 'gear' (in the child)."""
    return [_about(payload["scene"], payload["gear"], q) for q in payload["poses"]]


def _name(scene: Scene, gear: float) -> str:
    """Return the digest of the mechanics' code and of every table that it depends on."""
    tables = (scene.device, scene.wall, scene.operator, scene.effects)
    parts = [f"{_VERSION}", code_stamp("mech"), f"{gear!r}", *(repr(table) for table in tables)]
    return "start-" + hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _about(scene: Scene, gear: float, q: Array) -> Pose:
    linkage = mechanism(scene, gear)
    # a user's operator is loaded where it runs; without its mass the device is lighter, and faster to grow
    person = None if isinstance(scene.operator, PythonOperator) else operator(scene)
    along = np.zeros((scene.joints, scene.joints))
    if scene.wall is not None:
        w = linkage.jacobian(q).T @ np.array(scene.wall.normal)
        along = np.outer(w, w)
    viscosity = np.diag(linkage.pack()[0]["viscous"][: scene.joints])
    return Pose(q, linkage.mass_matrix(q, person), viscosity, along)
