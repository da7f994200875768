"""The paper's one-joint device: a drum that pulls a slider."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mech.linkage import Array, Linkage
from mech.parameter_checks import Checker, ParameterError, Refusal

__all__ = ["Slider"]


@final
@dataclass(frozen=True, kw_only=True)
class Slider(Linkage):
    """The paper's one-joint device (Fig. 5): a drum pulls a slider along a line.

    The coordinate is the drum's angle q; tip = origin + radius q direction.

    Parameters
    ----------
    radius_m
        Of the drum.
    mass_kg
        That slides.
    direction
        Of the line, any length but zero.

    Raises
    ------
    ParameterError
        With every refused parameter.

    Examples
    --------
    >>> Slider(radius_m=0.01, mass_kg=0.1).forward([2.0]).tolist()  # m
    [0.02, 0.0]
    """

    radius_m: float
    mass_kg: float
    direction: Sequence[float] = (1.0, 0.0)

    def __post_init__(self) -> None:
        check = Checker()
        check.number("radius_m", self.radius_m, above=0.0)
        check.number("mass_kg", self.mass_kg, least=0.0)
        direction = check.numbers("direction", self.direction, 2, spread=False)
        size = math.hypot(*direction)
        if not size > 0.0:
            check.refuse("direction", self.direction, "other than zero")
            size = 1.0
        self._store(direction=tuple(x / size for x in direction))
        self._check(check, 1)
        check.done()
        if not self.mass_kg * self.radius_m**2 + self._fixed_kg_m2[0] > 0.0:
            allowed = "> 0, unless a rotor with inertia is fixed to the drum"
            raise ParameterError([Refusal("mass_kg", self.mass_kg, allowed)])

    @property
    def reach_m(self) -> tuple[float, float]:
        """Least and greatest distance of the fingertip from the origin [m]: the line has no end."""
        return 0.0, math.inf

    @property
    def size_m(self) -> float:
        """Radius of the drum [m]."""
        return self.radius_m

    def _record(self) -> np.ndarray[Any, Any]:
        record = self._pack()
        p = record[0]
        p["slider"] = 1
        p["direction"] = self.direction
        p["length"][0] = self.radius_m
        p["couple"][0, 0] = self.mass_kg * self.radius_m**2
        p["moment"][0] = self.mass_kg * self.radius_m
        return record

    def _seed(self, target: Array, elbow: int) -> Array:
        return np.zeros(1)

    def _geometric(self, jac: Array, force: Array) -> Array:
        return np.zeros((1, 1))

    def _where(self) -> str:
        (x, y), (dx, dy) = self.origin_m, self.direction
        return f"on the slider's line through ({x:g}, {y:g}) m along ({dx:g}, {dy:g})"
