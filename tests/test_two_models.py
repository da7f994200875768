"""Two models of one scene: levels, strata, rare failures; from the command and against closed forms."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from formula_studies import LIMIT, SLOPE, D, formulas, measured
from scipy import special, stats
from support import SCENES

from cosim import cli
from cosim.tolerance import plane_samples
from cosim.tolerance.border_strata import (
    _LEAST,
    BORDER,
    FAILS,
    PASSES,
    allocation,
    failure_rate,
    learned,
    replicate_weights,
)
from cosim.tolerance.spec import Spec
from cosim.tolerance.unit_cube import sampling
from reports.monte_carlo import write_monte_carlo

WORDS = ["mc", str(SCENES / "drop.toml"), "--model", "linear", "--measure", "max_penetration"]
SPEC = Spec("k_max", high=LIMIT)


def cheap(u):
    return special.ndtri(u) @ SLOPE


def dear(u, fails_at=math.inf):
    """The cheap one, a little bent; and a failure that the cheap one knows nothing of."""
    z = special.ndtri(u)
    return np.where(z[:, 1] > fails_at, 9.0, z @ SLOPE + 0.02 * (z[:, 0] ** 2 - 1.0))


def truth(fails_at):
    """Failure rate by quadrature over z0 and z1: the other variables' sum is a Gaussian."""
    rest = math.sqrt(1.0 - SLOPE[0] ** 2 - SLOPE[1] ** 2)
    x, w = np.polynomial.hermite_e.hermegauss(60)
    w = w / w.sum()
    nodes, weights = np.polynomial.legendre.leggauss(400)
    z1 = 8.5 * nodes
    density = 8.5 * weights * stats.norm.pdf(z1)
    needed = LIMIT - SLOPE[0] * x[:, None] - SLOPE[1] * z1[None, :] - 0.02 * (x[:, None] ** 2 - 1.0)
    failing = np.where(z1[None, :] > fails_at, 1.0, stats.norm.sf(needed / rest))
    return float(w @ failing @ density)


def truth_at(limit):
    """Failure rate of the bent model beyond any limit."""
    nodes, weights = np.polynomial.legendre.leggauss(2000)
    z0 = 8.5 * nodes
    rest = math.sqrt(1.0 - SLOPE[0] ** 2)
    needed = limit - SLOPE[0] * z0 - 0.02 * (z0**2 - 1.0)
    return float(8.5 * weights @ (stats.norm.pdf(z0) * stats.norm.sf(needed / rest)))


