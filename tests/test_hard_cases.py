"""Every hard case on every model; and that the command tells a miss."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from browser import Browser

from cosim.accuracy.hard_cases import case_table
from cosim.accuracy.hard_cases.case_table import CASES, chosen
from cosim.accuracy.hard_cases.hard_case import ALL, CaseRunner, HardCase, Outcome
from cosim.cli import main
from cosim.errors import InputError, SimulationError
from reports.hard_cases import write_hard_cases

EVERY = [
    pytest.param(case, model, id=f"{case.row}-{case.name}-{model}",
                 marks=pytest.mark.slow if case.slow else ())
    for case in CASES for model in case.bound
]  # fmt: skip


@pytest.fixture(scope="module")
def runner():
    with CaseRunner() as made:
        yield made


@pytest.mark.few(150)
@pytest.mark.parametrize(("case", "model"), EVERY)
def test_hard_case(runner: CaseRunner, case: HardCase, model: str) -> None:
    result = runner.outcome(case, model)
    assert result.failed == ""
    assert result.held, f"{result.got!r}, expected {case.expected!r} to {case.bound[model]:g}: {case.reason}"


def test_every_case_says_what_it_is() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    assert {case.row for case in CASES} == set(range(1, 62))  # no row of the list is left out
    for case in CASES:
        assert 1 <= case.row <= 61
        assert case.what
        assert case.reason
        assert case.broken
        assert set(case.bound) <= set(ALL)
        assert case.bound


def test_a_miss_is_reported_and_no_number_is_one() -> None:
    case = CASES[0]
    (model,) = [next(iter(case.bound))]
    good = Outcome(case, model, case.expected + 0.5 * case.bound[model], "", 0.0)
    assert good.held
    for got in (case.expected + 2 * case.bound[model], float("nan"), float("inf"), None):
        assert not replace(good, got=got).held


def test_a_number_is_written_to_the_digit_of_its_bound() -> None:
    """The follower's 0.999999000001 was 0.999999, beside a bound of 1e-14."""
    (case,) = chosen(["follower of gain 1e6"], slow=False)
    assert Outcome(case, "spice", None, "", 0.0).written(case.expected) == "0.999999000001"
    rough = replace(case, expected=2.0 / 3.0, bound={"spice": 0.01})
    assert Outcome(rough, "spice", None, "", 0.0).written(rough.expected) == "0.666666667"
    assert Outcome(replace(rough, expected=0.0), "spice", None, "", 0.0).written(1e-12) == "1e-12"


def test_cases_are_chosen_by_name_and_number() -> None:
    assert {case.row for case in chosen(["bouncing"], slow=False)} == {17}
    assert {case.row for case in chosen(["22", "54"], slow=False)} == {22, 54}
    assert not any(case.slow for case in chosen([], slow=False))
    assert len(chosen([], slow=True)) == len(CASES)
    with pytest.raises(InputError, match="nearest is bouncing ball"):
        chosen(["bouncing bal, first impact"], slow=False)
    with pytest.raises(InputError, match="a number from 1 to 61"):  # each was listed as often as it has cases
        chosen(["99"], slow=False)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    outcomes = [
        Outcome(case, model, case.expected + bound / 3, "", 12.34)
        for case in CASES for model, bound in case.bound.items()
    ]  # fmt: skip
    return write_hard_cases(outcomes, tmp_path_factory.mktemp("page"))


def test_the_page_s_zeros_are_zeros(page: Path) -> None:
    assert any(bound == 0.0 for case in CASES for bound in case.bound.values())
    assert "0.0e+00" not in page.read_text(encoding="utf-8")
    with (page.parent / "hard_cases.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == sum(len(case.bound) for case in CASES)


@pytest.mark.browser
def test_the_page_s_tables_fit(page: Path) -> None:
    with Browser(1200, 900) as browser:
        browser.visit(page)
        # nothing is cut off at the right, and no row of numbers is taller than three lines of 23 pixels
        cut = "[...document.querySelectorAll('.scroll')].map(s => s.scrollWidth - s.clientWidth)"
        assert max(browser.evaluate(cut)) <= 0
        tall = "[...document.querySelectorAll('table')[0].rows].map(r => r.clientHeight)"
        assert max(browser.evaluate(tall)) <= 3 * 23 + 9
        browser.resize(420, 900)
        assert browser.evaluate("document.documentElement.scrollWidth") <= 420


def test_the_command_ends_with_1_on_a_miss(tmp_path, monkeypatch, capsys) -> None:
    def broken(runner: CaseRunner, model: str) -> float:
        raise SimulationError("it broke")

    cases = [
        HardCase("right", 1, "a number", 2.0, {"ideal": 0.1}, "none", lambda runner, model: 2.05),
        HardCase("wrong", 2, "a number", 2.0, {"ideal": 0.01}, "none", lambda runner, model: 2.05),
        HardCase("broken", 3, "a number", 2.0, {"spice": 0.01}, "none", broken),
        HardCase("no number", 4, "a number", 2.0, {"spice": 0.01}, "none", lambda *_: float("nan")),
    ]
    monkeypatch.setattr(case_table, "CASES", tuple(cases))
    assert main(["hard-cases", "right", "-o", str(tmp_path / "page")]) == 0
    assert "1 of 1 hold" in capsys.readouterr().out
    assert "holds" in (tmp_path / "page" / "report.html").read_text()
    assert main(["hard-cases", "-o", str(tmp_path / "page")]) == 1
    out = capsys.readouterr().out
    assert "1 of 4 hold" in out
    assert "failed: broken, spice: it broke" in out
    assert out.count("MISS") == 3
    assert main(["hard-cases", "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)["cases"]
    assert [row["held"] for row in printed] == [True, False, False, False]
    assert [row["got"] for row in printed] == [2.05, 2.05, None, None]
    assert main(["hard-cases", "nonesuch"]) == 2
