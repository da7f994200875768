"""Vector fitting: the paths to one place share their poles, and many such rows are fitted at once.

One step of it (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1052, 1999) from near poles is exact
but for rounding where the order is right. The states are a chain from the fastest pole to the slowest, sound
for equal poles as well; points come with their conjugates: complex algebra, real systems.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.types import Array, Complex

__all__ = ["Fractions", "fractions", "in_order", "realised", "relocated", "shortened", "weight"]


@dataclass(frozen=True)
class Fractions:
    """H = d + sum residue/(s - pole) of R rows with P paths and N poles each.

    Attributes
    ----------
    poles
        [R, N] rad/s.
    d, residues
        [R, P], [R, P, N].
    misfit
        [R], largest error at the points that it was not fitted to as well, relative to each path's measure.
    """

    poles: Complex
    d: Array
    residues: Complex
    misfit: Array

    def at(self, s: Complex) -> Complex:
        """Return H at the points; shape [R, P, F]."""
        away = 1.0 / (s[None, :, None] - self.poles[:, None, :])
        out: Complex = self.residues @ away.transpose(0, 2, 1) + self.d[:, :, None]
        return out

    def of(self, rows: list[int]) -> Fractions:
        """Return some of the rows."""
        return Fractions(self.poles[rows], self.d[rows], self.residues[rows], self.misfit[rows])


def relocated(s: Complex, f: Complex, poles: Complex) -> Complex:
    """Return the poles of the rows after one step.

    Parameters
    ----------
    s
        [F], points jw and their conjugates [rad/s].
    f
        [R, P, F], paths divided by their measure.
    poles
        [R, N], closed under conjugation, the fastest first.
    """
    count = poles.shape[1]
    if count == 0:
        return poles
    size = np.abs(poles)
    chain = np.cumprod(size[:, None, :] / (s[None, :, None] - poles[:, None, :]), axis=2)
    rows = len(f)
    numerator = np.concatenate([np.ones((rows, len(s), 1)), chain], axis=2)
    across = np.asarray(np.linalg.qr(numerator)[0])
    # f (1 + w x) but for what a numerator takes up, all paths below each other
    table = np.concatenate([f[..., None] * chain[:, None], -f[..., None]], axis=3)
    table -= across[:, None] @ (across.conj().transpose(0, 2, 1)[:, None] @ table)
    upper = np.asarray(np.linalg.qr(table.reshape(rows, -1, count + 1), mode="r"))
    shift = np.linalg.solve(upper[:, :count, :count], upper[:, :count, count:])[:, :, 0]
    a = np.zeros((rows, count, count), complex)
    each = np.arange(count)
    a[:, each, each] = poles
    a[:, each[1:], each[:-1]] = size[:, 1:]
    a[:, 0] -= size[:, :1] * shift
    return _closed(np.linalg.eigvals(a).astype(complex))


def _closed(poles: Complex) -> Complex:
    """Return poles [R, N] that are real or have their conjugates exactly, the fastest first."""
    partner = np.argmin(np.abs(poles[:, :, None] - poles.conj()[:, None, :]), axis=2)
    return in_order(0.5 * (poles + np.take_along_axis(poles.conj(), partner, axis=1)))


def in_order(poles: Complex) -> Complex:
    """Return poles [R, N], closed under conjugation, the fastest first; of a pair the upper half."""
    order = np.lexsort((poles.imag < 0.0, -np.abs(poles)), axis=1)  # however their moduli round
    out: Complex = np.take_along_axis(poles, order, axis=1)
    return out


def fractions(s: Complex, f: Complex, measure: Array, poles: Complex, used: NDArray[np.bool_]) -> Fractions:
    """Return partial fractions with given poles, fitted to the points that are `used` [F].

    `f` [R, P, F] are paths divided by `measure` [R, P].
    """
    rows, _, points = f.shape
    size = np.abs(poles)
    basis = np.ones((rows, points, poles.shape[1] + 1), complex)
    basis[..., 1:] = size[:, None, :] / (s[None, :, None] - poles[:, None, :])
    q, r = np.linalg.qr(basis[:, used])
    weights = np.linalg.solve(r, q.conj().transpose(0, 2, 1) @ f[:, :, used].transpose(0, 2, 1))
    misfit: Array = np.abs(basis @ weights - f.transpose(0, 2, 1)).max(axis=(1, 2))
    weights = weights.transpose(0, 2, 1) * measure[:, :, None]
    residues = (weights[..., 1:] * size[:, None, :]).astype(complex)
    return Fractions(poles, weights[..., 0].real.astype(float), residues, misfit)


def weight(full: Fractions, omega: float) -> Array:
    """Return how far each pole moves its row from its gain at rest, at most, at `omega` [rad/s]; [R, N]."""
    size = np.abs(full.poles)
    near = np.minimum(np.abs(1j * omega - full.poles), np.abs(1j * omega + full.poles))
    peak = np.abs(full.at(np.array([0.0, 1j * omega]))).max(axis=2)
    peak = np.maximum(peak, 1e-4 * peak.max(axis=1, keepdims=True))
    share = np.abs(full.residues) / np.where(peak > 0.0, peak, 1.0)[:, :, None]
    out: Array = share.max(axis=1) * omega / (size * near)
    return out


def shortened(full: Fractions, chosen: NDArray[np.int64], s: Complex) -> tuple[Fractions, Array]:
    """Return what comes nearest to `full` at the points with some of its poles, and its errors [R].

    `chosen` [R, keep] are the poles' places.

    The gain at rest is kept exactly; errors are relative to the maximum of each path at the points, or to a
    ten-thousandth of the strongest path's. `s` [F] are points with their conjugates.
    """
    keep = chosen.shape[1]
    poles = np.take_along_axis(full.poles, chosen, axis=1)
    target = full.at(s)
    rest = full.d - (full.residues / full.poles[:, None, :]).sum(axis=2).real
    weights = np.zeros((*full.d.shape, keep), complex)
    if keep:
        away = 1.0 / (s[None, :, None] - poles[:, None, :]) + (1.0 / poles)[:, None, :]
        size = np.abs(away).max(axis=1)
        q, r = np.linalg.qr(away / size[:, None, :])
        solution = np.linalg.solve(
            r, q.conj().transpose(0, 2, 1) @ (target - rest[:, :, None]).transpose(0, 2, 1)
        )
        weights = solution.transpose(0, 2, 1) / size[:, None, :]
    d = rest + (weights / poles[:, None, :]).sum(axis=2).real
    small = Fractions(poles, d, weights, full.misfit)
    peak = np.abs(target).max(axis=2)
    peak = np.maximum(peak, 1e-4 * peak.max(axis=1, keepdims=True))
    error = (np.abs(small.at(s) - target).max(axis=2) / np.where(peak > 0.0, peak, 1.0)).max(axis=1)
    return small, error


def realised(row: Fractions, k: int) -> tuple[Array, Array, Array, Array] | None:
    """Return A, B, C, D of row `k`, one state a pole; ``None`` where a complex pole lacks its partner."""
    poles, residues = row.poles[k], row.residues[k]
    alone, upper = np.flatnonzero(poles.imag == 0.0), np.flatnonzero(poles.imag > 0.0)
    count, first = len(poles), len(alone)
    if first + 2 * len(upper) != count:
        return None
    a, b, c = np.zeros((count, count)), np.zeros((count, len(row.d[k]))), np.zeros(count)
    a.flat[: first * (count + 1) : count + 1] = poles.real[alone]
    b[:first], c[:first] = residues.real.T[alone], 1.0
    for at, pole in zip(range(first, count, 2), upper.tolist(), strict=True):
        real, imag = poles[pole].real, poles[pole].imag
        a[at, at] = a[at + 1, at + 1] = real
        a[at, at + 1], a[at + 1, at] = -imag, imag
        b[at], b[at + 1], c[at] = residues[:, pole].real, residues[:, pole].imag, 2.0
    return a, b, c, row.d[k]
