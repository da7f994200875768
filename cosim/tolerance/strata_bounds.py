"""The highest failure rate that counts in strata allow, exactly.

Bounds of every stratum, added up, are too wide: not all strata are unlucky at once. Where no device of a
large stratum failed, the next outcome, one failure, is far away, and what the border's count says lies in
between. So outcomes are ordered by the large stratum's count, and equal ones by the border's: the bound is
that of Clopper and Pearson with ties broken by samples (by a coin: Stevens, Biometrika 37, 117, 1950). It
holds at the worst rate of the border within a bound of its own (Berger and Boos, JASA 89, 1012, 1994).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # loads its parts when they are used

from cosim.types import Array

__all__ = ["highest_rates"]

#: Share of the error probability for the bound within which the tie-breaker's rate lies, and for the stratum
#: that is bounded alone.
_OF_EACH = 0.04
#: Probabilities of no more failures of the tie-breaker than were counted: between two the larger ends count.
_GRID = np.append(scipy.special.ndtr(np.linspace(-4.0, 6.0, 251)), 1.0)
_HALVINGS = 45


def highest_rates(
    weights: Array, failed: Sequence[int], counted: Sequence[int], order: tuple[int, int, int], alpha: float
) -> Array:
    """Return the rates (strata,) of the largest weighted sum that is not refused at `alpha`.

    The true weighted sum is above theirs with a probability of at most `alpha`, whatever the true rates are.

    Parameters
    ----------
    weights
        Share of each stratum.
    failed, counted
        Independent samples of each stratum that failed, and all.
    order
        Stratum whose count decides, the one that breaks ties, and one that is bounded alone.

    Examples
    --------
    A stratum alone has the bound of Clopper and Pearson, here the "three over n" at 5 %:

    >>> import numpy as np
    >>> rates = highest_rates(np.array([0.0, 0.0, 1.0]), (0, 0, 0), (0, 0, 1000), (2, 1, 0), 0.05 / 0.92)
    >>> round(float(rates[2]), 6)
    0.002991
    """
    decides, breaks, alone = order
    each = _OF_EACH * alpha
    u = np.concatenate([[each], _GRID[_GRID > each]])
    tie = _rate(failed[breaks], counted[breaks], u)
    rest = _mixed(failed[decides], counted[decides], u, alpha - 2.0 * each)
    # the tie-breaker's rate falls with u, the other rises: of each step the worse end of both
    at = int(np.argmax(weights[breaks] * tie[:-1] + weights[decides] * rest[1:]))
    rates = np.zeros(len(weights))
    rates[decides], rates[breaks] = rest[at + 1], tie[at]
    rates[alone] = _rate(failed[alone], counted[alone], np.array([each]))[0]
    return rates


def _rate(failed: int, counted: int, probability: Array) -> Array:
    """Return the rates at which no more than so many fail with each probability; 1 where all failed."""
    if failed >= counted:
        return np.ones(len(probability))
    return np.asarray(scipy.special.betaincinv(failed + 1, counted - failed, 1.0 - probability))


def _mixed(failed: int, counted: int, u: Array, alpha: float) -> Array:
    """Return the rates at which P(fewer failed) + u P(as many failed) is alpha."""
    if failed >= counted:
        return np.ones(len(u))
    if failed == 0:
        return np.asarray(-np.expm1(np.log(np.minimum(alpha / u, 1.0)) / counted))
    low, high = np.zeros(len(u)), np.ones(len(u))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fewer, most = (scipy.special.bdtr(k, counted, middle) for k in (failed - 1, failed))
        likely = fewer + u * (most - fewer) > alpha
        low, high = np.where(likely, middle, low), np.where(likely, high, middle)
    return high
