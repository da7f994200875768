"""What a Monte Carlo study tells, ready for table, file and page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.catalogue import UNITS
from cosim.notebook_view import view
from cosim.tolerance.bill import Line, best_pair, bill, grade_text
from cosim.tolerance.border_strata import STRATA
from cosim.tolerance.corner_search import Corner
from cosim.tolerance.intervals import Estimate
from cosim.tolerance.listing import CONVENTION, component_rows
from cosim.tolerance.missing import text_of
from cosim.tolerance.model_levels import Levels
from cosim.tolerance.monte_carlo import Study, Summary, passed, summary, worst, yields
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.rare_study import Rare
from cosim.tolerance.sensitivity import GOOD, Surface, fit_surface
from cosim.tolerance.spec import Spec
from cosim.units import heading, quantity

__all__ = ["MOST_LOOKED_AT", "Findings", "components_csv", "estimate_dict", "find", "summary_dict"]


#: Samples that the bill, the decision and what a page shows of single components look at, at most.
MOST_LOOKED_AT = 1 << 16


@dataclass(frozen=True)
class Findings:
    """A study with all that is said about it.

    Attributes
    ----------
    study, specs
        What was measured, and what devices must be.
    summaries, surfaces, corners
        By measure that two samples have at least; a surface only where there are samples enough.
    yields
        By specification.
    bill
        What each random variable costs.
    wanted
        Yield that the bill's loosest tolerances keep; the present one where it is None.
    levels
        What a cheaper model adds; summaries and yields are corrected by it where that pays.
    rare
        Failures that are too rare for samples.
    """

    study: Study
    specs: tuple[Spec, ...]
    summaries: Mapping[str, Summary]
    yields: Mapping[str, Estimate]
    surfaces: Mapping[str, Surface]
    bill: tuple[Line, ...]
    wanted: float | None = None
    corners: Mapping[str, Corner] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    levels: Levels | None = None
    rare: Rare | None = None

    def plot(self, name: str = "distribution", measure: str | None = None) -> Any:
        """Return a matplotlib figure of a measure, the first where none is named.

        Parameters
        ----------
        name
            'distribution', 'estimate' (mean of the first samples), 'blame' or 'leading' (components).

        Raises
        ------
        ValueError
            For an unknown name or measure, or a measure without a fitted surface.
        """
        return view("findings_figure", self, name, measure)

    def _repr_html_(self) -> str:
        """Return yields, distribution and the head of the bill, for notebooks."""
        text: str = view("findings_html", self)
        return text

    @property
    def in_tables(self) -> frozenset[str]:
        """Those of the notes whose figures a page has in its tables: of two models, and of rare failures."""
        lines = _of_levels(self.levels) if self.levels is not None and self.levels.moments else []
        lines += _of_rare(self.rare, _units(self.study)) if self.rare is not None and self.rare.places else []
        return frozenset(lines)

    def correlation(self) -> NDArray[np.float64]:
        """Return the correlation of the measures that are summed up, NaN where too few devices have all."""
        table = np.array([self.study.column(name) for name in self.summaries])
        known = np.isfinite(table).all(axis=0)
        if known.sum() < 2:
            return np.full((len(table), len(table)), np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.atleast_2d(np.corrcoef(table[:, known]))

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, JSON-ready; infinite ends of intervals are None."""
        study = self.study
        return {
            "model": study.model,
            "sampling": study.sampling.as_dict(),
            "seconds": study.seconds,
            "convention": CONVENTION,
            "components": component_rows(study.tolerances),
            "variables": list(study.tolerances.variables),
            "measures": {name: summary_dict(each) for name, each in self.summaries.items()},
            "specs": [
                {"measure": s.measure, "low": _finite(s.low), "high": _finite(s.high)} for s in self.specs
            ],
            "yields": {text: estimate_dict(each) for text, each in self.yields.items()},
            "missing": {str(k): dict(each) for k, each in study.failures.items()},
            "surfaces": {name: _surface(each) for name, each in self.surfaces.items()},
            "bill": [_line(line) for line in self.bill],
            "worst_case": {name: asdict(corner) for name, corner in self.corners.items()},
            "worst": {name: worst(study, name) for name in study.names},
            "notes": list(self.notes),
            **({"two_level": self.levels.as_dict()} if self.levels is not None else {}),
            **({"rare": self.rare.as_dict()} if self.rare is not None else {}),
        }

    def samples_csv(self) -> str:
        """Return all samples: measures, whether they pass, and why some are missing."""
        units = (heading(name, UNITS.get(name, "")) for name in self.study.names)
        columns = ["sample", *units, "pass", "missing"]
        verdict = passed(self.study, self.specs)
        rows = (
            [k, *("" if math.isnan(v) else repr(float(v)) for v in row), int(verdict[k]),
             text_of(self.study.failures.get(k, {}))]
            for k, row in enumerate(self.study.results)
        )  # fmt: skip
        return _csv(columns, rows)

    def bill_csv(self) -> str:
        """Return the tolerance bill, one row a random variable."""
        names = list(self.surfaces)
        columns = [
            "component", "tolerance", *(f"share of variance of {n}" for n in names),
            *(f"interval of it, {n}" for n in names), *(f"change of {n} by 1 %" for n in names),
            "loosest tolerance", "next better", "yield it adds", "interval of it",
        ]  # fmt: skip
        rows = [
            [
                line.name, line.tolerance, *(line.share[n].value for n in names),
                *(f"{line.share[n].low:.6g} to {line.share[n].high:.6g}" for n in names),
                *(line.slope[n] for n in names), grade_text(line.loosest), grade_text(line.better),
                "" if line.gain is None else line.gain.value,
                "" if line.gain is None else f"{line.gain.low:.6g} to {line.gain.high:.6g}",
            ]
            for line in self.bill
        ]  # fmt: skip
        return _csv(columns, rows)


