"""Sampling, intervals, surfaces, bill and worst case against closed forms."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from cosim.errors import InputError
from cosim.tolerance import intervals
from cosim.tolerance.bill import best_pair, bill, bought
from cosim.tolerance.corner_search import corner
from cosim.tolerance.distributions import Shape
from cosim.tolerance.monte_carlo import Study, draw, pilot_size, yields
from cosim.tolerance.random_variables import Component, Tolerances
from cosim.tolerance.sensitivity import fit_surface
from cosim.tolerance.spec import Spec, parse_specs
from cosim.tolerance.study_results import find
from cosim.tolerance.trim import Trim, Trimmed
from cosim.tolerance.unit_cube import Method, sampling
from cosim.tolerance.value_expression import Recipe, Term
from cosim.tolerance.worst_case import extremes

Array = np.ndarray
NAME = "k_max"


class Formula:
    """A batch whose measure is a formula of the values."""

    def __init__(self, formula: Callable[[Array], Array]) -> None:
        self._formula = formula
        self.failures: dict[int, str] = {}

    def measures(self, values: Array) -> Array:
        return self._formula(values)[:, None]


def parts(nominal: list[float], *shapes: Shape, lot: Shape | None = None) -> Tolerances:
    """Components with own deviations, and a lot that all share."""
    variables = [f"r{k}" for k in range(len(nominal))] + (["lot"] if lot else [])
    rows = []
    for k, value in enumerate(nominal):
        terms = [Term(k, shapes[k % len(shapes)])] + ([Term(len(nominal), lot)] if lot else [])
        rows.append(Component(f"r{k}", value, "Ohm", "", recipe=Recipe(value, terms=tuple(terms))))
    return Tolerances(tuple(rows), tuple(variables))


def study(
    tolerances: Tolerances, formula: Callable[[Array], Array], n: int, method: Method = "plain", seed: int = 1
) -> Study:
    how = sampling(method, n, len(tolerances.variables), seed)
    return draw(tolerances, how, [NAME], Formula(formula), "ideal")


def divider(values: Array) -> Array:
    return values[:, 1] / (values[:, 0] + values[:, 1])


GAUSS = Shape("gauss", -0.01, 0.01)
UNIFORM = Shape("uniform", -0.01, 0.01)


@pytest.mark.parametrize("shape", [GAUSS, UNIFORM, Shape("truncated", -0.01, 0.01)])
def test_divider(shape: Shape) -> None:
    """v = 1/2 + (d2 - d1)/4 to first order, so sd = sigma sqrt(2)/4; the next order is 1e-4 of it."""
    sigma = shape.moments()[1]
    result = study(parts([1e3, 1e3], shape), divider, 20_000)
    mean, spread = (of(result.column(NAME), result.sampling) for of in (intervals.mean, intervals.spread))
    assert mean.low <= 0.5 <= mean.high
    assert spread.low <= sigma * math.sqrt(2.0) / 4.0 * (1 + 1e-4)
    assert spread.high >= sigma * math.sqrt(2.0) / 4.0 * (1 - 1e-4)


def test_of_a_divider_the_lot_cancels() -> None:
    """Both resistors move together by the lot: what is left is their own deviation."""
    with_lot = study(parts([1e3, 1e3], GAUSS, lot=Shape("gauss", -0.05, 0.05)), divider, 4000)
    spread = intervals.spread(with_lot.column(NAME), with_lot.sampling)
    assert spread.low <= 0.01 / 3 * math.sqrt(2.0) / 4.0 * 1.01
    assert spread.high >= 0.01 / 3 * math.sqrt(2.0) / 4.0 * 0.99


def test_one_parameter_on_two_resistors_with_and_without_match() -> None:
    matched = parts([1e3, 1e3], Shape("gauss", -1e-9, 1e-9), lot=GAUSS)
    assert float(np.std(study(matched, divider, 500).column(NAME))) < 1e-9
    assert float(np.std(study(parts([1e3, 1e3], GAUSS), divider, 500).column(NAME))) > 1e-3


def test_rc_corner() -> None:
    """f = 1/(2 pi R C): ln f is the sum of two uniforms' logarithms; mean and variance by quadrature."""
    r, c = Shape("uniform", -0.05, 0.05), Shape("uniform", -0.2, 0.2)
    tolerances = parts([1.58e3, 1e-6], r, c)
    result = study(tolerances, lambda v: 1.0 / (2.0 * np.pi * v[:, 0] * v[:, 1]), 16_384, "sobol")

    def inverse_mean(a: float, power: int) -> float:
        """Mean of (1 + d)^-power of d uniform within +-a."""
        return math.log((1 + a) / (1 - a)) / (2 * a) if power == 1 else 1.0 / (1.0 - a**2)

    f = 1.0 / (2.0 * math.pi * 1.58e-3)
    mean = f * inverse_mean(0.05, 1) * inverse_mean(0.2, 1)
    second = f**2 * inverse_mean(0.05, 2) * inverse_mean(0.2, 2)
    answer = intervals.mean(result.column(NAME), result.sampling)
    assert answer.low <= mean <= answer.high
    assert answer.half < 1e-4 * mean  # plain samples leave 1.5e-3
    spread = intervals.spread(result.column(NAME), result.sampling)
    assert spread.low <= math.sqrt(second - mean**2) <= spread.high


