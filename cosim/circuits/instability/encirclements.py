"""Poles in the right half plane, counted from driving-point impedances on the imaginary axis.

Ground all ports of a network for signals, one after the other. Each step multiplies its determinant by the
impedance that the port shows while those before it are grounded. The product of all is det Z, and by the
principle of the argument its winding along the imaginary axis counts the poles in the right half plane, as
long as the network with every port grounded has none. Nothing is fitted, no loop has to be known or opened
(Bode, Network Analysis and Feedback Amplifier Design, 1945, ch. 8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cosim.errors import SimulationError
from cosim.types import Array, Complex

__all__ = [
    "HELD_OHM",
    "SWEEP",
    "Impedances",
    "alike",
    "count",
    "independent",
    "measure",
    "pivots",
    "winding",
    "wound",
]

#: Measures the impedance matrix [F, N, N] over a sweep; returns the frequencies [Hz] and the matrix.
Ask = Callable[[str], tuple[Array, Complex]]

#: Far beyond every pole on either side: behind both ends a response is a power of s.
SWEEP = "dec 4 1e-7 1e15"
#: A port that shows less [Ohm] is held by a voltage source; one that keeps less of itself (relative) when
#: the ports before it are grounded is tied to them.
HELD_OHM, _TIED = 1e-13, 1e-9
#: Phase [rad] and level [Np] may change by so much between two points; beyond, the sweep is refined.
_TURN, _BEND = 0.7, 0.7
#: Loops that change by less with the gains have the same poles on the right, but for rounding.
_ALIKE = 0.01
#: Points between two that are too far apart, rounds of doing so, and where rounding of frequency ends it.
_BETWEEN, _ROUNDS, _CLOSE = 4, 24, 1e-9
#: Intervals that a round leaves too wide where rounding speaks, not the network: that turns at every scale.
#: No part behaves as modelled beyond that frequency [Hz], so a sweep may end there; so much below is clear.
_ROUNDING, _NO_PART_HZ, _CLEAR = 300, 1e10, 3.0


@dataclass(frozen=True)
class Impedances:
    """Impedances between ports: `z` [F, N, N] in ohms at `hz` [F], ascending."""

    hz: Array
    z: Complex

    def of(self, ports: list[int]) -> Impedances:
        """Return those between some of the ports, the others left open."""
        return Impedances(self.hz, self.z[:, ports][:, :, ports])

    def up_to(self, hz: float) -> Impedances:
        """Return those at frequencies below `hz`."""
        below = self.hz < hz
        return Impedances(self.hz[below], self.z[below])

    def joined(self, *others: Impedances) -> Impedances:
        """Return all points of several measurements in order, each frequency once."""
        hz, at = np.unique(np.concatenate([self.hz, *(one.hz for one in others)]), return_index=True)
        return Impedances(hz, np.concatenate([self.z, *(one.z for one in others)])[at])


def independent(seen: Impedances) -> list[int]:
    """Return the ports that are neither held by a voltage source nor tied to an earlier port."""
    kept: list[int] = []
    for port in range(seen.z.shape[1]):
        own = np.abs(seen.z[:, port, port])
        if own.max() <= HELD_OHM:
            continue
        left = pivots(seen.of([*kept, port]).z)[:, -1] if kept else seen.z[:, port, port]
        if (np.abs(left) > _TIED * own).any():
            kept.append(port)
    return kept


def pivots(z: Complex) -> Complex:
    """Return what each port shows while those before it are grounded [F, N]: the pivots of elimination."""
    left = z.copy()
    out = np.empty(left.shape[:2], complex)
    for k in range(left.shape[1]):
        out[:, k] = left[:, k, k]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = left[:, k + 1 :, k] / out[:, k, None]
        left[:, k + 1 :, k + 1 :] -= share[:, :, None] * left[:, k, None, k + 1 :]
    return out


def measure(ask: Ask, ports: list[int] | None = None) -> tuple[Impedances, list[int]]:
    """Measure the impedances of ports so closely that no turn of phase is missed.

    Parameters
    ----------
    ask
        Measures over a sweep such as ``dec 10 1 1meg`` or ``lin 4 1 2``.
    ports
        Those that count; the `independent` ones by default.

    Returns
    -------
    Impedances, list of int
        Of all ports, and the ports that count.

    Raises
    ------
    SimulationError
        Where rounding hides the impedances in the band of the parts.
    """
    seen = Impedances(*ask(SWEEP))
    chosen = independent(seen) if ports is None else ports
    for _ in range(_ROUNDS):
        wide = _wide(seen.hz, pivots(seen.of(chosen).z)) if chosen else []
        if not wide:
            break
        if len(wide) > _ROUNDING:
            return _before(seen, float(seen.hz[wide[0]])), chosen
        more = []
        for k in wide:
            low, high = float(seen.hz[k]), float(seen.hz[k + 1])
            step = (high - low) / (_BETWEEN + 1)
            more.append(Impedances(*ask(f"lin {_BETWEEN} {low + step!r} {high - step!r}")))
        seen = seen.joined(*more)
    return seen, chosen


def _before(seen: Impedances, first_hz: float) -> Impedances:
    """Return what was measured clearly below the frequency at which rounding begins."""
    if first_hz < _CLEAR * _NO_PART_HZ:
        raise SimulationError(f"the impedances of the board are lost in rounding at {first_hz:.3g} Hz")
    return seen.up_to(first_hz / _CLEAR)


def _wide(hz: Array, shown: Complex) -> list[int]:
    """Return the intervals in which some phase or level turns too far to be followed."""
    turn = np.abs(np.angle(shown[1:] / shown[:-1]))
    level = np.log(np.abs(shown))
    slope = np.diff(level, axis=0)
    bend = np.abs(np.diff(slope, axis=0))
    far = turn > _TURN
    far[:-1] |= bend > _BEND
    far[1:] |= bend > _BEND
    near = np.diff(hz) <= _CLOSE * hz[1:]
    return np.flatnonzero(far.any(axis=1) & ~near).tolist()


def count(seen: Impedances) -> int:
    """Return how many poles the network has in the right half plane; `seen` as `measure` leaves it."""
    return round(wound(seen))


def wound(seen: Impedances) -> float:
    """Return that number as it is measured: no integer where a sweep ends near to a pole."""
    shown = pivots(seen.z)
    return sum(winding(seen.hz, shown[:, k]) for k in range(shown.shape[1]))


def winding(hz: Array, h: Complex) -> float:
    """Return the poles less the zeros of a response in the right half plane, from its values at j w.

    At both ends it is taken to be a power of s, c s^k: its phase beyond them is known from its slope.
    """
    turned = np.angle(h[1:] / h[:-1]).sum()
    level, w = np.log(np.abs(h)), np.log(hz)
    low, high = ((level[k + 1] - level[k]) / (w[k + 1] - w[k]) for k in (0, -2))
    return float(turned - 0.5 * np.pi * (high - low)) / np.pi


def alike(first: Impedances, second: Impedances) -> bool:
    """Whether ports show the same in two states of a network: then no loop passes what was changed."""
    _, at, there = np.intersect1d(first.hz, second.hz, return_indices=True)
    ratio = pivots(first.z)[at] / pivots(second.z)[there]
    return bool((np.abs(ratio - 1.0) < _ALIKE).all())
