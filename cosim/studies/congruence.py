"""Footnote 2: the stiffness that the hand finds under a preload, against the one that was commanded.

The computer sets Ksp = J^T K J at the joints. Under a force F on the tip a change of pose changes J^T F as
well, so the tip yields by K_app = J^-T (Ksp - K_g(F)) J^-1, K_g = [dJ^T/dq1 F, dJ^T/dq2 F] (conservative
congruence transformation, Chen and Kao 2000).
With Ksp = J^T K J + K_g(F) the apparent stiffness is the commanded one.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cosim.errors import fail
from cosim.loop.setup import mechanism
from cosim.scene.parameters import Field, Parameters, Unit
from cosim.scene.schema import Stiffness
from cosim.studies.points import Points
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from mech import Chain

Array = NDArray[np.float64]

#: Published discrimination thresholds of stiffness by hand: 8 % at the elbow's best, 23 % for the arm.
NOTICED, NOTICED_SOURCE = 0.23, "Jones and Hunter 1990: 23 % for the arm"
#: Nearer to full stretch or fold than this angle [rad] the Jacobian's inverse says nothing of use.
_MARGIN_RAD = 0.15


class CongruenceParameters(Parameters):
    """``[parameters]`` of footnote 2."""

    preload_n: Annotated[float, Field(gt=0, le=100), Unit("N")] = 1.0
    stiffness_n_per_m: Stiffness = 100.0
    points: int = Field(default=41, ge=5, le=401)


def apparent(chain: Chain, q: Array, stiffness: Array, force: Array, *, compensated: bool) -> Array:
    """Return the stiffness [N/m] that the tip shows, [2, 2], under `force` [N] applied to it.

    `stiffness` is the commanded one in the robot's frame [N/m]; `compensated` adds K_g to the joints' gains.
    """
    jac = chain.jacobian(q)
    geometric = chain.geometric_stiffness(q, force)
    joints = jac.T @ stiffness @ jac
    if compensated:
        joints = joints + geometric
    inverse = np.linalg.inv(jac)
    found: Array = inverse.T @ (joints - geometric) @ inverse
    return found


def pressed(
    chain: Chain, q: Array, stiffness: Array, force: Array, *, compensated: bool, step: float = 1e-4
) -> Array:
    """Return the same by pressing: the pose is solved for forces changed by `step` [N] in each direction.

    The joints' springs are linear in the angles and carry `force` at `q`; nothing is linearised.
    """
    jac = chain.jacobian(q)
    joints: Array = jac.T @ stiffness @ jac
    if compensated:
        joints += chain.geometric_stiffness(q, force)
    torque = jac.T @ force  # what the springs hold at q
    compliance: Array = np.zeros((2, 2), np.float64)
    for axis in range(2):
        ends = []
        for sign in (1.0, -1.0):
            changed = force.copy()
            changed[axis] += sign * step
            at: Array = q.copy()
            for _ in range(50):
                torques = chain.jacobian(at).T @ changed - torque - joints @ (at - q)
                move = np.linalg.solve(joints - chain.geometric_stiffness(at, changed), torques)
                at += move
                if np.abs(move).max() < 1e-15:
                    break
            ends.append(np.asarray(chain.forward(at), np.float64))
        compliance[:, axis] = (ends[0] - ends[1]) / (2 * step)
    stiff: Array = np.asarray(np.linalg.inv(compliance), np.float64)
    return stiff


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Map the apparent stiffness along the wall's normal over the workspace, with and without K_g."""
    scene = spec.scene()
    given: CongruenceParameters = spec.parameters
    # the gear moves no kinematics: any will do
    chain = mechanism(scene, 1.0)
    if not isinstance(chain, Chain) or chain.n != 2:
        fail("footnote 2 needs a chain of two joints", file=str(spec.scene_file), key="device.linkage")
    if scene.wall is None:
        fail("footnote 2 needs a wall, for its normal", file=str(spec.scene_file), key="wall")
    normal = np.array(scene.wall.normal)
    commanded = given.stiffness_n_per_m * np.eye(2)
    force = -given.preload_n * normal  # the hand presses into the wall
    columns: dict[str, list[float]] = {
        "x [m]": [], "y [m]": [], "shift along the normal [%]": [], "shift, worst direction [%]": [],
        "compensated, worst direction [%]": [],
    }  # fmt: skip
    worst_check = 0.0
    for bend in np.linspace(_MARGIN_RAD, np.pi - _MARGIN_RAD, given.points):
        for turn in np.linspace(-np.pi, np.pi, given.points):
            q = np.array([turn, bend])
            plain, held = (apparent(chain, q, commanded, force, compensated=c) for c in (False, True))
            off, rest = (100.0 * (k / given.stiffness_n_per_m - np.eye(2)) for k in (plain, held))
            r = chain.forward(q)
            values = (r[0], r[1], normal @ off @ normal, np.abs(np.linalg.eigvalsh(off)).max(),
                      np.abs(np.linalg.eigvalsh(rest)).max())  # fmt: skip
            for column, value in zip(columns.values(), values, strict=True):
                column.append(float(value))
    # an independent look at a few poses: press, solve the pose, measure how far it went
    rng = np.random.default_rng(0)
    for _ in range(8):
        q = np.array([rng.uniform(-np.pi, np.pi), rng.uniform(0.4, 2.7)])
        for compensated in (False, True):
            difference = apparent(chain, q, commanded, force, compensated=compensated) - pressed(
                chain, q, commanded, force, compensated=compensated
            )
            worst_check = max(worst_check, float(np.abs(difference).max() / given.stiffness_n_per_m))
    worst = np.array(columns["shift, worst direction [%]"])
    left = float(np.max(columns["compensated, worst direction [%]"]))
    noticed = 100.0 * float(np.mean(worst > 100.0 * NOTICED))
    found = (
        f"median {np.median(worst):.3g} %, 95th percentile {np.percentile(worst, 95):.3g} % of "
        f"{given.stiffness_n_per_m:g} N/m at {given.preload_n:g} N; above what a hand notices "
        f"({NOTICED_SOURCE}) in {noticed:.2g} % of the poses"
    )
    shift = "footnote 2: a preload shifts the stiffness at the tip"
    restored = f"at most {left:.1g} %; pressing and solving the pose agrees within {worst_check:.1g}"
    return spec.result(
        Table("workspace", "Apparent against commanded stiffness over the workspace", columns),
        verdicts=(
            Verdict("N3", shift, "K_theta = J^T K J + K_g(F)", found, None),
            Verdict("N3", "adding K_g(F) in the control law restores it", "shift 0", restored,
                    left < 1e-6 and worst_check < 1e-6),
        ),
    )  # fmt: skip


STUDY = Study("congruence", "footnote 2: stiffness under a preload", CongruenceParameters, analyse)
