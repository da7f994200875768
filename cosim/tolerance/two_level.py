"""Two models of one device: few dear samples correct what many cheap ones say.

With the same draws for both, dear = (dear - b cheap) + b cheap: the first term scatters little where the two
agree, the second is cheap (a control variate with its own estimated mean; Pasupathy et al., IIE Transactions
44, 2012). The factor b and the split come from a pilot whose samples are not used again: nothing is biased.
The cheap level's own error is made small by scrambled Sobol points, and by a plane whose moments are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are used

from cosim.tolerance.plane import Plane, fit_plane, samples_for
from cosim.tolerance.unit_cube import REPLICATES, sampling
from cosim.types import Array

__all__ = ["Pilot", "TwoLevel", "cheap_samples", "corrected", "moments", "pilot_of"]

#: Points of the unit cube (n, variables) -> measure (n,).
Model = Callable[[Array], Array]

_LEVEL = 0.95
#: Variance times cost relative to plain sampling, above which two levels do not pay.
_PAYS = 0.8
#: Cheap samples of one randomisation, at most.
_MOST_CHEAP = 1 << 16


@dataclass(frozen=True)
class Pilot:
    """What a pilot says of two models.

    Attributes
    ----------
    correlation, of_squares
        Of the measure, and of its squared distance from the mean.
    factor, factor_of_squares
        b for each.
    middle, middle_of_cheap
        Means, about which squares are taken.
    cost_ratio
        Seconds of a cheap sample over those of a dear one.
    """

    correlation: float
    of_squares: float
    factor: float
    factor_of_squares: float
    middle: float
    middle_of_cheap: float
    cost_ratio: float

    def gain(self, *, squares: bool = False) -> float:
        """Return variance times cost relative to plain sampling at the best split."""
        rho = self.of_squares if squares else self.correlation
        return float((math.sqrt(max(1.0 - rho**2, 0.0)) + math.sqrt(rho**2 * self.cost_ratio)) ** 2)

    @property
    def words(self) -> str:
        """Why two levels do not pay; empty where they do."""
        if self.gain() <= _PAYS:
            return ""
        return (
            f"the cheap model says too little of the dear one (correlation {self.correlation:.4f}, "
            f"cost ratio {self.cost_ratio:.3g}): plain sampling of the dear model alone"
        )


@dataclass(frozen=True)
class TwoLevel:
    """Mean and standard deviation with their intervals.

    Attributes
    ----------
    mean, mean_low, mean_high, spread, spread_low, spread_high
        Estimates and the ends of their 95 % intervals.
    dear, cheap
        Samples of each model, the pilot's left out.
    pilot
        What the split came from.
    word
        Why the cheap model was not used, if so.
    beside_plane
        Share of the cheap model's variance that a plane through samples of it leaves; 1: there is none.
    """

    mean: float
    mean_low: float
    mean_high: float
    spread: float
    spread_low: float
    spread_high: float
    dear: int
    cheap: int
    pilot: Pilot
    word: str = ""
    beside_plane: float = 1.0


def pilot_of(cheap: Array, dear: Array, cost_ratio: float) -> Pilot:
    """Return what the same samples (n,) of both models say.

    Raises
    ------
    ValueError
        For fewer than eight samples, or values that are not finite.
    """
    if len(cheap) < 8 or not (np.isfinite(cheap).all() and np.isfinite(dear).all()):
        raise ValueError("a pilot needs at least eight samples with finite values")
    middle = float(dear.mean())
    squares = (cheap - cheap.mean()) ** 2, (dear - middle) ** 2
    rho, factor = _line(cheap, dear)
    rho_squares, factor_squares = _line(*squares)
    return Pilot(
        rho, rho_squares, factor, factor_squares, middle, float(cheap.mean()), cost_ratio
    )  # fmt: skip


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Return correlation, and slope of y over x; 0 where x does not vary."""
    table = np.cov(x, y)
    if table[0, 0] <= 0.0 or table[1, 1] <= 0.0:
        return 0.0, 0.0
    rho = table[0, 1] / math.sqrt(table[0, 0] * table[1, 1])
    return float(np.clip(rho, -1.0, 1.0)), float(table[0, 1] / table[0, 0])


