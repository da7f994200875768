"""Whether the arm renders what is commanded: the paper's (1) to (13) as checks, from the netlist.

* (1): the Jacobian against differences of the tip's place.
* (2) to (5): the gains that ngspice finds on the board against those that the control law asks for, springs
  and equilibria at rest, dampers as H(jw)/(jw) for w -> 0. The first level is judged, others are compared.
* (7) to (11): the static force at a depth, law and board together. r - r_d = J (q - q_d) of (11) is exact to
  first order only, which the depth and the pose decide.
* (12), (13): the slope of force over depth between two pushes, of computer and circuit apart and together.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from cosim.analysis.control_law import law_point, rests
from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact
from cosim.errors import fail
from cosim.measures import time_mean, wall_frame
from cosim.ngspice.child import start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import Scene
from cosim.scene.mechanism import mechanism
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.storage.checkpoint import Points
from cosim.storage.staging import scratch_folder
from cosim.studies import table_columns as col
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array
from mech import Chain

__all__ = ["STUDY", "gains", "jacobian_error", "linearised", "slope", "static_force"]


#: Step of the differences [rad]: their error is its square times 0.2 m / 6, rounding 1e-17 m over it.
_STEP_RAD = 1e-5
#: [rad/s], so slow that a circuit's first corner (600 rad/s) turns 1e-3 of nothing.
_SLOW = 1e-3
#: Poses nearer to full stretch or fold [rad] are left out of the map.
_MARGIN_RAD = 0.15
#: Bounds of the acceptance table, and for the slope those of gains (1e-3) and of (11) at a few mm.
_JACOBIAN, _GAIN, _NORMAL, _TANGENT, _SLOPE = 1e-8, 1e-3, 0.01, 1e-3, 5e-3


class AcceptanceParameters(Parameters):
    """``[parameters]`` of the checks on an arm; levels are ways to build the board, the first the ideal."""

    levels: tuple[Variation, ...] = Field(min_length=1)
    poses_rad: tuple[tuple[float, float], ...] = Field(min_length=1)
    sink_m: Annotated[float, Field(gt=0, le=0.1), Unit("m")] = 0.01
    points: int = Field(default=41, ge=5, le=401)
    pushes_n: tuple[float, float] = (0.4, 0.8)
    settle_s: Annotated[float, Field(gt=0, le=100), Unit("s")] = 2.0


def jacobian_error(chain: Chain, q: Array) -> float:
    """Return the largest difference [m/rad] between the Jacobian and central differences of the tip."""
    turned = np.eye(chain.n) * _STEP_RAD
    columns = [(chain.forward(q + d) - chain.forward(q - d)) / (2.0 * _STEP_RAD) for d in turned]
    return float(np.abs(chain.jacobian(q) - np.column_stack(columns)).max())


def gains(contact: HeldContact) -> list[tuple[Any, ...]]:
    """Return (pin, unit, commanded, measured) of every spring, damper and equilibrium at a pose.

    Commanded: J^T k n n^T J of the scene. Measured: the circuit's answer to the volts that the law writes.
    """
    scene, constants, circuit, w = contact.scene, contact.constants, contact.circuit, contact.torques
    n, m = scene.joints, len(circuit.gain)
    volts = law_point(scene, constants, contact.linkage, contact.q).volts[n : n + m]
    still = circuit.response(0.0, volts)[0].real * constants.torque_per_amp
    slow = circuit.response(1j * _SLOW, np.concatenate([np.zeros(n * n), volts[n * n :]]))[0]
    per_speed = slow.imag / _SLOW * constants.torque_per_amp
    k, c = scene.computer.analog_stiffness_n_per_m, scene.computer.analog_damping_n_s_per_m
    square = np.outer(w, w)
    out: list[tuple[Any, ...]] = []
    for kind, unit, commanded, measured in (
        ("ksp", "N m/rad", k * square, -still[:, :n]),
        ("u, ksp", "N m/rad", k * square, still[:, n : 2 * n] * constants.v_rad),
        ("ksd", "N m s/rad", c * square, -per_speed[:, :n]),
    ):
        for i in range(n):
            for j in range(n):
                out.append((f"{kind}{i + 1}{j + 1}", unit, float(commanded[i, j]), float(measured[i, j])))
    return out


def static_force(contact: HeldContact, sink: float) -> Array:
    """Return normal and tangential force [N] of law, board and motors at `sink` [m] below the pose."""
    scene, chain, wall_q, normal = contact.scene, contact.linkage, contact.q, contact.normal
    assert scene.wall is not None
    place = chain.forward(wall_q)
    moved = scene.model_copy(
        update={"wall": scene.wall.model_copy(update={"point_m": (float(place[0]), float(place[1]))})}
    )
    q = np.asarray(chain.inverse(place - sink * normal, elbow=1, seed=wall_q))
    _, _, current = rests(contact.of_scene(moved), q, 0.0)
    force = np.linalg.solve(chain.jacobian(q).T, contact.constants.torque_per_amp * current)
    return np.array([normal @ force, normal[1] * force[0] - normal[0] * force[1]])


def linearised(chain: Chain, wall_q: Array, normal: Array, sink: float) -> tuple[float, float]:
    """Return the share by which (11) errs along the normal, with J of the tip's pose and of half way.

    Raises
    ------
    ValueError
        Where the tip does not reach so deep.
    """
    q = np.asarray(chain.inverse(chain.forward(wall_q) - sink * normal, elbow=1, seed=wall_q))
    here, between = chain.jacobian(q), chain.jacobian((q + wall_q) / 2)
    return tuple(float(normal @ jac @ (wall_q - q) / sink - 1.0) for jac in (here, between))  # type: ignore[return-value]


def slope(spec: StudyFile, method: str, points: Points) -> tuple[float, float]:
    """Return the slope of force over depth [N/m] between two pushes on the wall, and the commanded one.

    The hand stands 2 mm above the wall's point, touches, and pushes slowly; both are means over the last
    fifth of a run.
    """
    given: AcceptanceParameters = spec.parameters
    level = given.levels[0].set
    other = {
        "discrete": ("computer.analog_stiffness_n_per_m=0", "computer.analog_damping_n_s_per_m=0"),
        "continuous": ("computer.discrete_stiffness_n_per_m=0", "computer.discrete_damping_n_s_per_m=0"),
    }.get(method, ())
    base = spec.scene(*level, f"computer.method={method}", *other)
    assert base.wall is not None
    point, normal = np.array(base.wall.point_m), np.array(base.wall.normal)
    above = (point + 2e-3 * normal).tolist()
    end = given.settle_s
    seen = []
    for push in given.pushes_n:
        force = (-push * normal).tolist()
        scene = spec.scene(
            *level, f"computer.method={method}", *other, f"duration_s={end!r}",
            f"device.start.tip_m={above}",
            f"operator.waypoints_s_m={[[0.0, *above], [0.1 * end, *point.tolist()]]}",
            f"operator.force_s_n={[[0.1 * end, 0.0, 0.0], [0.3 * end, *force]]}",
            "effects.encoder=false", "effects.dac=false", "effects.dac_settling=false",
        )  # fmt: skip
        seen.append(points.get(f"{method}, push of {push:g} N", lambda scene=scene: _pressed(scene)))  # type: ignore[misc]
    (low, weak), (deep, strong) = seen
    c = base.computer
    return (strong - weak) / (deep - low), c.analog_stiffness_n_per_m + c.discrete_stiffness_n_per_m


def _pressed(scene: Scene) -> tuple[float, float]:
    """Run a push; return depth [m] and the motors' force [N] at its end."""
    with (
        scratch_folder("press") as folder,
        start_early("cosim.loop.early_imports") as child,
    ):
        result = run(resolve(scene), folder / "run", formats=(), child=child)
        frame, t = wall_frame(scene, result.signals), np.asarray(result.signals["time"])
        late = t >= 0.8 * t[-1]
        return time_mean(t[late], frame["penetration"][late]), time_mean(t[late], frame["push"][late])


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Check A1 to A4 on the scene's arm."""
    given: AcceptanceParameters = spec.parameters
    chain = mechanism(spec.scene(), 1.0)
    if not isinstance(chain, Chain) or chain.n != 2:
        fail("these checks need a chain of two joints", file=str(spec.scene_file), key="device.linkage")
    if spec.scene().wall is None:
        fail("these checks need a wall", file=str(spec.scene_file), key="wall")
    poses = [np.array(pose) for pose in given.poses_rad]
    grid = [
        np.array([turn, bend])
        for bend in np.linspace(_MARGIN_RAD, np.pi - _MARGIN_RAD, given.points)
        for turn in np.linspace(-np.pi, np.pi, given.points)
    ]
    jacobian = max(jacobian_error(chain, q) for q in [*poses, *grid])
    rows, forces = _measured(spec, poses)
    workspace = _workspace(chain, np.array(spec.scene().wall.normal), given.sink_m, grid)  # type: ignore[union-attr]
    slopes = {method: slope(spec, method, points) for method in ("discrete", "continuous", "combined")}
    summed = Table(
        "slopes", "Static slope of force over depth",
        {
            "impedance of": list(slopes),
            "commanded [N/m]": [wanted for _, wanted in slopes.values()],
            "between two pushes [N/m]": [slope for slope, _ in slopes.values()],
        },
        f"Pushes of {given.pushes_n[0]:g} and {given.pushes_n[1]:g} N less what the hand holds back.",
    )  # fmt: skip
    return spec.result(
        Table("gains", "Gains of the board, by level", rows), Table("forces", "Static force", forces),
        summed, Table("workspace", "Normal force over the workspace", workspace),
        verdicts=_verdicts(given, jacobian, len(poses) + len(grid), rows, forces, workspace, slopes),
    )  # fmt: skip