@pytest.mark.parametrize("method", ["plain", "lhs", "sobol"])
def test_a_sample_depends_on_its_number_alone(method: Method) -> None:
    how = sampling(method, 200, 7, 3)
    result = how.uniforms(0, how.n)
    pieces = [how.uniforms(at, min(13, how.n - at)) for at in range(0, how.n, 13)]
    assert np.array_equal(result, np.vstack(pieces))
    assert np.array_equal(how.uniforms(150, 1)[0], result[150])
    assert 0.0 < result.min() < result.max() < 1.0
    assert not np.array_equal(result, sampling(method, 200, 7, 4).uniforms(0, how.n))
    assert abs(result.mean() - 0.5) < 5 / math.sqrt(12 * result.size)


def test_intervals_hold_as_often_as_they_say() -> None:
    """95 % of 400 repeats, to 4 standard deviations of the count."""
    truth = {"mean": 0.0, "spread": 1.0, "quantile": stats.norm.ppf(0.9), "share": 0.9}
    hit = dict.fromkeys(truth, 0)
    rng = np.random.default_rng(5)
    how = sampling("plain", 100, 1, 0)
    for _ in range(400):
        x = rng.standard_normal(100)
        by_name = {
            "mean": intervals.mean(x, how),
            "spread": intervals.spread(x, how),
            "quantile": intervals.quantile(x, 0.9, how),
            "share": intervals.share(x < stats.norm.ppf(0.9), how),
        }
        for name, of in by_name.items():
            hit[name] += of.low <= truth[name] <= of.high
    for name, count in hit.items():
        slack = 0.02 if name == "spread" else 0.0  # the delta method falls a little short at 100 samples
        assert count / 400 >= 0.95 - slack - 4 * math.sqrt(0.95 * 0.05 / 400), name


def test_of_randomisations_the_interval_is_students_and_narrow() -> None:
    """A smooth mean by Sobol points: covered in 95 % of 100 seeds, far narrower than by plain samples."""
    tolerances = parts([1e3, 1e3], UNIFORM)
    covered, halves = 0, []
    for seed in range(100):
        how = sampling("sobol", 256, 2, seed)
        result = intervals.mean(divider(tolerances.values(how.uniforms(0, how.n))), how)
        # E v = 1/2 by symmetry of the two resistors
        covered += result.low <= 0.5 <= result.high
        halves.append(result.half)
    assert covered >= 95 - 4 * math.sqrt(100 * 0.95 * 0.05)
    assert float(np.median(halves)) < 0.2 * 1.96 * 0.01 / math.sqrt(3) * math.sqrt(2) / 4 / 16


