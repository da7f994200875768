"""A Monte Carlo study as a page: distributions, who is to blame, the worst devices, and what to buy."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cosim.catalogue import UNITS
from cosim.caution import Caution, grouped
from cosim.results import json_text
from cosim.storage.owned_files import manifest_of
from cosim.tolerance.bill import grade_text
from cosim.tolerance.listing import CONVENTION
from cosim.tolerance.missing import Lack, lacks
from cosim.tolerance.monte_carlo import worst
from cosim.tolerance.scene_study import RECORD
from cosim.tolerance.sensitivity import deviations
from cosim.tolerance.study_results import components_csv
from cosim.types import Array
from cosim.units import heading, quantity
from reports.page import PAGE_NAME, picture, render, write_page
from reports.sliders import SLIDERS, sliders_page
from reports.style import FAINT, FORCE, INK, JOINTS, LIMIT, Drawn, figure, legend, look
from reports.tolerance_sections import Section, Table, percent, rare_failures, two_models, value

if TYPE_CHECKING:
    from cosim.tolerance.study_results import Findings

#: Figures of a measure; the last two need a fitted surface.
PARTS = ("distribution", "estimate", "blame", "leading")
#: What is written besides the figures.
FILES, MANIFEST = (PAGE_NAME, "samples.csv", "components.csv", "bill.csv", RECORD, SLIDERS), manifest_of("mc")
#: Bars of the tornado, points of a probability plot, of a scatter and (twice) of a curve, rows of tables.
_BARS, _POINTS, _SCATTERED, _CURVE, _ROWS, _WORST = 15, 4000, 300, 150, 40, 5


def write_monte_carlo(
    findings: "Findings",
    out: Path,
    replay: str,
    digest: str,
    cautions: Sequence[Caution] = (),
    asked: Mapping[str, Any] | None = None,
    command: str = "",
) -> Path:
    """Write ``report.html`` with its figures, ``mc.json``, and tables of samples, components and bill.

    Parameters
    ----------
    findings
        The findings of the study.
    out
        Folder; made when it is absent.
    replay
        Command that measures one sample, without its number.
    digest
        What the samples depend on, kept in the record.
    cautions
        For the head of the page.
    asked
        What the study was asked, from `cosim.tolerance.replay.record_of`: it can be repeated then.
    command
        The command of the whole study, for the head of the page.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    with look():
        sections = [
            _overview(findings, replay),
            *(_measure(findings, name, replay) for name in findings.summaries),
        ]
        sections += [_bill(findings)] if findings.bill else []
        sections += [two_models(findings.levels)] if findings.levels is not None else []
        if findings.rare is not None:
            sections.append(rare_failures(findings.rare, findings.study.tolerances.components))
    html = render(
        "study.html.j2", title="Tolerances: what the built devices do",
        command=command or replay.removesuffix(" --sample"),
        summary=[*sentences(findings, beside_tables=True), CONVENTION],
        sections=sections, claims=[], warnings=grouped(cautions),
    )  # fmt: skip
    record = json_text({"digest": digest, "replay": replay, "asked": asked, **findings.as_dict()}) + "\n"
    tables = (findings.samples_csv(), components_csv(findings.study.tolerances), findings.bill_csv(), record)
    files = dict(zip(FILES[1:], tables, strict=False))
    if findings.surfaces:
        files[SLIDERS] = sliders_page(findings)
    pictures = [each for section in sections for each in section.pictures]
    return write_page(out, html, pictures, files, MANIFEST)


def draw(findings: "Findings", part: str, name: str) -> Drawn:
    """Return one figure of a measure; parts are those of `PARTS`."""
    if part == "distribution":
        return _distribution(findings, name, _known(findings, name))
    if part == "estimate":
        return _estimates(findings, name, _known(findings, name))
    return (_tornado if part == "blame" else _scatter)(findings, name)


def _known(findings: "Findings", name: str) -> Array:
    column = findings.study.column(name)
    return column[np.isfinite(column)]