def moments(
    cheap: Model,
    dear: Model,
    variables: int,
    *,
    dear_samples: int,
    seed: int,
    cost_ratio: float,
    pilot_samples: int = 32,
    deviations: Model | None = None,
) -> TwoLevel:
    """Return mean and standard deviation of the dear model.

    The cheap level takes scrambled Sobol points in 16 randomisations, whose scatter tells its error; as many
    as make that small beside the dear level's, within the split's own bounds.

    Parameters
    ----------
    cheap, dear
        Points of the unit cube -> the measure.
    dear_samples
        Dear samples besides the pilot's.
    deviations
        Points of the unit cube -> independent deviations (n, variables) of mean 0 and variance 1: the cheap
        level samples what a plane in them leaves.
    """
    draws = sampling("plain", pilot_samples + dear_samples, variables, seed)
    first = draws.uniforms(0, pilot_samples)
    pilot = pilot_of(cheap(first), dear(first), cost_ratio)
    points = draws.uniforms(pilot_samples, dear_samples)
    high = dear(points)
    if pilot.words:
        return corrected(pilot, high, high, np.empty((REPLICATES, 0)))
    each = cheap_samples(pilot, dear_samples)
    cube = sampling("sobol", each * REPLICATES, variables, seed + 1)
    u = cube.uniforms(0, cube.n)
    plane = None
    if deviations is not None:
        own = sampling("plain", samples_for(variables), variables, seed + 2)
        first = own.uniforms(0, own.n)
        plane = fit_plane(deviations(first), cheap(first))
    known = None if plane is None or deviations is None else (plane, plane(deviations(u)))
    return corrected(pilot, high, cheap(points), cheap(u).reshape(REPLICATES, -1), known=known)


def corrected(
    pilot: Pilot,
    high: Array,
    low: Array,
    cheap: Array,
    word: str = "",
    known: tuple[Plane, Array] | None = None,
) -> TwoLevel:
    """Return mean and standard deviation of the dear model from samples of both.

    Parameters
    ----------
    pilot
        Of other samples: it gives both factors.
    high, low
        Measure of the same samples (n,) on the dear and on the cheap model.
    cheap
        Measure on the cheap model, (randomisations, n): independent randomisations.
    word
        Why the cheap model is of no use, where that is known.
    known
        A plane from other samples, and its values at those of `cheap`, in any shape of as many.
    """
    shifted = high - pilot.middle
    if word or pilot.words:
        none = np.zeros(REPLICATES)
        result = _combined(shifted, shifted**2, none, none, high, 0, pilot)
        return replace(result, word=word or pilot.words)
    about = pilot.middle_of_cheap  # not of the same samples: that would be a bias
    centred, values = low - about, cheap - about
    first, second = values.mean(axis=1), (values**2).mean(axis=1)
    count, left = cheap.size, 1.0
    if known is not None:
        plane, at = known[0], known[1].reshape(cheap.shape) - about
        off = plane.mean - about
        first = off + (values - at).mean(axis=1)
        second = plane.variance + off**2 + (values**2 - at**2).mean(axis=1)
        count += plane.samples
        left = float(np.var(values - at) / max(float(np.var(values)), 1e-300))
    result = _combined(
        shifted - pilot.factor * centred,
        shifted**2 - pilot.factor_of_squares * centred**2,
        pilot.factor * first, pilot.factor_of_squares * second, high, count, pilot,
    )  # fmt: skip
    return replace(result, beside_plane=left)


def cheap_samples(pilot: Pilot, dear_samples: int) -> int:
    """Return cheap samples of one randomisation: the split of least variance for a cost, a power of two."""
    rest = max(1.0 - pilot.correlation**2, 1e-12)
    wanted = dear_samples * math.sqrt(pilot.correlation**2 / (rest * max(pilot.cost_ratio, 1e-9)))
    each = max(wanted / REPLICATES, 16.0)
    return int(min(2 ** math.floor(math.log2(each)), _MOST_CHEAP))


def _combined(
    first: Array, second: Array, means: Array, squares: Array, high: Array, cheap: int, pilot: Pilot
) -> TwoLevel:
    """Put both levels together: `first`, `second` are dear samples of both moments, less their controls."""
    n, r = len(first), len(means)
    one, two = float(first.mean() + means.mean()), float(second.mean() + squares.mean())
    variance = max(two - one**2, 0.0)
    spread = math.sqrt(variance)
    # d variance = d two - 2 one d one: errors of both moments together
    both = second - 2.0 * one * first, squares - 2.0 * one * means
    reach = [_reach(a, b, n, r) for a, b in ((first, means), both)]
    mean = pilot.middle + one
    low, high_end = (max(variance + sign * reach[1], 0.0) for sign in (-1.0, 1.0))
    return TwoLevel(
        mean, mean - reach[0], mean + reach[0], spread, math.sqrt(low), math.sqrt(high_end),
        len(high), cheap, pilot, pilot.words,
    )  # fmt: skip


def _reach(samples: Array, replicates: Array, n: int, r: int) -> float:
    """Return half of the interval of a sum of two means, by Welch's degrees of freedom."""
    a, b = float(samples.var(ddof=1)) / n, float(replicates.var(ddof=1)) / r
    if a + b == 0.0:
        return 0.0
    freedom = (a + b) ** 2 / (a**2 / (n - 1) + b**2 / (r - 1))
    return float(scipy.stats.t.ppf(0.5 + 0.5 * _LEVEL, freedom) * math.sqrt(a + b))
