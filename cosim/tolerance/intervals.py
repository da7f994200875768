"""Estimates with the interval that the sampling method allows.

Plain samples of a fixed number: Student's t for the mean, the delta method for the standard deviation, order
statistics for quantiles, Clopper and Pearson for a yield. Latin hypercubes and Sobol sequences: Student's t
over their independent randomisations.

Values come by the sample's number, with NaN where a sample has none. The number tells which randomisation
a sample belongs to, so that those that lack the measure leave the others where they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.tolerance.unit_cube import Sampling
from cosim.types import Array

__all__ = ["CONFIDENCE", "Estimate", "clopper_pearson", "mean", "quantile", "share", "spread"]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A number and its interval of `CONFIDENCE`; `how` it was made."""

    value: float
    low: float
    high: float
    how: str

    @property
    def half(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.high - self.low)


def clopper_pearson(hits: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the exact interval of a share."""
    alpha = 0.5 * (1.0 - confidence)
    low = float(scipy.stats.beta.ppf(alpha, hits, n - hits + 1)) if hits > 0 else 0.0
    high = float(scipy.stats.beta.ppf(1.0 - alpha, hits + 1, n - hits)) if hits < n else 1.0
    return low, high


def mean(values: Array, how: Sampling) -> Estimate:
    """Return the mean of a measure; `values` (n,), NaN where a sample has none."""
    if how.replicates > 1:
        return _replicated(values, how, np.mean)
    values = values[np.isfinite(values)]
    error = (
        _t(len(values) - 1) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
        if len(values) > 1
        else math.inf
    )
    middle = float(np.mean(values))
    return Estimate(middle, middle - error, middle + error, "Student t")


def spread(values: Array, how: Sampling) -> Estimate:
    """Return the standard deviation.

    Its variance follows from the fourth moment, whatever the distribution; for few samples or long tails
    the interval is too narrow.
    """

    def deviation(of: Array) -> float:
        return float(np.std(of, ddof=1)) if len(of) > 1 else math.nan

    if how.replicates > 1:
        return _replicated(values, how, deviation, at_least=0.0)
    values = values[np.isfinite(values)]
    n, sigma = len(values), deviation(values)
    if n < 4 or sigma == 0.0:
        return Estimate(sigma, 0.0 if n < 4 else sigma, math.inf if n < 4 else sigma, "delta method")
    kurtosis = float(np.mean((values - np.mean(values)) ** 4)) / sigma**4
    relative = 0.5 * math.sqrt(max(kurtosis - (n - 3) / (n - 1), 0.0) / n)
    factor = math.exp(_t(n - 1) * relative)
    return Estimate(sigma, sigma / factor, sigma * factor, "delta method")


def quantile(values: Array, share_below: float, how: Sampling) -> Estimate:
    """Return the value below which a share lies.

    Of plain samples the interval is between order statistics, valid for any distribution: infinite on a side
    where there are too few samples. Of randomisations the share below the estimate has Student's interval,
    and the quantile lies between the values at its ends (Woodruff, JASA 47, 635, 1952): the
    jackknife fails for a number that jumps from sample to sample.
    """

    def at(of: Array) -> float:
        return float(np.quantile(of, share_below, method="median_unbiased"))

    known = values[np.isfinite(values)]
    ordered, n, estimate = np.sort(known), len(known), at(known)
    if how.replicates > 1:
        # the share of those that have the measure: where a sample has none it is not below, nor is it counted
        below = np.where(np.isfinite(values), values <= estimate, math.nan)
        _middle, reach, by = _jackknife(below, how, np.mean)
        error = min(max(reach, 0.5 / n), 1.0)
        low, high = math.floor(n * (share_below - error)), math.ceil(n * (share_below + error)) + 1
        words = f"Student t of the share below, {by}"
    else:
        alpha = 0.5 * (1.0 - CONFIDENCE)
        # P(x_(k) <= quantile) = P(binomial(n, share) >= k): the largest k below, the least k above
        low = int(scipy.stats.binom.ppf(alpha, n, share_below))
        high = int(scipy.stats.binom.ppf(1.0 - alpha, n, share_below)) + 1
        words = "order statistics"
    return Estimate(
        estimate,
        float(ordered[low - 1]) if low >= 1 else -math.inf,
        float(ordered[high - 1]) if high <= n else math.inf,
        words,
    )


def share(passed: NDArray[np.bool_], how: Sampling) -> Estimate:
    """Return the share of samples that pass."""
    hits, n = int(np.sum(passed)), len(passed)
    exact = clopper_pearson(hits, n)
    if how.replicates == 1:
        return Estimate(hits / n, *exact, "Clopper-Pearson")
    estimate = _replicated(passed.astype(float), how, np.mean)
    if estimate.half == 0.0:  # all randomisations agree: their scatter says nothing of what none has met
        return Estimate(estimate.value, *exact, "Clopper-Pearson, the randomisations being equal")
    return Estimate(estimate.value, max(estimate.low, 0.0), min(estimate.high, 1.0), estimate.how)


def _replicated(
    values: Array, how: Sampling, of: Callable[[Array], float], at_least: float = -math.inf
) -> Estimate:
    middle, error, by = _jackknife(values, how, of)
    return Estimate(middle, max(middle - error, at_least), middle + error, f"Student t, {by}")


def _jackknife(values: Array, how: Sampling, of: Callable[[Array], float]) -> tuple[float, float, str]:
    """Return an estimate, half its interval, and by how many randomisations: one after the other is left out.

    Randomisations are independent of each other, however many of their samples have the measure. One
    without any tells nothing, and is not counted. The interval of fewer than two is infinite, and where the
    rest of one has no such statistic.

    Raises
    ------
    ValueError
        For values that are not one a sample: they could be of any randomisation.
    """
    if len(values) != how.n:
        raise ValueError(f"{len(values)} values of {how.n} samples: give NaN where a sample has none")
    there = np.isfinite(values)
    known, group = values[there], (np.arange(how.n) // how.each)[there]
    some = np.unique(group)
    r, value = len(some), float(of(known)) if len(known) else math.nan
    by = f"{r} {'' if r == how.replicates else f'of {how.replicates} '}randomisations"
    if r < 2:
        return value, math.inf, by
    without = np.array([float(of(known[group != each])) for each in some])
    if not np.isfinite(without).all():
        return value, math.inf, by
    pseudo = r * value - (r - 1) * without
    error = _t(r - 1) * float(np.std(pseudo, ddof=1)) / math.sqrt(r)
    return float(np.mean(pseudo)), error, by


def _t(freedom: int) -> float:
    return float(scipy.stats.t.ppf(0.5 * (1.0 + CONFIDENCE), freedom))