def sentences(findings: "Findings", *, beside_tables: bool = False) -> list[str]:
    """Return the findings in sentences; `beside_tables`: without what the tables of a page say."""
    study = findings.study
    how = study.sampling
    kind = {"plain": "plain samples", "lhs": "Latin hypercubes", "sobol": "scrambled Sobol points"}
    lines = [
        f"{how.n} devices ({kind[how.method]}, seed {how.seed}) with {len(study.tolerances.components)} "
        f"varying components, measured on the model {study.model} in {study.seconds:.3g} s."
    ]
    for text, each in findings.yields.items():
        what = "All specifications are met" if text == "all" else f"{text} holds"
        lines.append(f"{what} for {percent(each)} of the devices ({each.how}).")
    notes = [note for note in findings.notes if not (beside_tables and note in findings.in_tables)]
    return [*lines, *(note if note.endswith(".") else f"{note}." for note in notes)]


def _overview(findings: "Findings", replay: str) -> Section:
    study = findings.study
    rows = []
    for name, each in findings.summaries.items():
        unit = UNITS.get(name, "")
        ends = [value(each.quantiles[share], unit) for share in (0.01, 0.5, 0.99)]
        rows.append(
            [name, quantity(each.nominal, unit, 5), value(each.mean, unit), value(each.spread, unit), *ends]
        )
    how = next(iter(findings.summaries.values())).mean.how
    tables = [
        Table(
            "What the devices do",
            ["measure", "nominal", "mean", "standard deviation", "1 % are below", "median", "1 % are above"],
            rows,
            f"In parentheses the interval that holds with 95 %: mean by {how}, quantiles by "
            f"{next(iter(findings.summaries.values())).quantiles[0.5].how}.",
            "samples.csv",
            stacked=True,
        )
    ]
    if findings.corners:
        rows = []
        for name, corner in findings.corners.items():
            unit = UNITS.get(name, "")
            rows.append([name, quantity(corner.low, unit, 5), quantity(corner.high, unit, 5),
                         str(corner.evaluations), str(corner.outside)])  # fmt: skip
        note = "No sample inside the limits lies beyond; those outside them are counted in the last column."
        head = ["measure", "least", "largest", "devices looked at", "samples outside the limits"]
        tables.append(Table("Worst case within all limits", head, rows, note, stacked=True))
    missing = lacks(study.failures, study.names)
    if missing:
        tables.append(_missing(findings, missing, replay))
    pictures = []
    if len(findings.summaries) > 1 and np.isfinite(findings.correlation()).any():
        pictures.append(picture("correlation", "Correlation of the measures", _correlation(findings)))
    return Section("overview", "What the batch does", (), pictures, tables)


def _missing(findings: "Findings", missing: Sequence[Lack], replay: str) -> Table:
    """Return which measures devices lack, why, and what specifications count them as."""
    rows = []
    for lack in missing:
        limits = [spec.text for spec in findings.specs if spec.measure in lack.names]
        count = "; ".join(f"not passing {text}" for text in limits) or "left out"
        rows.append(
            [lack.text, str(lack.samples), count, str(lack.first), lack.why, f"{replay} {lack.first}"]
        )
    head = ["measures", "devices without", "counted as", "first of them", "its reason", "replay"]
    note = (
        f"Of {findings.study.sampling.n} devices. They are left out of mean, deviation and quantiles; the "
        "reason of each stands in the file."
    )
    return Table(
        "Measures that devices lack", head, rows, note, "samples.csv", codes=frozenset({5}), stacked=True
    )


def _measure(findings: "Findings", name: str, replay: str) -> Section:
    study, unit = findings.study, UNITS.get(name, "")
    column = _known(findings, name)
    title = name.replace("_", " ").capitalize()
    pictures = [picture(f"{name}_distribution", "Distribution", _distribution(findings, name, column))]
    pictures.append(
        picture(f"{name}_estimate", "Estimate against samples", _estimates(findings, name, column))
    )
    if name in findings.surfaces:
        pictures.append(picture(f"{name}_tornado", "Who is to blame", _tornado(findings, name)))
        pictures.append(picture(f"{name}_scatter", "Leading components", _scatter(findings, name)))
    rows = [[str(k), quantity(value, unit, 5), f"{replay} {k}"] for k, value in worst(study, name, _WORST)]
    note = "Farthest from the nominal device; the command measures the same device again, alone."
    head = ["sample", name, "replay"]
    table = Table("Worst samples", head, rows, note, "samples.csv", codes=frozenset({2}), stacked=True)
    return Section(name, title, (), pictures, [table])


