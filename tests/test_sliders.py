"""The page of sliders: what a moved component does, in a browser, against the formula."""

import re
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from formula_studies import LIMIT, SIGMA, SLOPE, formulas, measured
from scipy import special, stats

from reports.monte_carlo import write_monte_carlo
from reports.sliders import SLIDERS, sliders_page


@pytest.mark.browser
def test_a_moved_resistor_moves_measure_and_yield(tmp_path: Path) -> None:
    """A shift of 1 % is one standard deviation of r1, which weighs most: the mean moves by its slope."""
    result = measured(formulas(400))
    page = tmp_path / SLIDERS
    page.write_text(sliders_page(result), encoding="utf-8")
    assert page.stat().st_size < 500_000
    cell = "Number(document.querySelector('#measures td:nth-child(2)').textContent)"
    passing = "document.querySelector('#yields td:nth-child(2)').textContent"
    with Browser(900, 800) as browser:
        visit = browser.visit(page)
        assert not visit.complaints
        assert len(visit.requests) == 1
        before = browser.evaluate(cell)
        assert before == pytest.approx(result.study.results.mean(), rel=1e-3)
        assert "r1" in browser.evaluate("document.querySelector('label span').textContent")
        browser.evaluate(
            f"(() => {{ const i = document.querySelector('input'); i.value = {-SIGMA};"
            "i.dispatchEvent(new Event('input')); })()"
        )
        moved = browser.evaluate(cell) - before
        # the fitted slope has an error of some per cent of its own
        assert moved == pytest.approx(-SLOPE[1], rel=0.05)
        share = float(browser.evaluate(passing).split()[0]) / 100.0
        exact = special.ndtr(LIMIT + SLOPE[1])
        assert share == pytest.approx(exact, abs=4.0 * np.sqrt(exact * (1.0 - exact) / 400))
        # the interval is the exact one of so many devices
        exact_bounds = stats.binomtest(round(400 * share), 400).proportion_ci(0.95, "exact")
        words = browser.evaluate(passing).replace("(", "").replace(")", "").split()
        shown = float(words[2]) / 100.0, float(words[4]) / 100.0
        assert shown == pytest.approx((exact_bounds.low, exact_bounds.high), rel=2e-4)
        browser.screenshot(tmp_path / "sliders.png")
        # a telephone scrolls the tables, not the page, however long a name or a number is
        browser.evaluate("document.querySelector('#measures td').textContent = 'x'.repeat(80)")
        browser.resize(420, 800)
        assert browser.evaluate("document.documentElement.scrollWidth") <= 420
        assert browser.evaluate("document.querySelector('.scroll').scrollWidth") > 420
        browser.resize(900, 800)
        browser.evaluate("document.getElementById('reset').click()")
        assert browser.evaluate(cell) == before
        # paper is white, whatever the screen's scheme
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        browser.call("Emulation.setEmulatedMedia", media="print", features=dark)
        ground = "getComputedStyle(document.documentElement).backgroundColor"
        assert browser.evaluate(ground) == "rgb(255, 255, 255)"
    assert (tmp_path / "sliders.png").stat().st_size > 0


@pytest.mark.browser
def test_sliders_of_randomisations_tell_the_interval_of_the_study(tmp_path: Path) -> None:
    """Student's t over 16 randomisations, not the exact one of independent devices."""
    result = measured(formulas(256, method="lhs", limit=1.0))
    page = tmp_path / SLIDERS
    page.write_text(sliders_page(result), encoding="utf-8")
    (wanted,) = result.yields.values()
    assert "Student t" in wanted.how
    with Browser(900, 800) as browser:
        visit = browser.visit(page)
        assert not visit.complaints
        shown = browser.evaluate("document.querySelector('#yields td:nth-child(3)').textContent")
        words = shown.replace("(", "").replace(")", "").split()
        told = [float(words[k]) / 100.0 for k in (0, 2, 4)]
        assert told == pytest.approx([wanted.value, wanted.low, wanted.high], rel=2e-4)
        assert "16 randomisations" in browser.evaluate("document.getElementById('note').textContent")


def test_without_a_fitted_surface_no_page_links_to_sliders(tmp_path: Path) -> None:
    few = measured(formulas(8))  # fewer samples than random variables ask for
    assert few.bill
    assert not few.surfaces
    page = write_monte_carlo(few, tmp_path, "cosim mc --sample", "x")
    links = re.findall(r'href="([^"#:]+)"', page.read_text(encoding="utf-8"))
    assert links
    assert [link for link in links if not (tmp_path / link).is_file()] == []
