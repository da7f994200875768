"""Indices by sparse polynomial chaos, where squares and products of the leading variables do not do.

Polynomials that are orthonormal for each variable's distribution, of which least angle regression takes those
that matter (Blatman and Sudret, J. Comput. Phys. 230, 2345, 2011); by `openturns`, the extra ``stat``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from cosim.tolerance.monte_carlo import Study
from cosim.types import Array

__all__ = ["Chaos", "available", "fit_chaos"]

#: Exponent of the hyperbolic cross: the smaller, the fewer products of many variables.
_CROSS = 0.75
#: Degrees that are tried one after the other, candidates at most.
_DEGREES, _MOST = (2, 3, 4, 6, 8, 10), 1200
_FOLDS = 5


@dataclass(frozen=True)
class Chaos:
    """What a sparse chaos says of a measure.

    Attributes
    ----------
    first, total
        Share of each variable by itself, and with all products that it is in.
    held_out
        R^2 on samples that were not fitted, by five folds, each with a choice of its own.
    terms, degree
        Polynomials that were chosen, and their largest degree.
    """

    first: Array
    total: Array
    held_out: float
    terms: int
    degree: int


def available() -> bool:
    """Whether the extra ``stat`` is installed."""
    return find_spec("openturns") is not None


def fit_chaos(study: Study, y: Array, known: Array, good: float) -> Chaos | None:
    """Fit a measure, with higher degrees until `good` of what was not fitted is explained.

    Parameters
    ----------
    y
        The measure of the samples that have it.
    known
        Which samples these are.
    """
    ot = import_module("openturns")
    ot.Log.Show(ot.Log.NONE)
    inputs, marginals = _inputs(ot, study)
    x = inputs[known]
    best: Chaos | None = None
    for degree in _DEGREES:
        family = _family(ot, marginals, degree)
        if family is None:
            break
        held = _held_out(ot, x, y, family)
        if best is None or held > best.held_out:
            best = _chaos(ot, x, y, family, held, degree)
        if best.held_out >= good:
            break
    return best


def _inputs(ot: Any, study: Study) -> tuple[Array, list[Any]]:
    """Return inputs (n, variables) and their distributions: standardised deviations, else plain numbers."""
    uniforms = study.uniforms()
    columns, marginals = [], []
    for j in range(uniforms.shape[1]):
        shape = study.tolerances.shape(j)
        even = -shape.low == shape.high
        if shape.kind in ("gauss", "truncated") and even:
            z = shape.inverse(uniforms[:, j]) / (shape.high / shape.sigmas)
            end = shape.sigmas
            columns.append(z)
            marginals.append(
                ot.Normal() if shape.kind == "gauss" else ot.TruncatedNormal(0.0, 1.0, -end, end)
            )
        else:  # of a uniform number: exact for uniform deviations, any other is a curve in it
            columns.append(2.0 * uniforms[:, j] - 1.0)
            marginals.append(ot.Uniform(-1.0, 1.0))
    return np.column_stack(columns), marginals


def _family(ot: Any, marginals: list[Any], degree: int) -> tuple[Any, Any] | None:
    """Return distribution and candidates up to a degree; ``None`` for too many."""
    enumeration = ot.HyperbolicAnisotropicEnumerateFunction(len(marginals), _CROSS)
    count = candidates(len(marginals), degree)
    if count > _MOST:
        return None
    polynomials = [ot.StandardDistributionPolynomialFactory(marginal) for marginal in marginals]
    basis = ot.OrthogonalProductPolynomialFactory(polynomials, enumeration)
    return ot.JointDistribution(marginals), ot.FixedStrategy(basis, count)


def candidates(variables: int, degree: int) -> int:
    """Return how many polynomials the cross holds: exponents a with sum a^q <= degree^q.

    Examples
    --------
    >>> candidates(2, 2)  # 1, x, y, x^2, y^2: xy has degree 2^(1/q) = 2.5
    5
    """
    most = degree**_CROSS * (1.0 + 1e-12)
    powers = [k**_CROSS for k in range(1, degree + 1)]
    count, sums = 0, [0.0]
    for active in range(variables + 1):
        count += math.comb(variables, active) * len(sums)
        sums = [s + p for s in sums for p in powers if s + p <= most]
        if not sums:
            break
    return count


def _fitted(ot: Any, x: Array, y: Array, family: tuple[Any, Any]) -> Any:
    selection = ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    algorithm = ot.FunctionalChaosAlgorithm(
        ot.Sample(x), ot.Sample(y[:, None]), family[0], family[1], ot.LeastSquaresStrategy(selection)
    )
    algorithm.run()
    return algorithm.getResult()


def _held_out(ot: Any, x: Array, y: Array, family: tuple[Any, Any]) -> float:
    fold = np.arange(len(y)) % _FOLDS
    left = np.empty_like(y)
    for k in range(_FOLDS):
        there = fold == k
        model = _fitted(ot, x[~there], y[~there], family).getMetaModel()
        left[there] = y[there] - np.asarray(model(ot.Sample(x[there])))[:, 0]
    variance = float(np.var(y))
    return 1.0 - float(np.mean(left**2)) / variance if variance > 0.0 else math.nan


def _chaos(ot: Any, x: Array, y: Array, family: tuple[Any, Any], held: float, degree: int) -> Chaos:
    result = _fitted(ot, x, y, family)
    indices = ot.FunctionalChaosSobolIndices(result)
    variables = range(x.shape[1])
    return Chaos(
        np.array([indices.getSobolIndex(j) for j in variables]),
        np.array([indices.getSobolTotalIndex(j) for j in variables]),
        held, len(result.getIndices()), degree,
    )  # fmt: skip