def _distribution(findings: "Findings", name: str, column: Array) -> Drawn:
    drawing, grid = figure(3.4, columns=2)
    bars, normal = grid[0]
    summary = findings.summaries[name]
    axis = heading(name.replace("_", " "), UNITS.get(name, ""))
    bars.hist(column, bins=min(60, max(10, int(2 * len(column) ** (1 / 3)))), color=FORCE, alpha=0.55)
    bars.axvline(summary.nominal, color=INK, linestyle="--", label="nominal")
    bars.axvline(summary.mean.value, color=JOINTS[1], label="mean")
    _limits(findings, name, bars.axvline)
    bars.set_xlabel(axis)
    bars.set_ylabel("devices")
    legend(bars, columns=3)
    ordered = np.sort(column)
    at = stats.norm.ppf((np.arange(1, len(ordered) + 1) - 0.375) / (len(ordered) + 0.25))
    some = _some(len(ordered), ends=True)
    normal.plot(at[some], ordered[some], ".", color=FORCE, markersize=3.0, rasterized=True, label="samples")
    ends = np.array([at[0], at[-1]])
    normal.plot(
        ends,
        summary.mean.value + summary.spread.value * ends,
        color=FAINT,
        label="Gaussian of that mean and sd",
    )
    _limits(findings, name, normal.axhline)
    normal.set_xlabel("standard deviations of a Gaussian")
    normal.set_ylabel(axis)
    caption = (
        "Left: how often; right: the same against a Gaussian, where points on the line are one and bent "
        "ends are heavier or cut tails."
    )
    return Drawn(drawing, caption)


