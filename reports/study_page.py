"""From the results of studies to one self-contained page: verdicts first, then study by study."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.caution import Caution, grouped
from cosim.storage.field_types import used
from cosim.storage.owned_files import manifest_of
from cosim.studies.claims import Claim
from cosim.studies.study import STUDIES, StudyResult, Verdict, table_text
from cosim.studies.study import Table as StudyTable
from cosim.units import unit_in
from reports.page import Picture, picture, render, write_page
from reports.style import Drawn, look

__all__ = ["Section", "TextTable", "drawer", "write_study_page"]

MANIFEST = manifest_of("study")
#: A longer table is data for a program: the page only links it.
_MOST_ROWS = 40
#: Values below this share of their column's largest are sums' and differences' rounding: some thousand
#: units in the last place of a double.
_EPS = 1e-12
_HOLDS = {True: "holds", False: "does not hold", None: "answered"}
#: The same of what judges a closed form or a model of this program.
_OWN = {True: "own check passed", False: "own check failed", None: "answered"}


@dataclass(frozen=True)
class TextTable:
    """A table as a page shows it: `numbers` are the columns set as such, `file` its CSV beside the page."""

    title: str
    head: list[str]
    rows: list[list[str]]
    numbers: set[int]
    note: str
    file: str = ""


@dataclass(frozen=True)
class _Judged:
    """A verdict with the name and the title of the study that judged."""

    claim: str
    expected: str
    outcome: str
    holds: str
    place: str
    section: str


@dataclass(frozen=True)
class _Claim:
    """What the paper says and when it counts, with the verdicts on it; none where it was not judged."""

    id: str
    says: str
    counts: str
    rows: list[_Judged]

    @property
    def anchor(self) -> str:
        return "claim-" + "".join(c if c.isalnum() else "-" for c in self.id)


@dataclass(frozen=True)
class Section:
    """A part of a page; `name` is its anchor, `judges` the claims that it answers, `price` its last line."""

    name: str
    title: str
    judges: list[_Claim]
    notes: tuple[str, ...]
    pictures: list[Picture]
    tables: list[TextTable]
    price: str


def write_study_page(
    results: Sequence[tuple[str, StudyResult]],
    out: Path,
    title: str,
    command: str = "",
    claims: Sequence[Claim] = (),
    cautions: Sequence[Caution] = (),
) -> Path:
    """Write ``report.html`` with the figures (PNG, SVG, CSV) and tables (CSV) of studies.

    Parameters
    ----------
    results
        Name and result of each study, in the order of the page; a name is the first part of file names.
    out
        Folder to write into; made when it is absent. A page that it holds is replaced.
    title, command
        Heading, and the command line that made the page.
    claims
        What is to be judged, in the order of the page; verdicts with other ids follow.
    cautions
        What is to be doubted, for the head of the page.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    judged = _claims(results, claims)
    sections, pictures = [], []
    for name, result in results:
        drawn = draw_study(name, result)
        pictures += drawn
        ids = {verdict.id for verdict in result.verdicts}
        sections.append(
            Section(
                name,
                result.title,
                [claim for claim in judged if claim.id in ids],
                result.notes,
                drawn,
                [text_table(table, f"data/{name}_{table.name}.csv") for table in result.tables],
                f"Computed in {result.seconds:.3g} s.",
            )
        )
    html = render(
        "study.html.j2", title=title, command=command, summary=_summary(judged), sections=sections,
        claims=judged, warnings=grouped(cautions),
    )  # fmt: skip
    tables = {
        f"data/{name}_{table.name}.csv": table_text(table)
        for name, result in results
        for table in result.tables
    }
    return write_page(out, html, pictures, tables, MANIFEST)


def _claims(results: Sequence[tuple[str, StudyResult]], asked: Sequence[Claim]) -> list[_Claim]:
    """Return every claim with its verdicts, those that nobody listed behind the others."""
    by_id: dict[str, _Claim] = {claim.id: _Claim(claim.id, claim.says, claim.counts, []) for claim in asked}
    for name, result in results:
        for v in result.verdicts:
            row = _Judged(v.claim, v.expected, v.outcome, verdict_word(v), name, result.title)
            by_id.setdefault(v.id, _Claim(v.id, "", "", [])).rows.append(row)
    return list(by_id.values())


