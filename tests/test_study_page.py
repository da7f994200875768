"""The page of studies: every claim once in its place, tables that fit, nothing from the network."""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, require
from support import SCENES

from cosim.errors import InputError
from cosim.studies.claims import load_claims
from cosim.studies.study import StudyResult, Table, Verdict
from reports.page import picture
from reports.study_page import text_table, write_study_page
from reports.style import Drawn, figure

PAPER = SCENES / "paper"
#: The rows of the acceptance table.
ROWS = ("A1 A2 A3 A4 A5 A6 A7 F13a F13b F13c F14 F16/17 F18 N1 N1a N2 N3 N4").split()


def synthetic() -> StudyResult:
    """A result of the study `congruence` as its figure takes it, with a table as wide as any."""
    turn, bend = np.meshgrid(np.linspace(-3.0, 3.0, 5), np.linspace(0.2, 2.9, 5))
    shift = {"shift, worst direction [%]": 10.0 + turn, "compensated, worst direction [%]": 0.0 * turn}
    place = {"x [m]": np.cos(turn) * bend, "y [m]": np.sin(turn) * bend}
    columns = {name: values.ravel().tolist() for name, values in {**place, **shift}.items()}
    wide = {f"a quantity of many words, number {i} [N s/m]": [1e-3 * i, 12345.678] for i in range(12)}
    return StudyResult(
        "congruence",
        "Two & more",
        (Table("workspace", "Map", columns), Table("wide", "A wide table", wide, "With a note.")),
        (
            Verdict("N3", "it shifts", "a question", "by 15 %", None),
            Verdict("A1", "it is right", "below 1e-8", "2e-11 < 1e-8", True),
            Verdict("N3", "it is restored", "0", "12 %", False),
            Verdict("own", "of nobody's list", "1", "1", True),
        ),
        seconds=1.5,
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = [("7_second", synthetic()), ("0_first", synthetic())]
    out = tmp_path_factory.mktemp("page")
    return write_study_page(results, out, "Claims", "cosim report here", load_claims(PAPER).claims)


def test_the_paper_s_claims_are_the_rows_of_the_acceptance_table() -> None:
    assert [claim.id for claim in load_claims(PAPER).claims] == ROWS


def test_every_claim_stands_once_in_its_order(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    heads = re.findall(r'<th scope="rowgroup">([^<]*)</th>', html)
    assert heads == ROWS
    bodies = dict(re.findall(r'<tbody id="claim-([\w-]*)">(.*?)</tbody>', html, re.DOTALL))
    assert list(bodies) == [row.replace("/", "-") for row in ROWS] + ["own"]
    for name, body in bodies.items():
        assert ("not judged" in body) == (name not in ("A1", "N3", "own")), name
    # both studies judge it, each verdict leads to its own section
    assert re.findall(r'href="#(\w+)"', bodies["A1"]) == ["7_second", "0_first"]
    assert bodies["N3"].count('class="verdict does-not-hold"') == 2
    assert "2e-11 &lt; 1e-8" in bodies["A1"]
    result = html.replace("\u00a0", " ")
    assert "4 of 6 verdicts on the paper hold; not all of N3 (footnote 2" in result  # no code to be looked up
    assert "2 more answer a question" in result
    missing = ", ".join(row for row in ROWS if row not in ("A1", "N3"))
    assert f"Not judged: {missing}." in html


def test_a_check_of_our_own_closed_form_is_no_verdict_on_the_paper(tmp_path: Path) -> None:
    verdicts = (
        Verdict("A1", "of the paper", "x", "x", True),
        Verdict("A1", "our formula", "x", "x", True, own=True),
        Verdict("A1", "our other formula", "x", "y", False, own=True),
    )
    result = replace(synthetic(), verdicts=verdicts)
    html = write_study_page([("0_first", result)], tmp_path, "t", "", load_claims(PAPER).claims)
    text = html.read_text(encoding="utf-8").replace("\u00a0", " ")
    assert "1 of 1 verdicts on the paper hold." in text
    assert "1 of 2 checks of this program" in text
    assert text.count('class="verdict own-check-failed"') == 1


def test_rounding_is_shown_as_zero() -> None:
    # 1e-12 of a column's largest is some thousand units in the last place; without a unit scales may be mixed
    columns = {"part": ["a", "b", "c"], "delay [us]": [3.0, -1.8e-13, 4e-12], "value": [1e6, 1e-9, 0.0]}
    shown = text_table(Table("t", "T", columns, "A note."), "t.csv")
    assert [row[1] for row in shown.rows] == ["3", "0", "4e-12"]
    assert [row[2] for row in shown.rows] == ["1e+06", "1e-09", "0"]
    assert shown.note == "A note. Shown as 0: what is below 1e-12 of its column's largest."
    assert text_table(Table("t", "T", {"delay [us]": [3.0, 0.0]}), "t.csv").note == ""


def test_a_page_of_questions_alone_counts_no_verdicts(tmp_path: Path) -> None:
    question = replace(synthetic(), verdicts=(Verdict("N3", "it shifts", "a question", "by 15 %", None),))
    text = write_study_page([("a", question)], tmp_path, "T").read_text(encoding="utf-8")
    assert "No verdict on the paper. 1 more answer a question with a number." in text.replace("\u00a0", " ")


def test_every_picture_has_its_data(tmp_path: Path) -> None:
    """Lines, bars, dots and maps: what is drawn stands in the file beside it, not its headings alone."""
    for name in ("line", "bars", "dots", "mesh", "shaded", "contours"):
        drawing, grid = figure(3.0)
        axes = grid[0, 0]
        x, y = np.meshgrid(np.linspace(0, 1, 4), np.linspace(2, 3, 5))
        if name == "line":
            axes.plot([0.0, 1.0], [2.0, 3.0])
        elif name == "bars":
            axes.barh([0, 1], [1.0, 2.0])
        elif name == "dots":
            axes.scatter([0.0, 1.0], [2.0, 3.0], c=[5.0, 6.0])
        elif name == "contours":
            axes.contour(x, y, x + y, levels=[2.5, 3.5])
        else:
            axes.pcolormesh(x, y, x + y, shading="gouraud" if name == "shaded" else "auto")
        rows = list(csv.DictReader(io.StringIO(picture(name, name, Drawn(drawing, "")).data)))
        assert rows, name
        if name in ("dots", "mesh", "shaded", "contours"):
            assert all(row["value"] for row in rows), name
        if name in ("mesh", "shaded", "contours"):  # what is shown is the sum of both
            assert all(
                float(row["value"]) == pytest.approx(float(row["x"]) + float(row["y"]), abs=1e-6)
                for row in rows
            ), name


def test_it_is_self_contained(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    targets = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert all(target.startswith(("data:", "#", "figures/", "data/")) for target in targets)
    assert "<script" not in html
    assert all(f'id="{target[1:]}"' in html for target in targets if target.startswith("#"))
    files = [target for target in targets if target.startswith(("figures/", "data/"))]
    assert len(files) == 2 * (3 + 2)  # PNG, SVG and data of a figure, two tables, for each study
    assert all((page.parent / target).is_file() for target in files)
    tables = [
        (page.parent / target).read_text("utf-8").splitlines() for target in files if target.endswith("csv")
    ]
    assert len(tables) == 2 * (1 + 2)
    assert all(len(rows) > 1 for rows in tables)  # a link to headings alone is a link to nothing


@pytest.mark.browser
def test_it_in_a_browser(page: Path, tmp_path: Path) -> None:
    require()
    with Browser() as browser:
        visit = browser.visit(page)
        assert visit.complaints == []
        assert visit.requests == [page.resolve().as_uri()]
        images = browser.evaluate("[...document.images].map(i => [i.naturalWidth, i.alt.length])")
        assert len(images) == 2
        assert all(width > 0 and alt > 20 for width, alt in images)
        # neither a laptop nor a telephone scrolls sideways, nor does any cell of the claims
        for width in (1280, 420):
            browser.resize(width, 800)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            cells = "[...document.querySelectorAll('.claims, .claims td')]"
            assert browser.evaluate(f"{cells}.every(c => c.getBoundingClientRect().right <= {width})")
        # A4 less its margins of 14 mm is 688 pixels; paper cannot scroll
        browser.call("Emulation.setEmulatedMedia", media="print")
        browser.resize(688, 900)
        tables = "Math.max(...[...document.querySelectorAll('table')].map(t => t.scrollWidth))"
        assert browser.evaluate(tables) <= 688
        browser.pdf(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


def test_what_is_wrong_with_the_claims_is_reported(tmp_path: Path) -> None:
    assert load_claims(tmp_path).claims == ()
    claim = '[[claims]]\nid = "A"\nsays = "x"\ncounts = "y"\n'
    file = tmp_path / "claims.toml"
    file.write_text(f'title = "T"\n{claim}{claim}', encoding="utf-8")
    with pytest.raises(InputError, match=r"claims.toml: claims.id = 'A': stands twice"):
        load_claims(tmp_path)
    file.write_text(f'title = "T"\n{claim}sais = "z"\n', encoding="utf-8")
    with pytest.raises(InputError, match='did you mean "says"'):
        load_claims(tmp_path)