def estimate(seed, fails_at, n=600, cheap_samples=1 << 13):
    """The failure rate as the study of two models takes its samples."""
    how = sampling("plain", 1 << 20, D, seed)
    first = 32
    u = how.uniforms(0, first)
    border = learned([SPEC], {"k_max": cheap(u)}, {"k_max": dear(u, fails_at)})
    cube = sampling("sobol", cheap_samples, D, seed + 1_000_000)
    weights = replicate_weights(border.strata({"k_max": cheap(cube.uniforms(0, cube.n))}), cube.replicates)
    wanted = allocation(weights.mean(axis=0), n - first, n // 2)
    pool = how.uniforms(first, 8 * n)
    strata = border.strata({"k_max": cheap(pool)})
    failed, counted = [], []
    for h in range(3):
        there = np.flatnonzero(strata == h)
        taken = there[: max(wanted[h], int(np.sum(there < n - first)))]
        failed.append(int(np.sum(~SPEC.passed(dear(pool[taken], fails_at)))))
        counted.append(len(taken))
    return failure_rate(weights, failed, counted, cube.n)


def test_dear_samples_are_added_only_where_they_lack():
    """Of the strata 1 %, 9 % and 90 %, a thousand plain samples hold 10, 90 and 900: four times the failing
    are wanted, and of what passes none more. Broken once: with `wanted + there` no test failed."""
    weights = np.zeros(3)
    weights[[FAILS, BORDER, PASSES]] = 0.01, 0.09, 0.9
    failing, _, passing = allocation(weights, 1000, 10**9)
    assert (failing, passing) == (max(40, _LEAST), 900)
    few = allocation(weights, 1000, 8)  # eight at most on top of the thousand, each stratum rounded up
    assert 1000 <= sum(few) <= 1008 + 3


@pytest.mark.parametrize("fails_at", [math.inf, 3.0])
def test_a_yield_by_strata_is_unbiased_and_covered(fails_at):
    exact = truth(fails_at)
    rows = [estimate(seed, fails_at) for seed in range(40)]
    values = np.array([each.value for each in rows])
    assert abs(values.mean() - exact) < 4.0 * values.std(ddof=1) / math.sqrt(40)
    # 95 % of 40 less three times a binomial's own scatter
    assert sum(each.low <= exact <= each.high for each in rows) >= 34


@pytest.mark.slow
@pytest.mark.parametrize("fails_at", [math.inf, 3.0])
def test_the_interval_of_strata_covers_in_1880_of_2000_repeats(fails_at):
    exact = truth(fails_at)
    rows = [estimate(seed, fails_at) for seed in range(2000)]
    assert sum(each.low <= exact <= each.high for each in rows) >= 1880


def test_no_failure_leaves_the_bound_of_every_stratum():
    """Zero of n: three over n at least, whatever the cheap model is sure of."""
    weights = np.tile([0.0, 0.01, 0.99], (16, 1))
    result = failure_rate(weights, (0, 0, 0), (0, 20, 300), 1 << 16)
    assert result.value == 0.0
    assert result.high > 0.99 * 3.0 / 300
    # a stratum without a sample may fail or not
    none = failure_rate(np.tile([0.1, 0.2, 0.7], (16, 1)), (0, 0, 0), (0, 10**6, 10**6), 1 << 16)
    assert none.value == pytest.approx(0.1 / 2, rel=1e-12)
    assert none.low == 0.0
    assert none.high > 0.1
    # and with few cheap samples what they have not met: three of 1024 are at the border
    few = failure_rate(np.tile([0.0, 3 / 1024, 1021 / 1024], (16, 1)), (0, 3, 0), (0, 3, 10**6), 1024)
    assert few.high > stats.beta.ppf(0.975, 4, 1021)


def test_mean_and_deviation_of_a_study_of_two_models(tmp_path):
    """Mean 0 and variance 1 + 2 * 0.02^2 in closed form; kept levels are not measured again."""
    result = measured(formulas(400, two_level=True), tmp_path)
    value = result.summaries["peak_force"]
    spread = math.sqrt(1.0 + 2.0 * 0.02**2)
    assert value.mean.low <= 0.0 <= value.mean.high
    assert value.spread.low <= spread <= value.spread.high
    assert "corrected by linear" in value.mean.how
    # what plain samples leave, and what is left of it: the bend's share, 0.028
    assert value.mean.half < 0.2 * 1.96 / math.sqrt(400)
    levels = result.levels
    assert levels.moments["peak_force"].pilot.correlation > 0.999
    share = levels.yields["peak_force <= 2 N"]
    assert share.failing.low <= truth(math.inf) <= share.failing.high
    assert sum(share.counted) == 400 - 32 + levels.extra
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "levels").rglob("*.parquet")}
    assert len(before) >= 2
    again = measured(formulas(400, two_level=True), tmp_path)
    assert again.levels.as_dict() == levels.as_dict()
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "levels").rglob("*.parquet")} == before
    assert "Two models" in write_monte_carlo(result, tmp_path, "cosim mc --sample", "x").read_text()
    assert (tmp_path / "sliders.html").stat().st_size < 500_000


def test_another_limit_in_the_same_folder_has_a_border_of_its_own(tmp_path):
    """Samples chosen at 2.0 were counted for 2.2 as if they were any: strata as in a folder of its own."""
    measured(formulas(300, two_level=True, limit=2.0), tmp_path / "one")
    again, fresh = (
        measured(formulas(300, two_level=True, limit=2.2), tmp_path / name).levels for name in ("one", "two")
    )
    (a,), (b,) = again.yields.values(), fresh.yields.values()
    assert a.by == b.by == "a plane through samples of linear"
    assert fresh.extra > 0
    assert (a.weights, a.counted, a.failed, again.extra) == (b.weights, b.counted, b.failed, fresh.extra)


def test_what_is_left_of_an_interrupted_study_of_two_models_is_the_same(tmp_path):
    result = measured(formulas(100, two_level=True), tmp_path)
    for name in ("same", "cheap"):
        (tmp_path / "levels" / name / "samples.parquet").unlink()
    (tmp_path / "samples.parquet").unlink()
    again = measured(formulas(100, two_level=True), tmp_path)
    assert again.levels.as_dict() == result.levels.as_dict()


