"""Mechanics of the device: linkage, friction, operators. Knows no circuit.

Importing it costs numpy only; the compiled kernels (`mech.kernels`) are loaded, or built, at the first use.
"""

from mech.chain import Chain
from mech.linkage import Linkage
from mech.operator import Hand, NoOperator, Operator, PointMass, UserOperator, load_user
from mech.parameter_checks import ParameterError
from mech.slider import Slider

__all__ = [
    "Chain",
    "Hand",
    "Linkage",
    "NoOperator",
    "Operator",
    "ParameterError",
    "PointMass",
    "Slider",
    "UserOperator",
    "load_user",
]
