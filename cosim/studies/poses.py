"""What a wall's joint gains do over the workspace: drag along the wall (Fig. 18), mismatch, curl.

Frictionless walls have one stiffness, along their normal. Gains at the joints without the cross terms (joint
PD) push along the wall as well, by how much and to which side depends on the pose. Mismatched multipliers do
the same on a smaller scale; they also make Ksp unsymmetric, so that the force field has a curl and feeds
energy to a hand that moves round in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cosim.analysis.extracted import circuit_of
from cosim.analysis.tip import joint_area
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import fail
from cosim.plan import resolve
from cosim.scene.mechanism import mechanism
from cosim.scene.parameters import Field, Parameters, Unit
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array
from mech import Chain

__all__ = ["STUDY", "Drag", "Unevenness", "drag", "rendered", "unevenness"]


#: Nearer to full stretch or fold than this angle [rad] the Jacobian's inverse is of no use.
_MARGIN_RAD = 0.15


class PoseParameters(Parameters):
    """``[parameters]`` of the maps over the workspace."""

    depth_m: Annotated[float, Field(gt=0, le=0.1), Unit("m")] = 7.5e-3
    mismatch: Annotated[float, Field(gt=0, le=0.5)] = 0.01
    circle_m: Annotated[float, Field(gt=0, le=0.1), Unit("m")] = 0.01
    points: int = Field(default=61, ge=5, le=401)
    poses_rad: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Drag:
    """Tangential over normal force at a depth: gains of the tip's pose, of the wall's, and of joint PD."""

    coupled: float
    coupled_at_wall: float
    diagonal: float


@dataclass(frozen=True)
class Unevenness:
    """What mismatched multipliers do; standard deviations over independent gains.

    Attributes
    ----------
    drag : tangential over normal force
    curl_n_per_m : of the field of force
    circle_j : energy fed to a hand that goes once round the circle
    least_n_m_per_rad : smallest eigenvalue of the symmetric part of Ksp, at one standard deviation
    """

    drag: float
    curl_n_per_m: float
    circle_j: float
    least_n_m_per_rad: float


def gains(jac: Array, normal: Array, stiffness: float) -> Array:
    """Return Ksp = J^T k n n^T J of (7) for a wall [N m/rad]."""
    along = jac.T @ normal
    ksp: Array = stiffness * np.outer(along, along)
    return ksp


def drag(chain: Chain, wall_q: Array, normal: Array, stiffness: float, depth: float, elbow: int = 1) -> Drag:
    """Return the drag at `depth` [m] below the place where the tip is at `wall_q` [rad].

    Raises
    ------
    ValueError
        Where the tip does not reach so deep.
    """
    q = np.asarray(chain.inverse(chain.forward(wall_q) - depth * normal, elbow=elbow, seed=wall_q))
    here, there = chain.jacobian(q), chain.jacobian(wall_q)
    tangent = np.array([normal[1], -normal[0]])

    def ratio(ksp: Array) -> float:
        force = np.linalg.solve(here.T, ksp @ (wall_q - q))
        return float((tangent @ force) / (normal @ force))

    ksp = gains(here, normal, stiffness)
    return Drag(ratio(ksp), ratio(gains(there, normal, stiffness)), ratio(np.diag(np.diag(ksp))))


def unevenness(
    chain: Chain, q: Array, normal: Array, stiffness: float, mismatch: float, circle_m: float
) -> Unevenness:
    """Return what independent errors of the multipliers do at a pose [rad], their standard deviation given.

    Everything is linear in the errors, so standard deviations are sums of squares; nothing is drawn.
    """
    jac = chain.jacobian(q)
    inverse = np.linalg.inv(jac)
    ksp = gains(jac, normal, stiffness)
    tangent = np.array([normal[1], -normal[0]])
    # an error e_ij adds e_ij Ksp_ij (J^-T column i) (J^-1 row j) to the stiffness at the tip
    parts = np.einsum("ia,ij,jb->ijab", inverse, ksp, inverse)
    across = np.einsum("a,ijab,b->ij", tangent, parts, normal) / stiffness
    curl = parts[:, :, 0, 1] - parts[:, :, 1, 0]
    area = joint_area(chain, q, circle_m)
    # round a circle at the joints only the antisymmetric part of Ksp does work: twice it times the area
    fed = (ksp[0, 1] * area, ksp[1, 0] * area)
    widest = ksp + mismatch * np.array([[-1.0, 1.0], [-1.0, -1.0]]) * ksp
    return Unevenness(
        mismatch * float(np.sqrt((across**2).sum())),
        mismatch * float(np.sqrt((curl**2).sum())),
        mismatch * float(np.hypot(*fed)),
        float(np.linalg.eigvalsh((widest + widest.T) / 2)[0]),
    )


def rendered(circuit: LinearCircuit, constants: DesignConstants, ksp: Array) -> Array:
    """Return the joints' stiffness [N m/rad] that the board renders at rest when `ksp` is commanded."""
    n = circuit.joints
    control = np.concatenate([ksp.ravel() * constants.v_fs / constants.k_fs, np.zeros(n * n)])
    still = circuit.response([0.0], control)[0].real
    ksp_shown: Array = -constants.torques_per_amp(n)[:, None] * still[:, :n]
    return ksp_shown


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Map drag, mismatch and curl over the workspace, for the scene's wall and analog stiffness."""
    scene, given = spec.scene(), spec.parameters
    chain = mechanism(scene, 1.0)
    if not isinstance(chain, Chain) or chain.n != 2 or scene.wall is None:
        fail(
            "the maps need a chain of two joints and a wall", file=str(spec.scene_file), key="device.linkage"
        )
    normal, stiffness = np.array(scene.wall.normal), scene.computer.analog_stiffness_n_per_m
    if not stiffness > 0.0:
        fail("must be above 0", file=str(spec.scene_file), key="computer.analog_stiffness_n_per_m")
    columns: dict[str, list[float | None]] = {
        name: []
        for name in (
            col.X,
            col.Y,
            col.DRAG_OF_JOINT_PD,
            col.DRAG_OF_MISMATCH,
            col.CURL,
            col.CIRCLE_ENERGY,
            col.LEAST_EIGENVALUE,
        )
    }
    for bend in np.linspace(_MARGIN_RAD, np.pi - _MARGIN_RAD, given.points):
        for turn in np.linspace(-np.pi, np.pi, given.points):
            q = np.array([turn, bend])
            uneven = unevenness(chain, q, normal, stiffness, given.mismatch, 0.0)
            try:
                diagonal: float | None = drag(chain, q, normal, stiffness, given.depth_m).diagonal
            except ValueError:
                diagonal = None
            try:
                fed: float | None = (
                    1e6 * unevenness(chain, q, normal, stiffness, given.mismatch, given.circle_m).circle_j
                )
            except ValueError:
                fed = None
            r = chain.forward(q)
            row = (
                float(r[0]), float(r[1]), diagonal, uneven.drag, uneven.curl_n_per_m, fed,
                1e3 * uneven.least_n_m_per_rad,
            )  # fmt: skip
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    circuit, constants = circuit_of(resolve(spec.scene("solver.model=auto")))
    poses = given.poses_rad or ((0.6, 1.1), (1.0, 1.6))
    at = Table(
        "poses", "At single poses", *_poses(chain, circuit, constants, normal, stiffness, given, poses)
    )
    diagonals = np.array([v for v in columns[col.DRAG_OF_JOINT_PD] if v is not None])
    uneven_drag = np.array(columns[col.DRAG_OF_MISMATCH], float)
    coupled = max(abs(value) for value in at.columns["coupled, F_t/F_n"])
    text = (
        f"joint PD: median {np.median(np.abs(diagonals)):.2g}, to one side in "
        f"{100 * np.mean(diagonals > 0):.0f} % of the poses; coupled {coupled:.1g}"
    )
    percent = 100.0 * given.mismatch
    curls = np.array(columns[col.CURL], float)
    noise = (
        f"force along the wall over its normal {100 * np.median(uneven_drag):.2g} % median, "
        f"{100 * np.percentile(uneven_drag, 95):.2g} % at the 95th percentile; "
        f"curl {np.median(curls):.2g} N/m median"
    )
    return spec.result(
        Table("workspace", "Over the workspace", columns), at,
        verdicts=(
            Verdict("F18", "per-joint PD drags along the wall",
                    "force along the wall over its normal far above that of coupled gains, sign by pose",
                    text, bool(np.median(np.abs(diagonals)) > 10 * coupled)),
            Verdict("N4", f"{percent:g} % of mismatch between the multipliers drags and feeds energy",
                    "a question", noise, None),
        ),
    )  # fmt: skip


