"""Measures by name: the scene is run only where one of them needs it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from cosim.catalogue import ALL_NAMES, AND, ETA_OF, NAMES, OF_A_RUN, find, needing_no_run
from cosim.caution import Caution
from cosim.errors import InputError, Problem, nearest
from cosim.measures import own_measures
from cosim.ngspice.child import Child
from cosim.ngspice.deck import Deck
from cosim.plan import Plan
from cosim.results import Run
from cosim.runner import Errors, run
from cosim.storage.staging import scratch_folder

__all__ = [
    "Measured",
    "Measurer",
    "check_blocks",
    "check_measures",
    "measure",
    "needs_a_run",
    "run_with_measures",
]

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Measured:
    """Measures of a plan.

    Attributes
    ----------
    rows : name -> {value, unit, text}; of a run all that it has, whatever was asked for
    lacking : measure that the scene or its board does not have -> why
    cpu_s : processor time of the run [s], 0 where none was needed
    warnings : doubts about the run
    of_a_run : those of the rows that a run gave
    """

    rows: Mapping[str, Row]
    lacking: Mapping[str, str]
    cpu_s: float
    warnings: tuple[Caution, ...] = ()
    of_a_run: Mapping[str, Row] = field(default_factory=dict)


class Measurer(Protocol):
    """A function that measures a plan, as `measure` does."""

    def __call__(
        self, plan: Plan, names: Collection[str], *, child: Child | None = None, lenient: bool = False
    ) -> Measured:
        """Return the measures of a plan."""


def needs_a_run(names: Iterable[str]) -> bool:
    """Whether one of the measures comes from a simulation."""
    return any(name in OF_A_RUN or ":" in name for name in names)


def measure(
    plan: Plan,
    names: Collection[str],
    *,
    child: Child | None = None,
    lenient: bool = False,
    errors: Errors | None = None,
) -> Measured:
    """Measure a plan; its result is not kept.

    Parameters
    ----------
    plan, names, lenient
        As for `board_measures`.
    errors
        As for `cosim.runner.run`.

    Raises
    ------
    InputError
        Where the basis of a measure that needs no run is missing, unless `lenient`.
    SimulationError
        When the run fails.
    """
    rows, lacking = _without_a_run(plan, names, child, lenient)
    if not needs_a_run(names):
        return Measured(rows, lacking, 0.0)
    with scratch_folder("measure") as folder:
        result = run(all_measures(plan), folder / "run", formats=(), child=child, errors=errors)
        warnings, cpu_s = tuple(result.warnings), float(result.stats["cpu_s"])
        return Measured({**result.measures, **rows}, lacking, cpu_s, warnings, result.measures)


def _without_a_run(
    plan: Plan, names: Iterable[str], child: Child | None, lenient: bool = False
) -> tuple[Mapping[str, Row], Mapping[str, str]]:
    """Return measures that need no run, and why others are lacking."""
    names = needing_no_run(names)
    if not names:
        return {}, {}
    from cosim.comparisons.board_measures import board_measures

    return board_measures(plan, names, child=child, lenient=lenient)


def run_with_measures(plan: Plan, out: str | Path | None, *, child: Child | None = None, **more: Any) -> Run:
    """Run a plan and keep with the result what its scene's `[measures]` names beside a run's own measures.

    Takes what `runner.run` takes, and raises what it and `measure` raise; what needs no run comes first.
    """
    check_blocks(plan.scene.measures.names, (plan.board,), "measures.names")
    rows, _ = _without_a_run(plan, plan.scene.measures.names, child)
    return run(plan, out, child=child, more=rows, **more)


def all_measures(plan: Plan) -> Plan:
    """Return the plan with every measure of a run and the user's own, whatever the scene asks for."""
    scene = plan.scene
    own = scene.measures.model_copy(update={"names": tuple(own_measures(scene))})
    return replace(plan, scene=scene.model_copy(update={"measures": own}))


def check_measures(names: Iterable[str]) -> None:
    """Raise an `InputError` for every unknown name of ``--measure``."""
    problems = [
        Problem(
            "no such measure" + (f"; nearest is {near}" if (near := nearest(name, NAMES)) else ""),
            key="--measure",
            value=name,
            allowed=ALL_NAMES,
        )
        for name in names
        if find(name) is None and ":" not in name  # `resolve` looks at the user's own
    ]
    if problems:
        raise InputError(problems)


def check_blocks(names: Iterable[str], boards: Iterable[Deck], key: str = "--measure") -> None:
    """Raise an `InputError` for every share of `eta` of a block that none of the boards has."""
    asked = [name for name in names if name not in NAMES and find(name) is not None]
    if not asked:
        return
    from cosim.circuits.extraction.block_delays import groups_of

    groups = tuple(dict.fromkeys(group for board in boards for group in groups_of(board)))
    problems = []
    for name in asked:
        near = [
            f"{group}; nearest is {nearest(group, groups)}" if nearest(group, groups) else group
            for group in name.removeprefix(ETA_OF).split(AND)
            if group not in groups
        ]
        if near:
            allowed = f"{ETA_OF}BLOCK of {', '.join(groups)}, or of several: {ETA_OF}A{AND}B"
            reason = f"the board has no block {', no '.join(near)}"
            problems.append(Problem(reason, None, key, name, allowed=allowed))
    if problems:
        raise InputError(problems)
