"""The tolerance bill: what each component costs in yield, and what a better one would gain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.tolerance.intervals import Estimate, clopper_pearson, share
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.sensitivity import Surface, deviations
from cosim.tolerance.spec import Spec
from cosim.types import Array

__all__ = ["GRADES", "Line", "best_pair", "bill", "bought", "gained", "grade_text"]

#: Tolerance grades in which components are sold.
GRADES = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.10, 0.20)
#: Leading resistors of which pairs are tried.
_CANDIDATES = 6


@dataclass(frozen=True)
class Line:
    """One random variable: a component's own deviation, or a lot's.

    Attributes
    ----------
    name, tolerance
        Its name, and what it is now.
    share
        Share of the variance of each measure.
    slope
        Change of each measure for 1 % of the component's value, or for its whole tolerance where that is no
        share; in the measure's unit.
    loosest
        Largest grade with which the specifications are met by the share of devices asked for, all else as it
        is; ``None``: not even the present one, nor a better one, does.
    better, gain
        The next better grade, and the yield it adds.
    """

    name: str
    tolerance: str
    share: Mapping[str, Estimate]
    slope: Mapping[str, float]
    loosest: float | None
    better: float | None
    gain: Estimate | None


def bill(
    study: Study, surfaces: Mapping[str, Surface], specs: Sequence[Spec], wanted: float | None = None
) -> list[Line]:
    """Return the bill, what costs most variance first.

    Other tolerances are looked at on the same samples through the fitted surfaces, what these leave
    unexplained kept as it is; the yield's change is counted sample by sample.

    Parameters
    ----------
    study, surfaces
        Samples, and the fitted surface of each measure that has one.
    specs
        Of measures with a surface.
    wanted
        Yield that the loosest tolerance must keep; the present one by default.
    """
    specs = [spec for spec in specs if spec.measure in surfaces]
    uniforms = study.uniforms()
    z = deviations(study.tolerances, uniforms)
    known = np.ones(len(z), dtype=bool)
    for spec in specs:
        known &= np.isfinite(study.column(spec.measure))
    z = z[known]
    base = {spec.measure: study.column(spec.measure)[known] for spec in specs}
    now = _passed(specs, base)
    target = float(np.mean(now)) if wanted is None else wanted
    shares = {name: surface.shares() for name, surface in surfaces.items()}
    lines = []
    for j, name in enumerate(study.tolerances.variables):
        shape = study.tolerances.shape(j)
        size = max(shape.high, -shape.low)
        sigma = shape.moments()[1]
        per = 0.01 if shape.relative else size
        better = max((g for g in GRADES if g < size * (1 - 1e-9)), default=None) if shape.relative else None

        def at(factor: float, j: int = j) -> NDArray[np.bool_]:
            moved = z.copy()
            moved[:, j] *= factor
            return _passed(
                specs,
                {m: y + surfaces[m](moved) - surfaces[m](z) for m, y in base.items()},
            )

        loosest, gain = None, None
        if specs and shape.relative and size > 0.0:
            loosest = max((g for g in GRADES if float(np.mean(at(g / size))) >= target - 1e-12), default=None)
            gain = gained(now, at(better / size)) if better is not None else None
        lines.append(
            Line(
                name,
                shape.text(),
                {m: shares[m][j] for m in surfaces},
                {m: float(surface.linear[j]) * per / sigma for m, surface in surfaces.items()},
                loosest,
                better,
                gain,
            )
        )
    lines.sort(key=lambda line: -max((each.value for each in line.share.values()), default=0.0))
    return lines


def bought(
    study: Study, surfaces: Mapping[str, Surface], specs: Sequence[Spec], grades: Mapping[str, float]
) -> Estimate:
    """Return the yield with other tolerances of some variables at once, through the fitted surfaces."""
    return share(_passing(study, surfaces, specs, grades), study.sampling)


def _passing(
    study: Study, surfaces: Mapping[str, Surface], specs: Sequence[Spec], grades: Mapping[str, float]
) -> NDArray[np.bool_]:
    """Return which samples pass with other tolerances of some variables (n,)."""
    specs = [spec for spec in specs if spec.measure in surfaces]
    z = deviations(study.tolerances, study.uniforms())
    moved = z.copy()
    for name, grade in grades.items():
        j = study.tolerances.variables.index(name)
        shape = study.tolerances.shape(j)
        moved[:, j] *= grade / max(shape.high, -shape.low)
    values = {
        s.measure: study.column(s.measure) + surfaces[s.measure](moved) - surfaces[s.measure](z)
        for s in specs
    }
    return _passed(specs, values)


def best_pair(
    study: Study, surfaces: Mapping[str, Surface], specs: Sequence[Spec], grade: float = 0.001
) -> tuple[tuple[str, str], Estimate, bool] | None:
    """Return the two resistors that raise the yield most when both are bought at `grade`.

    Behind them that yield, and whether it is surely more than the present one: of the same samples, by
    McNemar's exact test at 5 %. ``None`` where there are no two, or no specification of a measure with a
    surface.
    """
    specs = [spec for spec in specs if spec.measure in surfaces]
    names = study.tolerances.variables
    resistors = {
        each.key for each in study.tolerances.components if each.unit == "Ohm" and ":" not in each.key
    }
    weight = np.zeros(len(names))
    for spec in specs:
        weight += (surfaces[spec.measure].linear / surfaces[spec.measure].total) ** 2
    leading = [names[j] for j in np.argsort(-weight, kind="stable") if names[j] in resistors]
    pairs = list(combinations([name for name in leading if _looser(study, name, grade)][:_CANDIDATES], 2))
    if not specs or not pairs:
        return None
    # of equal ones the first: the most variance
    pair, best = max(((p, bought(study, surfaces, specs, dict.fromkeys(p, grade))) for p in pairs),
                     key=lambda each: each[1].value)  # fmt: skip
    now, then = (_passing(study, surfaces, specs, grades) for grades in ({}, dict.fromkeys(pair, grade)))
    won, lost = int(np.sum(then & ~now)), int(np.sum(now & ~then))
    sure = won > lost and float(scipy.stats.binomtest(won, won + lost).pvalue) < 0.05
    return pair, best, sure


def _looser(study: Study, name: str, grade: float) -> bool:
    shape = study.tolerances.shape(study.tolerances.variables.index(name))
    return shape.relative and shape.high > grade


def _passed(specs: Sequence[Spec], values: Mapping[str, Array]) -> NDArray[np.bool_]:
    every = [spec.passed(values[spec.measure]) for spec in specs]
    return np.asarray(np.all(every, axis=0)) if every else np.ones(1, dtype=bool)


def gained(before: NDArray[np.bool_], after: NDArray[np.bool_]) -> Estimate:
    """Return the change of a yield on the same samples; exact bounds of what is won and what is lost."""
    n = len(before)
    won, lost = int(np.sum(after & ~before)), int(np.sum(before & ~after))
    up, down = (clopper_pearson(count, n, 0.975) for count in (won, lost))
    value = (won - lost) / n
    return Estimate(value, max(up[0] - down[1], -1.0), min(up[1] - down[0], 1.0), "same samples")


def grade_text(grade: float | None) -> str:
    """Return a grade as it is sold."""
    return "-" if grade is None or math.isnan(grade) else f"{100.0 * grade:g}%"
