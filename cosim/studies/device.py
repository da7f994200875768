"""Four numbers of a device: force, stiffness, damping and workspace at its tip.

Force and full scale follow from the board's statements and the Jacobian; how much of the stiffness and
damping is stable, from the exact border of the scene (its wall's pose, its operator, contact held).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cosim.analysis.held_contact import HeldContact
from cosim.analysis.impedance import Displayed, full_scale, largest
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import fail
from cosim.plan import resolve
from cosim.scene import Method, Scene
from cosim.scene.mechanism import mechanism
from cosim.scene.parameters import Field, Parameters
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array
from mech import Chain

__all__ = ["PRESETS", "STUDY", "DeviceNumbers", "Forces", "device_numbers", "forces", "workspace"]


#: Nearer to full stretch or fold than this angle [rad] an arm counts as out of its workspace.
_MARGIN_RAD = 0.15


@dataclass(frozen=True)
class Preset:
    """A published device: force [N], stiffness [N/m], damping [N s/m], radius of the workspace [m]."""

    name: str
    force_n: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    radius_m: float


#: Limits that the library CHAI3D recommends for controllers of these devices (its device classes
#: `cPhantomDevice` and `cFalconDevice`); they are not identified dynamics.
PRESETS = (
    Preset("Phantom Omni", 3.3, 700.0, 5.0, 0.10),
    Preset("Phantom Premium 1.5", 8.5, 800.0, 5.0, 0.10),
    Preset("Falcon", 8.0, 3000.0, 20.0, 0.04),
)


@dataclass(frozen=True)
class Forces:
    """Forces at the tip [N] for a torque at every joint: in any direction, and in the best one."""

    any_n: float
    best_n: float


def forces(jac: Array, torque: float) -> Forces:
    """Return what joints of at most `torque` [N m] each give at the tip, for a Jacobian [2, n].

    A force F needs the torques J^T F. In any direction: torque over the longest column of J. In the best one:
    a corner of the box of torques (of one joint, its own direction).
    """
    n = jac.shape[1]
    if n == 1:
        only = torque / float(np.linalg.norm(jac[:, 0]))
        return Forces(only, only)
    longest = float(np.linalg.norm(jac, axis=0).max())
    back = np.linalg.inv(jac.T)
    corners = (np.array([1.0, s]) * torque for s in (1.0, -1.0))
    return Forces(torque / longest, max(float(np.linalg.norm(back @ corner)) for corner in corners))


@dataclass(frozen=True)
class Workspace:
    """Places that the tip reaches.

    Attributes
    ----------
    area_m2 : 0 for a slider
    width_m, height_m : of the box around it; of a slider, its travel along x and y
    note : what it is taken from
    """

    area_m2: float
    width_m: float
    height_m: float
    note: str


def workspace(scene: Scene) -> tuple[Workspace, Array]:
    """Return the workspace with the elbow as at the start, and poses spread over it [P, n] rad.

    Of two joints; where the scene states stops they bound it, else the base turns freely and the elbow from
    0.15 rad off full stretch to as much off the fold. Of a slider without stops, what its potentiometer and
    drum would allow is not known: its width is not a number then.
    """
    device, linkage = scene.device, mechanism(scene, 1.0)
    if device.slider is not None and scene.is_slider:
        slider = device.slider
        if not slider.stops_rad:
            return Workspace(0.0, math.nan, math.nan, "the scene states no stops"), np.zeros((1, 1))
        low, high = slider.stops_rad[0]
        travel = slider.radius_m * (high - low) * np.abs(slider.direction)
        return Workspace(0.0, float(travel[0]), float(travel[1]), "between its stops"), np.zeros((1, 1))
    if not isinstance(linkage, Chain) or linkage.n != 2 or device.chain is None:
        fail("the workspace is that of one or two joints", file=scene.file_name, key="device.linkage")
    stops = device.chain.stops_rad
    turn = stops[0] if stops else (-math.pi, math.pi)
    elbow = (_MARGIN_RAD, math.pi - _MARGIN_RAD)
    if device.start.elbow < 0:
        elbow = (-elbow[1], -elbow[0])
    bend = (max(elbow[0], stops[1][0]), min(elbow[1], stops[1][1])) if stops else elbow
    turn = (turn[0], min(turn[1], turn[0] + 2.0 * math.pi))
    if not bend[0] < bend[1]:
        fail("the stops leave no pose with this elbow", file=scene.file_name, key="device.chain.stops_rad")
    poses = np.array([[a, b] for b in np.linspace(*bend, 41) for a in np.linspace(*turn, 73)])
    # |det J| dq1 dq2 is the area swept; Gauss and Legendre in the bend, no turn changes it
    node, weight = np.polynomial.legendre.leggauss(24)
    middle, half = 0.5 * (bend[0] + bend[1]), 0.5 * (bend[1] - bend[0])
    swept = [abs(float(np.linalg.det(linkage.jacobian(np.array([0.0, middle + half * x]))))) for x in node]
    area = (turn[1] - turn[0]) * half * float(np.dot(weight, swept))
    tips = np.array([linkage.forward(q) for q in poses])
    size = np.ptp(tips, axis=0)
    note = "between its stops" if stops else "the base turns once round: the scene states no stops"
    return Workspace(area, float(size[0]), float(size[1]), note), poses


@dataclass(frozen=True)
class DeviceNumbers:
    """The four numbers, and where they come from.

    Attributes
    ----------
    continuous_n, peak_n : any direction, at the wall's pose: rated current, and the driver's limit
    continuous_least_n, peak_least_n : at the worst pose of the workspace
    continuous_best_n : best direction at the wall's pose
    discrete_n_per_m, analog_n_per_m, stiffness_n_per_m : largest along the wall's normal: by the computer
        alone, by the circuit alone, and by both together
    discrete_n_s_per_m, analog_n_s_per_m, damping_n_s_per_m : the same of damping
    workspace : of the tip
    period_s, model : sampling period and circuit model that they hold for
    """

    continuous_n: float
    peak_n: float
    continuous_least_n: float
    peak_least_n: float
    continuous_best_n: float
    discrete_n_per_m: Displayed
    analog_n_per_m: Displayed
    stiffness_n_per_m: float
    discrete_n_s_per_m: Displayed
    analog_n_s_per_m: Displayed
    damping_n_s_per_m: float
    workspace: Workspace
    period_s: float
    model: str

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready; what is unknown or infinite is None."""

        def clean(value: Any) -> Any:
            if isinstance(value, dict):
                return {key: clean(each) for key, each in value.items()}
            return None if isinstance(value, float) and not math.isfinite(value) else value

        out: dict[str, Any] = clean(asdict(self))
        return out

    def rows(self) -> dict[str, list[Any]]:
        """Return them as a table beside published devices."""
        both = self.workspace
        radius = math.sqrt(both.area_m2 / math.pi) if both.area_m2 else None
        own: tuple[Any, ...] = (
            "this device", self.continuous_n, self.peak_n, self.stiffness_n_per_m, self.damping_n_s_per_m,
            radius,
        )  # fmt: skip
        heads = (
            "device", col.CONTINUOUS_FORCE, "force, peak [N]", col.STIFFNESS, "damping [N s/m]",
            "workspace [m]",
        )  # fmt: skip
        others = [
            (p.name, None, p.force_n, p.stiffness_n_per_m, p.damping_n_s_per_m, p.radius_m) for p in PRESETS
        ]
        return {head: [row[k] for row in (own, *others)] for k, head in enumerate(heads)}


