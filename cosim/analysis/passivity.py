"""Passivity of a sampled wall: Colgate and Schenkel's condition, and its extension to a device with dynamics.

A computer that answers the sampled position x with the held force -H(z) x is passive on a device with the
viscosity b iff (J. E. Colgate and G. G. Schenkel, J. Robotic Systems 14, 37, 1997)

    b > (T/2) / (1 - cos wT) Re{(1 - exp(-jwT)) H(exp(jwT))},   0 <= w <= pi/T.

With R(z) = (H(z) - H(1))/(z - 1) the right-hand side is (T/2) (H(1) - 2 Re R(exp(jwT))), without the division
by zero at w = 0; where it takes a given value is an eigenvalue problem, which certifies its maximum.

Where the damping depends on frequency, and the force takes a path of its own, all aliases w_n = w + 2 pi n/T
of the motion count. With B_n the Hermitian part of the device's impedance at w_n, w the joint torques of a
unit force, and p_n those that the held force really makes, the energy over a period is a Hermitian form,
identity plus rank two, in the motions at all aliases; its least eigenvalue is positive iff

    (sqrt(S_aa S_dd - Im(S)^2) - Re S) / 2 < 1,    S_dd = sum w' B_n^-1 w / w_n^2,
    S_aa = sum |H/T|^2 p_n' B_n^-1 p_n,    S = (H/T) sum w' B_n^-1 p_n / (j w_n).

For a force without a path of its own, this is b_eff(w) = sum 1/w_n^2 / sum 1/(b_n w_n^2) in the place of b.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used

from cosim.types import Array, Complex

__all__ = ["Certified", "Device", "Law", "least_damping", "needed_damping", "share_used", "wall"]


#: Points of the grid on the half circle; the certificate does not depend on it, only the time to find it.
_GRID = 512
#: The certified bound lies this share of the maximum's own size above the value found.
_ABOVE = 1e-9
#: A joint motion with less than this share of the squared force is not excited, and an eigenvalue of the
#: damping below this share of the largest counts as zero.
_UNMOVED, _UNDAMPED = 1e-24, 1e-13
#: An eigenvalue this close to the unit circle counts as on it.
_CIRCLE = 1e-7
#: Aliases that are summed one by one on each side; the others by integrals on panels of an octave.
_ALIASES = 48
_OCTAVES = 40
_PANEL, _PANEL_WEIGHTS = np.polynomial.legendre.leggauss(10)
_TO_LEGENDRE = np.linalg.inv(np.polynomial.legendre.legvander(_PANEL, len(_PANEL) - 1))
#: Terms of a sum that turns slowly are taken for so many turns, at most so many of them.
_TURNS, _MOST_TERMS = 5.0, 1 << 19


@dataclass(frozen=True)
class Law:
    """Force over sampled position H(z) = c (z - a)^-1 b + d [N/m], every `period_s`; it is held, and late.

    Attributes
    ----------
    a, b, c, d
        [N, N], [N], [N] and a number; stable.
    period_s
        T.
    lag_s
        Delay between the sample and the change of the force beyond whole periods in H, 0 to T.
    """

    a: Array
    b: Array
    c: Array
    d: float
    period_s: float
    lag_s: float = 0.0

    def response(self, z: Complex) -> Complex:
        """Return H at the points `z`."""
        left = z[:, None, None] * np.eye(len(self.a)) - self.a
        right = np.broadcast_to(self.b.astype(complex)[:, None], (len(z), len(self.b), 1))
        out: Complex = (self.d + np.linalg.solve(left, right)[:, :, 0] @ self.c).astype(complex, copy=False)
        return out


def wall(
    stiffness: float,
    damping: float,
    period_s: float,
    *,
    keep: float = 0.0,
    periods: int = 0,
    lag_s: float = 0.0,
) -> Law:
    """Return the law of a wall, K x + B v, with v the backward difference behind a low-pass.

    Parameters
    ----------
    stiffness, damping
        K [N/m], B [N s/m].
    keep
        What the low-pass keeps each sample: exp(-2 pi f T) for the corner f, tau/(T + tau) by Euler's rule.
    periods, lag_s
        Delay in whole periods, and what is left of it [s].
    """
    # one state, the filter: (1 - keep)/T (z - 1)/(z - keep) = slope (1 + (keep - 1)/(z - keep))
    slope = damping * (1.0 - keep) / period_s
    a, b, c, d = np.array([[keep]]), np.array([1.0]), np.array([slope * (keep - 1.0)]), stiffness + slope
    if damping == 0.0:
        a, b, c = np.zeros((0, 0)), np.zeros(0), np.zeros(0)
    for _ in range(periods):  # one more state in front of all others: what was asked for a period ago
        size = len(a)
        grown = np.zeros((size + 1, size + 1))
        grown[1:, 1:], grown[0, 1:] = a, c
        a, b, c = grown, np.concatenate([[d], b]), np.eye(size + 1)[0]
        d = 0.0
    return Law(a, b, c, d, period_s, lag_s)


@dataclass(frozen=True)
class Certified:
    """A maximum over frequency.

    Attributes
    ----------
    value
        Largest value found.
    upper
        Proven bound: nothing in between reaches it; None where nothing is proven between the points.
    frequency_hz
        Where it is.
    """

    value: float
    upper: float | None
    frequency_hz: float


def needed_damping(law: Law) -> Certified:
    """Return the viscosity [N s/m] that a device needs for the wall to be passive, with its certificate.

    Raises
    ------
    ValueError
        For a law that is not stable, or one with a delay of less than a period: that takes `share_used`.
    """
    if law.lag_s != 0.0:
        raise ValueError("a delay of less than a period makes the hold itself different: use share_used")
    if len(law.a) and not np.abs(np.linalg.eigvals(law.a)).max() < 1.0:
        raise ValueError("the law is not stable by itself")
    half, one = 0.5 * law.period_s, float(law.response(np.ones(1, complex))[0].real)
    # R(z) = -c (z - a)^-1 (1 - a)^-1 b; the sum of R and its mirror image is what is looked at
    inner: Array = np.asarray(np.linalg.solve(np.eye(len(law.a)) - law.a, law.b), np.float64)

    def at(theta: Array) -> Array:
        rest = Law(law.a, inner, -law.c, 0.0, law.period_s).response(np.exp(1j * theta)).real
        out: Array = half * (one - 2.0 * rest)
        return out

    grid = np.linspace(0.0, np.pi, _GRID + 1)
    values = at(grid)
    best = int(np.argmax(values))
    value, theta = _refined(at, grid, best)
    scale = max(abs(value), float(np.abs(values).max()), 1e-300)
    for _ in range(_GRID):
        upper = value + _ABOVE * scale
        crossings = _on_circle(law.a, inner, -law.c, 0.5 * (one - upper / half))
        if not len(crossings):
            break
        # crossed: the maxima lie between the crossings
        edges = np.concatenate([[0.0], crossings, [np.pi]])
        tops = 0.5 * (edges[1:] + edges[:-1])
        at_tops = at(tops)
        highest = int(np.argmax(at_tops))
        if at_tops[highest] <= upper:
            break  # touched by rounding
        value, theta = float(at_tops[highest]), float(tops[highest])
    return Certified(value, upper, theta / (2.0 * np.pi * law.period_s))


def _refined(at: Callable[[Array], Array], grid: Array, best: int) -> tuple[float, float]:
    """Return the maximum near a grid point, and where it is."""
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    minimum = scipy.optimize.minimize_scalar(
        lambda x: -float(at(np.array([x]))[0]), bounds=(low, high), method="bounded", options={"xatol": 1e-12}
    )
    here = float(at(grid[best : best + 1])[0])
    return (-float(minimum.fun), float(minimum.x)) if -minimum.fun > here else (here, float(grid[best]))


def _on_circle(a: Array, b: Array, c: Array, level: float) -> Array:
    """Return the angles at which Re{c (z - a)^-1 b} is `level` on the unit circle, from 0 to pi.

    There the sum of the transfer and its mirror image, less twice the level, is singular: z x = a x + b u,
    y = z (a' y + c' u), c x + b' y - 2 level u = 0, a generalised eigenvalue problem in z.
    """
    n = len(a)
    if n == 0:
        return np.zeros(0)
    left, right = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, 2 * n + 1))
    left[:n, :n], right[:n, :n], right[:n, -1] = np.eye(n), a, b
    left[n : 2 * n, n : 2 * n], left[n : 2 * n, -1], right[n : 2 * n, n : 2 * n] = a.T, c, np.eye(n)
    right[-1, :n], right[-1, n : 2 * n], right[-1, -1] = c, b, -2.0 * level
    size = max(float(np.abs(b).max()), float(np.abs(c).max()), abs(level), 1e-300)
    right[-1] /= size
    pairs = scipy.linalg.eigvals(right, left, homogeneous_eigvals=True)
    up, down = pairs
    close = np.abs(np.abs(up) - np.abs(down)) <= _CIRCLE * (np.abs(up) + np.abs(down))
    real = close & (np.abs(down) > 0.0)
    angles = np.abs(np.angle(up[real] / down[real]))
    return np.unique(angles)


@dataclass(frozen=True)
class Device:
    """What a computer's force acts on, seen at the joints.

    Attributes
    ----------
    direction
        [n], joint torques of a unit force [m/rad]; [1.0] for a device seen at its tip.
    damping
        Maps frequencies [F] rad/s to the Hermitian part of the impedance [F, n, n] N m s/rad.
    command
        Maps frequencies [F] to joint torques per unit of force asked for [F, n]; None where they are
        `direction` at all frequencies.
    """

    direction: Array
    damping: Callable[[Array], Complex]
    command: Callable[[Array], Complex] | None = None

    def mobility(self, omega: Array) -> Array:
        """Return w' B^-1 w at the frequencies, 1/b for a device with the viscosity b at its tip."""
        w = self.direction.astype(complex)
        inner = np.linalg.solve(self.damping(omega), np.broadcast_to(w[:, None], (len(omega), len(w), 1)))
        out: Array = (inner[:, :, 0] @ w.conj()).real
        return out

    def viscosity(self, omega: float) -> float:
        """Return 1/(w' B^-1 w) at a frequency [rad/s]; 0 where a motion that it excites is not damped."""
        values, ways = np.linalg.eigh(self.damping(np.array([omega]))[0])
        share = np.abs(ways.conj().T @ self.direction) ** 2
        moved = share > _UNMOVED * share.sum()
        if (np.abs(values[moved]) <= _UNDAMPED * np.abs(values).max()).any():
            return 0.0
        return float(1.0 / np.sum(share[moved] / values[moved]))


