"""Components that vary, and the independent random variables that move them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cosim.tolerance.distributions import Shape
from cosim.tolerance.value_expression import Recipe, Term
from cosim.types import Array

__all__ = ["Component", "Tolerances"]


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
    names
        Parameters or elements whose tolerance it is.
    """

    key: str
    nominal: float
    unit: str
    distribution: str
    lots: tuple[str, ...] = ()
    file: str = ""
    line: int = 0
    recipe: Recipe = field(default=Recipe(0.0), repr=False, compare=False)
    names: tuple[str, ...] = ()


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
        return self._values(len(uniforms), lambda term: term.shape.inverse(uniforms[:, term.variable]))

    def in_box(self, points: Array) -> Array:
        """Return the components' values at points of the box of all deviations.

        Parameters
        ----------
        points
            (n, variables), -1 to 1: from the least to the largest deviation of each variable, 0: none.
        """

        def deviation(term: Term) -> Array:
            x, (low, high) = points[:, term.variable], term.shape.box
            return np.where(x < 0.0, -x * low, x * high)

        return self._values(len(points), deviation)

    def _values(self, n: int, deviation: Callable[[Term], Array]) -> Array:
        values = np.empty((n, len(self.components)))
        for column, component in enumerate(self.components):
            values[:, column] = component.recipe.values(n, deviation)
        return values

    def shape(self, variable: int) -> Shape:
        """Return the deviation that a random variable stands for: of the first component that it moves."""
        for component in self.components:
            for term in component.recipe.used():
                if term.variable == variable:
                    return term.shape
        raise KeyError(variable)

    def members(self, variable: int) -> list[int]:
        """Return the places of the components that a random variable moves."""
        return [
            place
            for place, component in enumerate(self.components)
            if any(term.variable == variable for term in component.recipe.used())
        ]
