"""Smaller models that are good in a band, with a bound on their error there.

Candidates of each order: the slowest modes with the others at rest (residualisation, which keeps them
exactly), and projection on what is both reached and seen inside the band (balancing with Gramians
restricted to the band, evaluated by quadrature: Gawronski and Juang, Int. J. Syst. Sci. 21, 349, 1990;
Phillips and Silveira, IEEE Trans. CAD 24, 43, 2005). Both keep the DC gain
exactly. The lowest order whose error is bounded below the tolerance wins.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are used

from cosim.circuits.fitting.rational_fit import Modes
from cosim.circuits.linear_circuit import rational
from cosim.types import Array, Complex

__all__ = ["TERMS", "Bound", "error_bound", "in_band", "path_scale", "reduce", "rest"]


#: Terms of the Taylor series in each interval of the bound.
TERMS = 4
#: A bound within this share of the value found at some point is good enough.
_TIGHT = 0.02
#: What a bound may be too large by besides, as a share of the worst path's error.
_LOOSE = 1e-3
_ROUNDS = 40
#: In place of a missing bound.
_HUGE = 1e250
#: Paths weaker than this share of the strongest to the same output are parasitic: their error counts
#: relative to that share.
_PARASITIC = 1e-4
#: Largest error of a transformation by rounding alone, relative to each path.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Bound:
    """How wrong a model is at most at any frequency of a band.

    Attributes
    ----------
    upper
        [outputs, inputs], proven bound on the error of each path, relative to its scale.
    lower
        [outputs, inputs], largest error at any point that was looked at.
    """

    upper: Array
    lower: Array

    @property
    def worst(self) -> float:
        """Bound over all paths."""
        return float(self.upper.max(initial=0.0))


def in_band(omega: float, count: int) -> Complex:
    """Return points jw from 0 to `omega`: logarithmic below, and linear with more of them at the ends."""
    fine = np.geomspace(1e-5 * omega, omega, count)
    even = 0.5 * omega * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))
    out: Complex = 1j * np.unique(np.concatenate([[0.0], fine, even]))
    return out


def path_scale(modes: Modes, omega: float) -> Array:
    """Return what the error of each path is measured by: its maximum in the band, unless it is parasitic."""
    h = np.abs(rational(in_band(omega, 200), modes.a, modes.b, modes.c, modes.d)).max(axis=0)
    row = h.max(axis=1, keepdims=True)
    out: Array = np.where(row > 0.0, np.maximum(h, _PARASITIC * row), 1.0)
    return out


def reduce(modes: Modes, omega: float, tolerance: float) -> tuple[Modes, Bound]:
    """Return the model of lowest order whose error up to `omega` [rad/s] is at most `tolerance`.

    The error of each path is relative to `path_scale`. The full model comes back when
    nothing smaller will do.
    """
    if not len(modes.a):
        return modes, Bound(np.zeros(modes.d.shape), np.zeros(modes.d.shape))
    scale = path_scale(modes, omega)
    points = in_band(omega, 100)
    target = rational(points, modes.a, modes.b, modes.c, modes.d)
    dc = target[0].real
    project = _projector(modes, omega, scale)
    best: tuple[Modes, Bound] | None = None
    for order in range(len(modes.a)):
        for small in (_slowest(modes, order), project(order)):
            if small is None or len(small.a) > order:
                continue
            small = _keeping_dc(small, dc)
            miss = np.abs(rational(points, small.a, small.b, small.c, small.d) - target) / scale
            if miss.max(initial=0.0) > tolerance:
                continue
            bound = error_bound(modes, small, omega, scale)
            if bound.worst <= tolerance and (best is None or bound.worst < best[1].worst):
                best = small, bound
        if best is not None:
            return best
    return modes, Bound(np.full(scale.shape, _ROUNDING), np.zeros(scale.shape))


def _keeping_dc(small: Modes, dc: Array) -> Modes:
    static = small.c @ np.linalg.solve(-small.a, small.b) if len(small.a) else np.zeros(dc.shape)
    return replace(small, d=dc - static)


def _slowest(modes: Modes, order: int) -> Modes | None:
    """Return the model with as many of the slowest blocks as have `order` states, or ``None``."""
    ends = np.cumsum((0, *modes.blocks))
    if order not in ends:
        return None
    count = int(np.flatnonzero(ends == order)[0])
    return replace(
        modes,
        a=modes.a[:order, :order],
        b=modes.b[:order],
        c=modes.c[:, :order],
        poles=np.linalg.eigvals(modes.a[:order, :order]).astype(complex),
        blocks=modes.blocks[:count],
    )


def _projector(modes: Modes, omega: float, scale: Array) -> Callable[[int], Modes | None]:
    """Return a function that projects the model on its most important states inside the band."""
    order = len(modes.a)
    points = in_band(omega, 40)
    row = scale.max(axis=1)
    b = modes.b * (scale / row[:, None]).max(axis=0)
    left = points[:, None, None] * np.eye(order) - modes.a
    reached = np.linalg.solve(left, np.broadcast_to(b.astype(complex), (len(points), *b.shape)))
    seen = np.linalg.solve(
        left.conj().transpose(0, 2, 1),
        np.broadcast_to((modes.c / row[:, None]).T.astype(complex), (len(points), order, len(row))),
    )
    x, y = (np.concatenate([z.real, z.imag], axis=2) for z in (reached, seen))
    x, y = (z.transpose(1, 0, 2).reshape(order, -1) for z in (x, y))
    # only the spans count: many samples shrink to as many columns as there are states
    x, y = (np.asarray(np.linalg.qr(z.T, mode="r"), float).T for z in (x, y))
    u, strength, v = np.linalg.svd(y.T @ x, full_matrices=False)

    def project(size: int) -> Modes | None:
        if size == 0 or size > len(strength) or strength[size - 1] <= 1e-14 * strength[0]:
            return None
        half = np.sqrt(strength[:size])
        into, out = x @ v[:size].T / half, (y @ u[:, :size] / half).T
        small = _modal(out @ modes.a @ into, out @ modes.b, modes.c @ into)
        return small if (small.poles.real < 0.0).all() else None

    return project


def _modal(a: Array, b: Array, c: Array) -> Modes:
    """Bring a small model to block diagonal form, slowest pole first, where that is sound."""
    poles, vectors = np.linalg.eig(a)
    order = np.argsort(np.abs(poles), kind="stable")
    columns: list[Array] = []
    blocks: list[int] = []
    for k in order:
        if poles[k].imag > 0.0:
            columns += [vectors[:, k].real, vectors[:, k].imag]
            blocks.append(2)
        elif poles[k].imag == 0.0:
            columns.append(vectors[:, k].real)
            blocks.append(1)
    turn = np.stack(columns, axis=1)
    poles = poles[order]
    kept = poles[poles.imag >= 0.0].astype(complex)
    if np.linalg.cond(turn) > 1e6:
        return Modes(a, b, c, np.zeros((len(c), b.shape[1])), kept, (len(a),), np.zeros((len(c), b.shape[1])))
    diagonal = scipy.linalg.block_diag(
        *[[[p.real, p.imag], [-p.imag, p.real]] if p.imag else [[p.real]] for p in kept]
    )
    rows, outputs = np.asarray(np.linalg.solve(turn, b), float), c @ turn
    zero = np.zeros((len(c), b.shape[1]))
    return Modes(diagonal, rows, outputs, zero, kept, tuple(blocks), zero)


def error_bound(full: Modes, small: Modes, omega: float, scale: Array, slope: Array | None = None) -> Bound:
    """Bound |full - small| / scale for all frequencies from 0 to `omega` [rad/s].

    Around the middle s0 of an interval the error is a Taylor series with the coefficients C R^(k+1) B,
    R = (s0 I - A)^-1, taken of both models together, so that what they share cancels; the rest of the series
    is bounded block by block with the norm of R. Intervals are halved until the bound is tight.

    Parameters
    ----------
    slope
        [outputs, inputs], a term `s * slope` of the small model.
    """
    groups = _difference(full, small)
    d = (full.d - small.d).ravel()
    linear = np.zeros(d.shape) if slope is None else slope.ravel()
    unit = scale.ravel()
    edges = np.concatenate([[0.0], np.geomspace(1e-6 * omega, omega, 60)])
    low, high = edges[:-1], edges[1:]
    upper, best = np.zeros(d.shape), np.zeros(d.shape)
    for _ in range(_ROUNDS):
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        terms = np.zeros((TERMS, len(low), len(d)), complex)
        terms[0] = d - 1j * middle[:, None] * linear
        terms[1] -= linear
        bound = np.zeros((len(low), len(d)))
        for a, weight, gain in groups:
            resolvent = _inverse(1j * middle[:, None, None, None] * np.eye(a.shape[1]) - a)
            power = resolvent
            for k in range(TERMS):
                terms[k] += (-1) ** k * (power.reshape(len(low), -1) @ weight)
                if k < TERMS - 1:
                    power = power * resolvent if a.shape[1] == 1 else power @ resolvent
            bound += rest(np.linalg.norm(resolvent, axis=(2, 3)), half) @ gain
        best = np.maximum(best, (np.abs(terms[0]) / unit).max(axis=0))
        for k in range(TERMS):
            bound += np.abs(terms[k]) * half[:, None] ** k
        bound /= unit
        good = bound <= (1.0 + _TIGHT) * best + _LOOSE * best.max() + _ROUNDING
        done = good.all(axis=1)
        upper = np.maximum(upper, bound[done].max(axis=0, initial=0.0))
        if done.all():
            break
        low, middle, high = low[~done], middle[~done], high[~done]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    else:
        upper = np.maximum(upper, bound.max(axis=0))
    return Bound(upper.reshape(scale.shape), best.reshape(scale.shape))


def _difference(full: Modes, small: Modes) -> list[tuple[Array, Array, Array]]:
    """Return the blocks of `full` minus `small` by size, those left out that both have.

    Of each size: A [blocks, k, k], the factors [blocks k k, paths] of the resolvents' entries, and the
    largest that a resolvent of norm 1 can make [blocks, paths].
    """
    shared = Counter(key for key, *_ in _keyed(full)) & Counter(key for key, *_ in _keyed(small))
    blocks = []
    for modes, sign in ((full, 1.0), (small, -1.0)):
        left = shared.copy()
        for key, a, b, c in _keyed(modes):
            if left[key]:
                left[key] -= 1
            else:
                blocks.append((a, b, sign * c))
    out = []
    for size in sorted({len(a) for a, _, _ in blocks}):
        chosen = [block for block in blocks if len(block[0]) == size]
        weight = np.concatenate(
            [np.einsum("oj,li->jloi", c, b).reshape(size * size, -1) for _, b, c in chosen]
        )
        gain = np.stack(
            [(np.linalg.norm(c, axis=1)[:, None] * np.linalg.norm(b, axis=0)).ravel() for _, b, c in chosen]
        )
        out.append((np.stack([a for a, _, _ in chosen]), weight, gain))
    return out


def _keyed(modes: Modes) -> list[tuple[bytes, Array, Array, Array]]:
    """Return each block's key, A, B and C."""
    parts = [
        (modes.a[i:j, i:j], modes.b[i:j], modes.c[:, i:j]) for i, j in pairwise(np.cumsum((0, *modes.blocks)))
    ]
    return [(b"".join(matrix.tobytes() for matrix in part), *part) for part in parts]


def _inverse(matrices: Complex) -> Complex:
    out: Complex = 1.0 / matrices if matrices.shape[-1] == 1 else np.linalg.inv(matrices).astype(complex)
    return out


def rest(norm: Array, half: Array) -> Array:
    """Bound what the Taylor series of a resolvent of this norm leaves out; huge where it is too long.

    `norm` [intervals, blocks] is Frobenius', never below the one that counts.
    """
    reach = half[:, None] * norm
    tail: Array = np.where(
        reach < 0.9, norm * np.minimum(reach, 1.0) ** TERMS / np.maximum(1.0 - reach, 0.1), _HUGE
    )
    return tail
