"""Values that a study was asked for stand in its tables as short decimals: 20.3, not 20.299999999999997."""

from typing import Any

import numpy as np
import pytest
from small_studies import FALL, PERIODS, first, small

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


#: Slow ones apart; studies that are missing here show no grid but poses, as places of the tip.
SLOW: list[tuple[str, dict[str, Any]]] = [
    ("0_2_passive", {"depths_m": (0.01,), "dampers_n_s_per_m": (2.0,), "seconds": 0.3}),
    ("5_5_corner", {"corners_hz": (2.0, 1000.0)}),
    ("8_maps", {**FALL, "periods_s": PERIODS, "dampings_n_s_per_m": (0.6,), "stiffness_shares": (0.6,),
                "stiffness_n_per_m": (10.0,), "panels": first(1), "widths": first(1)}),
]  # fmt: skip
STUDIES: list[tuple[str, dict[str, Any]]] = [
    ("1_fig13", {**FALL, "periods_s": PERIODS, "families": first(1)}),
    ("3_fig16_18", {"runs": first(1)}),
    ("5_2_rendering", {"cases": first(1), "stiffness_noticed": (0.07, 0.14), "force_noticed": (0.07, 0.29)}),
    ("5_3_footnote", {"points": 5, "opamps": first(1), "corners_hz": first(1), "drivers_hz": first(1)}),
    ("5_4_shift", {"periods_s": PERIODS, "cases": first(2), "gains": first(1)}),
    ("6a_ceiling", {"boards": first(1), "noise_points": 5}),
    ("6b_onset", {**FALL, "periods_s": PERIODS, "stiffness_n_per_m": (20.0, 25.0), "ways": first(1)}),
]  # fmt: skip


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        *(pytest.param(*each, id=each[0]) for each in STUDIES),
        *(pytest.param(*each, id=each[0], marks=pytest.mark.slow) for each in SLOW),
    ],
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