def test_a_failure_in_40_million_is_counted_by_300_samples(tmp_path):
    """The border of the dear model is nearly a plane, 5.45 standard deviations away at the cheap one."""
    result = measured(formulas(300, limit=5.45, rare=True), tmp_path)
    rare = result.rare
    # Gaussian and the bend's lean, to second order: by quadrature
    exact = truth_at(5.45)
    assert rare.distance == pytest.approx(5.45, abs=0.01)
    assert rare.first_order == pytest.approx(special.ndtr(-5.45), rel=0.05)
    assert rare.rate.value == pytest.approx(exact, rel=0.5)
    assert rare.rate.low <= exact <= rare.rate.high
    assert rare.effective > 10.0
    assert max(rare.device.items(), key=lambda each: abs(each[1] - 1.0))[0] == "r1"
    assert "rare failures" in " ".join(result.notes)
    assert "Rare failures" in write_monte_carlo(result, tmp_path, "cosim mc --sample", "x").read_text()


@pytest.mark.slow
def test_rare_failures_of_another_limit_in_the_same_folder(tmp_path):
    """They were refused as another study, after the whole search."""
    for limit in (4.5, 4.8):
        rare = measured(formulas(100, limit=limit, rare=True), tmp_path).rare
        assert rare.rate.low <= truth_at(limit) <= rare.rate.high
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "levels").rglob("*.parquet")}
    assert len(kept) == 2
    assert measured(formulas(100, limit=4.8, rare=True), tmp_path).rare == rare
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "levels").rglob("*.parquet")} == kept


def test_what_cannot_fail_is_the_answer(tmp_path):
    """Cut at three standard deviations the sum ends at 3 sum |a|, here 6.0: a limit of 6.5 is never met."""
    end = 3.0 * float(np.abs(SLOPE).sum())
    result = measured(formulas(64, kind="truncated", limit=end + 0.5, rare=True))
    assert "no device within the tolerances" in result.rare.word
    assert result.rare.rate.high == 0.0
    # within the corners' reach it is possible, and found
    near = measured(formulas(64, kind="truncated", limit=0.8 * end, rare=True))
    assert near.rare.places > 0


def test_a_study_of_measures_without_runs_has_no_second_model():
    prepared = replace(formulas(64, two_level=True), names=("curl",))
    prepared = replace(prepared, asked=replace(prepared.asked, specs=()))
    assert "needs a run" in " ".join(measured(prepared).notes)


@pytest.mark.parametrize("fails_at", [math.inf, 2.5])
def test_a_yield_by_planes_is_unbiased_and_covered(fails_at, monkeypatch):
    """As by the cheap model, without a sample of it for the weights; one case fails where nobody expects it.

    Seen to fail with the weight of the border halved.
    """
    monkeypatch.setattr(plane_samples, "_MOST", 1 << 14)
    rows = []
    for seed in range(40):
        study = formulas(200, two_level=True, seed=seed)
        levels = measured(replace(study, dear_fails_at=fails_at)).levels
        rows.append(levels.yields["peak_force <= 2 N"])
    # a pilot that sees much between the models makes a wide border: then the cheap model itself sorts
    assert sum(each.by == "a plane through samples of linear" for each in rows) >= 20
    exact = truth(fails_at)
    values = np.array([each.failing.value for each in rows])
    assert abs(values.mean() - exact) < 4.0 * values.std(ddof=1) / math.sqrt(40)
    # 95 % of 40 less three times a binomial's own scatter
    assert sum(each.failing.low <= exact <= each.failing.high for each in rows) >= 34


@pytest.mark.slow
def test_linear_is_corrected_by_ideal(tmp_path, capsys):
    """The drop with real windings: what op-amps add to its depth scatters little over the devices."""
    words = ["-n", "40", "--set", "duration_s=0.1", "--set", "effects.motor=ideal", "--two-level", "--json"]
    assert cli.main([*WORDS, *words, "--workers", "1", "-o", str(tmp_path / "mc")]) == 0
    result = json.loads(capsys.readouterr().out)
    levels = result["two_level"]
    assert (levels["dear"], levels["cheap"]) == ("linear", "ideal")
    depth = levels["moments"]["max_penetration"]
    assert depth["pilot"]["correlation"] > 0.9 or "plain sampling" in depth["word"]
    plain = result["measures"]["max_penetration"]["mean"]
    assert plain["low"] <= depth["mean"] <= plain["high"]


def command(capsys, *words):
    assert cli.main([*words]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--two-level", "-n", "20"], "too few"),
        (["--two-level", "--sampling", "sobol"], "is of plain samples"),
        (["--two-level", "--shard", "1/2"], "no meaning beside --shard"),
        (["--rare"], "give one"),
    ],
)
def test_slips_are_reported(words, reason, tmp_path, capsys):
    assert reason in command(capsys, *WORDS, *words, "-o", str(tmp_path / "mc"))
    assert not (tmp_path / "mc" / "samples.parquet").exists()
