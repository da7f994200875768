"""Distributions of a component's deviation from its nominal value, by their inverse.

Conventions differ between tools; ours: where nothing else is said a tolerance is a Gaussian with sigma =
tol/3, cut off at +-tol (standard deviation 0.9866 tol/3). What `agauss` and `gauss` draw is not cut, as in
ngspice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import scipy  # loads its parts when they are used

from cosim.types import Array

__all__ = ["SIGMAS", "Histogram", "Kind", "Shape"]

#: Standard deviations within a tolerance, where nothing else is said.
SIGMAS = 3.0


@cache
def _rule() -> tuple[Array, Array]:
    """Return nodes within 0 to 1 and weights of Gauss and Legendre's rule: a second, which few need."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    return (nodes + 1.0) / 2.0, weights


Kind = Literal["truncated", "gauss", "uniform", "sorted", "limit", "histogram"]


def _normal(z: float) -> float:
    return float(scipy.special.ndtr(z))


def _normal_inverse(share: Array) -> Array:
    return np.asarray(scipy.special.ndtri(share))


@dataclass(frozen=True)
class Histogram:
    """A measured distribution: edges of its bins, ascending, and the cumulative share at each (0 to 1)."""

    edges: tuple[float, ...]
    cumulative: tuple[float, ...]
    file: str = ""

    def inverse(self, u: Array) -> Array:
        """Return the value below which a share `u` lies; uniform within a bin."""
        return np.interp(u, self.cumulative, self.edges)

    def moments(self) -> tuple[float, float]:
        """Return mean and standard deviation."""
        share, (a, b) = np.diff(self.cumulative), (np.array(self.edges[:-1]), np.array(self.edges[1:]))
        mean = float(share @ (a + b)) / 2.0
        a, b = a - mean, b - mean
        return mean, math.sqrt(float(share @ (a**2 + a * b + b**2)) / 3.0)


@dataclass(frozen=True)
class Shape:
    """A deviation from the nominal value.

    Attributes
    ----------
    kind
        'truncated': Gaussian cut at the tolerance; 'gauss': not cut; 'uniform'; 'sorted': truncated, and what
        is within `inner` was sold as a better grade; 'limit': one end or the other; 'histogram'.
    low, high
        The tolerance: largest deviation to either side, `low` <= 0 <= `high`.
    sigmas
        Standard deviations within the tolerance, to either side.
    inner
        Of 'sorted': the better grade's tolerance.
    relative
        Whether deviations are shares of the nominal value, else they are in its unit.
    """

    kind: Kind
    low: float
    high: float
    sigmas: float = SIGMAS
    inner: float = 0.0
    relative: bool = True
    histogram: Histogram | None = None

    def inverse(self, u: Array) -> Array:
        """Return deviations for uniform numbers within (0, 1), ascending with them."""
        u = np.asarray(u, dtype=float)
        if self.histogram is not None:
            return self.histogram.inverse(u)
        if self.kind == "uniform":
            return self.low + (self.high - self.low) * u
        if self.kind == "limit":
            return np.where(u < 0.5, self.low, self.high)
        if self.kind == "gauss":
            return self._sided(_normal_inverse(u) / self.sigmas)
        if self.kind == "truncated":
            below = _normal(-self.sigmas)
            return self._sided(_normal_inverse(below + u * (1.0 - 2.0 * below)) / self.sigmas)
        # sorted: the upper half of the distribution of |z| between inner and the tolerance, mirrored
        inside, outside = (_normal(self.sigmas * share) for share in (self._inner_share, 1.0))
        upper = _normal_inverse(inside + np.abs(2.0 * u - 1.0) * (outside - inside)) / self.sigmas
        return self._sided(np.where(u < 0.5, -upper, upper))

    @property
    def _inner_share(self) -> float:
        return self.inner / max(self.high, -self.low)

    def _sided(self, z: Array) -> Array:
        """Stretch a symmetric deviation in units of the tolerance to its two sides."""
        return np.where(z < 0.0, -self.low * z, self.high * z)

    @property
    def support(self) -> tuple[float, float]:
        """Least and largest deviation that occur; infinite where nothing cuts it."""
        if self.histogram is not None:
            return self.histogram.edges[0], self.histogram.edges[-1]
        if self.kind == "gauss":
            return -math.inf, math.inf
        return self.low, self.high

    @property
    def box(self) -> tuple[float, float]:
        """The support, or +-tolerance where it has none."""
        low, high = self.support
        return (low if math.isfinite(low) else self.low), (high if math.isfinite(high) else self.high)

    def moments(self) -> tuple[float, float]:
        """Return mean and standard deviation: exact, or by Gauss and Legendre over the inverse."""
        if self.histogram is not None:
            return self.histogram.moments()
        if self.kind == "gauss":
            low, high = -self.low / self.sigmas, self.high / self.sigmas
            mean = (high - low) / math.sqrt(2.0 * math.pi)
            return mean, math.sqrt(0.5 * (low**2 + high**2) - mean**2)
        nodes, weights = _rule()
        x = self.inverse(nodes)
        mean = float(weights @ x) / 2.0
        return mean, math.sqrt(float(weights @ (x - mean) ** 2) / 2.0)

    def standard_moments(self) -> tuple[float, float]:
        """Return third and fourth moment of the standardised deviation: 0 and 3 of a Gaussian."""
        if self.kind == "gauss" and -self.low == self.high:
            return 0.0, 3.0
        middle, sigma = self.moments()
        nodes, weights = _rule()
        z = (self.inverse(nodes) - middle) / sigma
        return float(weights @ z**3) / 2.0, float(weights @ z**4) / 2.0

    def below(self, deviation: float) -> float:
        """Return the probability of a smaller deviation."""
        low, high = self.support
        if deviation <= low:
            return 0.0
        if deviation > high:
            return 1.0
        if self.kind == "gauss":
            side = -self.low if deviation < 0.0 else self.high
            return _normal(self.sigmas * deviation / side) if side else float(deviation > 0.0)
        # all others end, and what matters is whether a bound is beyond that end
        grid = np.linspace(0.0, 1.0, 100_001)
        return float(np.interp(deviation, self.inverse(grid), grid))

    def scaled(self, factor: float) -> Shape:
        """Return the shape of a part with a tolerance `factor` times as wide."""
        if self.histogram is not None:
            edges = tuple(factor * edge for edge in self.histogram.edges)
            inner = Histogram(edges, self.histogram.cumulative, self.histogram.file)
            return Shape(
                self.kind, self.low * factor, self.high * factor, relative=self.relative, histogram=inner
            )
        return Shape(
            self.kind, self.low * factor, self.high * factor, self.sigmas, self.inner * factor, self.relative
        )

    def text(self, unit: str = "") -> str:
        """Return it in words."""
        if self.histogram is not None:
            return f"measured, {self.histogram.file}"

        def amount(x: float) -> str:
            return f"{100 * x:.4g}%" if self.relative else f"{x:.4g} {unit}".rstrip()

        even = -self.low == self.high
        size = f"+-{amount(self.high)}" if even else f"{amount(self.low)} to +{amount(self.high)}"
        if self.kind == "gauss":
            return f"Gaussian, {f'sigma {amount(self.high / self.sigmas)}' if even else size}, not cut"
        return {
            "uniform": f"uniform {size}",
            "limit": f"at {size}",
            "truncated": f"Gaussian {size} = {self.sigmas:g} sigma, cut",
            "sorted": f"Gaussian {size} = {self.sigmas:g} sigma, cut, without +-{amount(self.inner)}",
        }[self.kind]
