"""The keys of a scene file: names, types, units, allowed ranges and null forms.

One class a TOML table. All of them are frozen and strict: a number is never made from text, NaN and
infinity are refused everywhere, an unknown key is an error. What one key alone can tell is stated
here; what needs several keys is in `cosim.scene.checks`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from cosim.scene.tolerance_table import Tolerance


@dataclass(frozen=True)
class Unit:
    """Unit of a number; travels in the field's metadata and from there into every error text."""

    text: str


def _normalised(vector: tuple[float, float]) -> tuple[float, float]:
    norm = math.hypot(*vector)
    if norm == 0.0:
        raise PydanticCustomError("zero_vector", "must not be the zero vector")
    # A vector that is already normal to rounding is kept, so that a stored scene loads to itself.
    return vector if abs(norm - 1.0) < 1e-15 else (vector[0] / norm, vector[1] / norm)


def _no_bool(value: Any) -> Any:
    # True equals 1, so a list of allowed integers alone would let it pass.
    if isinstance(value, bool):
        raise PydanticCustomError("literal_error", "is not one of the choices")
    return value


# Upper limits are far outside of anything built; they exist to catch a value written in a wrong unit.
Duration = Annotated[float, Field(gt=0, le=1e5), Unit("s")]
Period = Annotated[float, Field(ge=1e-6, le=10), Unit("s")]
Lag = Annotated[float, Field(ge=0, le=1), Unit("s")]
Step = Annotated[float, Field(ge=1e-9, le=1), Unit("s")]
Time = Annotated[float, Field(ge=0, le=1e5), Unit("s")]
Length = Annotated[float, Field(gt=0, le=10), Unit("m")]
Along = Annotated[float, Field(ge=0, le=10), Unit("m")]
Place = Annotated[float, Field(ge=-20, le=20), Unit("m")]
Mass = Annotated[float, Field(ge=0, le=1e3), Unit("kg")]
RealMass = Annotated[float, Field(gt=0, le=1e3), Unit("kg")]
Inertia = Annotated[float, Field(ge=0, le=1e3), Unit("kg m^2")]
Angle = Annotated[float, Field(ge=-100, le=100), Unit("rad")]
SmallAngle = Annotated[float, Field(ge=0, le=0.5), Unit("rad")]
AngleSpan = Annotated[float, Field(ge=1e-3, le=100), Unit("rad")]
Rate = Annotated[float, Field(ge=-1e4, le=1e4), Unit("rad/s")]
PositiveRate = Annotated[float, Field(gt=0, le=1e4), Unit("rad/s")]
Torque = Annotated[float, Field(ge=0, le=1e3), Unit("N m")]
JointStiffness = Annotated[float, Field(ge=0, le=1e7), Unit("N m/rad")]
JointDamping = Annotated[float, Field(ge=0, le=1e4), Unit("N m s/rad")]
Restitution = Annotated[float, Field(ge=0, le=1)]
Stiffness = Annotated[float, Field(ge=0, le=1e7), Unit("N/m")]
Damping = Annotated[float, Field(ge=0, le=1e5), Unit("N s/m")]
Force = Annotated[float, Field(ge=-1e4, le=1e4), Unit("N")]
Gravity = Annotated[float, Field(ge=-100, le=100), Unit("m/s^2")]
Frequency = Annotated[float, Field(gt=0, le=1e7), Unit("Hz")]
Temperature = Annotated[float, Field(ge=-55, le=150), Unit("C")]
Volts = Annotated[float, Field(gt=0, le=1e3), Unit("V")]
Vector = Annotated[tuple[float, float], AfterValidator(_normalised)]
Point = tuple[Place, Place]


class Linkage(StrEnum):
    """Kind of the mechanism."""

    CHAIN = "chain"
    SLIDER = "slider"


class Method(StrEnum):
    """How the wall is displayed: by the computer, by the circuit, by both, or by plain joint gains."""

    DISCRETE = "discrete"
    CONTINUOUS = "continuous"
    COMBINED = "combined"
    JOINT_PD = "joint_pd"