def verdict_word(verdict: Verdict) -> str:
    """Return whether a claim holds, or an own check passed, in words."""
    return (_OWN if verdict.own else _HOLDS)[verdict.holds]


def _summary(claims: Sequence[_Claim]) -> list[str]:
    """Say how many verdicts hold, which do not, and what was not judged."""
    if not claims:
        return []
    judged = [(claim, row.holds) for claim in claims for row in claim.rows]

    def which(word: str) -> list[str]:
        names = (f"{c.id} ({c.says})" if c.says else c.id for c, holds in judged if holds == word)
        return list(dict.fromkeys(names))

    held = sum(holds == _HOLDS[True] for _, holds in judged)
    decided = held + sum(holds == _HOLDS[False] for _, holds in judged)
    out = f"{held} of {decided} verdicts on the paper hold" if decided else "No verdict on the paper"
    if failed := which(_HOLDS[False]):
        out += f"; not all of {'; '.join(failed)}"
    answered = sum(holds == _HOLDS[None] for _, holds in judged)
    if answered:
        out += f". {answered} more answer a question with a number"
    sentences = [out + "."]
    passed, missed = (sum(holds == _OWN[each] for _, holds in judged) for each in (True, False))
    if passed or missed:
        sentences.append(
            f"{passed} of {passed + missed} checks of this program's own closed forms and models pass; they "
            "are no verdicts on the paper."
        )
        if failed := which(_OWN[False]):
            sentences.append(f"Own checks that failed are of {'; '.join(failed)}.")
    if absent := [claim.id for claim in claims if not claim.rows]:
        sentences.append(f"Not judged: {', '.join(absent)}.")
    return sentences


def drawer(study: str) -> Callable[[StudyResult], list[tuple[str, str, Drawn]]]:
    """Return what draws a study's result: its module has the name of the study's own."""
    module = import_module(f"reports.studies.{STUDIES[study].rpartition('.')[2]}")
    draw: Callable[[StudyResult], list[tuple[str, str, Drawn]]] = module.draw
    return draw


def draw_study(name: str, result: StudyResult) -> list[Picture]:
    """Return a study's figures, their names begun with `name`."""
    draw = drawer(result.study)
    with look(), used(result.kept_in, bool(result.kept_in)):
        return [picture(f"{name}_{part}", heading, drawn) for part, heading, drawn in draw(result)]


def text_table(table: StudyTable, file: str) -> TextTable:
    """Return a table as a page shows it; one of many rows stays in its file."""
    columns = list(table.columns.values())
    least = [_rounding(name, column) for name, column in table.columns.items()]
    count = len(columns[0]) if columns else 0
    numbers = {
        i for i, column in enumerate(columns)
        if all(isinstance(value, int | float) or value is None for value in column)
    }  # fmt: skip
    if count > _MOST_ROWS:
        note = f"{table.note} {count} rows, in the file.".strip()
        return TextTable(table.title, list(table.columns), [], numbers, note, file)
    rows = [
        [_text(value, size) for value, size in zip(row, least, strict=True)]
        for row in zip(*columns, strict=True)
    ]
    note = table.note
    if any(_is_noise(value, size) for column, size in zip(columns, least, strict=True) for value in column):
        note = f"{note} Shown as 0: what is below {_EPS:g} of its column's largest.".strip()
    return TextTable(table.title, list(table.columns), rows, numbers, note, file)


def _rounding(heading: str, column: Sequence[Any]) -> float:
    """Return the size below which a column's values are rounding.

    It is 0 without a unit in the heading, where a column may hold quantities of many scales.
    """
    numbers = [abs(value) for value in column if isinstance(value, float) and math.isfinite(value)]
    return _EPS * max(numbers, default=0.0) if unit_in(heading) else 0.0


def _is_noise(value: Any, least: float) -> bool:
    return isinstance(value, float) and 0.0 < abs(value) < least


def _text(value: Any, least: float) -> str:
    if _is_noise(value, least):
        return "0"
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
