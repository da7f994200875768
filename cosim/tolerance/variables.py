"""Which components of a device vary, how, and by which independent random variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.scene import Scene

__all__ = ["Component", "Tolerances", "tolerances"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Component:
    """One placed component, or one number of the mechanics, that varies.

    Attributes
    ----------
    key
        ``xdiff1.r11``: the value of a flattened element; ``xdiff1.xop:tl072_gbw``: a parameter of one placed
        part; ``scene:device.chain.masses_kg[0]``: a number of the scene.
    nominal, unit
        Value as designed, SI, and its unit.
    distribution
        In words.
    lots
        Names of the shared draws that it takes part in.
    file, line
        Where its tolerance stands.
    """

    key: str
    nominal: float
    unit: str
    distribution: str
    lots: tuple[str, ...] = ()
    file: str = ""
    line: int = 0


@dataclass(frozen=True)
class Tolerances:
    """All that varies of a device.

    Attributes
    ----------
    components
        What varies, in the order of the columns of `values`.
    variables
        Names of the independent random variables: own draws and shared ones.
    """

    components: tuple[Component, ...] = ()
    variables: tuple[str, ...] = ()

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
        return np.broadcast_to(self.nominal, (len(uniforms), len(self.components))).copy()


def tolerances(scene: Scene, **_: Any) -> Tolerances:
    """Return what varies of a scene's device.

    Raises
    ------
    InputError
        With all that is wrong with the tolerances.
    """
    return Tolerances()