class CommandPath(StrEnum):
    """Where the discrete force enters the circuit: by the equilibrium `u` or directly by `cmd`."""

    U = "u"
    CMD = "cmd"


class Onset(StrEnum):
    """Where a contact's springs are relaxed: at the wall, or as deep as the contact was first sampled."""

    WALL = "wall"
    ANCHORED = "anchored"


class Level(StrEnum):
    """Depth of an amplifier's model: ideal, finite gain and bandwidth, or everything its file holds."""

    IDEAL = "ideal"
    GBW = "gbw"
    FULL = "full"


class Drive(StrEnum):
    """What the motor driver imposes on the motor."""

    VOLTAGE = "voltage"
    CURRENT = "current"


class MotorLevel(StrEnum):
    """Motor as a resistance, with back-EMF, or with inductance as well."""

    IDEAL = "ideal"
    EMF = "emf"
    FULL = "full"


class PotLevel(StrEnum):
    """Potentiometer as a voltage source or with its track and wiper resistance."""

    IDEAL = "ideal"
    FULL = "full"


class Differentiator(StrEnum):
    """Differentiator as a pure one, or as the circuit with its corners and its op-amp."""

    IDEAL = "ideal"
    CORNER = "corner"


class PotNoise(StrEnum):
    """Reading of the 0.006 rad that the paper gives for the potentiometer."""

    NONE = "none"
    WHITE = "white"
    PEAK_TO_PEAK = "peak_to_peak"
    STATIC = "static"
    POSITION = "position"


class Jitter(StrEnum):
    """Distribution of the sampling instants about their nominal ones."""

    NONE = "none"
    UNIFORM = "uniform"
    NORMAL = "normal"


class CircuitModelName(StrEnum):
    """Circuit model asked for; `auto` lets the effects in force choose."""

    AUTO = "auto"
    IDEAL = "ideal"
    LINEAR = "linear"
    SPICE = "spice"


class Integration(StrEnum):
    """Integration method of ngspice."""

    GEAR = "gear"
    TRAP = "trap"


class Dialect(StrEnum):
    """Dialect in which a vendor's model is written."""

    NGSPICE = "ngspice"
    PSPICE = "pspice"
    LTSPICE = "ltspice"


# Strict validation accepts only members of an enum; in a TOML file a choice is a word.
_Word = Field(strict=False)


class Table(BaseModel):
    """Base of all tables of a scene."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def _zeros(data: dict[str, Any]) -> tuple[float, ...]:
    return (0.0,) * len(data["lengths_m"])


class Chain(Table):
    """``[device.chain]``: n revolute links in a plane, base at the origin; joint angles are relative.

    Lists hold one value a joint. Rotor inertia is on the motor's side of the gear, everything else on
    the joint's side. Centres of mass lie on the link, measured from its joint; inertias are about them.

    In the models `ideal` and `linear` Coulomb friction holds and slips, and stops push and let go, at located
    instants; stops with `stop_restitution` do not give. On `spice` and in exported decks it is
    coulomb tanh(v / coulomb_speed), the only use of `coulomb_speed_rad_per_s`.

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
    elbow: Annotated[Literal[1, -1], BeforeValidator(_no_bool)] = 1
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
    dialect: Annotated[Dialect, _Word] = Dialect.NGSPICE


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
    linkage: Annotated[Linkage, _Word]
    chain: Chain | None = None
    slider: Slider | None = None
    start: Start
    potentiometer: Potentiometer = Potentiometer()
    component_noise_bandwidth_hz: Annotated[float, Field(gt=0, le=1e5), Unit("Hz")] = 1000.0
    temperature_c: Temperature = 27.0
    parts: Mapping[str, Part] = {}
    values: Mapping[str, str] = {}


class Encoder(Table):
    """``[computer.encoder]``: on the motor, so a joint turn counts pulses x decoding x gear."""

    pulses_per_rev: int = Field(default=500, ge=1, le=10_000_000)
    decoding: Annotated[Literal[1, 2, 4], BeforeValidator(_no_bool)] = 4