def test_where_all_pass_the_bound_is_not_zero() -> None:
    how = sampling("lhs", 160, 2, 1)
    result = intervals.share(np.ones(160, dtype=bool), how)
    assert result.low == pytest.approx(0.025 ** (1 / 160), rel=1e-9)
    exact = stats.binomtest(7, 90).proportion_ci(method="exact")
    assert intervals.clopper_pearson(7, 90) == pytest.approx((exact.low, exact.high), rel=1e-9)


def by_hand(groups: list[Array], of: Callable[[Array], float]) -> tuple[float, float]:
    """Middle and half an interval, leaving one group out after the other."""
    r, every = len(groups), np.concatenate(groups)
    rest = [np.concatenate(groups[:j] + groups[j + 1 :]) for j in range(r)]
    pseudo = [r * of(every) - (r - 1) * of(some) for some in rest]
    return float(np.mean(pseudo)), stats.t.ppf(0.975, r - 1) * float(np.std(pseudo, ddof=1)) / math.sqrt(r)


@pytest.mark.parametrize("method", ["lhs", "sobol"])
def test_what_samples_lack_leaves_the_others_in_their_own_randomisation(method: Method) -> None:
    """Four samples each, of which some lack the measure: 4, 2, 3, none at all, 1 ... are left of them.

    They were cut into sixteen equal pieces again, which then held parts of two randomisations each.
    """
    how = sampling(method, 64, 2, 1)
    assert how.each == 4
    values = np.random.default_rng(2).standard_normal(64) + np.repeat(np.arange(16.0), 4)
    values[[4, 7, 9, *range(12, 16), 17, 18, 19, 63]] = math.nan
    groups = [row[np.isfinite(row)] for row in values.reshape(16, 4) if np.isfinite(row).any()]
    assert len(groups) == 15
    by = "Student t, 15 of 16 randomisations"
    for of, exact in ((intervals.mean, np.mean), (intervals.spread, lambda x: float(np.std(x, ddof=1)))):
        result, (middle, half) = of(values, how), by_hand(groups, exact)
        assert (result.value, result.high) == pytest.approx((middle, middle + half), rel=1e-12)
        assert result.how == by
    below = intervals.quantile(values, 0.5, how)
    known = np.sort(np.concatenate(groups))
    _, half = by_hand([g <= below.value for g in groups], np.mean)
    ends = math.floor(53 * (0.5 - half)), math.ceil(53 * (0.5 + half)) + 1
    assert (below.low, below.high) == (known[ends[0] - 1], known[ends[1] - 1])
    # of a yield those without the measure are devices that do not pass: all are counted
    passed = values > 5.0
    assert intervals.share(passed, how).half == pytest.approx(
        by_hand(list(passed.reshape(16, 4)), np.mean)[1], rel=1e-12
    )


def test_of_one_randomisation_alone_no_interval_is_known() -> None:
    how = sampling("lhs", 64, 2, 1)
    values = np.full(64, math.nan)
    values[4:8] = 1.0, 2.0, 3.0, 6.0
    for of, value in ((intervals.mean, 3.0), (intervals.spread, math.sqrt(14.0 / 3.0))):
        result = of(values, how)
        assert (result.value, result.high, result.how) == (
            pytest.approx(value), math.inf, "Student t, 1 of 16 randomisations",
        )  # fmt: skip
    middle = intervals.quantile(values, 0.5, how)
    assert (middle.value, middle.low, middle.high) == (2.5, -math.inf, math.inf)
    values[40] = 4.0  # a deviation without the first randomisation has one value left, and so none
    assert intervals.spread(values, how).high == math.inf
    assert intervals.mean(values, how).high < math.inf
    with pytest.raises(ValueError, match="5 values of 64 samples"):
        intervals.mean(values[np.isfinite(values)], how)


def plane(values: Array) -> Array:
    """100 + 100 (d1 + 2 d2 + 0.5 d3), deviations as shares."""
    d = values / 1e3 - 1.0
    return 100.0 + 100.0 * (d @ np.array([1.0, 2.0, 0.5]))


