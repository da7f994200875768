"""Distributions against closed forms, the grammar of tolerances, and what is refused."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from cosim.ngspice.flatten import including
from cosim.tolerance.distribution_functions import extracted_calls
from cosim.tolerance.distributions import Shape
from cosim.tolerance.eseries import SERIES, preferred
from cosim.tolerance.grammar import Wrong, begins, parse, shape_before

U = (np.arange(200_000) + 0.5) / 200_000


def moments(shape: Shape) -> tuple[float, float]:
    x = shape.inverse(U)
    return float(np.mean(x)), float(np.std(x))


def test_a_tolerance_is_a_gaussian_of_three_sigma_that_is_cut() -> None:
    """Standard deviation of a Gaussian cut at k sigma: sigma sqrt(1 - 2 k phi(k) / (2 Phi(k) - 1))."""
    shape = parse("tol=1%").own
    assert shape is not None
    k = 3.0
    share = math.sqrt(1.0 - 2.0 * k * stats.norm.pdf(k) / (2.0 * stats.norm.cdf(k) - 1.0))
    assert share == pytest.approx(0.9866, abs=5e-5)
    mean, sigma = moments(shape)
    assert mean == pytest.approx(0.0, abs=1e-9)
    assert sigma == pytest.approx(share * 0.01 / 3.0, rel=1e-5)
    assert shape.moments() == pytest.approx((0.0, share * 0.01 / 3.0), rel=1e-6, abs=1e-12)
    assert shape.support == (-0.01, 0.01)


@pytest.mark.slow
def test_the_inverse_of_a_cut_gaussian_is_scipys() -> None:
    shape = Shape("truncated", -0.02, 0.02, 2.0)
    assert shape.inverse(U) == pytest.approx(
        stats.truncnorm.ppf(U, -2.0, 2.0, scale=0.01), rel=1e-9, abs=1e-12
    )


def test_uniform_and_uncut_have_the_moments_of_the_books() -> None:
    assert moments(Shape("uniform", -0.05, 0.05))[1] == pytest.approx(0.05 / math.sqrt(3.0), rel=1e-6)
    mean, sigma = Shape("gauss", -0.03, 0.06).moments()
    assert moments(Shape("gauss", -0.03, 0.06)) == pytest.approx((mean, sigma), rel=1e-3)


def test_sorted_has_nothing_in_the_middle() -> None:
    stated = parse("tol=5% sorted(inner=1%)").own
    assert stated is not None
    x = stated.inverse(U)
    assert np.abs(x).min() >= 0.01
    assert np.abs(x).max() <= 0.05
    inner, outer = stats.norm.cdf([0.6, 3.0])
    below_two = (stats.norm.cdf(1.2) - inner) / (outer - inner)
    assert np.mean(np.abs(x) < 0.02) == pytest.approx(below_two, abs=1e-4)
    assert np.all(np.diff(x) >= 0.0)


def test_asymmetric_limits_keep_the_median() -> None:
    shape = parse("tol=-1%/+3%").own
    assert shape is not None
    assert (shape.low, shape.high) == (-0.01, 0.03)
    assert float(shape.inverse(np.array([0.5]))[0]) == pytest.approx(0.0, abs=1e-12)


def test_a_histogram_is_drawn_by_its_inverse(tmp_path: Path) -> None:
    (tmp_path / "lot.csv").write_text("from,to,count\n-2,-1,1\n1,2,3\n")
    shape = parse("histogram=lot.csv", tmp_path).own
    assert shape is not None
    x = shape.inverse(U)
    assert np.mean(x < 0.0) == pytest.approx(0.25, abs=1e-4)
    assert not np.any((x > -0.01) & (x < 0.01 - 1e-6))
    # means of the bins -1.5 % and 1.5 %, each uniform over 1 %
    variance = 1e-4 * (1.0 / 12.0 + 0.25 * (1.5 + 0.75) ** 2 + 0.75 * (1.5 - 0.75) ** 2)
    assert shape.moments() == pytest.approx((0.0075, math.sqrt(variance)), rel=1e-12)


@pytest.mark.parametrize(
    "text",
    ["tol=", "tol=foo%", "tol=0%", "tol=-1%", "lot=-5% dev=1%", "tol=1% dev=1%", "tol=1% lot=1%",
     "tol=1% film", "tol=1% sigmas=0", "tol=1% sorted(inner=2%)", "match= dev=1%", "match=a:b tol=1%",
     "tol=1% uniform gauss", "tol=+1%/+2%", "tol=1% tol=2%", "histogram=none.csv", "tol=1%%",
     "tol=1e400%", "lot=1e400"],
)  # fmt: skip
def test_what_cannot_be_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(Wrong):
        parse(text, tmp_path)


def test_a_histogram_lies_in_the_project_or_where_the_user_says(tmp_path: Path) -> None:
    """A board or a scene read any file, and the error repeated a row of one that was no histogram."""
    inner, outer = tmp_path / "project", tmp_path / "outside"
    inner.mkdir()
    outer.mkdir()
    (outer / "lot.csv").write_text("percent\n-1\n1\n")
    (inner / "link.csv").symlink_to(outer / "lot.csv")
    absolute = str(outer / "lot.csv")
    for name in (
        "../outside/lot.csv",
        "link.csv",
        *([] if " " in absolute else [absolute]),
    ):  # words end at blanks
        with pytest.raises(Wrong, match=re.escape(f"--include {outer} or --trust allows it")):
            parse(f"histogram={name}", inner)
        assert parse(f"histogram={name}", inner, [outer]) == parse(f"histogram={name}", inner, None)
        with including([outer]):
            assert parse(f"histogram={name}", inner).own is not None
    (inner / "secret.csv").write_text("percent\nthe password\n")
    with pytest.raises(Wrong) as caught:
        parse("histogram=secret.csv", inner)
    assert "password" not in str(caught.value)


@pytest.mark.parametrize(
    ("comment", "shape"),
    [
        ("sorted(inner=1%) tol=5%", "sorted(inner=1%)"),
        ("Ohm, uniform tol=5%", "uniform"),
        ("sigmas=2, lot=5% dev=1%", "sigmas=2"),
        ("tol=5% uniform", ""),
        ("flat pack; tol=5%", ""),
        ("Ohm, non-uniform tol=5%", ""),
        ("uniform", ""),
    ],
)
def test_a_shape_before_the_tolerance_is_seen(comment: str, shape: str) -> None:
    assert shape_before(comment) == shape


def test_words_for_people_stand_behind_a_semicolon() -> None:
    assert begins("tol=5% ; F, film") == "tol=5%"
    assert begins("Ohm, tol = 1% uniform") == "tol = 1% uniform"
    assert begins("V, 1 V/rad") is None
    assert begins("Ohm, histogram=lot.csv ; measured") == "histogram=lot.csv"
    assert parse("tol = -1 %/+2 % uniform").own == Shape("uniform", -0.01, 0.02)
    assert parse("1 %") == parse("1%")
    assert parse("tol = 1% uniform").own == Shape("uniform", -0.01, 0.01)
    lot = parse("lot=5% dev=1%")
    assert lot.shared == Shape("truncated", -0.05, 0.05)
    assert lot.own == Shape("truncated", -0.01, 0.01)


@pytest.mark.parametrize(
    ("text", "nominal", "kind", "sigma"),
    [
        ("agauss(1k, 100, 3)", 1e3, "gauss", 100 / 3),
        ("gauss(1k, 0.1, 3)", 1e3, "gauss", 100 / 3),
        ("aunif(1k, 50)", 1e3, "uniform", 50 / math.sqrt(3)),
        ("unif(1k, 0.05)", 1e3, "uniform", 50 / math.sqrt(3)),
        ("mc(1k, 0.05)", 1e3, "uniform", 50 / math.sqrt(3)),
        ("limit(1k, 20)", 1e3, "limit", 20.0),
        ("flat(3)", 0.0, "uniform", 3 / math.sqrt(3)),
        ("gauss(2)", 0.0, "gauss", 2.0),
    ],
)
def test_functions_as_ngspice_and_ltspice_define_them(
    text: str, nominal: float, kind: str, sigma: float
) -> None:
    rest, calls, wrong = extracted_calls(text)
    assert (rest, wrong) == ("drawn__1", "")
    middle, shape = calls["drawn__1"]
    assert (middle, shape.kind) == (nominal, kind)
    assert moments(shape)[1] == pytest.approx(sigma, rel=1e-3)


def test_preferred_values_are_the_catalogues() -> None:
    assert [len(SERIES[name]) for name in SERIES] == [6, 12, 24, 48, 96, 192]
    assert preferred(168e3, "E96") == 169e3
    assert preferred(9.9e3, "E12") == 10e3
    assert preferred(4.0, "E24") == 3.9
    assert SERIES["E6"] == (1.0, 1.5, 2.2, 3.3, 4.7, 6.8)
    assert SERIES["E12"][1::2] == (1.2, 1.8, 2.7, 3.9, 5.6, 8.2)
    assert set(SERIES["E48"]) <= set(SERIES["E96"]) <= set(SERIES["E192"])
