"""``[device]`` of a scene: linkage, start, potentiometers, parts."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from cosim.scene.choices import Dialect, Linkage
from cosim.scene.quantities import (
    Along,
    Angle,
    AngleSpan,
    Frequency,
    Gravity,
    Inertia,
    JointDamping,
    JointStiffness,
    Length,
    Mass,
    Point,
    PositiveRate,
    Rate,
    RealMass,
    Restitution,
    SmallAngle,
    Temperature,
    Torque,
    Unit,
    Vector,
)
from cosim.scene.table import WORD, Table, no_bool


def _zeros(data: dict[str, Any]) -> tuple[float, ...]:
    return (0.0,) * len(data["lengths_m"])


class Chain(Table):
    """``[device.chain]``: n revolute links in a plane, base at the origin; joint angles are relative.

    Lists hold one value a joint. Rotor inertia is on the motor's side of the gear, everything else on
    the joint's side. Centres of mass lie on the link, measured from its joint; inertias are about them.

    In a run of any model Coulomb friction holds and slips, and stops push and let go, at located instants
    (`spice` ends its steps there); on `ideal` and `linear` stops with `stop_restitution` do not give. In an
    exported deck friction is coulomb tanh(v / coulomb_speed), the only use of `coulomb_speed_rad_per_s`.

    Shafts (``effects.shaft``) turn between motor and joint, backlash (``effects.backlash``) is the full width
    of the gear's gap; both are counted at the joint. Friction is on the joint's side of them.
    """

    lengths_m: tuple[Length, ...] = Field(min_length=1, max_length=6)
    masses_kg: tuple[Mass, ...]
    coms_m: tuple[Along, ...]
    inertias_kg_m2: tuple[Inertia, ...]
    rotor_inertia_kg_m2: tuple[Inertia, ...] = Field(default_factory=_zeros)
    viscous_n_m_s: tuple[JointDamping, ...] = Field(default_factory=_zeros)
    coulomb_n_m: tuple[Torque, ...] = Field(default_factory=_zeros)
    coulomb_speed_rad_per_s: PositiveRate = 0.01
    stops_rad: tuple[tuple[Angle, Angle], ...] = ()
    stop_stiffness_n_m_per_rad: JointStiffness = 100.0
    stop_damping_n_m_s: JointDamping = 0.1
    stop_restitution: Restitution | None = None
    gravity_m_per_s2: tuple[Gravity, Gravity] = (0.0, -9.81)
    shaft_stiffness_n_m_per_rad: tuple[JointStiffness, ...] = Field(default_factory=_zeros)
    shaft_damping_n_m_s: tuple[JointDamping, ...] = Field(default_factory=_zeros)
    backlash_rad: tuple[SmallAngle, ...] = Field(default_factory=_zeros)


class Slider(Table):
    """``[device.slider]``: a carriage on a drum, tip = origin + radius q direction (Fig. 5).

    `mass_kg` is the carriage without the operator's mass and without the reflected rotor.
    """

    radius_m: Length
    mass_kg: RealMass
    rotor_inertia_kg_m2: Inertia = 0.0
    direction: Vector = (0.0, 1.0)
    origin_m: Point = (0.0, 0.0)
    viscous_n_m_s: JointDamping = 0.0
    coulomb_n_m: Torque = 0.0
    coulomb_speed_rad_per_s: PositiveRate = 0.01
    stops_rad: tuple[tuple[Angle, Angle], ...] = ()
    stop_stiffness_n_m_per_rad: JointStiffness = 100.0
    stop_damping_n_m_s: JointDamping = 0.1
    stop_restitution: Restitution | None = None
    gravity_m_per_s2: tuple[Gravity, Gravity] = (0.0, -9.81)
    shaft_stiffness_n_m_per_rad: JointStiffness = 0.0
    shaft_damping_n_m_s: JointDamping = 0.0
    backlash_rad: SmallAngle = 0.0


class Start(Table):
    """``[device.start]``: pose by joint angles or by the tip; `elbow` = +1 bends joints positively."""

    q_rad: tuple[Angle, ...] | None = None
    tip_m: Point | None = None
    elbow: Annotated[Literal[1, -1], BeforeValidator(no_bool)] = 1
    v_rad_per_s: tuple[Rate, ...] = ()


class Potentiometer(Table):
    """``[device.potentiometer]``: what it shows instead of the joint's angle.

    `noise_rad` is the size of the noise whose kind ``effects.pot_noise`` chooses: an rms for white, a full
    width for peak_to_peak, an offset's standard deviation for static and an rms over the angle for position,
    which varies over `position_period_rad`.

    `linearity_rad` is the largest distance from the straight line within a turn either way (a data sheet's
    independent linearity, there in per cent of the travel: 0.1 % of 340 degrees is 0.006 rad); it varies over
    `linearity_period_rad`. In ``effects.pot_linearity``.

    `gain_error` (0.01: 1 %) and `zero_rad` are what is left of the calibration against the encoder: it shows
    (1 + gain_error) q + zero_rad. In ``effects.pot_calibration``.
    """

    noise_rad: SmallAngle = 0.006
    noise_bandwidth_hz: Frequency = 100.0
    position_period_rad: AngleSpan = 0.1
    linearity_rad: SmallAngle = 0.006
    linearity_period_rad: AngleSpan = 1.0
    gain_error: float = Field(default=0.01, ge=-0.5, le=0.5)
    zero_rad: Annotated[float, Field(ge=-0.5, le=0.5), Unit("rad")] = 0.005


class PartFile(Table):
    """A vendor's model in place of a part: `pins` are its pins in the order of the part replaced."""

    file: Path
    subckt: str = Field(min_length=1)
    pins: str = Field(min_length=1)
    dialect: Annotated[Dialect, WORD] = Dialect.NGSPICE


def _part_kind(part: object) -> str:
    return "<name>" if isinstance(part, str) else "<file>"


Part = Annotated[
    Annotated[PartFile, Tag("<file>")] | Annotated[str, Tag("<name>")], Discriminator(_part_kind)
]


class Device(Table):
    """``[device]``: board, mechanism and where it starts.

    `values` overrides parameters and elements of the netlist by name; ``--set R12=8.2k`` lands here.
    ``effects.component_noise`` is drawn up to `component_noise_bandwidth_hz`.
    `temperature_c` holds where ``effects.temperature`` is in force.
    """

    board: Path
    linkage: Annotated[Linkage, WORD]
    chain: Chain | None = None
    slider: Slider | None = None
    start: Start
    potentiometer: Potentiometer = Potentiometer.model_construct()
    component_noise_bandwidth_hz: Annotated[float, Field(ge=1e-6, le=1e5), Unit("Hz")] = 1000.0
    temperature_c: Temperature = 27.0
    parts: Mapping[str, Part] = {}
    values: Mapping[str, str] = {}