def test_yield_of_a_hyperplane() -> None:
    """Distance to the border in standard deviations is all that counts."""
    tolerances = parts([1e3] * 3, GAUSS)
    sigma = 100 * 0.01 / 3 * math.sqrt(1 + 4 + 0.25)
    result = study(tolerances, plane, 20_000)
    answer = yields(result, parse_specs([f"k_max <= {100 + 1.2 * sigma}"]))
    estimate = next(iter(answer.values()))
    assert estimate.low <= stats.norm.cdf(1.2) <= estimate.high


def test_shares_of_variance_of_a_hyperplane() -> None:
    result = study(parts([1e3] * 3, UNIFORM), plane, 200)
    surface = fit_surface(result, NAME)
    assert surface is not None
    assert surface.held_out == pytest.approx(1.0, abs=1e-9)
    for each, weight in zip(surface.shares(), (1.0, 4.0, 0.25), strict=True):
        assert each.value == pytest.approx(weight / 5.25, abs=1e-9)
        assert each.low <= each.value <= each.high


def test_squares_and_products_are_found_where_a_plane_does_not_do() -> None:
    def bent(values: Array) -> Array:
        d = (values / 1e3 - 1.0) / 0.01
        return 5.0 + d[:, 0] + 0.5 * d[:, 0] * d[:, 1] + 0.7 * d[:, 2] ** 2

    result = study(parts([1e3] * 8, UNIFORM), bent, 256)
    surface = fit_surface(result, NAME)
    assert surface is not None
    assert surface.held_out > 0.9999
    assert {frozenset(pair) for pair in surface.terms} >= {frozenset((0, 1)), frozenset((2,))}


def test_squares_of_what_is_not_gaussian_have_their_own_variance() -> None:
    """z^2 of a uniform deviation varies by 4/5, of a Gaussian by 2: shares by hand."""

    def bent(values: Array) -> Array:
        z = (values / 1e3 - 1.0) / 0.01 * math.sqrt(3.0)
        return z[:, 0] + 0.5 * z[:, 1] ** 2 + 0.5 * z[:, 1]

    surface = fit_surface(study(parts([1e3] * 4, UNIFORM), bent, 256), NAME)
    assert surface is not None
    first, second = 1.0, 0.25 * 0.8 + 0.25
    shares = [each.value for each in surface.shares()]
    assert shares[:2] == pytest.approx([first / (first + second), second / (first + second)], abs=1e-6)


def test_the_square_of_a_lopsided_deviation_is_correlated_with_it() -> None:
    """Of r = max(n, 0), n Gaussian: E r = 1/sqrt(2 pi), E r^2 = 1/2, E r^3 = sqrt(2/pi), E r^4 = 3/2."""
    one_sided = Shape("gauss", 0.0, 0.01)

    def bent(values: Array) -> Array:
        d = (values / 1e3 - 1.0) / 0.01
        return math.sqrt(3.0) * d[:, 0] + 3.0 * d[:, 1] - 0.75 * (3.0 * d[:, 1]) ** 2

    surface = fit_surface(study(parts([1e3] * 4, UNIFORM, one_sided), bent, 256), NAME)
    assert surface is not None
    e1, e2, e3, e4 = 1.0 / math.sqrt(2.0 * math.pi), 0.5, math.sqrt(2.0 / math.pi), 1.5
    lopsided = (e2 - e1**2) - 2.0 * 0.75 * (e3 - e1 * e2) + 0.75**2 * (e4 - e2**2)
    shares = [each.value for each in surface.shares()]
    # the moments of an open end by Gauss and Legendre are good to some 1e-4
    assert shares[:2] == pytest.approx([1.0 / (1.0 + lopsided), lopsided / (1.0 + lopsided)], abs=1e-3)