def device_numbers(contact: HeldContact) -> DeviceNumbers:
    """Return the four numbers of the device of a contact.

    Raises
    ------
    InputError
        For a scene without a wall, with a law or an operator in Python, or of more than two joints.
    """
    scene, constants, linkage = contact.scene, contact.constants, contact.linkage
    room, poses = workspace(scene)
    rated, most = (constants.torque_per_amp * i for i in (constants.i_rated, constants.i_limit))
    here = forces(linkage.jacobian(contact.q), rated)
    worst = min(forces(linkage.jacobian(q), rated).any_n for q in poses)
    stiff, damp = full_scale(constants, contact.torques)
    none = contact.with_computer(
        method=Method.COMBINED, analog_stiffness_n_per_m=0.0, analog_damping_n_s_per_m=0.0,
        discrete_stiffness_n_per_m=0.0, discrete_damping_n_s_per_m=0.0,
    )  # fmt: skip

    def find(base: HeldContact, quantity: str, cap: float) -> tuple[Displayed, Displayed, float]:
        analog, discrete = f"analog_{quantity}", f"discrete_{quantity}"
        alone = largest(base, discrete)
        by_circuit = largest(base, analog, cap=cap)
        stiffest = base.with_computer(**{analog: by_circuit.value * (1.0 - 1e-6)})
        both = by_circuit.value + largest(stiffest, discrete).value
        return alone, by_circuit, max(both, alone.value)

    stiffness = find(none, "stiffness_n_per_m", stiff)
    damping = find(none, "damping_n_s_per_m", damp)
    return DeviceNumbers(
        here.any_n, here.any_n * most / rated, worst, worst * most / rated, here.best_n,
        *stiffness, *damping, room, scene.computer.period_s, contact.circuit.model,
    )  # fmt: skip


