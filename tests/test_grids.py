"""Values that a study was asked for stand in its tables as short decimals: 20.3, not 20.299999999999997."""

from typing import Any

import numpy as np
import pytest

from benchmarks.same_results import SHORT, small
from cosim.caution import collected
from cosim.studies.grid import decimal, even, geometric, milli, steps
from cosim.studies.study import StudyResult

#: A result that theory puts on a short number: at half the sampling frequency the closed form is the need.
RESULTS = {("curves", "needed over closed form")}


def ragged(result: StudyResult) -> set[tuple[str, str]]:
    """Table and column of every number that misses a decimal of six digits by rounding alone.

    A result comes that near to one by chance once in 1e6 numbers.
    """
    return {
        (table.name, name)
        for table in result.tables
        for name, column in table.columns.items()
        for value in column
        if isinstance(value, float) and (table.name, name) not in RESULTS
        if value != (short := float(f"{value:.6g}")) and abs(value - short) <= 1e-12 * abs(short)
    }


#: Those with other parameters show no grid but poses, as places of the tip.
GRIDS = [(name, changes) for name, changes in SHORT.items() if changes]
SLOW = ("0_2_passive", "5_5_corner", "8_maps")


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "changes"),
    [pytest.param(*each, id=each[0], marks=[pytest.mark.slow] if each[0] in SLOW else []) for each in GRIDS],
)
def test_what_was_asked_for_stands_in_the_tables_as_it_was_asked(name: str, changes: dict[str, Any]) -> None:
    with collected(forward=False) as cautions:
        assert ragged(small(name, **changes)) == set()
    assert [str(each) for each in cautions] == []  # no study that is shipped warns of what it does


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("8_device", {}),
        *(pytest.param(name, {}, id=name, marks=pytest.mark.slow)
          for name in ("0_1_acceptance", "4_fig18_poses", "5_1_eta", "5_6_budget", "7_footnote2")),
    ],
)  # fmt: skip
def test_no_other_study_warns_either(name: str, changes: dict[str, Any]) -> None:
    with collected(forward=False) as cautions:
        small(name, **changes)
    assert [str(each) for each in cautions] == []


def test_grids_are_what_they_say_to_twelve_digits() -> None:
    assert milli(0.0203) == 20.3
    assert decimal(3 * 0.1) == 0.3
    assert steps(0.3, 0.1).tolist() == [0.0, 0.1, 0.2]
    assert even(0.0, 1.0, 11).tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert geometric(1e-3, 10.0, 5).tolist() == [0.001, 0.01, 0.1, 1.0, 10.0]
    np.testing.assert_allclose(geometric(3.0, 7.0, 9), np.geomspace(3.0, 7.0, 9), rtol=1e-11)