def ishigami(values: Array) -> Array:
    x = (values / 1e3 - 1.0) / 0.01 * math.pi
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_shares() -> Array:
    """First-order indices in closed form (Ishigami and Homma, 1990), a = 7, b = 0.1."""
    a, b, pi = 7.0, 0.1, math.pi
    variance = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5
    return np.array([0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, 0.0]) / variance


def test_without_the_extra_rough_shares_are_marked_as_rough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.tolerance.sensitivity.available", lambda: False)
    findings = find(study(parts([1e3] * 3, UNIFORM), ishigami, 256), ())
    surface = findings.surfaces[NAME]
    assert surface.chaos is None
    assert surface.explained < 0.99
    assert any("less than 0.99" in note for note in findings.notes)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sparse_chaos_finds_the_indices_of_ishigami(seed: int) -> None:
    """+-0.01 from 256 samples, where what was not fitted is explained to 0.99."""
    pytest.importorskip("openturns", reason="needs the extra: pip install 'cosim[stat]'")
    surface = fit_surface(study(parts([1e3] * 3, UNIFORM), ishigami, 256, seed=seed), NAME)
    assert surface is not None
    assert surface.chaos is not None
    assert surface.explained >= 0.99
    assert [each.value for each in surface.shares()] == pytest.approx(ishigami_shares(), abs=0.01)


def test_sparse_chaos_of_gaussians_and_a_lot() -> None:
    """y = z1^3 + z2 lot: variances 15 and 1, of a lot as a variable of its own, none by itself."""
    pytest.importorskip("openturns", reason="needs the extra: pip install 'cosim[stat]'")
    tolerances = parts([1e3] * 2, GAUSS, lot=Shape("gauss", -0.01, 0.01))
    how = sampling("plain", 256, 3, 1)
    z = stats.norm.ppf(how.uniforms(0, 256))

    class Direct:
        failures: dict[int, str] = {}  # noqa: RUF012

        def measures(self, values: Array) -> Array:
            if len(values) == 1:
                return np.zeros((1, 1))
            return (z[:, :1] ** 3 + z[:, 1:2] * z[:, 2:]).copy()

    made = Study(tolerances, how, "ideal", (NAME,), np.zeros(1), Direct().measures(np.zeros((256, 2))))
    surface = fit_surface(made, NAME)
    assert surface is not None
    assert surface.explained >= 0.99
    assert [each.value for each in surface.shares()] == pytest.approx([15 / 16, 0.0, 0.0], abs=0.01)


def test_the_bill_names_what_to_buy() -> None:
    """With the dear component perfect the rest has sd s sqrt(1.25): the yield follows from the normal law."""
    tolerances = parts([1e3] * 3, GAUSS)
    result = study(tolerances, plane, 20_000)
    specs = (Spec(NAME, 99.0, 101.0),)
    surface = fit_surface(result, NAME)
    assert surface is not None
    lines = bill(result, {NAME: surface}, specs)
    assert [line.name for line in lines] == ["r1", "r0", "r2"]
    assert lines[0].slope[NAME] == pytest.approx(2.0, rel=1e-6)  # 200 times 1 %
    s = 100 * 0.01 / 3

    def within(variance: float) -> float:
        return 2.0 * float(stats.norm.cdf(1.0 / (s * math.sqrt(variance)))) - 1.0

    gain = lines[0].gain
    assert gain is not None
    assert lines[0].better == 0.005
    assert gain.low <= within(1.25 + 1.0) - within(5.25) <= gain.high
    both = bought(result, {NAME: surface}, specs, {"r1": 0.001, "r0": 0.001})
    assert both.low <= within(0.25 + 0.05) <= both.high
    pair = best_pair(result, {NAME: surface}, specs)
    assert pair is not None
    assert pair[:2] == (("r1", "r0"), both)
    assert pair[2]
    assert f"r1 and r0 bought at 0.1%: the yield becomes {100 * both.value:.4g} %" in " ".join(
        find(result, specs).notes
    )
    assert lines[0].loosest == 0.01  # what it is: any looser one costs yield