class Dac(Table):
    """``[computer.dac]``: bits and range come from the board where they are not given; ``effects.dac``.

    `settling_s` is the time of the ramp from one code to the next (``effects.dac_settling``), `skew_s` that
    by which the channels of equilibria and commands follow those of the gains (``effects.dac_skew``).
    """

    bits: int | None = Field(default=None, ge=1, le=32)
    range_v: Volts | None = None
    settling_s: Lag = 0.0
    skew_s: Lag = 0.0


class Velocity(Table):
    """``[computer.velocity]``: low-pass on the encoder's difference quotient; none by default."""

    filter_hz: Frequency | None = None


class Computer(Table):
    """``[computer]``: sampling and the control law of section III of the paper.

    `jitter_share` is by how much of a period samples come early or late: half the width of the uniform, or
    the standard deviation of the normal distribution that ``effects.period_jitter`` chooses, the latter
    cut off at 0.45 periods. The computer takes its period for constant.

    `onset` and `gain_ramp_samples` soften the jump of force that a contact begins with: where its springs are
    relaxed, and over how many samples all that the wall asks for is raised.
    """

    period_s: Period
    method: Annotated[Method, _Word]
    discrete_stiffness_n_per_m: Stiffness = 0.0
    discrete_damping_n_s_per_m: Damping = 0.0
    analog_stiffness_n_per_m: Stiffness = 0.0
    analog_damping_n_s_per_m: Damping = 0.0
    joint_stiffness_n_m_per_rad: tuple[JointStiffness, ...] = ()
    joint_damping_n_m_s_per_rad: tuple[JointDamping, ...] = ()
    command_path: Annotated[CommandPath, _Word] = CommandPath.CMD
    onset: Annotated[Onset, _Word] = Onset.WALL
    gain_ramp_samples: int = Field(default=0, ge=0, le=1000)
    jitter_share: float = Field(default=0.01, ge=0, le=0.45)
    delay_periods: int = Field(default=0, ge=0, le=1000)
    delay_fraction: float = Field(default=0.0, ge=0, lt=1)
    law: str | None = None
    encoder: Encoder = Encoder()
    dac: Dac = Dac()
    velocity: Velocity = Velocity()


class Wall(Table):
    """``[wall]``: a straight frictionless wall; `normal` points to the free side and has length 1."""

    point_m: Point
    normal: Vector


class NoOperator(Table):
    """``[operator] type = "none"``."""

    type: Literal["none"] = "none"


class MassOperator(Table):
    """``[operator] type = "mass"``: a point mass fixed to the tip (Fig. 12)."""

    type: Literal["mass"]
    mass_kg: RealMass


class HandOperator(Table):
    """``[operator] type = "hand"``: mass, damping and stiffness of a hand about its intended path.

    The path joins `waypoints_s_m` (rows t, x, y) by minimum-jerk moves; the wanted force
    `force_s_n` (rows t, fx, fy; on the device) is linear between its rows. Mass and damping are there with
    ``effects.operator_dynamics`` only: without, the hand is a spring, which follows its path at any speed.
    """

    type: Literal["hand"]
    mass_kg: Mass = 0.554
    damping_n_s_per_m: Damping = 6.45
    stiffness_n_per_m: Stiffness = 135.0
    waypoints_s_m: tuple[tuple[Time, Place, Place], ...] = Field(min_length=1, max_length=256)
    force_s_n: tuple[tuple[Time, Force, Force], ...] = Field(default=(), max_length=256)


class PythonOperator(Table):
    """``[operator] type = "python"``: the user's own class, ``file = "hand.py:Hand"``."""

    type: Literal["python"]
    file: str


Operator = Annotated[NoOperator | MassOperator | HandOperator | PythonOperator, Field(discriminator="type")]


#: Keys of `[effects]` whose settings are other devices or experiments, not finer models of one.
CHOICES = frozenset({"driver", "geometric_stiffness", "operator_dynamics"})


