"""Rational fit of frequency responses that share their poles, and its real, stable state space.

AAA finds the poles (`aaa.py`); residues come from linear least squares, and poles that no path needs are
removed. Poles near to each other form a chain instead of having residues of their own, which would be large
and cancel. A pole has as many states as its residue has rank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are used

from cosim.circuits.fitting.aaa import poles_of
from cosim.circuits.fitting.pole_chains import (
    NEAR,
    chain_basis,
    chain_matrices,
    chained,
    least_squares,
    states_of,
)
from cosim.circuits.fitting.vector_fitting import in_order, relocated
from cosim.circuits.linear_circuit import GOOD, rational
from cosim.types import Array, Complex

__all__ = ["WORST", "FitError", "Modes", "fit"]


#: A worse fit is refused. One in between is used and its error reported: the parts are known to a percent.
WORST = 1e-3
#: A pole in the right half plane is believed when the fit with it is at least as good as this.
_CERTAIN = 1e-5
#: ... and poles on the left alone leave more: behind amplifiers of gain 1e9 `.ac` is right to 1e-9 at best,
#: and forty poles on either side fit that rounding as well.
_NEEDED = 1e-7
#: ... and lies below so many times the fastest point.
_SURE = 3.0
#: Poles that stand for powers of s lie so many times the fastest point away, or further: there may be so many
#: of them, as long as each makes the error smaller by this.
_FAR, _MOST_FAR, _GAIN = 300.0, 4, 10.0
#: Paths that differ by less are one.
_EQUAL = 1e-13
#: A pole whose share of every path stays below this is spurious.
_SPURIOUS = 1e-12
#: Paths weaker than this share of the strongest path to the same output are fitted to that share's measure.
_WEAK = 1e-6
#: Error that fewer copies of a chain may make before C and D are found again; what serves best is kept.
_RANK = (1e-7, 1e-9, 1e-12)
#: Error that leaves nothing to be gained.
_EXCELLENT = 1e-12
_MOVES = 6
#: A path that rises by so many decades up to the end of the band is told where no fit is good enough.
_RISE = 3.0


class FitError(Exception):
    """No rational function of reasonable order fits, or only one with a pole in the right half plane.

    Parameters
    ----------
    message
        What is wrong.
    poles
        Poles [rad/s] in the right half plane, if that is the reason.
    """

    def __init__(self, message: str, poles: Complex | None = None) -> None:
        super().__init__(message)
        self.poles = poles


@dataclass(frozen=True)
class Modes:
    """H(s) = C (sI - A)^-1 B + D with A in blocks along the diagonal, one for each group of near poles.

    Attributes
    ----------
    a, b, c, d
        Real matrices; A is block diagonal with 1x1, 2x2 and (near poles) lower triangular blocks.
    poles
        Poles [rad/s], those of each block together.
    blocks
        Sizes of the blocks.
    error
        [outputs, inputs], largest error at the measured points relative to the path's maximum.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    poles: Complex
    blocks: tuple[int, ...]
    error: Array

    @property
    def worst(self) -> float:
        """Largest error of any path."""
        return float(self.error.max(initial=0.0))

    def derivatives(self, count: int) -> Array:
        """Return H, dH/ds, d2H/ds2 / 2, ... at s = 0; shape [count, outputs, inputs]."""
        out = np.zeros((count, *self.d.shape))
        out[0] = self.d
        state: Array = self.b
        for k in range(count):
            if len(self.a):
                state = np.asarray(np.linalg.solve(self.a, state), float)
                out[k] -= self.c @ state
        return out


def fit(s: Complex, h: Complex, worst: float = WORST) -> Modes:
    """Fit responses with one set of poles.

    Of the two ways to find poles (see `poles_of`) the second is gone where the first leaves more than `GOOD`.

    Parameters
    ----------
    s
        [F], points jw with w > 0 [rad/s].
    h
        [F, outputs, inputs].
    worst
        Largest error that is accepted, relative to each path's maximum.

    Raises
    ------
    FitError
        When no rational function fits, or when one fits that has a pole in the right half plane.
    """
    unstable: FitError | None = None
    fits: list[Modes] = []
    for reweighted in (True, False):
        try:
            fits.append(_fit(s, h, reweighted))
        except FitError as reason:
            unstable = reason
            continue
        if fits[-1].worst <= GOOD:
            return fits[-1]
    if unstable is not None:
        raise unstable
    best = min(fits, key=lambda modes: modes.worst)
    if not best.worst <= worst:
        left = f"order {len(best.a)} leaves an error of {best.worst:.1e} of the path's maximum"
        raise FitError(left + _rising(s, h))
    return best