def test_where_no_pair_helps_it_is_reported() -> None:
    """All of the yield is lost by a component that is no resistor: two resistors at 0.1 % change nothing."""
    tolerances = parts([1e3] * 3, GAUSS)
    winding = replace(tolerances.components[1], key="xm:motor_r")
    tolerances = replace(tolerances, components=(tolerances.components[0], winding, tolerances.components[2]))

    def only(values: Array) -> Array:
        d = values / 1e3 - 1.0
        return 100.0 + 100.0 * (d @ np.array([1e-3, 2.0, 1e-3]))

    notes = " ".join(find(study(tolerances, only, 400), (Spec(NAME, 99.9, 100.1),)).notes)
    assert "no two resistors at 0.1% surely raise the yield" in notes
    assert "bought at" not in notes


def test_a_pilot_tells_how_many_samples_an_interval_takes() -> None:
    tolerances = parts([1e3] * 3, GAUSS)
    sigma = 100 * 0.01 / 3 * math.sqrt(5.25)
    specs = parse_specs([f"k_max <= {100 + 1.2816 * sigma}"])  # yield 90 %
    pilot = study(tolerances, plane, 64, seed=9)
    n = pilot_size(("yield", 0.02), pilot, specs)
    assert 0.3 * 864 < n < 3 * 864  # 0.9 * 0.1 (1.96 / 0.02)^2, of a share that 64 samples know
    result = next(iter(yields(study(tolerances, plane, n), specs).values()))
    assert result.half < 0.03


def test_a_lot_that_pulls_both_ways() -> None:
    """10 V behind 1 kOhm, two 100 Ohm resistors with a common lot of 10 % and 5 % of their own in series: the
    largest voltage across the lower one has 115 below and 105 above, 0.9426 V, not 115 and 115 (0.9350 V)."""
    tolerances = parts([100.0, 100.0], Shape("uniform", -0.05, 0.05), lot=Shape("uniform", -0.1, 0.1))

    def lower(values: Array) -> Array:
        return 10.0 * values[:, 0] / (1e3 + values[:, 0] + values[:, 1])

    result = study(tolerances, lower, 500)
    answer = corner(result, NAME, Formula(lower))
    assert answer.high == pytest.approx(10.0 * 115.0 / 1220.0, rel=1e-9)
    assert answer.high == pytest.approx(0.9426, abs=5e-5)
    assert (answer.high_at["r0"], answer.high_at["r1"]) == pytest.approx((115.0, 105.0))
    assert answer.high >= np.max(result.column(NAME))
    assert answer.low <= np.min(result.column(NAME))


def test_a_corner_that_the_cheap_model_finds_is_measured_on_the_study_s_own() -> None:
    """The study's own model has a tenth more, and only ever sees the two corners."""
    tolerances = parts([1e3, 1e3], UNIFORM)
    seen: list[int] = []

    def more(values: Array) -> Array:
        seen.append(len(values))
        return 1.1 * divider(values)

    result = study(tolerances, lambda values: 1.1 * divider(values), 50)
    answer = corner(result, NAME, Formula(divider), Formula(more))
    assert seen == [2]
    assert (answer.low, answer.high) == pytest.approx((1.1 * 0.99 / 2.0, 1.1 * 1.01 / 2.0), rel=1e-9)


@pytest.mark.parametrize("kind", ["uniform", "gauss"])
@pytest.mark.parametrize("seed", range(8))
def test_no_sample_inside_the_box_is_beyond_the_corner(kind: str, seed: int) -> None:
    """Of formulas that bend, turn and pull two ways; samples outside of the box are counted, not covered."""
    rng = np.random.default_rng(seed)
    weights, bends = rng.standard_normal(6), 0.5 * rng.standard_normal((6, 6))
    tolerances = parts([1e3] * 5, Shape(kind, -0.02, 0.02), lot=Shape(kind, -0.05, 0.05))  # type: ignore[arg-type]

    def bent(values: Array) -> Array:
        d = (values / 1e3 - 1.0) / 0.02
        x = np.column_stack([d, np.sin(d.sum(axis=1))])
        return x @ weights + np.einsum("ni,ij,nj->n", x, bends, x)

    result = study(tolerances, bent, 4000, seed=seed)
    worst = corner(result, NAME, Formula(bent))
    column = result.column(NAME)
    deviations = [tolerances.shape(j).inverse(result.uniforms()[:, j]) for j in range(6)]
    inside = np.all([np.abs(d) <= tolerances.shape(j).box[1] for j, d in enumerate(deviations)], axis=0)
    assert worst.outside == np.sum(~inside)
    assert (worst.outside > 0) == (kind == "gauss")
    assert worst.low <= column[inside].min()
    assert column[inside].max() <= worst.high


