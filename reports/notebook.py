"""Notebook views of results: runs, sweeps, studies and batches of devices."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING

from cosim.catalogue import UNITS
from cosim.units import quantity
from reports.page import FIGURES, Picture, draw_all, picture
from reports.style import look
from reports.summary import summary
from reports.tables import with_bound
from reports.view import RunLike, View

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cosim.comparisons.sweep import Sweep
    from cosim.studies.study import StudyResult
    from cosim.tolerance.study_results import Findings

__all__ = ["figure", "findings_figure", "findings_html", "html", "study_figure", "study_html", "sweep_figure",
           "sweep_html"]  # fmt: skip

#: Rows of a table in a cell; files and pages have all.
_MOST_ROWS = 12


def figure(run: RunLike, name: str | None = None) -> "Figure":
    """Return a figure of a run: that of a name of `reports.page.FIGURES`, or the first that the run fills.

    Raises
    ------
    ValueError
        For an unknown name, or a figure for which the run lacks the signals.
    """
    names = [each[0] for each in FIGURES]
    if name is not None and name not in names:
        raise ValueError(f"no figure {name!r}; there are {', '.join(names)}")
    view = View(run)
    with look():
        for each, _, module, function in FIGURES:
            if name is None or each == name:
                drawn = getattr(import_module(f"reports.{module}"), function)(view)
                if drawn is not None:
                    drawing: Figure = drawn.figure
                    return drawing
    raise ValueError(f"the run lacks the signals of {name or 'every figure'}")


def html(run: RunLike) -> str:
    """Return the summary, cautions, the measures with their units and the main picture as HTML."""
    view = View(run)
    rows = [[name, with_bound(row), str(row["text"])] for name, row in run.measures.items()]
    pictures, _ = draw_all(view, first=True)
    title = str(view.scene_at("title", default="Co-simulation"))
    doubts = [str(caution) for caution in run.warnings]
    return _cell(title, summary(view), doubts, _table([], rows), pictures)


def sweep_figure(sweep: "Sweep") -> "Figure":
    """Return a sweep's figure.

    Raises
    ------
    ValueError
        Where the first range is not of numbers, or no point has a measure.
    """
    from reports.sweep import draw

    with look():
        drawn = draw(sweep)
    if drawn is None:
        raise ValueError("nothing to draw: the first range is not of numbers, or no point has a measure")
    return drawn.figure


def sweep_html(sweep: "Sweep") -> str:
    """Return a sweep's table, what failed, and its picture as HTML."""
    from reports.sweep import draw

    rows = [
        [*values, *("-" if column[k] is None else _number(column[k], UNITS.get(name, ""))
                    for name, column in sweep.measures.items())]
        for k, values in enumerate(sweep.values)
    ]  # fmt: skip
    with look():
        drawn = draw(sweep)
        pictures = [] if drawn is None else [picture("sweep", f"Sweep of {', '.join(sweep.names)}", drawn)]
    failed = [f"{point}: {why}" for point, why in sweep.failed.items()]
    table = _table([*sweep.names, *sweep.measures], rows)
    return _cell(f"Sweep of {', '.join(sweep.names)}", [], failed, table, pictures)


def findings_figure(findings: "Findings", part: str, measure: str | None = None) -> "Figure":
    """Return a figure of a batch of devices: a part of `reports.monte_carlo.PARTS`, of one measure.

    Raises
    ------
    ValueError
        For an unknown part or measure, or a measure without a fitted surface.
    """
    from reports.monte_carlo import PARTS, draw

    name = next(iter(findings.summaries)) if measure is None else measure
    if part not in PARTS or name not in findings.summaries:
        raise ValueError(f"no figure {part!r} of {name!r}; there are {', '.join(PARTS)} of "
                         f"{', '.join(findings.summaries)}")  # fmt: skip
    if part in PARTS[2:] and name not in findings.surfaces:
        raise ValueError(f"{name} has no fitted surface: more samples, or a measure that changes")
    with look():
        return draw(findings, part, name).figure


def findings_html(findings: "Findings") -> str:
    """Return what a batch of devices does: sentences, distribution, and the head of the bill as HTML."""
    from reports.monte_carlo import bill_table, draw, sentences

    name = next(iter(findings.summaries))
    with look():
        pictures = [picture(name, f"Distribution of {name}", draw(findings, "distribution", name))]
    head, rows = bill_table(findings, _MOST_ROWS) if findings.surfaces else ([], [])
    return _cell("The built devices", sentences(findings), [], _table(head, rows), pictures)


def study_figure(result: "StudyResult", name: str | None = None) -> "Figure":
    """Return a study's figure: that of a name, or its first.

    Raises
    ------
    ValueError
        For a name that the study does not draw.
    """
    from reports.study_page import drawer

    with look():
        drawn = drawer(result.study)(result)
        for each, _, drawing in drawn:
            if name is None or each == name:
                return drawing.figure
    raise ValueError(f"no figure {name!r}; there are {', '.join(each[0] for each in drawn)}")


def study_html(result: "StudyResult") -> str:
    """Return a study's notes, verdicts, tables and pictures as HTML."""
    from reports.study_page import draw_study, text_table, verdict_word

    verdicts = [[v.id, v.claim, v.expected, v.outcome, verdict_word(v)] for v in result.verdicts]
    tables = [_table(["", "claim", "expected", "found", "verdict"], verdicts)] if verdicts else []
    for table in result.tables:
        shown = text_table(table, f"{table.name}.csv")
        if shown.rows:
            tables.append(f"<h5>{escape(shown.title)}</h5>{_table(shown.head, shown.rows)}")
    return _cell(result.title, result.notes, [], "".join(tables), draw_study("study", result))


def _cell(
    title: str, sentences: Iterable[str], doubts: Sequence[str], table: str, pictures: Iterable[Picture]
) -> str:
    warned = "".join(f"<li>{escape(each)}</li>" for each in doubts)
    return "".join(
        (
            f"<h4>{escape(title)}</h4>",
            *(f"<p>{escape(sentence)}</p>" for sentence in sentences),
            f"<ul>{warned}</ul>" if warned else "",
            table,
            *(
                f'<figure><img alt="{escape(each.title)}" src="{each.source}">'
                f"<figcaption>{escape(each.caption)}</figcaption></figure>"
                for each in pictures
            ),
        )
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = f"<tr>{''.join(f'<th>{escape(each)}</th>' for each in head)}</tr>" if head else ""
    body = "".join(f"<tr>{''.join(f'<td>{escape(each)}</td>' for each in row)}</tr>" for row in rows)
    return f"<table>{top}{body}</table>"


def _number(value: object, unit: str) -> str:
    return quantity(value, unit, 5) if isinstance(value, int | float) else str(value)