def _rising(s: Complex, h: Complex) -> str:
    """Return words for a path that rises to the end of the band, as leads without a pole do; '' for none."""
    size = np.abs(h).reshape(len(s), -1)
    least = np.maximum(size.min(axis=0), np.finfo(float).tiny)
    decades = np.where(size[-1] >= size.max(axis=0), np.log10(np.maximum(size[-1] / least, 1.0)), 0.0)
    worst = float(decades.max(initial=0.0))
    if worst < _RISE:
        return ""
    return (
        f": a path rises by {worst:.2g} decades and still does at {abs(s[-1]) / (2.0 * np.pi):.3g} Hz, as "
        "ideal leads do, whose zeros have no poles; give it those of the circuit (amplifiers of finite "
        'bandwidth, effects.opamp = "gbw", or a resistor in series with the capacitor)'
    )


def _fit(s: Complex, h: Complex, reweighted: bool) -> Modes:
    size, rows, columns = h.shape
    own = np.abs(h).max(axis=0)
    # what is weaker than _WEAK of its row is known, to rounding, only relative to the row
    scale = np.maximum(own, _WEAK * own.max(axis=1, keepdims=True))
    scale[scale == 0.0] = 1.0
    f = (h / scale).reshape(size, rows * columns)
    poles = _needed(s, f[:, _distinct(f)], reweighted)
    chains = chained(poles)
    basis = chain_basis(s, chains)
    weights = least_squares(basis, f).reshape(-1, rows, columns)
    peaks = np.abs(basis).max(axis=0)
    fits: list[Modes] = []
    for rank in _RANK:
        fits.append(_polished(s, h / scale, _realise(chains, weights, peaks, scale, rank), scale))
        if fits[-1].worst <= _EXCELLENT:
            break
    good = [modes for modes in fits if modes.worst <= GOOD]
    if not good:
        return min(fits, key=lambda modes: modes.worst)
    return min(good, key=lambda modes: (len(modes.a), modes.worst))


def _polished(s: Complex, f: Complex, modes: Modes, scale: Array) -> Modes:
    """Find C and D again for the A and B of `modes`; residues of near poles are right only together."""
    rows, columns = scale.shape
    left = s[:, None, None] * np.eye(len(modes.a)) - modes.a
    states = np.linalg.solve(left, np.broadcast_to(modes.b.astype(complex), (len(s), *modes.b.shape)))
    through = np.broadcast_to(np.eye(columns, dtype=complex), (len(s), columns, columns))
    known = np.concatenate([states, through], axis=1).transpose(0, 2, 1)
    c, d = np.zeros((rows, len(modes.a))), np.zeros((rows, columns))
    for row in range(rows):
        here = (known / scale[row, :, None]).reshape(-1, known.shape[2]).astype(complex)
        solution = least_squares(here, f[:, row].reshape(-1, 1))[:, 0]
        c[row], d[row] = solution[: len(modes.a)], solution[len(modes.a) :]
    fitted = rational(s, modes.a, modes.b, c, d) / scale
    return replace(modes, c=c, d=d, error=np.abs(fitted - f).max(axis=0))


def _distinct(f: Complex) -> list[int]:
    """Return the columns that are not equal to an earlier one (equal channels are common, and cost time)."""
    columns: list[int] = []
    for k in range(f.shape[1]):
        if np.abs(f[:, k]).max() > 0.0 and all(np.abs(f[:, k] - f[:, i]).max() > _EQUAL for i in columns):
            columns.append(k)
    return columns


