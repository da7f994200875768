"""Exact steps of linear systems and the integrals that covariances need, for poles of any speed.

Van Loan's block exponential holds exp(-A h) next to exp(A h) and overflows where a pole is fast; here time
is doubled instead. The transition of each level comes from `phi_functions` on its own, so no digits of slow
modes are lost on the way, and sums of positive semidefinite matrices stay so.
"""

from __future__ import annotations

import numpy as np

from cosim.loop.linear.matrix_phi import phi_functions
from cosim.types import Array

__all__ = ["exact_step", "integral", "repeated", "stationary", "summed", "white_covariance"]


#: Gauss-Legendre over the first interval: exact for polynomials of degree 15.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
#: Fastest pole times the first interval.
_SHORT = 0.25
#: A power of the transition below this is nothing beside what has been summed.
_NOTHING = 1e-18
_MOST = 200


def exact_step(a: Array, b: Array, e: Array, h: float) -> Array:
    """Return the map of (x, i, i') over `h` [s] for x' = A x + B i + E i' and constant i'."""
    n, m = b.shape
    zero, one, two = phi_functions(a, h, 2)
    out = np.eye(n + 2 * m)
    out[:n, :n] = zero
    out[:n, n : n + m] = h * one @ b
    out[:n, n + m :] = h * h * two @ b + h * one @ e
    out[n : n + m, n + m :] = h * np.eye(m)
    return out


def integral(a: Array, b: Array, e: Array, h: float, p: Array) -> Array:
    """Return the integral over `h` [s] of exp(F s) P exp(F s)^T for the system of `exact_step`.

    F is the generator of its map, and `p` the second moment of (x, i, i') at the start.
    """
    fastest = float(np.abs(np.linalg.eigvals(a)).max(initial=0.0))
    levels = max(0, int(np.ceil(np.log2(max(fastest * h, 1e-300) / _SHORT))))
    first = np.ldexp(h, -levels)
    total = np.zeros_like(p)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        step = exact_step(a, b, e, 0.5 * first * (1.0 + float(node)))
        total += 0.5 * first * weight * (step @ p @ step.T)
    for level in range(levels):
        step = exact_step(a, b, e, np.ldexp(first, level))
        total += step @ total @ step.T
    return 0.5 * (total + total.T)


def white_covariance(a: Array, b: Array, density: Array, h: float) -> Array:
    """Return the covariance that white noise adds to x' = A x + B w over `h` [s].

    Parameters
    ----------
    a, b
        [N, N] and [N, M].
    density
        [M, M], two-sided spectral density of w, its E w(t) w(s)^T = density delta(t - s).
    h
        Time [s]; infinite for the stationary covariance.

    Raises
    ------
    ValueError
        For an infinite time and a system that is not stable.
    """
    none = np.zeros((len(a), 0))
    drive = b @ density @ b.T
    if np.isfinite(h):
        return integral(a, none, none, h, drive)
    poles = np.linalg.eigvals(a)
    if not (poles.real < 0.0).all():
        raise ValueError("a system that is not stable has no stationary covariance")
    # a few of the slowest time constants, then doubled until nothing is added
    h = 1.0 / float(np.abs(poles.real).min())
    return stationary(phi_functions(a, h, 0)[0], integral(a, none, none, h, drive))


def stationary(step: Array, added: Array) -> Array:
    """Return P = S P S^T + Q by doubling (Smith's method): symmetric and positive semidefinite as it sums.

    Raises
    ------
    ValueError
        When the spectral radius of S is not below one.

    Examples
    --------
    x_k+1 = x_k/2 + w with E w^2 = 3: the variance is 3/(1 - 1/4).

    >>> stationary(np.array([[0.5]]), np.array([[3.0]])).round(12).tolist()
    [[4.0]]
    """
    if not np.abs(np.linalg.eigvals(step)).max(initial=0.0) < 1.0:
        raise ValueError("a map that is not stable has no stationary covariance")
    total, power = np.array(added), np.array(step)
    for _ in range(_MOST):
        more = power @ total @ power.T
        total = total + more
        if np.abs(more).max(initial=0.0) <= _NOTHING * np.abs(total).max(initial=0.0):
            break
        power = power @ power
    return 0.5 * (total + total.T)


def repeated(step: Array, added: Array, count: int) -> tuple[Array, Array, Array]:
    """Return S^count, P_count and the sum over k < count of P_k, for P_k+1 = S P_k S^T + Q from P_0 = 0."""
    size = len(step)
    product, cover, sums = np.eye(size), np.zeros_like(added), np.zeros_like(added)
    power, run, run_sums, length = step, added, np.zeros_like(added), 1
    while count:
        if count & 1:
            sums = sums + run_sums + summed(step, cover, length)
            cover = run + power @ cover @ power.T
            product = power @ product
        count >>= 1
        if count:
            run_sums = 2.0 * run_sums + summed(step, run, length)
            run = run + power @ run @ power.T
            power, length = power @ power, 2 * length
    return product, cover, sums


def summed(step: Array, p: Array, count: int) -> Array:
    """Return the sum over k < count of S^k P S^kT.

    Examples
    --------
    1 + 1/4 + 1/16.

    >>> summed(np.array([[0.5]]), np.array([[1.0]]), 3).tolist()
    [[1.3125]]
    """
    total, run = np.zeros_like(p), np.array(p)
    power, shift = step, np.eye(len(step))
    while count:
        if count & 1:
            total = total + shift @ run @ shift.T
            shift = power @ shift
        count >>= 1
        if count:
            run = run + power @ run @ power.T
            power = power @ power
    return total
