"""Which oscillation a mode of the sampled loop is: motion between samples decides what z = exp(s T) cannot.

A mode of the map of one period repeats itself up to the factor z; its exponent is s_k = (ln z + 2 pi i k)/T
for any integer k. Between two samples it moves as x(t) = exp(s_k t) p_k(t), with p_k of period T: the one
seen on an oscilloscope is that whose p_k has the largest mean. A mode that nothing samples, such as one
of the circuit alone, has a constant p_k for one k, and s_k is then its eigenvalue in continuous time.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.analysis.period_map import Lifted

__all__ = ["exponents"]

#: Poles that decay by more than this exponent in a period leave no visible oscillation [nepers].
_FADED = 40.0
#: Points of the path to a turn of its fastest oscillation; fewest and most points in a period.
_A_TURN, _FEWEST, _MOST = 16, 256, 1 << 16
#: Points handled at once.
_CHUNK = 512


def exponents(
    lifted: Lifted, z: NDArray[np.complex128], vectors: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return the exponents s [1/s] of modes, and the share of their motion that goes by exp(s t).

    Parameters
    ----------
    z
        [M] eigenvalues of the map of a period, none zero.
    vectors
        [size, M] their eigenvectors.

    Returns
    -------
    tuple
        s [M], and shares [M] of the squared motion, in coordinates balanced against each other's units. Below
        one half several frequencies describe the motion equally well. NaN where oscillations are too fast
        against the period to be told apart.
    """
    system = lifted.system
    period = system.period_s
    poles = np.linalg.eigvals(system.a)
    lasting = poles[np.abs(poles.real) * period < _FADED].imag
    turns = float(np.abs(lasting).max(initial=0.0)) * period / (2.0 * math.pi)
    principal: NDArray[np.complex128] = np.asarray(np.log(z.astype(complex)), np.complex128) / period
    if turns * _A_TURN > _MOST:
        return principal, np.full(len(z), np.nan)
    # whole turns that can be: none, those that a lasting pole makes, and their neighbours
    around = np.unique(np.rint(np.abs(lasting) * period / (2.0 * math.pi)).astype(int))
    near = {int(k) + step for k in (0, *around) for step in (-1, 0, 1)}
    shifts = np.array(sorted({sign * k for k in near for sign in (-1, 1)}))
    scale = np.diag(scipy.linalg.matrix_balance(system.a, permute=False)[1])
    means, power = _content(
        lifted, principal, vectors, shifts, scale, max(_FEWEST, math.ceil(_A_TURN * turns))
    )
    content = np.abs(means) ** 2
    weight = np.sum(content, axis=1)  # [turns, M]
    total = np.maximum(np.sum(power, axis=0), 1e-300)
    best = np.argmax(weight, axis=0)
    s = principal + 2j * math.pi * shifts[best] / period
    share = weight[best, np.arange(len(z))] / total
    # a real motion holds exp(s t) and its conjugate: of a real z both are the same mode
    real = np.abs(z.imag) <= 1e-12 * np.abs(z)
    for m in np.flatnonzero(real & (np.abs(s.imag) > 0.0)):
        twin = np.abs(principal[m] + 2j * math.pi * shifts / period - np.conj(s[m])) < 1e-6 / period
        share[m] += weight[twin, m].sum() / total[m]
    return s, np.minimum(share, 1.0)


def _content(
    lifted: Lifted,
    s: NDArray[np.complex128],
    vectors: NDArray[np.complex128],
    shifts: NDArray[np.int64],
    scale: NDArray[np.float64],
    points: int,
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return means [turns, states, M] of exp(-s_k t) x(t) over a period, and [states, M] of its square."""
    states, period = lifted.states, lifted.system.period_s
    means = np.zeros((len(shifts), states, vectors.shape[1]), complex)
    power = np.zeros((states, vectors.shape[1]))
    x = vectors.astype(complex)
    for t, after in pairwise([*lifted.instants(), period]):
        x = lifted.at(t) @ x
        stretch = lifted.stretch(t, after - t)
        count = max(2, math.ceil(points * (after - t) / period))
        h = (after - t) / count
        step, now = lifted.step(h), stretch.enter @ x
        for start in range(0, count + 1, _CHUNK):
            at = np.arange(start, min(start + _CHUNK, count + 1))
            path = np.empty((len(at), states, vectors.shape[1]), complex)
            for i in range(len(at)):
                path[i] = now[:states] / scale[:, None]
                now = step @ now
            weight = np.where((at == 0) | (at == count), 0.5, 1.0) * h / period
            when = t + h * at
            path *= np.exp(-np.outer(when, s))[:, None, :]
            turned = weight * np.exp(-2j * math.pi * np.outer(shifts, when) / period)
            means += np.tensordot(turned, path, axes=1)
            power += np.tensordot(weight, np.abs(path) ** 2, axes=1)
        x = stretch.leave @ x
    return means, power