def _needed(s: Complex, f: Complex, reweighted: bool) -> Complex:
    """Return the poles that the paths need, one of each conjugate pair."""
    if f.shape[1] == 0:
        return np.empty(0, complex)
    every = poles_of(s, f, GOOD, reweighted)
    # the side of the axis of a pole so far beyond the fastest point is not identifiable
    every = every[(every.real < 0.0) | (np.abs(every) < _SURE * np.abs(s).max())]
    poles = _with_powers(s, f, every[every.real < 0.0])
    misfit = _misfit(s, f, poles)
    every = poles if (every.real < 0.0).all() else _with_powers(s, f, every)
    if (every.real >= 0.0).any() and misfit > _NEEDED and _misfit(s, f, every) < min(1e-2 * misfit, _CERTAIN):
        share = _shares(s, f, every)
        wrong = (every.real >= 0.0) & (share > GOOD)
        raise FitError("a pole lies in the right half plane", every[wrong])
    poles, misfit = _relocated(s, f, poles)
    limit = max(_SPURIOUS, 3.0 * misfit)
    while len(poles):
        rest = np.delete(poles, int(np.argmin(_shares(s, f, poles))))
        if _misfit(s, f, rest) > limit:
            break
        poles = rest
    return _relocated(s, f, poles)[0]


def _with_powers(s: Complex, f: Complex, poles: Complex) -> Complex:
    """Return the poles, and such far beyond the points that paths may grow towards their end as powers of s.

    A vendor's model whose common-mode gain has a zero and no pole makes such paths. AAA gives them poles far
    away on either side, of which those on the right do not belong to the circuit. What only grows is a
    differentiator, which no state space holds.
    """
    if (np.argmax(np.abs(f), axis=0) == len(s) - 1).all():
        return poles
    misfit = _misfit(s, f, poles)
    for k in range(_MOST_FAR):
        more = np.append(poles, -_FAR * 2.0**k * np.abs(s).max())  # apart: equal ones have no modes
        now = _misfit(s, f, more) if misfit > GOOD else misfit
        if now * _GAIN > misfit:
            break
        poles, misfit = more, now
    return poles


def _relocated(s: Complex, f: Complex, poles: Complex) -> tuple[Complex, float]:
    """Improve the poles together, and return them with their misfit.

    AAA leaves each of q equal poles wrong by the q-th root of rounding: steps of vector fitting on one chain
    of them all find the polynomial that they are the zeros of.
    """
    both, rows = np.concatenate([s, s.conj()]), np.concatenate([f, f.conj()]).T[None]
    best, misfit = poles, _misfit(s, f, poles)
    for _ in range(_MOVES):
        pairs = np.concatenate([best, best[best.imag > 0.0].conj()])
        try:
            moved = relocated(both, rows, in_order(pairs[None]))[0]
        except np.linalg.LinAlgError:  # more poles than the paths have
            break
        trial = moved[moved.imag >= 0.0]
        if not (trial.real < 0.0).all() or (now := _misfit(s, f, trial)) >= misfit:
            break
        best, misfit = trial, now
    return best, misfit


def _misfit(s: Complex, f: Complex, poles: Complex) -> float:
    """Return the largest error of a fit with these poles, infinite where a point lies on one of them."""
    basis = chain_basis(s, chained(poles))
    if not np.isfinite(basis).all():
        return math.inf
    return float(np.abs(basis @ least_squares(basis, f) - f).max())


def _shares(s: Complex, f: Complex, poles: Complex) -> Array:
    """Return how much of any path each pole makes at most; within a chain all count as much."""
    chains = chained(poles)
    basis = chain_basis(s, chains)
    weights = np.abs(least_squares(basis, f)).max(axis=1) * np.abs(basis).max(axis=0)
    out, at = np.zeros(len(poles)), 1
    for chain in chains:
        size = sum(states_of(pole) for pole in chain)
        last = states_of(chain[-1])  # the end of a chain is what its poles make together
        for pole in chain:
            out[poles == pole] = weights[at + size - last : at + size].max()
        at += size
    return out


