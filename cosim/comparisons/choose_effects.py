"""``effects = "auto"``: as many effects as the stated tolerance needs, and no more.

1. From the null form of everything, the effects whose a-priori size reaches the tolerance are switched on one
   at a time, by size per predicted second, each on top of what is in already. One that moves a measure by
   more than the tolerance stays in, any other is out.
2. The largest effect that is out is switched on over the whole choice; if it moves a measure after all, it is
   put in, and the next largest is tried.
3. Everything that is out is switched on at once, where its predicted time allows: many small effects may add
   up to more than the tolerance. If they do, the largest are put in until what is left holds.

Costs are predicted and noise is seeded, so that a scene leads to the same choice on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from cosim.catalogue import OF_A_RUN
from cosim.comparisons.effect_candidates import Candidates, Rung, Settings
from cosim.comparisons.measure_values import measure
from cosim.effects import EFFECTS
from cosim.errors import InputError, Problem
from cosim.measures import Tolerance, tolerances
from cosim.ngspice.child import Child
from cosim.plan import Plan
from cosim.provenance import effects_digest
from cosim.scene.load import SceneLike
from cosim.types import Measures
from cosim.units import quantity

#: With all effects on the scene is run for comparison if its predicted time is at most this [s].
CHECK_S = 60.0
#: A force below this counts as zero.
_NOTHING_N = 1e-12


@dataclass(frozen=True)
class Move:
    """What switching something on does to the measures with a tolerance.

    Attributes
    ----------
    share : largest change over the change allowed; above 1 it matters
    measure : where that is
    text : in words
    """

    share: float
    measure: str
    text: str


@dataclass(frozen=True)
class Decision:
    """Why a setting of an effect is in force or left out.

    Attributes
    ----------
    effect, value : name in `[effects]` and setting
    in_force : whether it is in
    why : in words
    size_n, size : a-priori size over the choice [N at the tip], and in words
    seconds : predicted time of a run of the choice with it
    share : measured change over the change allowed, where it was run
    """

    effect: str
    value: Any
    in_force: bool
    why: str
    size_n: float | None = None
    size: str = ""
    seconds: float | None = None
    share: float | None = None


@dataclass
class _Search:
    """State of the search: what was run, and what was learnt about each rung."""

    candidates: Candidates
    tolerances: Mapping[str, Tolerance]
    child: Child | None
    on_progress: Callable[[str], None] | None
    known: dict[tuple[Any, ...], Measures] = field(default_factory=dict)
    moves: dict[str, Move] = field(default_factory=dict)
    cpu_s: float = 0.0

    def measures(self, settings: Settings, name: str) -> Measures:
        key = tuple(settings.items())
        if key not in self.known:
            if self.on_progress is not None:
                self.on_progress(name)
            measured = measure(
                self.candidates.plan(settings), (*OF_A_RUN, *self.tolerances), child=self.child
            )
            self.known[key] = measured.rows
            self.cpu_s += measured.cpu_s
        return self.known[key]

    def force_n(self, settings: Settings) -> float:
        """Return the tolerance as a force: the strictest share of a measure, of the largest force."""
        measures = self.measures(settings, "")
        peak = float(measures["peak_force"]["value"])
        shares = [
            tolerance.allowed(value) / abs(value)
            for name, tolerance in self.tolerances.items()
            if name in measures and (value := float(measures[name]["value"])) != 0.0
        ]
        return min(shares, default=0.0) * peak

    def on_top(self, settings: Settings, rung: Rung) -> Move:
        """Switch a rung on over the settings and remember what it does."""
        before = self.measures(settings, "")
        after = self.measures(self.candidates.with_(settings, rung), f"with {rung.name}")
        self.moves[rung.name] = move = self.move(before, after)
        return move

    def move(self, before: Measures, after: Measures) -> Move:
        moves = [self._move(name, before, after) for name in self.tolerances]
        return max(moves, key=lambda move: move.share)

    def _move(self, name: str, before: Measures, after: Measures) -> Move:
        words = name.replace("_", " ")
        if (name in before) != (name in after):
            return Move(float("inf"), name, f"{words} {'appears' if name in after else 'vanishes'}")
        if name not in after:
            return Move(0.0, name, f"{words} is not there")
        first, last = float(before[name]["value"]), float(after[name]["value"])
        allowed, change = self.tolerances[name].allowed(last), abs(last - first)
        share = 0.0 if change == 0.0 else change / allowed if allowed > 0.0 else float("inf")
        if self.tolerances[name].relative:
            size = f"{100 * change / abs(last):.2g} %" if last else f"{change:.2g}"
        else:
            size = f"{change:.2g} {after[name]['unit']}".strip()
        return Move(share, name, f"{words} by {size}")

    def score(self, settings: Settings, rung: Rung) -> float:
        seconds = self.candidates.seconds(self.candidates.with_(settings, rung))
        return self.candidates.size(rung, settings).force_n / seconds


def choose(
    path: SceneLike,
    overrides: tuple[str, ...] = (),
    *,
    child: Child | None = None,
    trust: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> tuple[Plan, float]:
    """Choose the effects of a scene that says ``effects = "auto"``.

    Parameters
    ----------
    path, overrides, trust
        The scene, as for `load_scene` and `resolve`.
    child
        A simulation process to use for all runs.
    on_progress
        Called with a few words before every run.

    Returns
    -------
    plan : Plan
        With the effects stated one by one and `choice` telling why.
    cpu_s : float
        Processor time of the runs that it took [s].

    Raises
    ------
    InputError
        For a tolerance of a measure that this scene does not have.
    SimulationError
        When a run fails.
    """
    candidates = Candidates(path, overrides, trust=trust, child=child)
    search = _Search(candidates, tolerances(candidates.scene), child, on_progress)
    search.measures(candidates.null, "with no effect")
    chosen = _add_by_size(search, candidates.null)
    chosen, largest_error = _verify_largest(search, chosen)
    chosen, error = _verify_all(search, chosen)
    _check_measures(search, chosen)
    plan = candidates.plan(chosen)
    digest = effects_digest(plan.scene)
    record = {
        "tolerance": {name: dict(vars(t)) for name, t in search.tolerances.items()},
        "decisions": [vars(decision) for decision in decisions(search, chosen)],
        "verified": [largest_error, error],
        "runs": len(search.known),
        "effects_digest": digest,
    }
    return replace(plan, choice=record), search.cpu_s


def _add_by_size(search: _Search, settings: Settings) -> Settings:
    """Try what may matter a priori, the largest per predicted second first."""
    while True:
        least_n = search.force_n(settings)
        left = [
            rung
            for rung in search.candidates.possible(settings)
            if rung.name not in search.moves
            and search.candidates.size(rung, settings).force_n >= max(least_n, _NOTHING_N)
        ]
        if not left:
            return settings
        best = left[0]
        for rung in left:
            if search.score(settings, rung) > search.score(settings, best):
                best = rung
        if search.on_top(settings, best).share > 1.0:
            settings = search.candidates.with_(settings, best)


def _verify_largest(search: _Search, settings: Settings) -> tuple[Settings, str]:
    while True:
        left = _open(search, settings)
        if not left:
            return settings, "nothing that the scene leaves open is left out"
        force_n, largest = max(
            ((search.candidates.size(rung, settings).force_n, rung) for rung in left),
            key=lambda pair: pair[0],
        )
        move = search.on_top(settings, largest)
        if move.share <= 1.0:
            return settings, (
                f"with {largest.name}, a priori the largest that is left out "
                f"({quantity(force_n, 'N', 2)}), switched on "
                f"over this choice, the measures move by {move.share:.2g} of the tolerance ({move.text})"
            )
        settings = _add_by_size(search, search.candidates.with_(settings, largest))


def _open(search: _Search, settings: Settings) -> list[Rung]:
    """Return the rungs that could be switched on and have a size."""
    candidates = search.candidates
    return [r for r in candidates.possible(settings) if candidates.size(r, settings).force_n > _NOTHING_N]


def _verify_all(search: _Search, settings: Settings) -> tuple[Settings, str]:
    everything = search.candidates.everything()
    seconds = search.candidates.seconds(everything)
    if dict(everything) == dict(settings):
        return settings, "all effects that the scene leaves open are in force"
    if seconds > CHECK_S:
        return settings, (
            f"all that is left out at once was not run: predicted {quantity(seconds, 's')}, more "
            f"than {quantity(CHECK_S, 's', 4)}"
        )
    full = search.measures(everything, "with every effect")
    move = search.move(search.measures(settings, ""), full)
    if move.share > 1.0:
        settings = _add_until(search, settings, full)
        move = search.move(search.measures(settings, ""), full)
    return settings, (
        f"with all that is left out switched on at once, the measures move by {move.share:.2g} of the "
        f"tolerance ({move.text})"
    )


def _add_until(search: _Search, settings: Settings, full: Measures) -> Settings:
    """Put in what moves the measures most, one after another, until the rest together does not matter."""
    while left := search.candidates.possible(settings):
        moves = [search.on_top(settings, rung).share for rung in left]
        settings = search.candidates.with_(settings, left[moves.index(max(moves))])
        if search.move(search.measures(settings, ""), full).share <= 1.0:
            break
    return settings


def _check_measures(search: _Search, settings: Settings) -> None:
    """Refuse a tolerance of a measure that the chosen run does not have: it was never looked at."""
    measures = search.measures(settings, "")
    missing = [name for name in search.tolerances if name not in measures]
    if missing:
        scene = search.candidates.scene
        raise InputError(
            Problem(
                "this scene has no such measure (steady figures need contact in the last fifth of the run)",
                file=scene.file_name,
                key=f"tolerance.{name}",
                value=str(scene.tolerance.measures[name]),
                allowed=", ".join(measures),
            )
            for name in missing
        )


def decisions(search: _Search, chosen: Settings) -> list[Decision]:
    """Return why each setting of each effect is in or out, in the order of the registry."""
    candidates, rows = search.candidates, []
    above = candidates.above(chosen)
    least_n = search.force_n(chosen)
    for effect in EFFECTS:
        if effect.name in candidates.fixed:
            value, why = chosen[effect.name], candidates.fixed[effect.name]
            rows.append(Decision(effect.name, value, value != effect.null, why))
        for rung in (r for r in candidates.rungs if r.effect is effect):
            if rung in above or chosen[effect.name] == rung.value:  # else a finer setting is in force
                rows.append(_decided(search, chosen, rung, rung not in above, least_n))
        rows += [
            Decision(name, value, False, f"not possible here: {why}")
            for (name, value), why in candidates.refused.items()
            if name == effect.name
        ]
    return rows


def _decided(search: _Search, chosen: Settings, rung: Rung, in_force: bool, least_n: float) -> Decision:
    candidates, move = search.candidates, search.moves.get(rung.name)
    name, value = rung.effect.name, rung.value
    try:
        size = candidates.size(rung, chosen)
        seconds = candidates.seconds(candidates.with_(chosen, rung))
    except InputError as error:  # what it requires is left out, or what it excludes is in
        return Decision(name, value, False, error.in_brief)
    if move is None:
        why = (
            f"not run: a priori up to {quantity(size.force_n, 'N', 2)}, the tolerance is "
            f"{quantity(least_n, 'N', 2)}"
        )
        if size.force_n <= _NOTHING_N:
            why = "nothing to switch on"
    else:
        why = f"moves {move.text}" if move.share > 0.0 else "changes nothing"
        if in_force and move.share <= 1.0:
            why += "; one of many that together exceed the tolerance"
    share = None if move is None or move.share == float("inf") else move.share
    return Decision(name, value, in_force, why, size.force_n, str(size), seconds, share)
