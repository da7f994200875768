"""Common poles of frequency responses, by rational approximation.

AAA (Nakatsukasa, Sete and Trefethen, SIAM J. Sci. Comput. 40, A1494, 2018) on all paths of a block at once
(Lietaert, Meerbergen, Perez and Vandereycken, IMA J. Numer. Anal. 42, 1087, 2022), with support points in
conjugate pairs, so that everything is real: the poles are common to the paths by construction, and each is
found where it shows best. The poles alone are taken from it, spurious ones (Froissart doublets) among them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.types import Complex

__all__ = ["poles_of"]


#: AAA goes on to this error relative to each path's maximum; rounding in `.ac` is at 1e-16 to 1e-14.
_FINE = 1e-13
_MOST_PAIRS = 40
#: Poles this much faster than the fastest point measured are part of the feedthrough.
_BEYOND = 1e4
_ABERTH = 30
#: Solutions of each AAA step, and how many may pass without progress once the fit is good.
_REWEIGHT, _PATIENCE = 2, 6


def poles_of(s: Complex, f: Complex, good: float, reweighted: bool) -> Complex:
    """Return the poles of the AAA fit of all columns of `f`, one of each conjugate pair.

    Every support point jw brings -jw with it and the conjugate weight, so 2 real unknowns. Over ten decades
    of frequency the linearised error, the true one times the denominator, sees nothing of the fast poles:
    reweighted, each step is solved again with its rows divided by the denominator just found. Where many
    poles lie close together that makes matters worse, and the plain steps serve.

    Parameters
    ----------
    s
        [F], points jw with w > 0 [rad/s].
    f
        [F, paths], each with a maximum near 1.
    good
        Error from which on the fit need not get better if it does not.
    reweighted
        Whether to divide rows by the denominator.
    """
    support: list[int] = []
    fitted = np.broadcast_to(f.real.mean(axis=0), f.shape).astype(complex)
    best, barycentric, stale = np.inf, (s[:0], s[:0]), 0
    size = np.ones(len(s))
    for _ in range(min(_MOST_PAIRS, len(s) // 4)):
        wrong = np.abs(f - fitted).max(axis=1)
        wrong[support] = 0.0
        support.append(int(np.argmax(wrong)))
        rest = np.ones(len(s), bool)
        rest[support] = False
        at, value = s[support], f[support]
        near, far = 1.0 / (s[rest, None] - at), 1.0 / (s[rest, None] + at)
        low = (f[rest][:, None] - value) * near[:, :, None]
        high = (f[rest][:, None] - value.conj()) * far[:, :, None]
        loewner = np.concatenate([low + high, 1j * (low - high)], axis=1).transpose(0, 2, 1)
        for _ in range(_REWEIGHT if reweighted else 1):
            weight = _null_vector(loewner / size[rest, None, None])
            below = near @ weight + far @ weight.conj()
            above = near @ (weight[:, None] * value) + far @ (weight[:, None] * value).conj()
            fitted = f.copy()
            # a pole of the attempt on a point of the sweep: endlessly wrong there, and the next to support
            with np.errstate(divide="ignore", invalid="ignore"):
                fitted[rest] = above / below[:, None]
            error = float(np.abs(f - fitted).max())
            if reweighted:
                size[rest] = np.maximum(np.abs(below), np.finfo(float).eps * np.abs(below).max())
            stale = 0 if error < 0.1 * best else stale + 1
            if error < best:
                best, barycentric = error, (at, weight)
        if best < _FINE or (best < good and stale > _PATIENCE):
            break
    return _zeros(*barycentric)


def _null_vector(rows: NDArray[Any]) -> Complex:
    """Return the complex weights whose real and imaginary parts come nearest to the null space of `rows`."""
    flat = rows.reshape(-1, rows.shape[2])
    upper = np.linalg.qr(np.concatenate([flat.real, flat.imag]), mode="r")
    norm = np.linalg.norm(upper, axis=0)
    norm[norm == 0.0] = 1.0
    last = np.linalg.svd(upper / norm)[2][-1] / norm
    half = len(last) // 2
    both = last[:half] + 1j * last[half:]
    out: Complex = both / np.abs(both).max()
    return out


def _zeros(at: Complex, weight: Complex) -> Complex:
    """Return the zeros of sum(weight/(s - at) + conj(weight)/(s + at)), one of each conjugate pair."""
    pairs = len(at)
    a, b = np.zeros((2 * pairs + 1, 2 * pairs + 1)), np.eye(2 * pairs + 1)
    b[0, 0] = 0.0
    for k in range(pairs):
        i = 1 + 2 * k
        # each row divided by its frequency: they range over ten decades
        a[i, 0], a[i, i + 1], a[i + 1, i] = 1.0 / at[k].imag, -1.0, 1.0
        b[i, i] = b[i + 1, i + 1] = 1.0 / at[k].imag
        a[0, i], a[0, i + 1] = 2.0 * weight[k].real, -2.0 * weight[k].imag
    # one zero more than there are is infinite, and comes out so or very large
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = scipy.linalg.eigvals(a, b)
    zeros = zeros[np.isfinite(zeros)]
    zeros = zeros[np.abs(zeros) < _BEYOND * np.abs(at).max()]
    real = zeros.imag == 0.0  # exactly, as the matrices are real
    return _refined(zeros[real], zeros[zeros.imag > 0.0], at, weight)


def _refined(real: Complex, pairs: Complex, at: Complex, weight: Complex) -> Complex:
    """Improve all zeros at once (Aberth): eigenvalues are good to rounding of the largest only."""
    places = np.concatenate([at, at.conj()])
    strength = np.concatenate([weight, weight.conj()])
    for _ in range(_ABERTH):
        every = np.concatenate([real, pairs, pairs.conj()])
        terms = 1.0 / (every[:, None] - places)
        value, slope = terms @ strength, -(terms**2) @ strength
        apart = every[:, None] - every
        np.fill_diagonal(apart, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = 1.0 / (slope / value + terms.sum(axis=1) - (1.0 / apart).sum(axis=1))
        step = np.where(np.isfinite(step), step, 0.0)
        step[: len(real)].imag = 0.0
        real, pairs = np.split((every - step)[: len(real) + len(pairs)], [len(real)])
        pairs = np.where(pairs.imag < 0.0, pairs.conj(), pairs)
        if (np.abs(step) <= 4e-16 * np.abs(every)).all():
            break
    return np.concatenate([real, pairs])