def test_an_extreme_within_the_box_and_one_that_takes_two_together() -> None:
    def hill(x: Array) -> Array:
        return -((x[:, 0] - 0.3) ** 2) - (x[:, 1] + 0.2) ** 2 + x[:, 2]

    _, most = extremes(hill, 3)
    assert most.value == pytest.approx(1.0, abs=1e-5)

    def saddle(x: Array) -> Array:
        """At the middle every slope is zero, and one alone changes nothing."""
        return x[:, 0] * x[:, 1]

    least, most = extremes(saddle, 2)
    assert (least.value, most.value) == (-1.0, 1.0)


def test_bad_specifications_are_reported_together() -> None:
    with pytest.raises(InputError) as caught:
        parse_specs(["k_maxx > 3", "k_max in 5..5", "k_max about 3", "rest_force < 5 mm", "headroom > 9 V"])
    assert len(caught.value.problems) == 5
    assert not [problem for problem in caught.value.problems if problem.unit]  # none behind the whole text


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("k_max in 0.1k..200 N/m", 100.0, 200.0),
        ("k_max in 0.1k..0.2kN/m", 100.0, 200.0),
        ("k_max in 0.1..0.2 kN/m", 100.0, 200.0),
        ("k_max < 2 MN/m", -math.inf, 2e6),  # mega in front of a unit, milli behind a number of SPICE
        ("k_max < 2meg N/m", -math.inf, 2e6),
        ("k_max < 2megN/m", -math.inf, 2e6),
        ("max_penetration < 20 mm", -math.inf, 0.02),
        ("max_penetration < 20mm", -math.inf, 0.02),
        ("max_penetration < 0.02 m", -math.inf, 0.02),
        ("rest_force > 50 mN", 0.05, math.inf),
        ("heat < 2 A^2 s", -math.inf, 2.0),
        ("heat < 2 A² s", -math.inf, 2.0),
    ],
)
def test_a_limit_may_have_a_unit_with_a_prefix(text: str, low: float, high: float) -> None:
    (spec,) = parse_specs([text])
    assert (spec.low, spec.high) == pytest.approx((low, high), rel=1e-12)


def test_nothing_varies_is_an_error_and_findings_are_whole() -> None:
    with pytest.raises(InputError, match="nothing varies"):
        draw(Tolerances(), sampling("plain", 3, 0, 1), [NAME], Formula(plane), "ideal")
    result = find(study(parts([1e3] * 3, GAUSS), plane, 64), (Spec(NAME, 99.0, 101.0),))
    answer = result.as_dict()
    assert answer["bill"][0]["name"] == "r1"
    assert len(result.samples_csv().splitlines()) == 65


def test_a_trimmer_is_set_for_each_device() -> None:
    """The measure is a ratio: the setting is the target's, and what cannot be reached has failed."""
    values = np.array([[1000.0, 500.0], [1040.0, 480.0], [9000.0, 500.0]])
    trimmed = Trimmed(Formula(lambda v: 100.0 * v[:, 1] / v[:, 0]), (NAME,), Trim("r1", NAME, 50.0), (1,))
    value = trimmed.measures(values)[:, 0]
    assert value[:2] == pytest.approx(50.0, rel=1e-6)
    assert math.isnan(value[2])  # it would take 9 times the resistor
    assert list(trimmed.failures) == [2]