class Effects(Table):
    """``[effects]``: what is in force. Every default is the null form.

    With `auto`, written ``effects = "auto"`` where nothing else is stated, the effects that the table does
    not state are chosen until ``tolerance`` holds. Of a file that is extended only `CHOICES` stay.
    """

    auto: bool = False
    opamp: Annotated[Level, _Word] = Level.IDEAL
    opamp_slew: bool = False
    opamp_saturation: bool = False
    opamp_offset: bool = False
    vca: Annotated[Level, _Word] = Level.IDEAL
    vca_gain_error: bool = False
    vca_offset: bool = False
    vca_nonlinearity: bool = False
    differentiator: Annotated[Differentiator, _Word] = Differentiator.IDEAL
    driver: Annotated[Drive, _Word] = Drive.VOLTAGE
    driver_level: Annotated[Level, _Word] = Level.IDEAL
    driver_limit: bool = False
    motor: Annotated[MotorLevel, _Word] = MotorLevel.IDEAL
    potentiometer: Annotated[PotLevel, _Word] = PotLevel.IDEAL
    temperature: bool = False
    pot_noise: Annotated[PotNoise, _Word] = PotNoise.NONE
    pot_linearity: bool = False
    pot_calibration: bool = False
    component_noise: bool = False
    encoder: bool = False
    dac: bool = False
    dac_settling: bool = False
    dac_skew: bool = False
    delay: bool = False
    period_jitter: Annotated[Jitter, _Word] = Jitter.NONE
    geometric_stiffness: bool = False
    gravity: bool = False
    coriolis: bool = False
    viscous: bool = False
    coulomb: bool = False
    rotor_inertia: bool = False
    end_stops: bool = False
    shaft: bool = False
    backlash: bool = False
    operator_dynamics: bool = False


class Solver(Table):
    """``[solver]``: circuit model and tolerances; `time_limit_s` is on the wall clock.

    The model `linear` keeps as many of the circuit's poles as it needs to stay within
    `reduction_tolerance` of each path's maximum up to `band_hz`.

    Transients of capacitors whose charge stays below `charge_tolerance_c` do not shorten ngspice's step: by
    default the op-amps' internal poles (microseconds) are stepped over by the L-stable method. 1e-14 is
    ngspice's own default and resolves them, at about a fifth more points with the shipped parts.

    An unstable circuit is refused, in every model; with `allow_unstable` it runs as it is, with a warning.
    """

    model: Annotated[CircuitModelName, _Word] = CircuitModelName.AUTO
    rtol: float = Field(default=1e-4, gt=0, le=0.1)
    max_step_s: Step = 2e-3
    method: Annotated[Integration, _Word] = Integration.GEAR
    coupling_tolerance_rad: Annotated[float, Field(ge=1e-14, le=0.1), Unit("rad")] = 1e-7
    band_hz: Frequency = 1000.0
    reduction_tolerance: float = Field(default=1e-6, gt=0, le=0.1)
    charge_tolerance_c: Annotated[float, Field(gt=0, le=1e-3), Unit("C")] = 1e-9
    time_limit_s: Annotated[float, Field(gt=0, le=1e6), Unit("s")] = 600.0
    allow_unstable: bool = False


class Record(Table):
    """``[record]``: further nodes by their path, such as ``xboard.xsum1.inn``."""

    nodes: tuple[str, ...] = ()


class Measures(Table):
    """``[measures]``: names wanted; none means the standard set."""

    names: tuple[str, ...] = ()


class SceneTables(Table):
    """Top level of a scene file."""

    title: str = Field(min_length=1)
    duration_s: Duration
    seed: int = Field(default=0, ge=0, lt=2**63)
    device: Device
    computer: Computer
    wall: Wall | None = None  # free space when left out
    operator: Operator = NoOperator()
    effects: Effects = Effects()
    tolerance: Tolerance = Tolerance()
    solver: Solver = Solver()
    record: Record = Record()
    measures: Measures = Measures()
