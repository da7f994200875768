"""What ``effects = "auto"`` chooses from: every effect's settings, their a-priori size and cost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from cosim.catalogue import UNITS
from cosim.effects import EFFECTS, Effect, Size, features, levels, temperature_c
from cosim.effects.scale import scale
from cosim.errors import InputError
from cosim.measures import tolerances
from cosim.ngspice.child import Child
from cosim.ngspice.deck import Deck
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from cosim.scene.load import SceneLike

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
    child
        A simulation process to ask for what a board states.

    Attributes
    ----------
    scene : as stated, `effects` still to be chosen
    fixed : name -> why it is not chosen, for every effect that the scene decides
    null : settings with every open effect in its null form
    refused : (effect, value) -> why it cannot be in this scene
    rungs : what may be switched on
    """

    def __init__(
        self,
        path: SceneLike,
        overrides: tuple[str, ...] = (),
        *,
        trust: bool = False,
        child: Child | None = None,
    ) -> None:
        self._path, self._overrides, self._trust, self._child = path, overrides, trust, child
        self._plans: dict[tuple[Any, ...], Plan | InputError] = {}
        self._boards: dict[tuple[Any, ...], Deck] = {}  # by what the effects make of the netlist
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
        self.plan(self.null)  # raises what is wrong with the scene itself
        self.refused: dict[tuple[str, Any], str] = {}
        self.rungs: tuple[Rung, ...] = ()
        for effect in EFFECTS:
            if effect.name not in self.fixed:
                self._add(effect)

    def _add(self, effect: Effect) -> None:
        for rung in ladder(effect):
            reason = effect.lacks(self.scene) or self._objection(self.with_(self._needed(effect), rung))
            if reason:
                self.refused[effect.name, rung.value] = reason
            else:
                self.rungs = (*self.rungs, rung)

    def _needed(self, effect: Effect) -> Settings:
        """Return the null form with the effects without which this one means nothing."""
        known = {each.name: each for each in EFFECTS}
        settings, wanted = self.null, list(effect.requires)
        while wanted:
            other = known[wanted.pop()]
            if settings[other.name] == other.null:
                settings = {**settings, other.name: other.on[0]}
                wanted += other.requires
        return settings

    def _objection(self, settings: Settings) -> str:
        try:
            self.plan(settings)
        except InputError as error:
            return error.in_brief
        return ""

    def with_(self, settings: Settings, *rungs: Rung) -> Settings:
        """Return the settings with these rungs in place."""
        return {**settings, **{rung.effect.name: rung.value for rung in rungs}}

    def above(self, settings: Settings) -> list[Rung]:
        """Return the rungs that are finer than what is set."""
        at = {r.effect.name: r.step for r in self.rungs if settings[r.effect.name] == r.value}
        return [rung for rung in self.rungs if rung.step > at.get(rung.effect.name, 0)]

    def possible(self, settings: Settings) -> list[Rung]:
        """Return those of them that can be switched on now: nothing that they require is off."""
        return list(self._possible(settings))

    def _possible(self, settings: Settings) -> Iterator[Rung]:
        for rung in self.above(settings):
            if not self._objection(self.with_(settings, rung)):  # a plan each: no more than are asked for
                yield rung

    def everything(self) -> Settings:
        """Return the settings with the finest possible rung of every effect.

        Where two effects exclude one another, the one that stands first in the registry is in.
        """
        settings = self.null
        while (rung := next(self._possible(settings), None)) is not None:
            settings = self.with_(settings, rung)
        return settings

    def plan(self, settings: Settings) -> Plan:
        """Return the plan of a choice.

        Raises
        ------
        InputError
            For settings that do not go together, with the scene or with its circuit model.
        """
        key = tuple(settings.items())
        if key not in self._plans:
            stated = [f"effects.{name}={_toml(value)}" for name, value in settings.items()]
            try:
                scene = load_scene(self._path, [*self._overrides, *stated, "effects.auto=false"])
                netlist = (*levels(scene).items(), features(scene), temperature_c(scene))
                board = self._boards.get(netlist)
                plan = resolve(
                    scene.model_copy(update={"tolerance": scene.tolerance.without_measures()}),
                    trust=self._trust,
                    board=board,
                )
                plan.stated(self._child)
                self._boards[netlist] = plan.board
                self._plans[key] = plan
            except InputError as error:
                self._plans[key] = error
        known = self._plans[key]
        if isinstance(known, InputError):
            raise known
        return known

    def seconds(self, settings: Settings) -> float:
        """Return the predicted time of a run: a measured one would let machines choose differently."""
        return self.plan(settings).cost()["seconds"]

    def size(self, rung: Rung, settings: Settings) -> Size:
        """Return the a-priori size of a rung over the settings."""
        plan = self.plan(self.with_(settings, rung))
        return rung.effect.size(plan.scene, plan.stated())

    def force_n(self) -> float:
        """Return the order of magnitude of the force at the tip, before anything has run [N]."""
        plan = self.plan(self.everything())
        return scale(plan.scene, plan.stated()).force_n

    def tolerance_n(self) -> float:
        """Return the force that matters, before anything has run [N]: the strictest tolerance's."""
        force = self.force_n()
        forces = [
            tolerance.allowed(force)
            for name, tolerance in tolerances(self.scene).items()
            if tolerance.relative or UNITS[name] == "N"
        ]
        return min(forces, default=0.0)

    def ranked(self) -> list[tuple[Rung, Plan, Size]]:
        """Return all rungs, with plan and size over what they require, by size per predicted second."""
        order = []
        for rung in self.rungs:
            settings = self._needed(rung.effect)
            order.append((rung, self.plan(self.with_(settings, rung)), self.size(rung, settings)))
        return sorted(order, key=lambda row: -row[2].force_n / row[1].cost()["seconds"])


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"'
