"""Measures within a tolerance: model, steps and tolerances of the solver are chosen for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from cosim.accuracy.estimate import estimator
from cosim.catalogue import OF_A_RUN, UNITS
from cosim.caution import Caution, collected, warn
from cosim.comparisons.measure_values import Measured, Measurer, measure, run_with_measures
from cosim.errors import InputError, Problem, nearest
from cosim.measures import Tolerance, amount
from cosim.ngspice.child import Child
from cosim.plan import Plan, resolve
from cosim.results import Run
from cosim.runner import Errors
from cosim.scene import CircuitModelName
from cosim.types import Measures

__all__ = ["Wanted", "measurer_within", "parse_tolerances", "run_within", "shortfalls"]

T = TypeVar("T")

#: Measures whose error no solver setting can reduce.
_WITHOUT = frozenset({"ledger_closure", "headroom"})
#: How often solver settings are tightened before a tolerance counts as out of reach.
_LEVELS = 5
#: Our own loop begins with steps four times those of the scene: a run that misses takes milliseconds, and
#: where measures need no rows in between (press) the longer ones do. With ngspice a vain run is too dear.
_FIRST_LEVEL = -1


@dataclass(frozen=True)
class Wanted:
    """Tolerances: of some measures, or one for all (`every`).

    Attributes
    ----------
    by_name : measure -> tolerance
    every : share that all measures must meet; None where only those named count
    of : measures that `every` applies to; None for all that a run has
    """

    by_name: Mapping[str, Tolerance]
    every: float | None = None
    of: Collection[str] | None = None

    def names(self, measures: Measures) -> list[str]:
        """Return the measures of a run that have a tolerance."""
        every = [name for name in measures if self.of is None or name in self.of]
        return [*dict.fromkeys([*self.by_name, *(every if self.every is not None else ())])]

    def missed(self, measures: Measures) -> dict[str, str]:
        """Return the measures whose error is too large or unknown, with that error."""
        out = {}
        for name in self.names(measures):
            row = measures.get(name)
            asked = self.by_name.get(name)
            if row is None:
                out[name] = "this run has none"
            elif name in _WITHOUT and asked is None:
                continue
            elif row.get("error") is None:
                out[name] = str(row.get("no_error", "its error is not known"))
            else:
                allowed = self.allowed(name, row)
                if row["error"] > allowed:
                    out[name] = f"error {row['error']:.2g}, allowed {allowed:.2g} {row['unit']}".rstrip()
        return out

    def allowed(self, name: str, row: Mapping[str, Any]) -> float:
        """Return the error that is allowed of a measure, in its unit."""
        asked, value = self.by_name.get(name), float(row["value"])
        return asked.allowed(value) if asked else (self.every or 0.0) * abs(value)


def parse_tolerances(texts: Sequence[str]) -> Wanted:
    """Parse ``1e-3`` (a share, of every measure) and ``NAME=AMOUNT`` (``0.1%``, ``0.05 N``, a share).

    Raises
    ------
    InputError
        For anything else, and for what is given twice, all of it at once.
    """
    by_name: dict[str, Tolerance] = {}
    every: float | None = None
    problems = []
    for text in texts:
        name, given, written = text.rpartition("=")
        name = name.strip()
        amount = _amount(written, UNITS.get(name, ""))
        if not given:
            if amount is None or not amount.relative or amount.size > 1.0:
                problems.append(_problem("is not a share", text))
            elif every is not None:
                problems.append(_problem("is a second share for every measure", text))
            else:
                every = amount.size
        elif name in _WITHOUT:
            problems.append(_problem("no setting of the solver makes this measure more accurate", text))
        elif name not in OF_A_RUN:
            near = nearest(name, OF_A_RUN)
            problems.append(
                _problem(f"no such measure of a run{f'; nearest is {near}' if near else ''}", text)
            )
        elif amount is None:
            problems.append(_problem("is not an amount of this measure", text))
        elif name in by_name:
            problems.append(_problem("is a second tolerance of this measure", text))
        else:
            by_name[name] = amount
    if problems:
        raise InputError(problems)
    return Wanted(by_name, every)


def _amount(text: str, unit: str) -> Tolerance | None:
    """Return an amount; a number alone is a share, and above 1 an amount whose unit was forgotten: None."""
    try:
        size = float(text)
    except ValueError:
        return amount(text, unit)
    return Tolerance(size, True) if 0.0 < size <= 1.0 else None


def _problem(message: str, text: str) -> Problem:
    return Problem(message, key="--tol", value=text, allowed="1e-3, NAME=0.1%, or NAME=AMOUNT with its unit")


def run_within(
    plan: Plan,
    out: str | Path | None,
    wanted: Wanted,
    *,
    free: bool = True,
    child: Child | None = None,
    **more: Any,
) -> Run:
    """Run a plan so that the estimated errors of its measures are within tolerances.

    Tolerances and steps are tightened until the estimates fit. What cannot be reached is a caution, and the
    last run is kept.

    Parameters
    ----------
    plan, out, child, more
        As `cosim.runner.run` takes them.
    free
        Whether the cheapest model that carries the scene replaces the one that the scene states.
    """

    def attempt(tried: Plan, errors: Errors) -> tuple[Run, Measures]:
        result = run_with_measures(tried, out, child=child, errors=errors, **more)
        return result, result.measures

    result, cautions = _refined(plan, wanted, free, child, attempt)
    warn(*cautions)
    return result


def measurer_within(wanted: Wanted, *, free: bool = True) -> Measurer:
    """Return a stand-in for `cosim.comparisons.measure_values.measure` that keeps tolerances.

    Rows have their 'error'; what cannot be reached is among the warnings.
    """

    def measured(
        plan: Plan, names: Collection[str], *, child: Child | None = None, lenient: bool = False
    ) -> Measured:
        def attempt(tried: Plan, errors: Errors) -> tuple[Measured, Measures]:
            outcome = measure(tried, names, child=child, lenient=lenient, errors=errors)
            return outcome, outcome.of_a_run

        best, cautions = _refined(plan, wanted, free, child, attempt)
        return replace(best, warnings=(*best.warnings, *(c for c in cautions if c not in best.warnings)))

    return measured


def _refined(
    plan: Plan,
    wanted: Wanted,
    free: bool,
    child: Child | None,
    attempt: Callable[[Plan, Errors], tuple[T, Measures]],
) -> tuple[T, list[Caution]]:
    """Run a plan with ever tighter settings until its measures are within tolerances or nothing helps."""
    level, tries = _FIRST_LEVEL, 0
    while True:
        with collected(forward=False) as heard:
            tried = _at_level(plan, wanted, level, free)
            if level < 0 and tried.model == "spice":
                level = 0
                tried = _at_level(plan, wanted, level, free)
            result, measures = attempt(tried, estimator(tried, child))
        tries += 1
        missed = wanted.missed(measures)
        if not missed or not _could_shrink(missed, measures) or level == _LEVELS - 1:
            return result, [*heard, *shortfalls(missed, f", after {tries} run(s)")]
        level = min(level + _steps(wanted, measures), _LEVELS - 1)


def shortfalls(missed: Mapping[str, str], when: str = "") -> list[Caution]:
    """Return the cautions about measures that are not within their tolerance, of `Wanted.missed`."""
    return [
        Caution(
            "tolerance-missed",
            f"{name} is not known to be within its tolerance{when}: {why}",
            "allow more; cosim accuracy tells what each setting reaches",
        )
        for name, why in missed.items()
    ]


def _steps(wanted: Wanted, measures: Measures) -> int:
    """Return how many levels to tighten at once: each divides the errors by ten or somewhat more."""
    ratios = [row["error"] / wanted.allowed(name, row) for name in wanted.names(measures)
              if (row := measures.get(name)) and row.get("error") and wanted.allowed(name, row)]  # fmt: skip
    return max(1, math.floor(math.log10(max(ratios, default=1.0))))


def _at_level(plan: Plan, wanted: Wanted, level: int, free: bool) -> Plan:
    """Return the plan with tolerances that many times tightened, and every measure that is wanted."""
    scene, solver = plan.scene, plan.scene.solver
    tight = 10.0**-level
    update: dict[str, Any] = {
        "max_step_s": max(solver.max_step_s * 4.0**-level, 1e-9),
        "rtol": max(solver.rtol * tight, 1e-9),
        "coupling_tolerance_rad": max(solver.coupling_tolerance_rad * tight, 1e-14),
        "charge_tolerance_c": max(solver.charge_tolerance_c * tight, 1e-18),
    }
    if free:
        update["model"] = CircuitModelName.AUTO
    names = scene.measures.names
    if names and wanted.every is None:
        names = tuple(dict.fromkeys([*names, *wanted.by_name]))
    changes = {
        "solver": solver.model_copy(update=update if level else {"model": update.get("model", solver.model)}),
        "measures": scene.measures.model_copy(update={"names": names}),
    }
    tried = resolve(scene.model_copy(update=changes), trust=plan.trust, board=plan.board)
    return replace(tried, cautions=plan.cautions, choice=plan.choice)


def _could_shrink(missed: Mapping[str, str], measures: Measures) -> bool:
    """Whether smaller steps may bring a measure that misses its tolerance within it."""
    return any(measures.get(name, {}).get("error") is not None for name in missed)