def find(
    study: Study,
    specs: Sequence[Spec],
    *,
    wanted: float | None = None,
    corners: Mapping[str, Corner] | None = None,
    notes: Sequence[str] = (),
    levels: Levels | None = None,
    rare: Rare | None = None,
) -> Findings:
    """Work a study out.

    Raises
    ------
    InputError
        Where fewer than two samples have any of the measures.
    """
    seen = [name for name in study.names if np.isfinite(study.column(name)).sum() > 1] or study.names
    summaries = {name: summary(study, name) for name in seen}
    fitted = {name: fit_surface(study, name) for name in seen}
    surfaces = {name: surface for name, surface in fitted.items() if surface is not None}
    notes_of, few = [*notes], study.thinned(MOST_LOOKED_AT)
    notes_of += [f"{name}: fewer than two devices have it" for name in study.names if name not in seen]
    if few is not study:
        notes_of.append(
            f"sensitivities and the bill look at {few.sampling.n} of the {study.sampling.n} samples, the "
            "first of each randomisation; mean, deviation, quantiles and yield at all of them"
        )
    for name, surface in fitted.items():
        if surface is None:
            count = len(study.tolerances.variables)
            notes_of.append(
                f"{name}: no sensitivities; {count} random variables need at least {count + 12} samples, and "
                "a measure that changes"
            )
        elif surface.explained < GOOD:
            notes_of.append(
                f"{name}: the fitted surface explains R^2 = {surface.explained:.4g} of samples that it was "
                f"not fitted to, less than {GOOD:g}: shares and bill are rough; more samples help"
            )
    notes_of += _decision(few, surfaces, specs)
    shares = yields(study, specs)
    if levels is not None:
        summaries = {name: _corrected(each, levels) for name, each in summaries.items()}
        shares |= {text: each.passing for text, each in levels.yields.items()}
        notes_of += _of_levels(levels)
    notes_of += _of_rare(rare, _units(study)) if rare is not None else []
    return Findings(
        study, tuple(specs), summaries, shares, surfaces,
        tuple(bill(few, surfaces, specs, wanted)), wanted, dict(corners or {}), tuple(notes_of), levels,
        rare,
    )  # fmt: skip


def _corrected(summary: Summary, levels: Levels) -> Summary:
    """Return mean and standard deviation by two models, where these pay."""
    moments = levels.moments.get(summary.name)
    if moments is None or moments.word:
        return summary
    how = f"{levels.dear} corrected by {levels.cheap}"
    mean = Estimate(moments.mean, moments.mean_low, moments.mean_high, how)
    spread = Estimate(moments.spread, moments.spread_low, moments.spread_high, how)
    return replace(
        summary,
        mean=mean if mean.half < summary.mean.half else summary.mean,
        spread=spread if spread.half < summary.spread.half else summary.spread,
    )


