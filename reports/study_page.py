"""From the results of studies to one self-contained page: verdicts first, then study by study."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.studies.study import StudyResult, Verdict, write_table
from cosim.studies.study import Table as StudyTable
from reports.page import Picture, picture, render, write_page
from reports.style import look

__all__ = ["write_study_page"]

#: A longer table is data for a program: the page only links it.
_MOST_ROWS = 40
_HOLDS = {True: "holds", False: "does not hold", None: "answered"}


@dataclass(frozen=True)
class _Table:
    title: str
    head: list[str]
    rows: list[list[str]]
    numbers: set[int]
    note: str
    file: str = ""


@dataclass(frozen=True)
class _Section:
    name: str
    title: str
    notes: tuple[str, ...]
    pictures: list[Picture]
    tables: list[_Table]
    price: str


def write_study_page(
    results: Sequence[tuple[str, StudyResult]], out: Path, title: str, command: str = ""
) -> Path:
    """Write ``report.html`` with the figures (PNG, SVG, CSV) and tables (CSV) of studies.

    Parameters
    ----------
    results
        Name and result of each study, in the order of the page; a name is the first part of file names.
    out
        Folder to write into; made when it is absent. A page that it holds is replaced.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    sections, pictures = [], []
    for name, result in results:
        drawn = _draw(name, result)
        pictures += drawn
        sections.append(
            _Section(
                name,
                result.title,
                result.notes,
                drawn,
                [_table(table, f"data/{name}_{table.name}.csv") for table in result.tables],
                f"Computed in {result.seconds:.3g} s.",
            )
        )
    verdicts = [(result.title, verdict) for _, result in results for verdict in result.verdicts]
    held = sum(verdict.holds is True for _, verdict in verdicts)
    failed = [verdict.id for _, verdict in verdicts if verdict.holds is False]
    summary = []
    if verdicts:
        summary.append(
            f"{held} of {held + len(failed)} claims hold"
            + (f"; not: {', '.join(dict.fromkeys(failed))}." if failed else ".")
        )
    html = render(
        "study.html.j2", title=title, command=command, summary=summary, sections=sections,
        verdicts=_verdicts([verdict for _, verdict in verdicts]) if verdicts else None,
    )  # fmt: skip
    page = write_page(out, html, pictures)
    data = out / "data"
    data.mkdir(exist_ok=True)
    for name, result in results:
        for table in result.tables:
            write_table(data / f"{name}_{table.name}.csv", table)
    return page


def _draw(name: str, result: StudyResult) -> list[Picture]:
    draw = import_module(f"reports.studies.{result.study}").draw
    with look():
        return [picture(f"{name}_{part}", heading, drawn) for part, heading, drawn in draw(result)]


def _verdicts(verdicts: Sequence[Verdict]) -> _Table:
    rows = [[v.id, v.claim, v.expected, v.found, _HOLDS[v.holds]] for v in verdicts]
    return _Table("Claim by claim", ["", "claim", "expected", "found", ""], rows, set(), "")


def _table(table: StudyTable, file: str) -> _Table:
    columns = list(table.columns.values())
    count = len(columns[0]) if columns else 0
    numbers = {
        i for i, column in enumerate(columns)
        if all(isinstance(value, int | float) or value is None for value in column)
    }  # fmt: skip
    if count > _MOST_ROWS:
        note = f"{table.note} {count} rows, in the file.".strip()
        return _Table(table.title, list(table.columns), [], numbers, note, file)
    rows = [[_text(value) for value in row] for row in zip(*columns, strict=True)]
    return _Table(table.title, list(table.columns), rows, numbers, table.note, file)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
