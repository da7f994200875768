"""Bounds of a failure rate that is counted in strata: their coverage by enumeration of all outcomes."""

import itertools

import numpy as np
import pytest
from scipy import stats

from cosim.tolerance.border_strata import BORDER, FAILS, PASSES, allocation, failure_rate
from cosim.tolerance.strata_bounds import highest_rates

#: The strata's shares and samples: small enough that all outcomes are counted, and unequal.
DESIGNS = {
    "little at the border": ((0.1, 0.05, 0.85), (2, 4, 14)),
    "much at the border": ((0.1, 0.6, 0.3), (2, 7, 6)),
    "one sample at the border": ((0.3, 0.1, 0.6), (5, 1, 8)),
}
ALPHA = 0.05


def bounds(weights, counted, order):
    """Outcome -> largest weighted sum that it allows."""
    outcomes = list(itertools.product(*(range(n + 1) for n in counted)))
    w = np.array(weights)
    return outcomes, np.array([w @ highest_rates(w, x, counted, order, ALPHA) for x in outcomes])


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("order", [(PASSES, BORDER, FAILS), (FAILS, BORDER, PASSES)])
def test_whatever_the_rates_a_bound_is_exceeded_in_at_most_five_of_a_hundred(design, order):
    """Exact: the probability of every outcome, at 300 sets of rates, many of them at 0 or 1.

    Seen to fail with the whole of alpha for the ordered strata and none for the third, and with the
    tie-breaker's rate held at its estimate.
    """
    weights, counted = DESIGNS[design]
    outcomes, highest = bounds(weights, counted, order)
    rng = np.random.default_rng(7)
    x = np.array(outcomes)
    for k in range(300):
        rates = rng.beta(0.5, 0.5, 3) if k % 2 else rng.beta([20.0, 2.0, 0.2], [0.2, 2.0, 20.0])
        probability = np.prod([stats.binom.pmf(x[:, h], counted[h], rates[h]) for h in range(3)], axis=0)
        missed = probability[highest < np.dot(weights, rates) - 1e-12].sum()
        assert missed <= ALPHA + 1e-9, (rates, missed)


def test_no_failure_and_a_narrow_border_cost_less_than_both_bounds_together():
    """Of 5,000: exp(-n p) Phi(-d) = alpha at the worst d is (ln(1/alpha) - 0.4)/n for a border whose
    deviation is 0.235/n; the bounds at half of alpha each add up to 5.0/n."""
    n, w = 5000, np.array([0.0, 0.0025, 0.9975])
    border = round((0.5 * w[BORDER] * n / 0.235) ** 2)
    failed, counted = (0, border // 2, 0), (0, border, n)
    off = w @ highest_rates(w, failed, counted, (PASSES, BORDER, FAILS), ALPHA) - 0.5 * w[BORDER]
    expected = np.log(1.0 / (0.92 * ALPHA)) - 0.4
    assert off * n == pytest.approx(expected, rel=0.05)


def test_one_per_cent_of_failures_is_known_to_a_twenty_fifth_of_a_per_cent_by_7000_dear_samples():
    """A thirtieth of the 241,000 that Clopper and Pearson's interval of this width takes is 8,060."""
    plain, weights = 5400, np.array([0.0085, 0.003, 0.9885])
    counted = allocation(weights, plain, plain // 2)
    known = np.tile(weights, (16, 1))
    result = failure_rate(known, (counted[0], counted[1] // 2, 0), counted, 1 << 22)
    more = np.array(counted) - plain * weights
    assert plain + more[more > 0].sum() < 7000
    assert result.half < 0.0004