def _measured(spec: StudyFile, poses: list[Array]) -> tuple[dict[str, list[Any]], dict[str, list[Any]]]:
    """Return the columns of gains and of forces, for every level and pose."""
    given: AcceptanceParameters = spec.parameters
    rows: dict[str, list[Any]] = {
        name: []
        for name in ("level", col.Q1, col.Q2, "gain", "unit", "commanded", "measured", col.ERROR_PERCENT)
    }
    forces: dict[str, list[Any]] = {
        name: [] for name in ("level", col.Q1, col.Q2, "normal [N]", col.ERROR_PERCENT, "F_t/F_n")
    }
    for level in given.levels:
        scene = spec.scene(*level.set, "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0")
        circuit, constants = circuit_of(resolve(scene))
        wanted = scene.computer.analog_stiffness_n_per_m * given.sink_m
        for q in poses:
            contact = HeldContact(scene, constants, circuit, q)
            for name, unit, commanded, measured in gains(contact):
                off = 100.0 * (measured / commanded - 1.0) if commanded else None
                row = (level.name, *q.tolist(), name, unit, commanded, measured, off)
                for column, value in zip(rows.values(), row, strict=True):
                    column.append(value)
            normal, tangent = static_force(contact, given.sink_m).tolist()
            row = (level.name, *q.tolist(), normal, 100.0 * (normal / wanted - 1.0), tangent / normal)
            for column, value in zip(forces.values(), row, strict=True):
                column.append(value)
    return rows, forces


