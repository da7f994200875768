"""Signals between their rows: means, peaks and shares that do not depend on how dense the rows are.

A signal is a cubic between two rows, with its slope where that is known, else with that of the parabola
through three rows; a straight line where noise bends it at rows. It is smooth between changes of the DACs;
over the step that a jump begins it has its value at the end, as the integrator takes it. Where a signal
settles faster than rows follow, a parabola would overshoot: of two neighbours the much flatter one is taken,
as essentially non-oscillatory schemes do (Harten, Engquist, Osher and Chakravarthy, 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cosim.types import Array

__all__ = ["Spans", "Trace", "changes", "together"]


#: Share of a DAC's largest voltage that rounding may move it by at the end of a ramp: an ulp of 10 s is 2e-10
#: of a ramp of 10 us. The least step of 30 bits is 1.9e-9 of the range.
_SAME = 1e-9

#: From this ratio of their curvatures on, the flatter one of two neighbouring parabolas is taken. A smooth
#: signal has 1, one that decays by half a row 2.
_MUCH_FLATTER = 4.0

#: Gauss-Legendre of four points: exact for the square of a cubic.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def changes(dacs: Sequence[Array], rows: int) -> NDArray[np.bool_]:
    """Return for each of the `rows` - 1 steps whether a DAC changes over it by more than rounding.

    At the end of its ramp a DAC misses its final value by what an ulp of time makes: that is no change, and
    the kink is at the ramp's end.
    """
    changed = np.zeros(max(rows - 1, 0), bool)
    for volts in dacs:
        held = np.asarray(volts)
        changed |= np.abs(np.diff(held)) > _SAME * np.abs(held).max(initial=0.0)
    return changed


def _each_once(times: Array) -> Array:
    """Return times ascending, without repetition; `np.unique` would load masked arrays for it."""
    ascending = np.sort(times)
    return np.asarray(ascending[np.append(True, ascending[1:] != ascending[:-1])], np.float64)


@dataclass(frozen=True)
class Spans:
    """Times [s] at which something begins and ends, ascending; [k] each."""

    begin: Array
    end: Array

    @property
    def length(self) -> float:
        """Sum of their lengths [s]."""
        return float(np.sum(self.end - self.begin))


def together(parts: Sequence[Spans]) -> Spans:
    """Return the union of several spans."""
    begin = np.concatenate([part.begin for part in parts])
    end = np.concatenate([part.end for part in parts])
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], end[order]
    reached = np.maximum.accumulate(end) if len(end) else end
    first = np.append(True, begin[1:] > reached[:-1]) if len(end) else np.zeros(0, bool)
    last = np.append(first[1:], True) if len(end) else first
    return Spans(begin[first], reached[last])


@dataclass(frozen=True)
class Cubics:
    """A cubic for every step between rows; `scipy.interpolate` has it too, at half a second for its import.

    `t` [R] are the rows' times [s]; `c` [4, R - 1] the coefficients, of the highest power first, of the time
    since the step began.
    """

    t: Array
    c: Array

    def __call__(self, t: Array | float) -> Array:
        """Return values at times [s]; beyond the rows those of the first or last cubic."""
        x, step = self._within(t)
        a, b, c, d = self.c[:, step]
        return np.asarray(((a * x + b) * x + c) * x + d)

    def rate(self, t: Array) -> Array:
        """Return rates of change at times [s]."""
        x, step = self._within(t)
        a, b, c, _ = self.c[:, step]
        return np.asarray((3.0 * a * x + 2.0 * b) * x + c)

    def integral(self, t: Array | float) -> Array:
        """Return integrals from the first row to times [s]."""
        a, b, c, d = self.c
        h = np.diff(self.t)
        begun = np.append(0.0, np.cumsum((((a / 4.0 * h + b / 3.0) * h + c / 2.0) * h + d) * h))
        x, step = self._within(t)
        a, b, c, d = self.c[:, step]
        return np.asarray(begun[step] + (((a / 4.0 * x + b / 3.0) * x + c / 2.0) * x + d) * x)

    def crossings(self, level: float) -> Array:
        """Return ascending times [s] at which the cubics cross a value; none in a step that stays at it."""
        h = np.diff(self.t)
        a, b, c, d = self.c * np.array([h**3, h**2, h, np.ones(len(h))])
        d = d - level
        # a cubic lies within the hull of its Bernstein coefficients: most steps cannot cross
        hull = np.array([d, d + c / 3.0, d + (2.0 * c + b) / 3.0, a + b + c + d])
        inside = np.flatnonzero((hull.min(axis=0) <= 0.0) & (hull.max(axis=0) >= 0.0))
        step, x = _roots(np.array([a, b, c, d])[:, inside])
        here = np.abs(x - 0.5) <= 0.5 + 1e-12
        step = inside[step[here]]
        return np.sort(self.t[step] + np.clip(x[here], 0.0, 1.0) * h[step])

    def _within(self, t: Array | float) -> tuple[Array, NDArray[np.intp]]:
        """Return for each time [s] the time since its step began, and the step."""
        step = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.c.shape[1] - 1)
        return np.asarray(t) - self.t[step], step


def _roots(c: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the real roots of many cubics c [4, N], each with the number of its cubic."""
    leading = np.abs(c) > 1e-14 * np.abs(c).max(axis=0, initial=0.0)
    degree = np.where(leading[:3].any(axis=0), 3 - leading[:3].argmax(axis=0), 0)
    step: list[NDArray[np.intp]] = [np.zeros(0, np.intp)]
    x: list[Array] = [np.zeros(0)]
    for n in (1, 2, 3):
        at = np.flatnonzero(degree == n)
        monic = c[4 - n :, at] / c[3 - n, at]
        companion = np.zeros((len(at), n, n))
        companion[:, 0] = -monic.T
        companion[:, range(1, n), range(n - 1)] = 1.0
        values = np.linalg.eigvals(companion)
        cubic, root = np.nonzero(np.abs(values.imag) <= 1e-9)
        step.append(at[cubic])
        x.append(np.asarray(values.real[cubic, root], float))
    return np.concatenate(step), np.concatenate(x)