def least_damping(device: Device, lowest: float = 1e-2, highest: float = 1e11) -> tuple[float, float]:
    """Return the least eigenvalue of the damping over all frequencies, and where it is [rad/s].

    Below zero the analog path alone is active: no computer can make the device passive. Looked for on 40
    points a decade, and between them.
    """

    def least(omega: Array) -> Array:
        return np.asarray(np.linalg.eigvalsh(device.damping(omega))[:, 0], np.float64)

    grid = np.geomspace(lowest, highest, 40 * round(math.log10(highest / lowest)) + 1)
    best = int(np.argmin(least(grid)))
    value, place = _refined(lambda x: -least(np.exp(x)), np.log(grid), best)
    return -value, math.exp(place)


def _aliases(omega: float, period: float) -> tuple[Array, Array]:
    """Return frequencies [rad/s] and weights that stand for the sum over all aliases of something smooth."""
    turn = 2.0 * np.pi / period
    n = np.arange(-_ALIASES, _ALIASES + 1)
    # the sum beyond N is the integral from N + 1/2 on, less 1/24 of the slope there (Euler and Maclaurin)
    edges = (_ALIASES + 0.5) * 2.0 ** np.arange(_OCTAVES + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (edges[1:] - edges[:-1])
    far = (middle[:, None] + half[:, None] * _PANEL).ravel()
    weight = (half[:, None] * _PANEL_WEIGHTS).ravel()
    step = 0.01 * edges[0]
    ends = np.array([edges[0] + step, edges[0] - step])
    slope = np.array([1.0, -1.0]) / (2.0 * step) / 24.0
    sides = [(far, weight), (-far, weight), (ends, slope), (-ends, slope)]
    places = np.concatenate([n, *[side[0] for side in sides]])
    weights = np.concatenate([np.ones(len(n)), *[side[1] for side in sides]])
    return omega + turn * places, weights


def _used(law: Law, device: Device, theta: float) -> float:
    """Return the left-hand side of the condition at w = theta/T; below 1 it is passive there."""
    period = law.period_s
    omega, weight = _aliases(theta / period, period)
    over_t = law.response(np.exp(1j * np.array([theta])))[0] / period
    w = device.direction.astype(complex)
    inverse = np.linalg.inv(device.damping(omega))
    seen = inverse @ w  # [F, n]
    d_d = float(np.sum(weight * (seen @ w.conj()).real / omega**2))
    hold = (1.0 - np.exp(-1j * theta)) / (1j * omega)
    if device.command is None and law.lag_s == 0.0:
        # parallel vectors: only |Re S| is left of the root
        return max(float((over_t * (1.0 - np.exp(-1j * theta))).real) * d_d, 0.0)
    path = device.command(omega) if device.command is not None else np.broadcast_to(w, (len(omega), len(w)))
    p = hold[:, None] * path
    a_a = abs(over_t) ** 2 * float(np.sum(weight * np.einsum("fi,fij,fj->f", p.conj(), inverse, p).real))
    cross = np.einsum("i,fij,fj->f", w.conj(), inverse, p) / (1j * omega)
    late = omega * law.lag_s
    if law.lag_s == 0.0:
        s = over_t * np.sum(weight * cross)
    else:
        s = over_t * _turning(cross, late, theta, law.lag_s / period)
    root = max(a_a * d_d - s.imag**2, 0.0)
    return float(0.5 * (math.sqrt(root) - s.real))


def _turning(cross: Complex, late: Array, theta: float, share: float) -> complex:
    """Return the sum over all aliases of cross exp(-j late), which turns by 2 pi share from one to the next.

    Beyond the aliases one by one, `cross` is smooth and read off its panels for some turns; behind those,
    summation by parts: g/(1 - turn), and the same of its differences.
    """
    count = 2 * _ALIASES + 1
    total = complex(np.sum(cross[:count] * np.exp(-1j * late[:count])))
    away = min(share, 1.0 - share)
    last = int(min(max(_TURNS / away, 4 * _ALIASES), _MOST_TERMS))
    panels = cross[count : count + 2 * _OCTAVES * len(_PANEL)].reshape(2, _OCTAVES, len(_PANEL))
    for side, sign in zip(panels, (1.0, -1.0), strict=True):
        turn = np.exp(-2j * np.pi * sign * share)
        n = np.arange(_ALIASES + 1, last + 4)
        octave = np.floor(np.log2(n / (_ALIASES + 0.5))).astype(int)
        smooth = np.empty(len(n), complex)
        for k in range(int(octave[-1]) + 1):
            low = (_ALIASES + 0.5) * 2.0**k
            inside = octave == k
            x = (n[inside] - 1.5 * low) / (0.5 * low)
            smooth[inside] = np.polynomial.legendre.legval(x, _TO_LEGENDRE @ side[k])
        values = smooth[-4:]
        terms = smooth[:-4] * np.exp(-2j * np.pi * sign * share * n[:-4])
        tail, factor = 0.0j, 1.0 / (1.0 - turn)
        for _ in range(3):
            tail += factor * values[0]
            values = np.diff(values)
            factor *= turn / (1.0 - turn)
        start = np.exp(-2j * np.pi * sign * share * n[-4])
        total += np.exp(-1j * theta * share) * complex(np.sum(terms) + start * tail)
    return total


def share_used(law: Law, device: Device, points: int = 96) -> Certified:
    """Return the share of the device's damping that the law uses: passive below 1.

    For a law of stiffness alone it is proportional to it, so stiffness over this share is the largest that is
    passive. The maximum is that of a grid and of a search around its best point.
    """
    grid = np.linspace(0.0, np.pi, points + 1)
    grid[0] = 0.01 * grid[1]

    def at(theta: Array) -> Array:
        return np.array([_used(law, device, float(x)) for x in theta])

    values = at(grid)
    value, theta = _refined(at, grid, int(np.argmax(values)))
    return Certified(value, None, theta / (2.0 * np.pi * law.period_s))