def _realise(chains: list[list[complex]], weights: Array, peaks: Array, scale: Array, rank: float) -> Modes:
    """Make the smallest state space of each chain: as many copies as its weights have rank.

    `weights` [1 + states, outputs, inputs] belong to paths divided by `scale`; `peaks` are the largest
    values of the basis functions.
    """
    parts: list[tuple[Array, Array, Array]] = []
    poles: list[complex] = []
    at = 1
    for chain in chains:
        a, b = chain_matrices(chain)
        states = slice(at, at + len(a))
        if len(chain) == 1 and chain[0].imag > NEAR * abs(chain[0]):
            part = _oscillators(chain[0], weights[states], scale, rank)
        else:
            part = _copies(a, b, weights[states], peaks[states, None, None], scale, rank)
        if len(part[0]):
            parts.append(part)
            poles += chain
        at += len(a)
    outputs, inputs = scale.shape
    return Modes(
        scipy.linalg.block_diag(np.zeros((0, 0)), *[a for a, _, _ in parts]),
        np.concatenate([np.zeros((0, inputs)), *[b for _, b, _ in parts]]),
        np.concatenate([np.zeros((outputs, 0)), *[c for _, _, c in parts]], axis=1),
        weights[0] * scale,
        np.array(poles, complex),
        tuple(len(a) for a, _, _ in parts),
        np.zeros((outputs, inputs)),
    )


def _copies(
    a: Array, b: Array, weights: Array, peaks: Array, scale: Array, rank: float
) -> tuple[Array, Array, Array]:
    """Return A, B, C of one chain: a copy for each direction of its inputs, or of its outputs if fewer."""
    size, outputs, inputs = weights.shape
    from_inputs, kept = _directions(weights, scale, peaks, rank)
    to_outputs, turned = _directions(weights.transpose(0, 2, 1), scale.T, peaks, rank)
    if len(from_inputs) <= len(to_outputs):
        copies = len(from_inputs)
        c = kept.transpose(1, 2, 0).reshape(outputs, copies * size)
        driven: Array = np.kron(from_inputs, b[:, None])
        return np.asarray(np.kron(np.eye(copies), a), float), driven, np.asarray(c, float)
    copies = len(to_outputs)
    back = turned.transpose(2, 0, 1).reshape(copies * size, inputs)
    out: Array = np.kron(to_outputs.T, b[None, :])
    return np.asarray(np.kron(np.eye(copies), a.T), float), np.asarray(back, float), out


def _oscillators(pole: complex, weights: Array, scale: Array, rank: float) -> tuple[Array, Array, Array]:
    """Return A, B, C of one pair of conjugate poles: the rank of its complex residue counts."""
    rate = abs(pole)
    residue = (weights[:1] * rate**2 + weights[1:] * rate * pole) / (2j * pole.imag)
    into, out = _directions(residue, scale, np.array(1.0 / abs(pole.real)), rank)
    turn = np.array([[pole.real, -pole.imag], [pole.imag, pole.real]])
    b = np.stack([into.real, into.imag], axis=1).reshape(-1, scale.shape[1])
    c = 2.0 * np.stack([out[0].real, -out[0].imag], axis=2).reshape(scale.shape[0], -1)
    return np.kron(np.eye(len(into)), turn), b, c


def _directions(weights: Any, scale: Array, peaks: Array, missed: float) -> tuple[Any, Any]:
    """Return as few rows as span the last axis of `weights * scale` but for `missed`, relative to each path.

    With them, the coefficients [size, outputs, rows], by least squares in the measure of each path: a weak
    path has to follow the direction that the strong ones show.
    """
    true = weights * scale
    rows = true / scale.max(axis=1, keepdims=True)  # outputs count alike, whatever their units
    _, _, every = np.linalg.svd(rows.reshape(-1, rows.shape[2]), full_matrices=False)
    for rank in range(len(every) + 1):
        left = every[:rank] / scale[:, None, :]
        kept = np.einsum("koi,oir->kor", weights, np.linalg.pinv(left))
        rest = np.abs(np.einsum("kor,ori->koi", kept, left) - weights) * peaks
        if rest.max(initial=0.0) <= missed:
            break
    return every[:rank], kept