def _workspace(chain: Chain, normal: Array, sink: float, grid: list[Array]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {
        name: [] for name in (col.X, col.Y, col.ERROR_OF_THE_POSE, col.ERROR_HALF_WAY)
    }
    for q in grid:
        r = chain.forward(q)
        try:
            here, between = (100.0 * share for share in linearised(chain, q, normal, sink))
        except ValueError:
            here = between = None  # type: ignore[assignment]
        for column, value in zip(columns.values(), (float(r[0]), float(r[1]), here, between), strict=True):
            column.append(value)
    return columns


def _verdicts(
    given: AcceptanceParameters, jacobian: float, poses: int, rows: dict[str, list[Any]],
    forces: dict[str, list[Any]], workspace: dict[str, list[Any]], slopes: dict[str, tuple[float, float]],
) -> list[Verdict]:  # fmt: skip
    first = given.levels[0].name

    def worst(columns: dict[str, list[Any]], name: str, level: str) -> float:
        pairs = zip(columns["level"], columns[name], strict=True)
        return float(max(abs(value) for which, value in pairs if which == level and value is not None))

    off = worst(rows, col.ERROR_PERCENT, first)
    others = "; ".join(
        f"{level.name}: {worst(rows, col.ERROR_PERCENT, level.name):.2g} %" for level in given.levels[1:]
    )
    normal, tangent = worst(forces, col.ERROR_PERCENT, first), worst(forces, "F_t/F_n", first)
    depth = f"{1e3 * given.sink_m:g} mm"
    reached = [abs(value) for value in workspace[col.ERROR_OF_THE_POSE] if value is not None]
    between = [abs(value) for value in workspace[col.ERROR_HALF_WAY] if value is not None]
    within = [100.0 * float(np.mean(np.array(errors) <= 100 * _NORMAL)) for errors in (reached, between)]
    (alone, _), (circuit, _), (both, wanted) = (
        slopes[method] for method in ("discrete", "continuous", "combined")
    )
    return [
        Verdict("A1", "the Jacobian is the derivative of the tip's place", "below 1e-8 m/rad",
                f"{jacobian:.1g} m/rad at most, in {poses} poses", jacobian < _JACOBIAN),
        Verdict("A2", f"gains that ngspice measures: {first} board", "commanded to 0.1 %",
                f"{off:.2g} % at most" + (f" ({others})" if others else ""), off <= 100 * _GAIN),
        Verdict("A3", f"{depth} deep in the poses of the slope, law and board together",
                "normal within 1 %, tangential about 0",
                f"normal {normal:.2g} % off, tangential {tangent:.1g} of it",
                normal <= 100 * _NORMAL and tangent <= _TANGENT),
        Verdict("A3", f"{depth} deep elsewhere: (11) is exact to first order only", "a question",
                f"within 1 % in {within[0]:.0f} % of the workspace, median {np.median(reached):.2g} %; "
                f"with the Jacobian half way to the wall in {within[1]:.0f} %", None),
        Verdict("A4", "static slope of computer and circuit together", f"{wanted:g} N/m",
                f"{both:.4g} N/m; apart {alone:.4g} and {circuit:.4g}",
                abs(both / wanted - 1.0) <= _SLOPE and abs(both / (alone + circuit) - 1.0) <= _SLOPE),
    ]  # fmt: skip


STUDY = Study(
    "acceptance",
    "what is commanded is what the arm renders, (1) to (13)",
    AcceptanceParameters,
    analyse,
    no_tolerance="it takes differences between the ends of two runs, which are no measures",
)
