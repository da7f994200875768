"""The table of hard cases as a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.storage.owned_files import manifest_of
from reports.page import PAGE_NAME, render, write_page
from reports.study_page import Section, TextTable

if TYPE_CHECKING:
    from cosim.accuracy.hard_cases.hard_case import Outcome

FILES, MANIFEST = (PAGE_NAME, "hard_cases.csv"), manifest_of("hard-cases")
_HEAD = [
    "#", "case", "model", "what is found", "expected", "got", "off by", "bound", "where the bound comes from",
    "time [s]", "verdict",
]  # fmt: skip
#: Columns of sentences: they get a table of their own, since they would squeeze the numbers.
_NUMBERS, _WORDS = (0, 1, 2, 4, 5, 6, 7, 9, 10), (0, 1, 3, 8)


def write_hard_cases(outcomes: Sequence[Outcome], folder: Path) -> Path:
    """Write ``report.html`` and ``hard_cases.csv`` into the folder and return the page.

    Raises
    ------
    InputError
        The folder cannot be written, or holds something else under these names.
    """
    rows = [_row(each) for each in outcomes]
    held = sum(each.held for each in outcomes)
    numbers = TextTable(
        "Case by case", _part(_HEAD, _NUMBERS), [_part(row, _NUMBERS) for row in rows], {0, 3, 4, 5, 6, 7},
        "", FILES[1],
    )  # fmt: skip
    sentences = {tuple(_part(row, _WORDS)): None for row in rows}  # those of a case's models are one
    words = TextTable(
        "What is found, and where its bound comes from",
        _part(_HEAD, _WORDS),
        [list(row) for row in sentences],
        {0},
        "",
    )
    note = (
        f"{held} of {len(outcomes)} hold. Every expected value is theory's: a closed form, a matrix "
        "exponential, an elliptic integral; none is this program's output."
    )
    section = Section("cases", "Scenes that are hard for numbers", [], (note,), [], [numbers, words], "")
    html = render(
        "study.html.j2", title="Hard cases", command="", summary=[], sections=[section], claims=[],
        warnings=[],
    )  # fmt: skip
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEAD)
    writer.writerows(rows)
    return write_page(folder, html, [], {FILES[1]: stream.getvalue()}, MANIFEST)


def _part(row: Sequence[str], columns: Sequence[int]) -> list[str]:
    return [row[k] for k in columns]


def _small(value: float) -> str:
    return f"{value:.1e}" if value else "0"


def _row(each: Outcome) -> list[str]:
    case = each.case
    got = "-" if each.got is None else each.written(each.got)
    off = "-" if each.got is None else _small(abs(each.got - case.expected))
    verdict = "holds" if each.held else each.failed or "MISSED"
    return [str(case.row), case.name, each.model, case.what, each.written(case.expected), got, off,
            _small(case.bound[each.model]), case.reason, f"{each.seconds:.2g}", verdict]  # fmt: skip
