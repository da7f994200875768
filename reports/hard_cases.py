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
    "time [s]", "",
]  # fmt: skip


def write_hard_cases(outcomes: Sequence[Outcome], folder: Path) -> Path:
    """Write ``report.html`` and ``hard_cases.csv`` into the folder and return the page.

    Raises
    ------
    InputError
        The folder cannot be written, or holds something else under these names.
    """
    rows = [_row(each) for each in outcomes]
    held = sum(each.held for each in outcomes)
    table = TextTable("Case by case", _HEAD, rows, {0, 4, 5, 6, 7, 9}, "", FILES[1])
    note = (
        f"{held} of {len(outcomes)} hold. Every expected value is theory's: a closed form, a matrix "
        "exponential, an elliptic integral; none is this program's output."
    )
    section = Section("cases", "Scenes that are hard for numbers", [], (note,), [], [table], "")
    html = render(
        "study.html.j2", title="Hard cases", command="", summary=[], sections=[section], claims=[],
        warnings=[],
    )  # fmt: skip
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEAD)
    writer.writerows(rows)
    return write_page(folder, html, [], {FILES[1]: stream.getvalue()}, MANIFEST)


def _row(each: Outcome) -> list[str]:
    case = each.case
    got = "-" if each.got is None else f"{each.got:.9g}"
    off = "-" if each.got is None else f"{abs(each.got - case.expected):.1e}"
    verdict = "holds" if each.held else each.failed or "MISSED"
    return [str(case.row), case.name, each.model, case.what, f"{case.expected:.9g}", got, off,
            f"{case.bound[each.model]:.1e}", case.reason, f"{each.seconds:.2g}", verdict]  # fmt: skip
