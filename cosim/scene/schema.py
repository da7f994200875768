"""The keys of a scene file: names, types, units, allowed ranges and null forms.

One class a TOML table. All of them are frozen and strict: a number is never made from text, NaN and
infinity are refused everywhere, an unknown key is an error. What one key alone can tell is stated
here; what needs several keys is in `cosim.scene.checks`.
"""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from cosim.scene.choices import (
    CircuitModelName,
    CommandPath,
    Differentiator,
    Drive,
    Integration,
    Jitter,
    Level,
    Method,
    MotorLevel,
    Onset,
    PotLevel,
    PotNoise,
)
from cosim.scene.device_tables import Device
from cosim.scene.quantities import (
    Damping,
    Duration,
    Force,
    Frequency,
    JointDamping,
    JointStiffness,
    Lag,
    Mass,
    Period,
    Place,
    Point,
    RealMass,
    Step,
    Stiffness,
    Time,
    Unit,
    Vector,
    Volts,
)
from cosim.scene.table import WORD, Table, no_bool
from cosim.scene.tolerance_table import Tolerance


class Encoder(Table):
    """``[computer.encoder]``: on the motor, so a joint turn counts pulses x decoding x gear."""

    pulses_per_rev: int = Field(default=500, ge=1, le=10_000_000)
    decoding: Annotated[Literal[1, 2, 4], BeforeValidator(no_bool)] = 4


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
    method: Annotated[Method, WORD]
    discrete_stiffness_n_per_m: Stiffness = 0.0
    discrete_damping_n_s_per_m: Damping = 0.0
    analog_stiffness_n_per_m: Stiffness = 0.0
    analog_damping_n_s_per_m: Damping = 0.0
    joint_stiffness_n_m_per_rad: tuple[JointStiffness, ...] = ()
    joint_damping_n_m_s_per_rad: tuple[JointDamping, ...] = ()
    command_path: Annotated[CommandPath, WORD] = CommandPath.CMD
    onset: Annotated[Onset, WORD] = Onset.WALL
    gain_ramp_samples: int = Field(default=0, ge=0, le=1000)
    jitter_share: float = Field(default=0.01, ge=0, le=0.45)
    delay_periods: int = Field(default=0, ge=0, le=1000)
    delay_fraction: float = Field(default=0.0, ge=0, lt=1)
    law: str | None = None
    encoder: Encoder = Encoder.model_construct()
    dac: Dac = Dac.model_construct()
    velocity: Velocity = Velocity.model_construct()


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
    opamp: Annotated[Level, WORD] = Level.IDEAL
    opamp_slew: bool = False
    opamp_saturation: bool = False
    opamp_offset: bool = False
    vca: Annotated[Level, WORD] = Level.IDEAL
    vca_gain_error: bool = False
    vca_offset: bool = False
    vca_nonlinearity: bool = False
    differentiator: Annotated[Differentiator, WORD] = Differentiator.IDEAL
    driver: Annotated[Drive, WORD] = Drive.VOLTAGE
    driver_level: Annotated[Level, WORD] = Level.IDEAL
    driver_limit: bool = False
    motor: Annotated[MotorLevel, WORD] = MotorLevel.IDEAL
    potentiometer: Annotated[PotLevel, WORD] = PotLevel.IDEAL
    temperature: bool = False
    pot_noise: Annotated[PotNoise, WORD] = PotNoise.NONE
    pot_linearity: bool = False
    pot_calibration: bool = False
    component_noise: bool = False
    encoder: bool = False
    dac: bool = False
    dac_settling: bool = False
    dac_skew: bool = False
    delay: bool = False
    period_jitter: Annotated[Jitter, WORD] = Jitter.NONE
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

    model: Annotated[CircuitModelName, WORD] = CircuitModelName.AUTO
    rtol: float = Field(default=1e-4, ge=1e-12, le=0.1)  # rounding ends what less would buy
    max_step_s: Step = 2e-3
    method: Annotated[Integration, WORD] = Integration.GEAR
    coupling_tolerance_rad: Annotated[float, Field(ge=1e-14, le=0.1), Unit("rad")] = 1e-7
    band_hz: Frequency = 1000.0
    reduction_tolerance: float = Field(default=1e-6, ge=1e-14, le=0.1)
    charge_tolerance_c: Annotated[float, Field(ge=1e-21, le=1e-3), Unit("C")] = 1e-9  # six electrons
    time_limit_s: Annotated[float, Field(ge=1e-3, le=1e6), Unit("s")] = 600.0
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
    operator: Operator = NoOperator.model_construct()
    effects: Effects = Effects.model_construct()
    tolerance: Tolerance = Tolerance.model_construct()
    solver: Solver = Solver.model_construct()
    record: Record = Record.model_construct()
    measures: Measures = Measures.model_construct()
