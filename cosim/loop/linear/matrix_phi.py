"""Matrix exponential and its integrals for stiff real matrices.

Well-conditioned eigenvectors are used where they exist, each refined: the pairs that `eig` returns are right
to the rounding of the fastest mode, 1e-8 rad/s beside 1e7 rad/s, which is 1e-7 of a slow one. Otherwise:
scaling and squaring loses the slow modes' digits where a fast mode makes the norm large. So slow and fast are
separated first (Schur form ordered by modulus, Sylvester equation), until each part is of one size: a slow
part has a small norm, and in a fast one the integrals follow from the exponential without cancellation.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.loop.linear.divided_differences import TOP, singles
from cosim.types import Array, Complex

#: Refined eigenvectors conditioned better than this lose six digits at most, and are the quick way.
_WELL = 1e6
#: Refinements of a pair, and the residual at which it is right: of each row's largest sum.
_REFINED, _RIGHT = 4, 4e-16
#: A refined pole is the one that was found, to this share: of a cluster it might become another.
_SAME = 1e-2
#: Moduli further apart than this are separated; up to this modulus a part counts as slow.
_GAP, _SLOW = 30.0, 30.0
#: Poles times the time that differ by less lose digits in a quotient of differences: 1e-16 over this.
_NEAR = 1e-4
#: Decompositions that are kept.
_KEPT = 16


class Modes:
    """A real matrix [N, N], decomposed once for its phi functions at many times.

    Attributes
    ----------
    balanced, scale
        The matrix is `scale` * `balanced`, entry by entry.
    poles, vectors, inverse
        Of the balanced matrix; `inverse` is None where the vectors are ill-conditioned.
    """

    def __init__(self, a: Array) -> None:
        self.balanced, _, _, factors, _ = scipy.linalg.lapack.dgebal(a, scale=1)
        self.scale = factors[:, None] / factors
        self.poles, self.vectors = refined(self.balanced, *np.linalg.eig(self.balanced))
        well = np.linalg.cond(self.vectors) < _WELL
        self.inverse = np.linalg.inv(self.vectors) if well else None


def refined(a: Array, poles: Array, vectors: Array) -> tuple[Complex, Complex]:
    """Refine eigenpairs until each row of ``a v - pole v`` is zero to the rounding of its own terms.

    Newton's method on the pair, the correction normal to the vector (Wilkinson, The Algebraic Eigenvalue
    Problem, 1965, ch. 3). A step that leaves a pair's largest residual as it was is not taken.

    Parameters
    ----------
    a : [N, N], balanced
    poles, vectors : as `numpy.linalg.eig` returns them, [N] and [N, N]

    Returns
    -------
    poles [N] and vectors [N, N]
    """
    n, size = len(a), np.abs(a)
    p, v = poles.astype(complex), vectors.astype(complex)

    def residuals(p: Complex, v: Complex) -> tuple[Complex, Array]:
        r = a @ v - v * p
        terms = size @ np.abs(v) + np.abs(v) * np.abs(p)
        share = np.divide(np.abs(r), terms, out=np.zeros_like(terms), where=terms > 0.0)
        return r, share.max(axis=0, initial=0.0)

    r, wrong = residuals(p, v)
    for _ in range(_REFINED):
        at = np.flatnonzero(wrong > _RIGHT * n)
        if not at.size:
            break
        bordered, right = np.zeros((len(at), n + 1, n + 1), complex), np.zeros((len(at), n + 1, 1), complex)
        bordered[:, :n, :n] = a - p[at, None, None] * np.eye(n)
        bordered[:, :n, n], bordered[:, n, :n] = -v[:, at].T, v[:, at].T.conj()
        right[:, :n, 0] = -r[:, at].T
        step = _solved(bordered, right)
        p_new, v_new = p.copy(), v.copy()
        p_new[at] += step[:, n]
        v_new[:, at] += step[:, :n].T
        r_new, wrong_new = residuals(p_new, v_new)
        better = (wrong_new < wrong) & (np.abs(p_new - p) <= _SAME * np.abs(p))
        if not better.any():
            break
        p[better], v[:, better] = p_new[better], v_new[:, better]
        r[:, better], wrong[better] = r_new[:, better], wrong_new[better]
    return p, v


def _solved(systems: Complex, right: Complex) -> Complex:
    """Solve systems [K, N, N] whose rows differ by decades, for `right` [K, N, 1]; NaN for singular ones."""
    rows = np.abs(systems).max(axis=2, keepdims=True)
    rows[rows == 0.0] = 1.0
    scaled, wanted = systems / rows, right / rows
    try:
        return np.asarray(np.linalg.solve(scaled, wanted)[:, :, 0], complex)
    except np.linalg.LinAlgError:  # one of them: a pole that is there twice
        if len(systems) == 1:
            return np.full(right.shape[:2], np.nan, complex)
        return np.concatenate([_solved(systems[k : k + 1], right[k : k + 1]) for k in range(len(systems))])


@lru_cache(maxsize=_KEPT)
def _modes(a: bytes, n: int) -> Modes:
    """Return the decomposition of a matrix given by its bytes; a run needs few, each at many times."""
    return Modes(np.frombuffer(a).reshape(n, n))


def phi_functions(a: Array, h: float, count: int) -> list[Array]:
    """Return F_0 .. F_count of `a` times `h`: F_0 = exp, F_r = int_0^1 exp((1 - x) a h) x^(r-1)/(r-1)! dx.

    Parameters
    ----------
    a
        Real [N, N]; any norm, no mode that grows by more than floats can hold.
    h
        Time [s].

    Examples
    --------
    exp(-1), and the integral of exp(-x) over 0 to 1.

    >>> zero, one = phi_functions(np.array([[-1.0]]), 1.0, 1)
    >>> round(float(zero[0, 0]), 6), round(float(one[0, 0]), 6)
    (0.367879, 0.632121)
    """
    one = phi_functions_of(np.asarray(a, float)[None], np.zeros(1, np.int64), np.array([h], float), count)
    return [f[0] for f in one]


def phi_functions_of(matrices: Array, which: NDArray[np.int64], times: Array, count: int) -> Array:
    """Return what `phi_functions` does for some of `matrices` [K, N, N], `which` [P] at `times` [P] s.

    The shape is [count + 1, P, N, N].
    """
    n = matrices.shape[1]
    out = np.zeros((count + 1, len(times), n, n))
    if not n:
        return out
    every = [_modes(a.tobytes(), n) for a in matrices]
    well = np.array([modes.inverse is not None for modes in every])[which]
    if well.any():
        of, t = which[well], times[well]
        used = [modes if modes.inverse is not None else every[of[0]] for modes in every]
        poles, vectors, inverse, scale = (
            np.array([getattr(modes, name) for modes in used])
            for name in ("poles", "vectors", "inverse", "scale")
        )
        nodes = (t[:, None] * poles[of]).astype(complex)
        values = np.zeros((*nodes.shape, TOP + 1), complex)
        singles(nodes.ravel(), values.reshape(-1, TOP + 1))
        each = values.transpose(2, 0, 1)[: count + 1, :, None, :]
        out[:, well] = scale[of] * np.real((vectors[of] * each) @ inverse[of])
    for p in np.flatnonzero(~well):
        modes = every[which[p]]
        out[:, p] = [modes.scale * f for f in _functions(modes.balanced * float(times[p]), count)]
    return out


def _functions(z: Array, count: int) -> list[Array]:
    size = np.sort(np.abs(np.linalg.eigvals(z)))
    if len(z) > 1 and size[-1] > _SLOW:
        low = np.maximum(size[:-1], 1.0)
        at = int(np.argmax(size[1:] / low))
        if size[at + 1] > _GAP * low[at]:
            return _apart(z, float(np.sqrt(size[at + 1] * low[at])), count)
    n = len(z)
    if size[-1] <= _SLOW or size[0] < 1.0:
        chain = np.zeros((n * (count + 1), n * (count + 1)))
        chain[:n, :n] = z
        for r in range(count):
            chain[n * r : n * (r + 1), n * (r + 1) : n * (r + 2)] = np.eye(n)
        exponential = _exponential(chain)
        return [exponential[:n, n * r : n * (r + 1)] for r in range(count + 1)]
    out: list[Array] = [_exponential(z)]
    factorial = 1.0
    for r in range(count):
        factorial *= max(r, 1)
        out.append(np.asarray(np.linalg.solve(z, out[-1] - np.eye(n) / factorial), float))
    return out


def _exponential(z: Array) -> Array:
    """Return exp(z), z of moderate norm.

    SciPy (1.17) divides differences of exponentials where a matrix is triangular, and loses 4e-9 between
    poles that differ by 1e-8: such a one is turned first, by a reflection. Poles that are equal, or well
    apart, it knows to rounding even where the norm is large, and a reflection would not.
    """
    triangular = np.triu(z, 1).any() != np.tril(z, -1).any()
    gaps = np.diff(np.sort(np.diag(z)))
    if not (triangular and ((gaps > 0.0) & (gaps < _NEAR)).any()):
        return np.asarray(scipy.linalg.expm(z))
    along = np.arange(1.0, len(z) + 1.0)
    turn = np.eye(len(z)) - 2.0 / (along @ along) * np.outer(along, along)
    return np.asarray(turn @ scipy.linalg.expm(turn @ z @ turn) @ turn)


def _apart(z: Array, cut: float, count: int) -> list[Array]:
    """Split into the modes above and below the modulus `cut`."""
    t, q, fast = scipy.linalg.schur(z, output="real", sort=lambda re, im: np.hypot(re, im) > cut)
    x = scipy.linalg.solve_sylvester(t[:fast, :fast], -t[fast:, fast:], -t[:fast, fast:])
    left, right = q.copy(), q.T.copy()
    left[:, fast:] += q[:, :fast] @ x
    right[:fast] -= x @ q.T[fast:]
    above, below = _functions(t[:fast, :fast], count), _functions(t[fast:, fast:], count)
    return [
        left[:, :fast] @ f @ right[:fast] + left[:, fast:] @ s @ right[fast:]
        for f, s in zip(above, below, strict=True)
    ]