class DeviceParameters(Parameters):
    """``[parameters]`` of the device's numbers: poses each way of the map of forces."""

    points: int = Field(default=41, ge=5, le=401)


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Tell the numbers for the circuit as it is, and for an ideal one; map the force over the workspace."""
    columns: dict[str, list[Any]] = {}
    kept: list[DeviceNumbers] = []
    for model in ("linear", "ideal"):
        plan = resolve(spec.scene(*(IDEAL if model == "ideal" else ()), "solver.model=auto"))
        contact = HeldContact.of(plan, reduced=True)
        numbers = device_numbers(contact)
        kept.append(numbers)
        for name, value in flat(numbers).items():
            columns.setdefault(name, []).append(value)
    full = kept[0]
    note = (
        "Published values are limits that the library CHAI3D recommends for controllers of these devices, "
        "not identified dynamics. Ours: force in any direction at the wall's pose; stiffness and damping "
        f"along the wall's normal, stable at {1e3 * full.period_s:g} ms with the scene's operator, the "
        "analog part within the board's full scale; radius of a disc of the workspace's area "
        f"({full.workspace.note}). Stability alone: the encoder's steps make damping rough well before."
    )
    names = list(columns)
    table = Table(
        "numbers", "Four numbers of the device",
        {
            "number": names,
            "circuit as built": [columns[name][0] for name in names],
            "circuit ideal": [columns[name][1] for name in names],
        },
    )  # fmt: skip
    tables = [Table("presets", "Beside published devices", full.rows(), note), table]
    if not spec.scene().is_slider:
        tables.append(_force_map(spec, contact.constants))
    fits = full.analog_n_per_m
    return spec.result(
        *tables,
        verdicts=(
            Verdict(
                "D1", "what ends the analog stiffness", "a question",
                f"{fits.by} at {fits.value:.4g} N/m; with the computer {full.stiffness_n_per_m:.4g} N/m, "
                f"which alone displays {full.discrete_n_per_m.value:.4g} N/m", None,
            ),
        ),
    )  # fmt: skip


#: Overrides that leave no dynamics in the circuit.
IDEAL = (
    "effects.opamp=ideal", "effects.vca=ideal", "effects.driver_level=ideal", "effects.motor=emf",
    "effects.differentiator=ideal",
)  # fmt: skip


def flat(numbers: DeviceNumbers) -> dict[str, Any]:
    """Return the numbers with units as a flat table."""
    room = numbers.workspace
    return {
        "continuous force, any direction [N]": numbers.continuous_n,
        "peak force, any direction [N]": numbers.peak_n,
        "continuous force, best direction [N]": numbers.continuous_best_n,
        "continuous force, worst pose [N]": numbers.continuous_least_n,
        "peak force, worst pose [N]": numbers.peak_least_n,
        "stiffness, computer alone [N/m]": _number(numbers.discrete_n_per_m.value),
        "stiffness, circuit alone [N/m]": _number(numbers.analog_n_per_m.value),
        "stiffness of the circuit ends by": numbers.analog_n_per_m.by,
        "stiffness, both [N/m]": _number(numbers.stiffness_n_per_m),
        "damping, computer alone [N s/m]": _number(numbers.discrete_n_s_per_m.value),
        "damping, circuit alone [N s/m]": _number(numbers.analog_n_s_per_m.value),
        "damping of the circuit ends by": numbers.analog_n_s_per_m.by,
        "damping, both [N s/m]": _number(numbers.damping_n_s_per_m),
        "workspace, area [cm^2]": 1e4 * room.area_m2,
        "workspace, width [m]": _number(room.width_m),
        "workspace, height [m]": _number(room.height_m),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _force_map(spec: StudyFile, constants: DesignConstants) -> Table:
    """Return continuous force in any direction, and full-scale stiffness, over the bend of the elbow."""
    scene = spec.scene()
    linkage, (_, poses) = mechanism(scene, constants.gear), workspace(scene)
    bends = np.linspace(poses[:, 1].min(), poses[:, 1].max(), spec.parameters.points)
    columns: dict[str, list[Any]] = {
        name: []
        for name in (col.REACH, "continuous, any direction [N]", "continuous, best direction [N]",
                     "peak, any direction [N]", col.FULL_SCALE_STIFFNESS)
    }  # fmt: skip
    rated = constants.torque_per_amp * constants.i_rated
    for bend in bends:
        q = np.array([0.0, bend])
        jac = linkage.jacobian(q)
        each = forces(jac, rated)
        longest = float(np.linalg.norm(jac, axis=0).max())
        row = (
            float(np.linalg.norm(linkage.forward(q))), each.any_n, each.best_n,
            each.any_n * constants.i_limit / constants.i_rated,
            full_scale(constants, np.array([longest]))[0],
        )  # fmt: skip
        for column, value in zip(columns.values(), row, strict=True):
            column.append(value)
    return Table("reach", "Over the reach of the arm", columns)


STUDY = Study("device", "force, stiffness, damping and workspace of the device", DeviceParameters, analyse)
