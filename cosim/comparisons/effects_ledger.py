"""The effects ledger: each effect switched on alone and off alone, on the same seed.

Two baselines are run, one with every effect in its null form and one with every effect in force; then each
effect is switched on alone from the first and off alone from the second. The difference in a measure is what
the effect is worth there, the difference in processor time what it costs. What is a choice of the device or
of the experiment (the kind of drive, the hand's mass) stays in both baselines as the scene states it. No
choice of effects is run twice; effects that cannot apply to the scene are listed, not run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.catalogue import OF_A_RUN
from cosim.caution import collected, warn
from cosim.comparisons.measure_values import Measurer, measure, needs_a_run
from cosim.effects import EFFECTS, Effect, features, levels, temperature_c
from cosim.errors import InputError, SimulationError
from cosim.ngspice.child import Child, start_early
from cosim.ngspice.deck import Deck
from cosim.plan import Plan, resolve
from cosim.scene import Scene, load_scene
from cosim.types import Measures

Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """One effect at one value.

    Attributes
    ----------
    effect, value : name in `[effects]` and what it was set to
    on : what it adds to every measure when it is switched on alone, with what it requires
    off : what it adds to every measure where all others are in force (they are kept while it is off)
    on_s, off_s : what it costs in seconds of processor time, alone and on top of all others
    note : why a side is empty, in words
    on_error, off_error : bounds of the solver's error of `on` and `off`, where measures have errors
    """

    effect: str
    value: str
    on: dict[str, float]
    off: dict[str, float]
    on_s: float
    off_s: float
    note: str = ""
    on_error: dict[str, float] = field(default_factory=dict)
    off_error: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class EffectsLedger:
    """The measured ledger of a scene.

    Attributes
    ----------
    null, full : measures of the two baselines
    null_s, full_s : their processor time [s]
    rows : one an effect and value
    runs : how many co-simulations were run
    not_applicable : name of an effect that was not run -> why
    lacking : measure that not every choice of effects has -> why
    """

    null: Measures
    full: Measures
    null_s: float
    full_s: float
    rows: tuple[Row, ...]
    runs: int
    not_applicable: Mapping[str, str] = field(default_factory=dict)
    lacking: Mapping[str, str] = field(default_factory=dict)


def effects_ledger(
    path: str | Path,
    overrides: tuple[str, ...] = (),
    *,
    measures: tuple[str, ...] = OF_A_RUN,
    child: Child | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
    measurer: Measurer = measure,
    trust: bool = False,
) -> EffectsLedger:
    """Measure what each effect changes and costs in a scene.

    Parameters
    ----------
    path, overrides
        The scene, as for `load_scene`. Where the scene has an effect in force, its value counts as 'on'.
    measures
        What is looked at; nothing is simulated where none of them needs a run, and all costs are 0 then.
    child
        A simulation process to use for all runs.
    on_progress
        Called with (runs done, runs in all, name) before every run.
    measurer
        What measures one choice of effects.
    trust
        Whether the netlists may hold commands and name files.

    Raises
    ------
    InputError, SimulationError
        When one of the two baselines cannot be run; a single effect that fails says so in its row.
    """
    runner = _Runner(path, overrides, measures, child, on_progress, measurer, trust)
    try:
        return _measured(runner)
    finally:
        runner.close()


def _measured(runner: _Runner) -> EffectsLedger:
    scene = load_scene(runner.path, runner.overrides)
    nothing = {effect.name: effect.value(scene) if effect.design else effect.null for effect in EFFECTS}
    apart: dict[str, str] = {}
    for effect in EFFECTS:
        trial = _with_required({**nothing, effect.name: _on(effect, scene)}, effect)
        reason = effect.lacks(scene) or runner.objection(trial)
        if reason:
            apart[effect.name] = reason
    everything = dict(nothing)
    for effect in EFFECTS:
        if effect.name not in apart and not effect.design:
            more = _with_required({**everything, effect.name: _on(effect, scene)}, effect)
            if not runner.objection(more):  # of two that exclude one another, the first is in
                everything = more
    pairs: list[tuple[Effect, Any, tuple[Settings, Settings] | str, tuple[Settings, Settings] | str]] = []
    for effect in EFFECTS:
        if effect.name in apart:
            continue
        bare = {**_with_required(nothing, effect), effect.name: effect.null}
        without = _without({**everything, effect.name: effect.null}, effect)
        for value in _values(effect, _on(effect, scene)):
            single, among = {**bare, effect.name: value}, {**everything, effect.name: value}
            excluded = runner.objection(among) or runner.objection(without)
            pairs.append(
                (
                    effect, value, runner.objection(single) or (single, bare),
                    "excluded by what is in force" if excluded else (among, without),
                )
            )  # fmt: skip
    both = [pair for _, _, *two in pairs for pair in two]
    sides = [side for pair in both if not isinstance(pair, str) for side in pair]
    runner.total = len({_key(side) for side in (nothing, everything, *sides)})
    (null, null_s), (full, full_s) = (
        runner.baseline(settings, f"{words} effect in force")
        for settings, words in ((nothing, "no"), (everything, "every"))
    )
    rows = []
    for effect, value, alone, top in pairs:
        on = runner.difference(alone, f"{effect.name} = {value} alone")
        off = runner.difference(top, f"all, with and without {effect.name} = {value}")
        if isinstance(alone, str):  # what cannot be alone can be nowhere
            off = _Change()
        note = "; ".join(dict.fromkeys(filter(None, (on.why, off.why))))
        rows.append(
            Row(
                effect.name, str(value), on.of, off.of, on.cost_s, off.cost_s, note, on.error, off.error
            )
        )  # fmt: skip
    return EffectsLedger(null, full, null_s, full_s, tuple(rows), runner.runs, apart, runner.lacking)


@dataclass(frozen=True)
class _Change:
    """What an effect changes: of each measure, what it costs [s], what went wrong, bounds of the error."""

    of: dict[str, float] = field(default_factory=dict)
    cost_s: float = 0.0
    why: str = ""
    error: dict[str, float] = field(default_factory=dict)


def _key(settings: Settings) -> tuple[tuple[str, Any], ...]:
    return tuple(sorted(settings.items()))


def _with_required(settings: Settings, effect: Effect) -> dict[str, Any]:
    """Return the settings with the effects without which this one means nothing."""
    known = {each.name: each for each in EFFECTS}
    out, wanted = dict(settings), list(effect.requires)
    while wanted:
        other = known[wanted.pop()]
        if out[other.name] == other.null:
            out[other.name] = other.on[0]
            wanted += other.requires
    return out


def _without(settings: Settings, effect: Effect) -> dict[str, Any]:
    """Return the settings without the effects that mean nothing without this one."""
    out, gone = dict(settings), {effect.name}
    while more := [each for each in EFFECTS if gone & {*each.requires} and out[each.name] != each.null]:
        out |= {each.name: each.null for each in more}
        gone |= {each.name for each in more}
    return out


class _Runner:
    """Runs choices of effects, each once."""

    def __init__(
        self,
        path: str | Path,
        overrides: tuple[str, ...],
        measures: tuple[str, ...],
        child: Child | None,
        on_progress: Callable[[int, int, str], None] | None,
        measurer: Measurer,
        trust: bool,
    ) -> None:
        self._measurer, self._trust = measurer, trust
        self.path, self.overrides, self._names = path, overrides, measures
        self.done = self.total = 0
        self.lacking: dict[str, str] = {}
        self._child, self._own, self._on_progress = child, False, on_progress
        self._boards: dict[Any, Deck] = {}
        self._plans: dict[Any, Plan | InputError] = {}
        self._known: dict[Any, tuple[Measures, float] | str] = {}

    @property
    def runs(self) -> int:
        """How many runs there were: none for measures that need none."""
        return self.done if needs_a_run(self._names) else 0

    def close(self) -> None:
        """End the process that was started here."""
        if self._own and self._child is not None:
            self._child.close()

    def _plan(self, settings: Settings) -> Plan | InputError:
        key = _key(settings)
        if key not in self._plans:
            stated = [f"effects.{name}={_toml(value)}" for name, value in settings.items()]
            try:
                scene = load_scene(self.path, [*self.overrides, *stated, "effects.auto=false"])
                at = (*levels(scene).items(), features(scene), temperature_c(scene))
                plan = resolve(
                    scene.model_copy(update={"tolerance": scene.tolerance.without_measures()}),
                    trust=self._trust,
                    board=self._boards.get(at),
                )
                self._boards[at] = plan.board
                self._plans[key] = plan
            except InputError as error:
                self._plans[key] = error
        return self._plans[key]

    def objection(self, settings: Settings) -> str:
        """Return why the settings do not go together, or with the scene; '' when they do."""
        plan = self._plan(settings)
        if isinstance(plan, InputError):
            return "; ".join(dict.fromkeys(problem.message for problem in plan.problems))
        return ""

    def baseline(self, settings: Settings, name: str) -> tuple[Measures, float]:
        """Run settings that must work."""
        plan = self._plan(settings)
        if isinstance(plan, InputError):
            raise plan
        got = self._measure(settings, name)
        if isinstance(got, str):
            raise SimulationError(f"with {name}: {got}")
        return got

    def difference(self, pair: tuple[Settings, Settings] | str, name: str) -> _Change:
        """Return what the first settings change over the second; a reason given instead is passed on."""
        if isinstance(pair, str):
            return _Change(why=pair)
        first, second = (self._measure(settings, name) for settings in pair)
        if isinstance(first, str) or isinstance(second, str):
            return _Change(why=first if isinstance(first, str) else str(second))
        (rows, cost_s), (others, other_s) = first, second
        both = [name for name in rows if name in others]
        return _Change(
            {name: float(rows[name]["value"]) - float(others[name]["value"]) for name in both},
            cost_s - other_s,
            error={
                name: float(rows[name]["error"]) + float(others[name]["error"])
                for name in both
                if rows[name].get("error") is not None and others[name].get("error") is not None
            },
        )

    def _measure(self, settings: Settings, name: str) -> tuple[Measures, float] | str:
        key = _key(settings)
        if key not in self._known:
            if self._on_progress is not None:
                self._on_progress(self.done, self.total, name)
            self.done += 1
            plan = self._plan(settings)
            if isinstance(plan, InputError):
                raise plan
            try:
                with collected(name):
                    with collected(forward=False) as heard:
                        measured = self._measurer(plan, self._names, child=self._child, lenient=True)
                    # that energy is open without velocity products is what the ledger itself has switched off
                    warn(*(each for each in heard if settings["coriolis"] or each.code != "ledger-open"))
                    warn(*(caution for caution in measured.warnings if caution.code == "tolerance-missed"))
                self.lacking |= measured.lacking
                self._known[key] = measured.rows, measured.cpu_s
            except SimulationError as error:
                self._known[key] = error.in_brief
                self.close()
                self._child, self._own = (
                    start_early("cosim.loop.early_imports"),
                    True,
                )  # the other one has ended
        return self._known[key]


def _on(effect: Effect, scene: Scene) -> Any:
    value = effect.value(scene)
    return value if value != effect.null else effect.on[0]


def _values(effect: Effect, in_force: Any) -> list[Any]:
    return [in_force, *(value for value in effect.on if value != in_force)]


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"'
