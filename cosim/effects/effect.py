"""What an effect is: something that a scene asks for, or that is not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.design_constants import Stated
from cosim.scene import Scene
from cosim.scene.schema import CHOICES
from cosim.units import quantity

#: Every circuit model; those that know the circuit's dynamics; and the one that bends.
ALL = frozenset({"ideal", "linear", "spice"})
DYNAMIC = frozenset({"linear", "spice"})
#: Models of effects that no linear model can carry.
SPICE = frozenset({"spice"})


@dataclass(frozen=True)
class Size:
    """How large an effect is before anything has run.

    Attributes
    ----------
    value, unit : the effect's own quantity: a delay, a step, a weight
    force_n : estimate from above of what it changes in the force at the fingertip [N]; always finite. Of a
        force that stays: one that sets in at once makes an undamped wall swing by up to twice as much
    text : what the value is, in a few words
    source : equation, paper or data sheet that leads from the value to the force
    """

    value: float
    unit: str
    force_n: float
    text: str
    source: str

    def __str__(self) -> str:
        """Return the size in a line."""
        return (
            f"{quantity(self.value, self.unit)} {self.text}; up to "
            f"{quantity(self.force_n, 'N', 2)} ({self.source})"
        )


@dataclass(frozen=True)
class Cost:
    """What an effect adds where it is in force.

    Attributes
    ----------
    events_per_s : further instants in a second of simulated time on which the integration must land
    states : further states of the circuit
    text : in words
    """

    events_per_s: float
    states: int
    text: str


def free(scene: Scene, constants: Stated) -> Cost:
    """Return the cost of an effect that only changes numbers."""
    return Cost(0.0, 0, "nothing")


def nothing(state: np.void, scene: Scene) -> NDArray[np.float64]:
    """Pack an effect that needs nothing in the loops' record."""
    return np.zeros(0)


def always(scene: Scene) -> str:
    """Return that nothing is missing."""
    return ""


@dataclass(frozen=True)
class Effect:
    """One effect of `[effects]`.

    Attributes
    ----------
    name : key in `[effects]`
    null : its null form, as the scene spells it
    on : what it can be instead, the usual value first
    home : where it lives ('netlist', 'linkage', 'computer', 'potentiometer', 'operator')
    models : circuit models that can carry it below its level `full`, where it has levels
    size : a-priori size as a function of the scene and of what its board states; of the value in force, or
        of the usual value where the effect is off
    cost : what it adds, as a function of the same
    lacks : what the scene does not state that the effect would need, in words; '' when nothing is missing
    requires : names of effects without which this one means nothing; asking for it without them is an error
    excludes : names of effects that cannot be in force together with it
    at_full : circuit models that can carry its level `full`
    keys : keys of the scene that act through it alone
    pack : puts it, where it is in force, into the record of both loops (`cosim.loop.state.STATE`), whose last
        tick is known by then; returns what it drew, which must live as long as the record
    fresh_intervals : whether no two intervals between events are the same, so that no map serves twice
    not_held : what theory of a held contact leaves out of it, in words; '' where nothing is
    not_exported : why no exported deck can carry it; '' where one can
    not_monolithic : what of it a monolithic deck cannot carry; '' where it can
    """

    name: str
    null: str | bool
    on: tuple[str | bool, ...]
    home: str
    models: frozenset[str]
    size: Callable[[Scene, Stated], Size]
    cost: Callable[[Scene, Stated], Cost] = free
    lacks: Callable[[Scene], str] = always
    requires: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    at_full: frozenset[str] = frozenset({"spice"})
    keys: tuple[str, ...] = ()
    pack: Callable[[np.void, Scene], NDArray[np.float64]] = nothing
    fresh_intervals: bool = False
    not_held: str = ""
    not_exported: str = ""
    not_monolithic: str = ""

    @property
    def design(self) -> bool:
        """Whether its settings are other devices or experiments, not finer models of one.

        ``effects = "auto"`` leaves it as the scene states it.
        """
        return self.name in CHOICES

    def value(self, scene: Scene) -> Any:
        """Return the setting of the scene: a word or a truth value."""
        value = getattr(scene.effects, self.name)
        return getattr(value, "value", value)

    def carriers(self, scene: Scene) -> frozenset[str]:
        """Return the circuit models that can carry the scene's setting."""
        if not self.is_in_force(scene):
            return ALL
        return self.at_full if self.value(scene) == "full" else self.models

    def is_in_force(self, scene: Scene) -> bool:
        """Whether the scene asks for more than the null form."""
        return bool(self.value(scene) != self.null)