def _of_levels(levels: Levels) -> list[str]:
    """Say what two models gave, and where one of them had to do."""
    dear, cheap = levels.seconds
    if not levels.moments:
        return [f"no measure needs a run: {levels.dear} and {levels.cheap} would tell the same"]
    lines = [f"a sample takes {dear:.3g} s on {levels.dear} and {cheap:.3g} s on {levels.cheap}"]
    for name, each in levels.moments.items():
        if each.word:
            lines.append(f"{name}: {each.word}")
            continue
        pilot = each.pilot
        lines.append(
            f"{name}: correlation of both models {pilot.correlation:.5f}, of the squares "
            f"{pilot.of_squares:.5f}; {each.dear} samples on {levels.dear}, {each.cheap} on {levels.cheap}: "
            f"variance times cost {pilot.gain():.3g} of plain sampling for the mean, "
            f"{pilot.gain(squares=True):.3g} for the standard deviation, at the best split of plain samples"
            + (
                f"; a plane of known moments leaves {each.beside_plane:.2g} of {levels.cheap}'s variance"
                if each.beside_plane < 1.0
                else ""
            )
        )
    for text, share in levels.yields.items():
        agreed = f"{share.correlation:.4f}" if math.isfinite(share.correlation) else "not known, no failure"
        counted = ", ".join(
            f"{name} {100 * weight:.3g} % ({failed} of {count} failed)"
            for name, weight, failed, count in zip(
                STRATA, share.weights, share.failed, share.counted, strict=True
            )
        )
        what = "all specifications" if text == "all" else text
        lines.append(f"yield, {what}: by {share.by}, {counted}; correlation of passing {agreed}")
        if share.word:
            lines.append(f"yield, {what}: {share.word}")
    return lines


def _units(study: Study) -> dict[str, str]:
    return {each.key: each.unit for each in study.tolerances.components}


def _of_rare(rare: Rare, units: Mapping[str, str]) -> list[str]:
    """Say how rare failures are, and which device fails first."""
    if not rare.places:
        return [f"rare failures: {rare.word}"]
    leading = list(rare.device.items())[:3]
    nearest = ", ".join(f"{key} = {quantity(value, units[key], 5)}" for key, value in leading)
    lines = [
        f"rare failures: {rare.rate.value:.3g} ({rare.rate.low:.3g} to {rare.rate.high:.3g}) of the devices, "
        f"by {rare.samples} samples on {rare.model}, {rare.effective:.1f} effective; first order on "
        f"{rare.cheap}: {rare.first_order:.3g}, {rare.distance:.3g} standard deviations away at {nearest}"
    ]
    return [*lines, *([f"rare failures: {rare.word}"] if rare.word else [])]


def _decision(study: Study, surfaces: Mapping[str, Surface], specs: Sequence[Spec]) -> list[str]:
    """Say which two resistors to buy better."""
    pair = best_pair(study, surfaces, specs)
    if pair is None:
        return []
    (a, b), share, sure = pair
    if not sure:
        return [
            f"no two resistors at 0.1% surely raise the yield: with the best, {a} and {b}, it becomes "
            f"{100 * share.value:.4g} % through the fitted surfaces; look at what else has a large share"
        ]
    return [
        f"{a} and {b} bought at 0.1%: the yield becomes {100 * share.value:.4g} % ({100 * share.low:.4g} to "
        f"{100 * share.high:.4g}), through the fitted surfaces"
    ]


def components_csv(tolerances: Tolerances) -> str:
    """Return what varies, one row a component."""
    rows = component_rows(tolerances)
    return _csv(list(rows[0]) if rows else [], [list(row.values()) for row in rows])


def summary_dict(of: Summary) -> dict[str, Any]:
    """Return a summary, JSON-ready."""
    return {
        "nominal": of.nominal,
        "unit": UNITS.get(of.name, ""),
        "mean": estimate_dict(of.mean),
        "standard_deviation": estimate_dict(of.spread),
        "quantiles": {f"{share:g}": estimate_dict(each) for share, each in of.quantiles.items()},
        "least": of.least,
        "largest": of.largest,
        "lacking": of.lacking,
    }


def estimate_dict(of: Estimate) -> dict[str, Any]:
    """Return an estimate, JSON-ready; infinite ends are None."""
    return {"value": _finite(of.value), "low": _finite(of.low), "high": _finite(of.high), "how": of.how}


def _surface(of: Surface) -> dict[str, Any]:
    return {
        "held_out_r2": _finite(of.held_out),
        "r2_of_the_shares": _finite(of.explained),
        "mean": of.mean,
        "linear": dict(zip(of.names, map(float, of.linear), strict=True)),
        "second": [
            [of.names[a], of.names[b], float(c)] for (a, b), c in zip(of.terms, of.second, strict=True)
        ],
    }


def _line(line: Line) -> dict[str, Any]:
    return {
        "name": line.name,
        "tolerance": line.tolerance,
        "share": {name: estimate_dict(each) for name, each in line.share.items()},
        "slope": dict(line.slope),
        "loosest": line.loosest,
        "better": line.better,
        "gain": None if line.gain is None else estimate_dict(line.gain),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return stream.getvalue()
