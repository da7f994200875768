"""Components that vary, and the independent random variables that move them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cosim.tolerance.recipe import Recipe

__all__ = ["Component", "Tolerances"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Component:
    """One placed component, or one number of the mechanics, that varies.

    Attributes
    ----------
    key
        ``xdiff1.r11``: the value of a flattened element; ``xdiff1.xop:tl072_gbw``: a parameter of one placed
        part or block; ``scene:device.chain.masses_kg[0]``: a number of the scene.
    nominal, unit
        Value as designed, SI, and its unit.
    distribution
        In words.
    lots
        Names of the shared draws that it takes part in.
    file, line
        Where its tolerance stands.
    recipe
        How its values come about.
    """

    key: str
    nominal: float
    unit: str
    distribution: str
    lots: tuple[str, ...] = ()
    file: str = ""
    line: int = 0
    recipe: Recipe = field(default=Recipe(0.0), repr=False, compare=False)


@dataclass(frozen=True)
class Tolerances:
    """All that varies of a device.

    Attributes
    ----------
    components
        What varies, in the order of the columns of `values`.
    variables
        Names of the independent random variables: own draws and shared ones.
    idle
        Classes of the scene's ``[tolerance]`` that nothing in force belongs to.
    """

    components: tuple[Component, ...] = ()
    variables: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the components."""
        return tuple(component.key for component in self.components)

    @property
    def nominal(self) -> Array:
        """Nominal values (components), SI."""
        return np.array([component.nominal for component in self.components], dtype=float)

    def values(self, uniforms: Array) -> Array:
        """Return the components' values, SI, of samples of the unit cube.

        Parameters
        ----------
        uniforms
            (n, variables), within (0, 1).

        Returns
        -------
        ndarray
            (n, components)
        """
        found = np.empty((len(uniforms), len(self.components)))
        for column, component in enumerate(self.components):
            found[:, column] = component.recipe.values(uniforms)
        return found

    def members(self, variable: int) -> list[int]:
        """Return the places of the components that a random variable moves."""
        return [
            place
            for place, component in enumerate(self.components)
            if any(term.variable == variable for term in component.recipe.used())
        ]
