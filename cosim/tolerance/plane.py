"""A plane through samples of the cheap model: its mean and its variance are known, and need no samples.

Every random variable enters by its standardised deviation. These are independent, of mean 0 and variance 1,
so a plane c + s z has the mean c and the variance s s. What is left to the cheap level is the distance from
the plane (a control variate of known mean; Asmussen and Glynn, Stochastic Simulation, V.2). The plane comes
from samples of its own, which are not used again: nothing is biased, however badly it fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.types import Array

__all__ = ["Plane", "fit_plane", "samples_for"]

#: Samples for each coefficient, and the share of the variance of left-out ones that a plane must explain.
_EACH, _LEAST = 2, 0.5


@dataclass(frozen=True)
class Plane:
    """A measure as a plane in standardised deviations.

    Attributes
    ----------
    mean, slopes
        At the middle, and by one standard deviation of each variable, in the measure's unit.
    samples
        How many it was fitted to.
    """

    mean: float
    slopes: Array
    samples: int

    @property
    def variance(self) -> float:
        """Of the plane, over the distributions of the variables."""
        return float(self.slopes @ self.slopes)

    def __call__(self, z: Array) -> Array:
        """Return the plane at standardised deviations (n, variables)."""
        at: Array = self.mean + z @ self.slopes
        return at


def samples_for(variables: int) -> int:
    """Return how many samples a plane takes."""
    return _EACH * (variables + 1)


def fit_plane(z: Array, values: Array) -> Plane | None:
    """Return the plane of least squares; ``None`` where it explains too little of samples left out of it.

    Parameters
    ----------
    z
        Standardised deviations (n, variables).
    values
        The measure (n,); what is not finite is left out.
    """
    known = np.isfinite(values)
    x, y = np.column_stack([np.ones(int(known.sum())), z[known]]), values[known]
    if len(y) < x.shape[1] + 2:
        return None
    q, r = np.linalg.qr(x)
    if np.abs(np.diag(r)).min() < 1e-9 * np.abs(np.diag(r)).max():
        return None
    coefficients = np.linalg.solve(r, q.T @ y)
    # each sample by a plane through the others: e / (1 - leverage)
    left = (y - x @ coefficients) / np.maximum(1.0 - (q**2).sum(axis=1), 1e-12)
    if not float(left @ left) < (1.0 - _LEAST) * float(((y - y.mean()) ** 2).sum()):
        return None
    return Plane(float(coefficients[0]), coefficients[1:], len(y))