def _some(n: int, *, ends: bool = False) -> NDArray[np.int64]:
    """Return the places of the points of n that a figure shows: all, or evenly spread ones, and the ends."""
    if n <= _POINTS:
        return np.arange(n)
    spread = np.linspace(0, n - 1, _POINTS).astype(np.int64)
    few = np.arange(_POINTS // 8)
    return np.unique(np.concatenate([spread, few, n - 1 - few])) if ends else spread


def _limits(findings: "Findings", name: str, line: object) -> None:
    label = "specification"
    for spec in findings.specs:
        for end in (spec.low, spec.high):
            if spec.measure == name and math.isfinite(end):
                line(end, color=LIMIT, linewidth=1.0, label=label)  # type: ignore[operator]
                label = "_"


def _estimates(findings: "Findings", name: str, column: Array) -> Drawn:
    drawing, grid = figure(2.6)
    axes = grid[0, 0]
    n = np.arange(1, len(column) + 1)
    mean = np.cumsum(column) / n
    square = np.cumsum((column - column[0]) ** 2) / n - (mean - column[0]) ** 2
    half = 1.96 * np.sqrt(np.maximum(square, 0.0) / n)
    first = min(10, len(column))
    # what a wide figure can show: evenly spread, and closer where the band narrows fastest
    places = np.concatenate(
        [np.geomspace(first, len(column), _CURVE), np.linspace(first, len(column), _CURVE)]
    )
    shown = np.unique(places.astype(np.int64)) - 1
    axes.plot(n[shown], mean[shown], color=FORCE, label="running mean")
    axes.fill_between(
        n[shown], (mean - half)[shown], (mean + half)[shown], color=FORCE, alpha=0.2, linewidth=0
    )
    axes.set_xlabel("samples")
    axes.set_ylabel(heading(name.replace("_", " "), UNITS.get(name, "")))
    each = findings.study.seconds / max(findings.study.sampling.n, 1)
    seconds = axes.secondary_xaxis("top", functions=(lambda x: x * each, lambda x: x / max(each, 1e-12)))
    seconds.set_xlabel("seconds")
    plain = findings.study.sampling.method == "plain"
    band = "The band holds with 95 % at each number alone" if plain else "The band is that of plain sampling"
    return Drawn(drawing, f"Mean of the first samples. {band}: to stop when it looks right would bias it.")


def _tornado(findings: "Findings", name: str) -> Drawn:
    surface = findings.surfaces[name]
    order = np.argsort(-np.abs(surface.linear))[:_BARS]
    drawing, grid = figure(1.2 + 0.26 * len(order))
    axes = grid[0, 0]
    place = np.arange(len(order))[::-1]
    axes.barh(place, surface.linear[order], xerr=1.96 * surface.errors[order], color=FORCE, height=0.66,
              error_kw={"ecolor": INK, "elinewidth": 0.8})  # fmt: skip
    axes.set_yticks(place, [surface.names[j] for j in order])
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_xlabel(
        f"change of {heading(name.replace('_', ' '), UNITS.get(name, ''))} by one standard deviation"
    )
    axes.grid(axis="y", visible=False)
    more = f" with {len(surface.terms)} squares and products" if surface.terms else ""
    return Drawn(
        drawing,
        f"The largest {len(order)} of {len(surface.names)}, with 95 % intervals, from a linear surface{more}"
        f"; of samples that it was not fitted to it explains R^2 = {surface.held_out:.5g}.",
    )


def _scatter(findings: "Findings", name: str) -> Drawn:
    study, surface = findings.study.thinned(_SCATTERED), findings.surfaces[name]
    z = deviations(study.tolerances, study.uniforms())
    order = np.argsort(-np.abs(surface.linear))[:3]
    drawing, grid = figure(2.9, columns=len(order), sharey=True)
    column = study.column(name)
    for axes, j in zip(grid[0], order, strict=True):
        axes.plot(z[:, j], column, ".", color=FORCE, markersize=2.5, alpha=0.6, rasterized=True)
        ends = np.array([z[:, j].min(), z[:, j].max()])
        axes.plot(ends, surface.mean + surface.linear[j] * ends, color=JOINTS[1])
        axes.set_xlabel(f"{surface.names[j]} [sd]")
    grid[0, 0].set_ylabel(heading(name.replace("_", " "), UNITS.get(name, "")))
    return Drawn(
        drawing, "The measure over the deviation of its three leading components, and the fitted slope."
    )


def _correlation(findings: "Findings") -> Drawn:
    names, table = list(findings.summaries), findings.correlation()
    drawing, grid = figure(1.4 + 0.5 * len(names))
    axes = grid[0, 0]
    axes.imshow(table, vmin=-1.0, vmax=1.0, cmap="RdBu_r", aspect="auto")
    for i in range(len(names)):
        for j in range(len(names)):
            shade = "white" if abs(table[i, j]) > 0.6 else INK
            axes.text(j, i, f"{table[i, j]:.2f}", ha="center", va="center", color=shade)
    ticks = [name.replace("_", " ") for name in names]
    axes.set_xticks(range(len(names)), ticks, rotation=20, ha="right")
    axes.set_yticks(range(len(names)), ticks)
    axes.grid(visible=False)
    return Drawn(drawing, "Pearson's correlation over the samples that have all measures.")


def bill_table(findings: "Findings", most: int = _ROWS) -> tuple[list[str], list[list[str]]]:
    """Return heading and rows of the tolerance bill, what costs most first."""
    names = list(findings.surfaces)
    rows = [
        [
            line.name, line.tolerance, grade_text(line.loosest), grade_text(line.better),
            "-" if line.gain is None else percent(line.gain), *(percent(line.share[n]) for n in names),
            *(quantity(line.slope[n], UNITS.get(n, ""), 4) for n in names),
        ]
        for line in findings.bill[:most]
    ]  # fmt: skip
    head = [
        "component", "tolerance", "loosest", "next better", "adds to yield",
        *(f"share of variance, {n}" for n in names), *(f"change by 1 %, {n}" for n in names),
    ]  # fmt: skip
    return head, rows


def _bill(findings: "Findings") -> Section:
    head, rows = bill_table(findings)
    wanted = "the present yield" if findings.wanted is None else f"a yield of {100 * findings.wanted:g} %"
    note = (
        f"Loosest: the largest sold tolerance with which {wanted} is kept, all others as they are; it and "
        "what the next better one adds go through the fitted surface, on the same samples. Change: by 1 % of "
        "the component, or by its whole tolerance where that is no share."
    )
    if len(findings.bill) > _ROWS:
        note += f" {len(findings.bill)} rows, all of them in the file."
    table = Table("Tolerance bill", head, rows, note, "bill.csv", stacked=True)
    link = (SLIDERS, "Sliders over the fitted surfaces") if findings.surfaces else None
    return Section("bill", "What to buy better", (), [], [table], link=link)