class Trace:
    """One signal over its rows.

    Parameters
    ----------
    t
        [R] times [s], rising; between rows of one time there is a jump.
    y
        [R] values.
    jumped
        [R - 1] whether a jump begins the step between two rows.
    kinks
        [R] whether the signal has a kink at a row, so that no parabola fits across.
    slope
        [R] rate of change, where it is known; the signal may not jump then.
    bent
        Whether it is straight between rows and bends at any of them.
    """

    def __init__(
        self, t: Array, y: Array, jumped: NDArray[np.bool_], *, kinks: NDArray[np.bool_] | None = None,
        slope: Array | None = None, bent: bool = False,
    ) -> None:  # fmt: skip
        t = np.array(t, float)
        instant = np.diff(t) <= 0.0
        for row in np.flatnonzero(instant) + 1:
            t[row] = np.nextafter(t[row - 1], np.inf)
        self.t, self.y = t, np.asarray(y, float)
        self._jumped = jumped | instant
        self._slope = None if slope is None else np.asarray(slope, float)
        self._bent = bent
        self._kinks = np.zeros(len(t), bool) if kinks is None else kinks

    @cached_property
    def cubics(self) -> Cubics:
        """The piecewise cubic; of one row a constant over no time."""
        t, y = self.t, self.y
        if len(t) < 2:
            return Cubics(np.array([t[-1], t[-1] + 1.0]), np.array([[0.0], [0.0], [0.0], [float(y[-1])]]))
        h = np.diff(t)
        if self._slope is not None:
            first, last, left, right = y[:-1], y[1:], self._slope[:-1], self._slope[1:]
        else:
            left, right = self._slopes()
            first = np.where(self._jumped, y[1:], y[:-1])
            last = y[1:]
        rise = (last - first) / h
        c = np.array([(left + right - 2 * rise) / h**2, (3 * rise - 2 * left - right) / h, left, first])
        return Cubics(t, c)

    def _slopes(self) -> tuple[Array, Array]:
        """Return slopes at both ends of every step, of parabolas through the row and its neighbours."""
        t, y, jumped = self.t, self.y, self._jumped
        h, rise = np.diff(t), np.diff(y) / np.diff(t)
        rise = np.where(jumped, 0.0, rise)
        if self._bent:
            return rise, rise
        middle = np.zeros(len(t))  # at rows inside a smooth piece
        middle[1:-1] = (h[1:] * rise[:-1] + h[:-1] * rise[1:]) / (h[1:] + h[:-1])
        left, right = middle[:-1].copy(), middle[1:].copy()
        kink = self._kinks[1:-1]
        curved = np.zeros(len(t))  # of the parabola about each row; half the second derivative
        curved[1:-1] = np.diff(rise) / (h[1:] + h[:-1])
        inside = np.append(False, np.append(~(jumped[:-1] | jumped[1:] | kink), False))
        both = inside[:-1] & inside[1:]
        before, after = np.abs(curved[:-1]), np.abs(curved[1:])
        left = np.where(both & (before > _MUCH_FLATTER * after), rise - h * curved[1:], left)
        right = np.where(both & (after > _MUCH_FLATTER * before), rise + h * curved[:-1], right)
        begins = np.append(True, jumped[:-1] | kink)  # no smooth step before this one
        ends = np.append(jumped[1:] | kink, True)
        # at the ends of a piece the parabola of the neighbouring row, or the straight line of a lonely step
        left[begins] = (2.0 * rise - right)[begins]
        right[ends & ~begins] = (2.0 * rise - left)[ends & ~begins]
        lonely = begins & ends
        left[lonely] = right[lonely] = rise[lonely]
        left[jumped] = right[jumped] = 0.0
        return left, right

    def mean(self) -> float:
        """Mean over time; the value where there is no time."""
        span = float(self.t[-1] - self.t[0])
        return float(self.cubics.integral(self.t[-1])) / span if span > 0.0 else float(self.y[-1])

    def cut(self, begin: float, end: float) -> Trace:
        """Return the part between two times [s]."""
        inside = np.flatnonzero((self.t > begin) & (self.t < end))
        t = np.concatenate([[begin], self.t[inside], [end]])
        y = np.concatenate([[float(self.cubics(begin))], self.y[inside], [float(self.cubics(end))]])
        # by where a piece begins: the middle of a jump's step, one number long, rounds to either end of it
        step = np.clip(np.searchsorted(self.t, t[:-1], side="right") - 1, 0, len(self._jumped) - 1)
        rates = None if self._slope is None else self.cubics.rate(t)
        kinks = np.concatenate([[False], self._kinks[inside], [False]])
        return Trace(t, y, self._jumped[step], kinks=kinks, slope=rates, bent=self._bent)

    def mean_over(self, spans: Spans) -> float:
        """Mean over spans of time; not a number over none."""
        integral = self.cubics.integral
        total = float(np.sum(integral(spans.end) - integral(spans.begin)))
        return total / spans.length if spans.length > 0.0 else float("nan")

    def mean_square(self) -> float:
        """Mean of the square over time."""
        h = np.diff(self.t)
        span = float(self.t[-1] - self.t[0])
        if not span > 0.0:
            return float(self.y[-1]) ** 2
        total = 0.0
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            x = 0.5 * h * (1.0 + node)
            c = self.cubics.c
            value = ((c[0] * x + c[1]) * x + c[2]) * x + c[3]
            total += 0.5 * float(weight) * float(np.sum(h * value**2))
        return total / span

    def peak(self, spans: Spans | None = None) -> float:
        """Return the largest value, of rows and of smooth tops between them; within `spans` if given."""
        best = float(self.y.max()) if spans is None else -np.inf
        at, value = self._tops()
        if spans is not None:
            ends = self.cubics(np.concatenate([spans.begin, spans.end]))
            at, value = np.concatenate([at, self.t]), np.concatenate([value, self.y])
            place = np.searchsorted(spans.begin, at, side="right") - 1
            value = value[(place >= 0) & (at <= spans.end[np.maximum(place, 0)])]
            best = float(np.max(ends, initial=-np.inf))
        return max(best, float(np.max(value, initial=-np.inf)))

    def _tops(self) -> tuple[Array, Array]:
        """Return times and values of the tops of the cubics between their rows.

        Two rows that stand level, as at a limit, have no top between them unless their slopes are known.
        """
        if self._bent or len(self.t) < 2:
            return np.zeros(0), np.zeros(0)
        bend, turn, rate, value = self.cubics.c
        h = np.diff(self.t)
        falls = rate + h * (2.0 * turn + 3.0 * h * bend) < 0.0
        level = (self.y[1:] == self.y[:-1]) if self._slope is None else np.zeros(len(h), bool)
        inner = np.flatnonzero((rate > 0.0) & falls & ~self._jumped & ~level)
        bend, turn, rate = bend[inner], turn[inner], rate[inner]
        x = rate / (np.sqrt(turn * turn - 3.0 * bend * rate) - turn)
        return self.t[inner] + x, value[inner] + x * (rate + x * (turn + x * bend))

    def above(self, level: float) -> Spans:
        """Return the spans of time in which the signal is above a level."""
        if len(self.t) < 2:
            return Spans(np.zeros(0), np.zeros(0))
        crossed = self.cubics.crossings(level)
        edges = _each_once(np.concatenate([[self.t[0]], crossed, self.t[:-1][self._jumped], [self.t[-1]]]))
        high = self.cubics(0.5 * (edges[:-1] + edges[1:])) > level
        start = high & ~np.append(False, high[:-1])
        stop = high & ~np.append(high[1:], False)
        return Spans(edges[:-1][start], edges[1:][stop])
