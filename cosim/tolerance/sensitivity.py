"""Which component is to blame: a surface fitted to the samples of a study, no new runs.

Every random variable enters as its standardised deviation, so that the squared coefficients of a linear
surface are the shares of variance. Where it does not predict held-out samples well, squares and products
of the leading variables are added, one at a time, as long as the prediction improves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cosim.tolerance.intervals import CONFIDENCE, Estimate
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.sparse_chaos import Chaos, available, fit_chaos
from cosim.types import Array

__all__ = ["GOOD", "Surface", "deviations", "fit_surface"]

#: Share of the variance of held-out samples that a surface must explain to be relied upon.
GOOD = 0.99
_FOLDS = 10
#: Samples that a surface is fitted to, at most: what they leave open is far below what a surface leaves.
_MOST = 1 << 14
#: Variables whose squares and products are candidates, and terms that are added at most.
_LEADING, _MOST_TERMS = 10, 40
_Z = 1.959964


@dataclass(frozen=True)
class Surface:
    """A measure as a polynomial of standardised deviations.

    Attributes
    ----------
    name, names
        The measure and the random variables.
    mean, linear
        Constant, and change by one standard deviation of each variable, in the measure's unit.
    terms, second
        Pairs of variables (twice the same: a square, less its mean), and their coefficients.
    errors
        Standard errors of `linear`.
    noise
        Variance that the polynomial leaves.
    third, fourth
        Moments of each variable's standardised deviation.
    chaos
        A sparse chaos that explains more, where the polynomial does not do and the extra ``stat`` is there.
    held_out
        R^2 on samples that were not fitted, by ten folds.
    total
        Standard deviation of the measure.
    samples
        How many were fitted.
    """

    name: str
    names: tuple[str, ...]
    mean: float
    linear: Array
    terms: tuple[tuple[int, int], ...]
    second: Array
    errors: Array
    held_out: float
    total: float
    samples: int
    noise: float
    third: Array
    fourth: Array
    chaos: Chaos | None = None

    @property
    def explained(self) -> float:
        """R^2 on samples that were not fitted, of what the shares are taken from."""
        return self.chaos.held_out if self.chaos is not None else self.held_out

    def __call__(self, z: Array) -> Array:
        """Return the measure for standardised deviations (n, variables)."""
        predicted = self.mean + z @ self.linear
        if self.terms:
            predicted = predicted + _products(z, self.terms) @ self.second
        return np.asarray(predicted)

    def shares(self) -> list[Estimate]:
        """Return each variable's share of the variance by itself (first order).

        The variance is that of the polynomial over the distributions and of what it leaves: the samples' own
        would add its error, a tenth of it for 200 samples.
        """
        if self.chaos is not None:
            rest = max(1.0 - self.chaos.held_out, 0.0)
            how = f"sparse chaos, degree {self.chaos.degree}"
            return [
                Estimate(s, max(s - rest, 0.0), min(s + rest, 1.0), how) for s in map(float, self.chaos.first)
            ]
        own, both = self.linear**2, 0.0
        for (a, b), c in zip(self.terms, self.second, strict=True):
            if a == b:  # variance of a z + c (z^2 - 1)
                own[a] += 2.0 * self.linear[a] * c * self.third[a] + c**2 * (self.fourth[a] - 1.0)
            else:
                both += c**2
        variance = float(own.sum()) + both + self.noise
        out = []
        for value, slope, error in zip(own, self.linear, self.errors, strict=True):
            half = _Z * 2.0 * abs(slope) * error + (_Z * error) ** 2
            share = value / variance if variance else 0.0
            width = half / variance if variance else 0.0
            out.append(Estimate(share, max(share - width, 0.0), min(share + width, 1.0), "regression"))
        return out


def deviations(tolerances: Tolerances, uniforms: Array) -> Array:
    """Return the standardised deviation of each variable (n, variables): mean 0, standard deviation 1."""
    z = np.empty_like(uniforms)
    for j in range(uniforms.shape[1]):
        shape = tolerances.shape(j)
        middle, sigma = shape.moments()
        z[:, j] = (shape.inverse(uniforms[:, j]) - middle) / sigma
    return z


def fit_surface(study: Study, name: str) -> Surface | None:
    """Fit a measure; ``None`` where there are too few samples for as many variables, or nothing changes."""
    study = study.thinned(_MOST)
    y = study.column(name)
    known = np.isfinite(y)
    z = deviations(study.tolerances, study.uniforms())[known]
    y = y[known]
    n, p = z.shape
    total = float(np.std(y, ddof=1)) if n > 1 else 0.0
    if n < p + 12 or total <= 1e-13 * abs(float(np.mean(y))):
        return None
    terms: list[tuple[int, int]] = []
    held = _held_out(z, y)
    if held < GOOD and n >= 2 * p:
        terms, held = _grown(z, y, held)
    chaos = fit_chaos(study, y, known, GOOD) if held < GOOD and available() else None
    if chaos is not None and not chaos.held_out > held:
        chaos = None
    moments = [study.tolerances.shape(j).standard_moments() for j in range(p)]
    surface = _fitted(name, study.tolerances.variables, z, y, tuple(terms), held, total, np.array(moments))
    return replace(surface, chaos=chaos)


def _grown(z: Array, y: Array, held: float) -> tuple[list[tuple[int, int]], float]:
    """Add squares and products, the most correlated with what is left first, while it helps."""
    n, p = z.shape
    slopes = np.linalg.lstsq(_columns(z), y, rcond=None)[0][1:]
    leading = np.argsort(-np.abs(slopes))[: min(_LEADING, p)]
    candidates = [(int(a), int(b)) for i, a in enumerate(leading) for b in leading[i:]]
    terms: list[tuple[int, int]] = []
    best, best_terms = held, list[tuple[int, int]]()
    while candidates and len(terms) < min(_MOST_TERMS, (n - p) // 4):
        design = _columns(z, terms)
        rest = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        columns = _products(z, candidates)
        columns = columns - design @ np.linalg.lstsq(design, columns, rcond=None)[0]
        norm = np.linalg.norm(columns, axis=0)
        score = np.abs(columns.T @ rest) / np.where(norm > 1e-9, norm, np.inf)
        terms.append(candidates.pop(int(np.argmax(score))))
        now = _held_out(z, y, terms)
        if now > best:
            best, best_terms = now, list(terms)
        elif len(terms) > len(best_terms) + 3:
            break
    return best_terms, best


def _fitted(
    name: str, names: tuple[str, ...], z: Array, y: Array, terms: tuple[tuple[int, int], ...], held: float,
    total: float, moments: Array,
) -> Surface:  # fmt: skip
    design = _columns(z, terms)
    coefficients, *_ = np.linalg.lstsq(design, y, rcond=None)
    freedom = max(len(y) - design.shape[1], 1)
    noise = float(np.sum((y - design @ coefficients) ** 2)) / freedom
    errors = np.sqrt(np.maximum(noise * np.diag(np.linalg.pinv(design.T @ design)), 0.0))
    p = z.shape[1]
    return Surface(
        name, names, float(coefficients[0]), np.asarray(coefficients[1 : p + 1], float), terms,
        np.asarray(coefficients[p + 1 :], float), errors[1 : p + 1], held, total, len(y), noise,
        moments[:, 0], moments[:, 1],
    )  # fmt: skip


def _held_out(z: Array, y: Array, terms: list[tuple[int, int]] | tuple[()] = ()) -> float:
    """Return R^2 of what is predicted for each tenth of the samples from the others."""
    design = _columns(z, terms)
    fold = np.arange(len(y)) % _FOLDS
    left = np.empty_like(y)
    for k in range(_FOLDS):
        there = fold == k
        coefficients, *_ = np.linalg.lstsq(design[~there], y[~there], rcond=None)
        left[there] = y[there] - design[there] @ coefficients
    variance = float(np.var(y))
    return 1.0 - float(np.mean(left**2)) / variance if variance > 0.0 else math.nan


def _columns(z: Array, terms: list[tuple[int, int]] | tuple[tuple[int, int], ...] = ()) -> Array:
    return np.column_stack([np.ones(len(z)), z, *([_products(z, terms)] if terms else [])])


def _products(z: Array, terms: list[tuple[int, int]] | tuple[tuple[int, int], ...]) -> Array:
    return np.column_stack([z[:, a] * z[:, b] - float(a == b) for a, b in terms])


assert CONFIDENCE == 0.95  # what _Z stands for
