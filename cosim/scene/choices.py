"""Words that a scene may choose from."""

from enum import StrEnum


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
