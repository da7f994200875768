"""Networks before and after the multipliers row by row: orders are learned once, then fitted in no time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.extraction.path_measurement import Paths
from cosim.circuits.fitting.rational_fit import Modes, fit
from cosim.circuits.fitting.vector_fitting import Fractions, fractions, realised, relocated, shortened, weight
from cosim.types import Array, Complex

__all__ = ["GOOD", "Batch", "Fitted", "Unfit", "batches", "fitted", "points"]


#: Largest error at any frequency, relative to each path's maximum: what the unreduced model promises.
GOOD = 1e-9
#: Steps of the poles.
_STEPS = 4
#: A path below this share of the strongest one to the same place is rounding; below the second it is fitted
#: in that share's measure.
_ROUNDING, _WEAK = 1e-13, 1e-6
#: Rows that differ by less have the same poles.
_EQUAL = 1e-12
#: How far beyond the slowest and the fastest pole is measured, and points besides one and a half a pole.
_BEYOND, _SPARE = 4.0, 3
#: One point of so many is for checking only.
_CHECK = 4
#: Frequencies in the band at which a reduced row is compared with the whole one.
GRID = 33


class Unfit(Exception):
    """The rows are not what they were: another number of poles, or one in the right half plane."""


@dataclass(frozen=True)
class Batch:
    """Rows with as many poles and paths: fitted in one go.

    Attributes
    ----------
    before
        Whether they stand before the multipliers, of each row.
    outputs, inputs
        Places in the block, of each row.
    poles
        [R, N] as learned, the fastest first.
    keep
        Poles that each row of the reduced model needs at least.
    """

    before: tuple[bool, ...]
    outputs: tuple[tuple[int, ...], ...]
    inputs: tuple[tuple[int, ...], ...]
    poles: Complex
    keep: tuple[int, ...]


@dataclass(frozen=True)
class Fitted:
    """Both networks.

    Attributes
    ----------
    pre, post
        State space of each.
    batches
        What to go by next time.
    poles
        All poles before reduction [rad/s].
    error
        Largest error at the measured points, relative to each path's measure.
    lost
        Largest error of the reduction at the grid's points.
    """

    pre: Modes
    post: Modes
    batches: tuple[Batch, ...]
    poles: Complex
    error: float
    lost: float


def batches(paths: Paths, outputs: Sequence[tuple[bool, tuple[int, ...]]]) -> tuple[Batch, ...]:
    """Find out which poles each row has.

    Parameters
    ----------
    paths
        Densely measured.
    outputs
        For each row whether it stands before the multipliers, and its places in the block: places that are
        one node make one row.
    """
    known: list[tuple[Complex, Complex]] = []
    groups: dict[tuple[int, int], list[tuple[bool, tuple[int, ...], tuple[int, ...], Complex]]] = {}
    for before, places in outputs:
        h = (paths.x if before else paths.post)[:, places[0]]
        peak = np.abs(h).max(axis=0)
        inputs = tuple(np.flatnonzero((peak > _ROUNDING * peak.max()) & (peak > 0.0)).tolist())
        if not inputs:
            continue
        h = h[:, list(inputs)]
        poles = next((p for other, p in known if other.shape == h.shape and _equal(other, h)), None)
        if poles is None:
            one = fit(paths.s, h[:, None, :]).poles
            poles = np.concatenate([one, one[one.imag > 0.0].conj()])
            poles = poles[np.lexsort((poles.imag < 0.0, -np.abs(poles)))]
            known.append((h, poles))
        groups.setdefault((len(poles), len(inputs)), []).append((before, places, inputs, poles))
    out = []
    for rows in groups.values():
        sides, places_, inputs_, poles_ = zip(*rows, strict=True)
        out.append(Batch(sides, places_, inputs_, np.stack(poles_), (0,) * len(rows)))
    return tuple(out)


def points(rows: Sequence[Batch]) -> str:
    """Return the sweep that the rows need: a little beyond their poles on both sides."""
    every = np.concatenate([[1.0] if not rows else [], *(np.abs(batch.poles.ravel()) for batch in rows)])
    every = every if len(every) else np.ones(1)
    low = max(every.min() / (2.0 * np.pi * _BEYOND), 1e-3)
    high = min(every.max() * _BEYOND / (2.0 * np.pi), 1e9)
    count = 1.5 * max((batch.poles.shape[1] for batch in rows), default=0) + _SPARE
    return f"dec {int(np.ceil(count / np.log10(high / low)))} {float(low)!r} {float(high)!r}"


def fitted(paths: Paths, rows: Sequence[Batch], omega: float, share: float) -> Fitted:
    """Fit all rows, and leave out poles that are not needed.

    Parameters
    ----------
    omega, share
        Band [rad/s] and largest error there of the reduced rows; 0: unreduced.

    Raises
    ------
    Unfit
        With the reason.
    """
    s = np.concatenate([paths.s, paths.s.conj()])
    used = _used(len(paths.s))
    grid = _grid(omega)
    systems: tuple[list[_System], list[_System]] = ([], [])
    error, lost, poles, kept = 0.0, 0.0, [], []
    for batch in rows:
        try:
            row = _fit(paths, s, used, batch)
        except np.linalg.LinAlgError as reason:
            raise Unfit("the poles cannot be told apart") from reason
        error = max(error, float(row.misfit.max()))
        if not error <= GOOD:
            raise Unfit(f"as many poles as before leave an error of {error:.1e} of the path's maximum")
        if (row.poles.real >= 0.0).any():
            raise Unfit("a pole lies in the right half plane")
        poles.append(row.poles.ravel())
        kept.append(batch)
        if omega > 0.0 and share > 0.0:
            small, worst = _reduced(row, batch.keep, grid, share)
            kept[-1] = replace(batch, keep=tuple(one.poles.shape[1] for one, _ in small))
            lost = max(lost, worst)
        else:
            small = [(row, k) for k in range(len(batch.before))]
        for k, (one, place) in enumerate(small):
            system = realised(one, place)
            if system is None:
                raise Unfit("a complex pole lacks its partner")
            systems[not batch.before[k]].append((batch.outputs[k], batch.inputs[k], system))
    pre = _joined(systems[0], *paths.x.shape[1:])
    post = _joined(systems[1], *paths.post.shape[1:])
    return Fitted(pre, post, tuple(kept), np.concatenate([*poles, np.empty(0, complex)]), error, lost)


_System = tuple[tuple[int, ...], tuple[int, ...], tuple[Array, Array, Array, Array]]


@lru_cache(maxsize=8)
def _used(count: int) -> NDArray[np.bool_]:
    """Return which of so many points, and of their conjugates, the rows are fitted to."""
    return np.tile(np.arange(count) % _CHECK != 1, 2)


@lru_cache(maxsize=8)
def _grid(omega: float) -> Complex:
    """Return points from 0 to `omega`, linear and logarithmic, and their conjugates."""
    half = GRID // 2
    even, fine = np.linspace(0.0, omega, half + 2)[1:-1], omega * np.geomspace(1e-4, 1.0, half)
    w = np.concatenate([[0.0], fine, even])
    out: Complex = np.concatenate([1j * w, -1j * w])
    return out


def _equal(first: Complex, second: Complex) -> bool:
    return bool((np.abs(first - second).max(axis=0) <= _EQUAL * np.abs(second).max(axis=0)).all())


def _fit(paths: Paths, s: Complex, used: NDArray[np.bool_], batch: Batch) -> Fractions:
    h = np.stack(
        [
            (paths.x if before else paths.post)[:, outputs[0], list(inputs)].T
            for before, outputs, inputs in zip(batch.before, batch.outputs, batch.inputs, strict=True)
        ]
    )
    own = np.abs(h).max(axis=2)
    measure = np.maximum(own, _WEAK * own.max(axis=1, keepdims=True))
    measure[measure == 0.0] = 1.0
    f = np.concatenate([h, h.conj()], axis=2) / measure[:, :, None]
    poles, best = batch.poles, None
    for _ in range(_STEPS):
        poles = relocated(s[used], f[:, :, used], poles)
        row = fractions(s, f, measure, poles, used)
        if best is None or row.misfit.max() < best.misfit.max():
            best = row
        if best.misfit.max() <= 0.1 * GOOD:
            break
    assert best is not None
    return best


def _reduced(
    row: Fractions, keep: Sequence[int], grid: Complex, share: float
) -> tuple[list[tuple[Fractions, int]], float]:
    """Return each row with as few poles as its error may be, as a place among rows, and the largest error."""
    count = row.poles.shape[1]
    order = np.argsort(-weight(row, float(np.abs(grid).max())), axis=1, kind="stable")
    best: dict[int, tuple[Fractions, int]] = {}
    worst = 0.0
    for size in range(min(keep), count):
        if len(best) == len(keep):
            break
        left = [k for k in range(len(keep)) if keep[k] <= size and k not in best]
        chosen = order[:, :size]
        unpaired = np.abs(np.take_along_axis(row.poles, chosen, axis=1).imag.sum(axis=1))
        left = [
            k for k in left if unpaired[k] <= 1e-9 * np.abs(row.poles[k]).max()
        ]  # no pole without partner
        if not left:
            continue
        small, error = shortened(row.of(left), chosen[left], grid)
        for at, k in enumerate(left):
            if error[at] <= share:
                best[k] = small, at
                worst = max(worst, float(error[at]))
    return [best.get(k, (row, k)) for k in range(len(keep))], worst


def _joined(rows: list[_System], outputs: int, inputs: int) -> Modes:
    """Put rows together as one network."""
    size = sum(len(system[0]) for _, _, system in rows)
    a, b = np.zeros((size, size)), np.zeros((size, inputs))
    c, d = np.zeros((outputs, size)), np.zeros((outputs, inputs))
    at = 0
    for to, of, (a_row, b_row, c_row, d_row) in rows:
        states = slice(at, at + len(a_row))
        a[states, states] = a_row
        b[states, of] = b_row
        for output in to:
            c[output, states] = c_row
            d[output, of] = d_row
        at += len(a_row)
    return Modes(a, b, c, d, np.empty(0, complex), (), np.zeros((outputs, inputs)))
