"""Numbers that a scene may hold: each with its unit and the range that is allowed."""

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError


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


# Limits are far outside of anything built; they exist to catch a value written in a wrong unit, and so that
# squares and quotients of what is allowed are finite and not zero.
Duration = Annotated[float, Field(ge=1e-9, le=1e5), Unit("s")]
Period = Annotated[float, Field(ge=1e-6, le=10), Unit("s")]
Lag = Annotated[float, Field(ge=0, le=1), Unit("s")]
Step = Annotated[float, Field(ge=1e-9, le=1), Unit("s")]
Time = Annotated[float, Field(ge=0, le=1e5), Unit("s")]
Length = Annotated[float, Field(ge=1e-6, le=10), Unit("m")]
Along = Annotated[float, Field(ge=0, le=10), Unit("m")]
Place = Annotated[float, Field(ge=-20, le=20), Unit("m")]
Mass = Annotated[float, Field(ge=0, le=1e3), Unit("kg")]
RealMass = Annotated[float, Field(ge=1e-12, le=1e3), Unit("kg")]
Inertia = Annotated[float, Field(ge=0, le=1e3), Unit("kg m^2")]
Angle = Annotated[float, Field(ge=-100, le=100), Unit("rad")]
SmallAngle = Annotated[float, Field(ge=0, le=0.5), Unit("rad")]
AngleSpan = Annotated[float, Field(ge=1e-3, le=100), Unit("rad")]
Rate = Annotated[float, Field(ge=-1e4, le=1e4), Unit("rad/s")]
PositiveRate = Annotated[float, Field(ge=1e-9, le=1e4), Unit("rad/s")]
Torque = Annotated[float, Field(ge=0, le=1e3), Unit("N m")]
JointStiffness = Annotated[float, Field(ge=0, le=1e7), Unit("N m/rad")]
JointDamping = Annotated[float, Field(ge=0, le=1e4), Unit("N m s/rad")]
Restitution = Annotated[float, Field(ge=0, le=1)]
Stiffness = Annotated[float, Field(ge=0, le=1e7), Unit("N/m")]
Damping = Annotated[float, Field(ge=0, le=1e5), Unit("N s/m")]
Force = Annotated[float, Field(ge=-1e4, le=1e4), Unit("N")]
Gravity = Annotated[float, Field(ge=-100, le=100), Unit("m/s^2")]
Frequency = Annotated[float, Field(ge=1e-6, le=1e7), Unit("Hz")]
Temperature = Annotated[float, Field(ge=-55, le=150), Unit("C")]
Volts = Annotated[float, Field(ge=1e-6, le=1e3), Unit("V")]
Vector = Annotated[tuple[float, float], AfterValidator(_normalised)]
Point = tuple[Place, Place]
