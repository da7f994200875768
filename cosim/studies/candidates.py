"""What ``effects = "auto"`` chooses from: every effect's settings, their a-priori size and cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cosim.effects import EFFECTS, Effect
from cosim.errors import InputError
from cosim.plan import Plan, resolve
from cosim.scene import load_scene

Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Rung:
    """One setting of an effect above its null form; `step` counts from 1."""

    effect: Effect
    value: Any
    step: int

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.effect.name} = {str(self.value).lower()}"


def ladder(effect: Effect) -> tuple[Rung, ...]:
    """Return the settings of an effect from coarse to fine.

    The fewer circuit models can carry a setting, the more of the circuit it holds. Settings that the same
    models carry are readings of one thing, of which the usual one stands first.
    """
    known: dict[frozenset[str], Any] = {}
    for value in effect.on:
        known.setdefault(effect.at_full if value == "full" else effect.models, value)
    finer = sorted(known, key=len, reverse=True)
    return tuple(Rung(effect, known[models], step) for step, models in enumerate(finer, 1))


class Candidates:
    """The settings that a scene leaves open, and the plan of every choice among them.

    Parameters
    ----------
    path, overrides, trust
        The scene, as for `load_scene` and `resolve`; what its table `[effects]` states is fixed.

    Attributes
    ----------
    scene : as stated, `effects` still to be chosen
    fixed : name -> why it is not chosen, for every effect that the scene decides
    null : settings with every open effect in its null form
    refused : rung's name -> why it cannot be in this scene
    """

    def __init__(self, path: str | Path, overrides: tuple[str, ...] = (), *, trust: bool = False) -> None:
        self._path, self._overrides, self._trust = path, overrides, trust
        self._plans: dict[tuple[Any, ...], Plan] = {}
        self.scene = load_scene(path, overrides)
        stated = self.scene.effects.model_fields_set
        self.fixed = {
            effect.name: "stated by the scene" if effect.name in stated else "a choice of the device"
            for effect in EFFECTS
            if effect.design or effect.name in stated
        }
        self.null: Settings = {
            effect.name: effect.value(self.scene) if effect.name in stated else effect.null
            for effect in EFFECTS
        }
        self.refused: dict[str, str] = {}
        self.rungs = tuple(self._possible())

    def _possible(self) -> list[Rung]:
        found = []
        for effect in EFFECTS:
            for rung in () if effect.name in self.fixed else ladder(effect):
                try:
                    self.plan(self.with_(self.null, rung))
                except InputError as error:
                    self.refused[rung.name] = "; ".join(problem.message for problem in error.problems)
                else:
                    found.append(rung)
        return found

    def with_(self, settings: Settings, *rungs: Rung) -> Settings:
        """Return the settings with these rungs in place."""
        return {**settings, **{rung.effect.name: rung.value for rung in rungs}}

    def above(self, settings: Settings) -> list[Rung]:
        """Return the rungs that are finer than what is set."""
        at = {r.effect.name: r.step for r in self.rungs if settings[r.effect.name] == r.value}
        return [rung for rung in self.rungs if rung.step > at.get(rung.effect.name, 0)]

    def everything(self) -> Settings:
        """Return the settings with the finest possible rung of every effect.

        Where two effects exclude one another, the one that stands first in the registry is in.
        """
        settings = self.null
        for rung in self.rungs:
            try:
                self.plan(self.with_(settings, rung))
            except InputError:
                continue
            settings = self.with_(settings, rung)
        return settings

    def plan(self, settings: Settings) -> Plan:
        """Return the plan of a choice, with all measures.

        Raises
        ------
        InputError
            For settings that do not go together, with the scene or with its circuit model.
        """
        key = tuple(settings.items())
        if key not in self._plans:
            stated = [f"effects.{name}={_toml(value)}" for name, value in settings.items()]
            scene = load_scene(self._path, [*self._overrides, *stated, "effects.auto=false"])
            scene = scene.model_copy(update={"tolerance": {}})
            self._plans[key] = resolve(scene, trust=self._trust)
        return self._plans[key]

    def seconds(self, settings: Settings) -> float:
        """Return the predicted time of a run: never measured, so that the choice is the same everywhere."""
        return self.plan(settings).cost()["seconds"]

    def by_size(self) -> list[Rung]:
        """Return all rungs by a-priori size per predicted second; those of unknown size first."""

        def key(rung: Rung) -> tuple[bool, float]:
            size = self.size_n(rung)
            return size is not None, -(size or 0.0) / self.seconds(self.with_(self.null, rung))

        return sorted(self.rungs, key=key)

    def size_n(self, rung: Rung) -> float | None:
        """Return the a-priori size of a rung as a force at the tip [N]; ``None`` if it is not known."""
        return getattr(self._size(rung), "force_n", None)

    def size_text(self, rung: Rung) -> str:
        """Return the a-priori size in words."""
        return str(self._size(rung))

    def _size(self, rung: Rung) -> Any:
        return rung.effect.size(self.plan(self.with_(self.null, rung)).scene)


def all_measures(plan: Plan) -> Plan:
    """Return the plan with every measure, whatever the scene wants to see."""
    scene = plan.scene
    return replace(
        plan, scene=scene.model_copy(update={"measures": scene.measures.model_copy(update={"names": ()})})
    )


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"'
