"""A yield from few dear samples, in strata that a cheap model forms by distance from the limits.

Where the cheap model is sure, a dear sample adds next to nothing; at the border it adds most. So the cheap
model sorts devices into those that fail, those at the border, and those that pass; each stratum gets dear
samples of its own, and its weight comes from many cheap ones (stratified sampling with estimated weights;
Cochran, Sampling Techniques, 12.2). Where the cheap model is sure it is not trusted blindly: a defensive
number of dear samples bounds what it may have missed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.tolerance.intervals import CONFIDENCE, Estimate, clopper_pearson
from cosim.tolerance.spec import Spec
from cosim.tolerance.strata_bounds import highest_rates
from cosim.types import Array

__all__ = [
    "BORDER",
    "FAILS",
    "PASSES",
    "STRATA",
    "Border",
    "allocation",
    "failure_rate",
    "learned",
    "replicate_weights",
]

#: Names of the strata, by what the cheap model says.
STRATA = ("fails", "border", "passes")
FAILS, BORDER, PASSES = range(3)

#: Standard deviations of the two models' difference that the border is wide to either side.
_WIDE = 4.0
#: Share of the error probability that the weights use, from and to; the strata have the rest.
_OF_WEIGHTS = (0.05, 0.3)
#: With fewer cheap samples outside the largest stratum, their scatter over randomisations says too little.
_FEW = 30
_LEAST = 8


@dataclass(frozen=True)
class Border:
    """How measures of the cheap model decide a sample's stratum.

    Attributes
    ----------
    specs
        Limits.
    lines
        Measure -> (constant, factor, deviation) of a line: dear = constant + factor cheap, and its error.
    """

    specs: tuple[Spec, ...]
    lines: Mapping[str, tuple[float, float, float]]

    def margins(self, cheap: Mapping[str, Array]) -> Array:
        """Return by how many deviations samples pass (n,); 0, the border, where the cheap model is silent."""
        columns = []
        for spec in self.specs:
            constant, factor, deviation = self.lines[spec.measure]
            expected = constant + factor * cheap[spec.measure]
            columns.append(np.minimum(expected - spec.low, spec.high - expected) / deviation)
        least = np.min(columns, axis=0)
        return np.where(np.isnan(least), 0.0, least)

    def strata(self, cheap: Mapping[str, Array]) -> NDArray[np.int64]:
        """Return the stratum of each sample (n,)."""
        margin = self.margins(cheap)
        return np.where(margin < -_WIDE, FAILS, np.where(margin <= _WIDE, BORDER, PASSES))


def learned(specs: Sequence[Spec], cheap: Mapping[str, Array], dear: Mapping[str, Array]) -> Border:
    """Return the border as a pilot shows it: samples of both models whose outcome is not counted again.

    Parameters
    ----------
    specs
        Limits, each in its measure's unit.
    cheap, dear
        Measure -> [pilot], the same devices on both models, in the measure's unit. What is not finite in
        either is left out; of fewer than three every device lies at the border.
    """
    lines = {}
    for name in dict.fromkeys(spec.measure for spec in specs):
        x, y = cheap[name], dear[name]
        known = np.isfinite(x) & np.isfinite(y)
        x, y = x[known], y[known]
        if len(x) < 3:
            lines[name] = (0.0, 1.0, math.inf)
            continue
        factor = float(np.polyfit(x - x.mean(), y, 1)[0]) if np.ptp(x) > 0.0 else 0.0
        constant = float(y.mean() - factor * x.mean())
        rest = y - constant - factor * x
        deviation = math.sqrt(float(rest @ rest) / (len(x) - 2))
        lines[name] = (constant, factor, max(deviation, 1e-12 * float(np.abs(y).max()), 1e-300))
    return Border(tuple(specs), lines)


def replicate_weights(strata: NDArray[np.int64], replicates: int) -> Array:
    """Return the share of each stratum in each randomisation (replicates, strata)."""
    groups = strata.reshape(replicates, -1)
    return np.stack([(groups == h).mean(axis=1) for h in range(len(STRATA))], axis=1)


def allocation(weights: Array, plain: int, most: int) -> tuple[int, int, int]:
    """Return dear samples of each stratum: few enough at the border that the rest's bound stays what counts.

    Parameters
    ----------
    weights
        Share of each stratum.
    plain
        Plain dear samples that are there anyhow, which fall into the strata by themselves.
    most
        Samples that may come on top.
    """
    rest = plain * float(weights[PASSES])
    # least cost times square of the interval, 3.3/plain for no failure in the rest and 2.4 deviations here
    at_border = 0.5 * plain ** (4.0 / 3.0) * float(weights[BORDER]) ** (2.0 / 3.0)
    # a device that passes among those that should fail counts less than the border's deviation, 0.5 w/sqrt(n)
    failing = float(weights[FAILS]) * float(
        np.clip(2.5 * math.sqrt(at_border) / max(float(weights[BORDER]), 1e-300), 4.0 * plain, 16.0 * plain)
    )
    wanted = np.array([failing, at_border, rest])
    wanted[:2] = np.where(weights[:2] > 0.0, np.maximum(wanted[:2], _LEAST), 0.0)
    there = plain * weights
    more = np.maximum(wanted - there, 0.0)
    more *= min(1.0, most / max(more.sum(), 1e-300))
    numbers = np.ceil(there + more)
    return int(numbers[FAILS]), int(numbers[BORDER]), int(numbers[PASSES])


def failure_rate(weights: Array, failed: Sequence[int], counted: Sequence[int], cheap: int) -> Estimate:
    """Return the share of devices that fail.

    The exact bound of all strata together (`highest_rates`), and the weights' own error, by Student's t over
    the randomisations; what no sample has met is bounded by its count. The ends share the error probability
    so that the interval is expected to be shortest.

    Parameters
    ----------
    weights
        (randomisations, strata): share of each stratum on the cheap model.
    failed, counted
        Dear samples of each stratum that failed, and all.
    cheap
        Cheap samples in all.

    Examples
    --------
    >>> import numpy as np
    >>> even = np.tile([0.01, 0.02, 0.97], (16, 1))
    >>> round(failure_rate(even, (40, 50, 0), (40, 100, 2000), 1 << 16).value, 6)
    0.02
    """
    alpha = 1.0 - CONFIDENCE
    mean = weights.mean(axis=0)
    rates = np.array([f / n if n else 0.5 for f, n in zip(failed, counted, strict=True)])
    of_weights = alpha * _share_of_weights(mean, counted, cheap)
    above = (alpha - of_weights) * _share_above(mean, counted)
    passed = [n - f for f, n in zip(failed, counted, strict=True)]
    highest = highest_rates(mean, failed, counted, (PASSES, BORDER, FAILS), above)
    below = alpha - of_weights - above
    lowest = 1.0 - highest_rates(mean, passed, counted, (FAILS, BORDER, PASSES), below)
    low, high = (_weighted(weights, r, cheap, of_weights, side) for side, r in enumerate((lowest, highest)))
    return Estimate(float(mean @ rates), max(low, 0.0), min(high, 1.0), "strata, exact bounds")


def _share_above(weights: Array, counted: Sequence[int]) -> float:
    """Return the upper end's share of the error probability: the interval is expected to be shortest.

    It is decided by the numbers of samples, not by what failed. A bound of no failure falls with -ln(alpha),
    one of the border's count about half as fast: what each adds to an end tells that end's share.
    """
    numbers = np.maximum(np.array(counted, dtype=float), 1.0)
    each = weights / numbers
    border = 0.25 * float(weights[BORDER]) / math.sqrt(numbers[BORDER])
    above = (each[PASSES] + border) / (each[PASSES] + each[FAILS] + 2.0 * border)
    return float(np.clip(above, 0.05, 0.95))


def _share_of_weights(weights: Array, counted: Sequence[int], cheap: int) -> float:
    """Return the weights' share of the error probability, by the width that they are expected to add."""
    numbers = np.maximum(np.array(counted, dtype=float), 1.0)
    failing = np.array([1.0, 0.5, 0.0])
    variance = float(weights @ failing**2 - (weights @ failing) ** 2)
    own = math.sqrt(max(variance, 0.0) / cheap)
    strata = 3.0 * float((weights / numbers)[[FAILS, PASSES]].max())
    strata += 0.5 * float(weights[BORDER]) / math.sqrt(numbers[BORDER])
    return float(np.clip(own / (own + strata), *_OF_WEIGHTS))


def _weighted(weights: Array, rates: Array, cheap: int, alpha: float, side: int) -> float:
    """Return the lower (0) or upper (1) end of the weighted mean of the rates, for the weights' error."""
    sign = 1.0 if side else -1.0
    each = weights @ rates
    mean = weights.mean(axis=0)
    counts = mean * cheap
    if cheap - counts.max() >= _FEW:
        error = float(
            scipy.stats.t.ppf(1.0 - 0.5 * alpha, len(each) - 1) * each.std(ddof=1) / math.sqrt(len(each))
        )
        return float(each.mean()) + sign * error
    # too few to tell: exact bounds of each share, which scrambled points keep better than plain ones
    largest = int(np.argmax(mean))
    end = float(rates[largest])
    for h in range(len(mean)):
        if h != largest:
            bounds = clopper_pearson(round(counts[h]), cheap, 1.0 - 0.5 * alpha)
            gain = float(rates[h]) - float(rates[largest])
            end += gain * (bounds[1] if sign * gain > 0.0 else bounds[0])
    return end
