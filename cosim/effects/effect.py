"""What an effect is: something that a scene asks for, or that is not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cosim.scene import Scene

#: Every circuit model; and those that know the circuit's dynamics.
ALL = frozenset({"ideal", "linear", "spice"})
DYNAMIC = frozenset({"linear", "spice"})


@dataclass(frozen=True)
class Effect:
    """One effect of `[effects]`.

    Attributes
    ----------
    name : key in `[effects]`
    null : its null form, as the scene spells it
    on : what it can be instead, the usual value first
    home : where it lives ('netlist', 'linkage', 'computer', 'potentiometer')
    models : circuit models that can carry it below its level `full`, where it has levels
    cost : what it adds where it is in force, in words
    at_full : circuit models that can carry its level `full`
    size : a-priori size, as a function of the scene, in words with a number and its source
    """

    name: str
    null: str | bool
    on: tuple[str | bool, ...]
    home: str
    models: frozenset[str]
    cost: str
    size: Callable[[Scene], str]
    at_full: frozenset[str] = frozenset({"spice"})

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