def _poses(
    chain: Chain, circuit: LinearCircuit, constants: DesignConstants, normal: Array, stiffness: float,
    given: PoseParameters, poses: tuple[tuple[float, float], ...],
) -> tuple[dict[str, list[float]], str]:  # fmt: skip
    """Return columns for single poses, the last of them with the board's own gains."""
    columns: dict[str, list[float]] = {}
    for pose in poses:
        q = np.array(pose)
        force = drag(chain, q, normal, stiffness, given.depth_m)
        uneven = unevenness(chain, q, normal, stiffness, given.mismatch, given.circle_m)
        inverse = np.linalg.inv(chain.jacobian(q))
        board = (
            inverse.T @ rendered(circuit, constants, gains(chain.jacobian(q), normal, stiffness)) @ inverse
        )
        for name, value in {
            col.Q1: pose[0], col.Q2: pose[1], "coupled, F_t/F_n": force.coupled,
            "coupled at the wall, F_t/F_n": force.coupled_at_wall, col.DRAG_OF_JOINT_PD: force.diagonal,
            col.DRAG_OF_MISMATCH: uneven.drag, col.CURL: uneven.curl_n_per_m,
            "energy round the circle [uJ]": 1e6 * uneven.circle_j,
            "least eigenvalue of sym(Ksp) [mN m/rad]": 1e3 * uneven.least_n_m_per_rad,
            "board: normal stiffness [N/m]": float(normal @ board @ normal),
            "board: curl [N/m]": float(board[0, 1] - board[1, 0]),
        }.items():  # fmt: skip
            columns.setdefault(name, []).append(float(value))
    note = (
        f"{1e3 * given.depth_m:g} mm deep; mismatch of {100 * given.mismatch:g} % standard deviation; "
        f"circle of {1e3 * given.circle_m:g} mm radius."
    )
    return columns, note


STUDY = Study("poses", "drag, mismatch and curl over the workspace", PoseParameters, analyse)
