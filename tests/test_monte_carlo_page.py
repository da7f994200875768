"""The page of a Monte Carlo study with all of its sections, in a browser and by its weight."""

import html
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from formula_studies import SIGMA, SLOPE, Formulas, formulas, measured
from legible import faults

from cosim.tolerance.intervals import Estimate
from cosim.tolerance.scene_study import monte_carlo
from cosim.tolerance.study_results import Findings
from reports.monte_carlo import PARTS, draw, write_monte_carlo
from reports.style import look
from reports.tolerance_sections import value

#: Measures of the catalogue, in whose units the formulas are read.
FOUR = ("rendered_stiffness", "peak_force", "k_max", "curl")
REPLAY = (
    "cosim mc scenes/press.toml --set effects.driver=current --measure peak_force "
    "--spec 'heat < 2 A^2 s' --model linear --seed 7 --sample"
)


@dataclass(frozen=True)
class Four(Formulas):
    """A prepared scene of four measures, each with its own weights of the six resistors."""

    def batch(self, names, model):
        return FourFormulas()


class FourFormulas:
    """Four measures: planes of the deviations, and one that bends."""

    failures = {}  # noqa: RUF012

    def measures(self, values):
        z = (values - 1.0) / SIGMA
        planes = [100.0 + z @ np.roll(SLOPE, k) for k in range(4)]
        planes[1] = planes[1] + 0.3 * z[:, 0] ** 2
        return np.stack(planes, axis=1)


def four(n: int) -> Findings:
    one = formulas(n, limit=101.5)
    prepared = Four(one.asked, one.plan, one.tolerances, FOUR, one.seed)
    return monte_carlo(prepared, None, None)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with bill, two models, rare failures and worst case."""
    result = measured(formulas(300, two_level=True, rare=True, corners=True))
    return write_monte_carlo(result, tmp_path_factory.mktemp("mc"), REPLAY, "x")


@pytest.mark.slow
def test_a_page_of_four_measures_weighs_at_most_500_kb(tmp_path: Path) -> None:
    """Seventeen figures; as matplotlib writes them they are 1.2 MB."""
    page = write_monte_carlo(four(2000), tmp_path, REPLAY, "x")
    assert page.read_text(encoding="utf-8").count("<figure ") == 17
    assert page.stat().st_size <= 500_000


@pytest.mark.slow
def test_figures_of_a_study_can_be_read() -> None:
    findings = four(300)
    with look():
        for name in FOUR:
            for part in PARTS:
                assert faults(draw(findings, part, name).figure) == [], (name, part)


def test_a_command_stands_on_the_page_as_it_is_typed(full: Path) -> None:
    """Pretty units are for words: `heat < 2 A^2 s` in a command stays what it was."""
    page = full.read_text(encoding="utf-8")
    commands = re.findall(r"<code>(cosim mc [^<]*--sample \d+)</code>", page)
    assert len(commands) == 5
    assert all(html.unescape(each).startswith(REPLAY) for each in commands)


@pytest.mark.parametrize(
    ("middle", "low", "high", "unit", "text"),
    [
        (4.0001e-3, 3.9999e-3, 4.0003e-3, "m", "4.00010 mm (3.99990 to 4.00030)"),
        (104.5, 103.5, 105.5, "N/m", "104.50 N/m (103.5 to 105.5)"),
        (1.0001e-3, 9.998e-4, 1.0004e-3, "m", "1.0001 mm (999.80 µm to 1.0004)"),
        (0.36411, 0.3, math.inf, "N/m", "0.36411 N/m (0.3000 to not known)"),
        (0.0, 0.0, 0.0, "N", "0 N (0 to 0)"),
    ],
)
def test_the_ends_of_an_interval_can_be_told_apart(
    middle: float, low: float, high: float, unit: str, text: str
) -> None:
    """A mean that is known to 5e-5 stood there as 4 mm, between 4 mm and 4 mm."""
    assert value(Estimate(middle, low, high, ""), unit) == text


def test_the_tables_of_two_models_are_not_told_twice(full: Path) -> None:
    head = full.read_text(encoding="utf-8").partition("<nav>")[0]
    assert "devices" in head
    assert "bought at" in head or "no two resistors" in head
    assert "correlation" not in head
    assert "rare failures:" not in head


@pytest.mark.browser
def test_all_sections_in_a_browser_and_on_a_telephone(full: Path, tmp_path: Path) -> None:
    """At 420 px neither the page nor a table scrolls sideways, and no command has to be scrolled along."""
    with Browser(1280, 900) as browser:
        visit = browser.visit(full)
        assert visit.complaints == []
        assert visit.requests == [full.resolve().as_uri()]
        ids = browser.evaluate("[...document.querySelectorAll('h2')].map(e => e.id)")
        assert ids == ["overview", "peak_force", "bill", "levels", "rare"]
        assert all(
            browser.evaluate("[...document.images].map(i => i.naturalWidth > 0 && i.clientHeight > 100)")
        )
        for width in (1280, 420):
            browser.resize(width, 900)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            browser.screenshot(tmp_path / f"{width}.png")
        stacked = "[...document.querySelectorAll('table.stacked')].map(e => e.clientWidth)"
        assert all(0 < width <= 420 for width in browser.evaluate(stacked))
        tables = (
            "[...document.querySelectorAll('.scroll:has(> table)')].map(e => e.scrollWidth - e.clientWidth)"
        )
        assert set(browser.evaluate(tables)) == {0}
        ends = "[...document.querySelectorAll('td code')].map(e => e.getBoundingClientRect().right)"
        assert all(0 < end <= 420 for end in browser.evaluate(ends))
