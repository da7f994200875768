"""The common period of samples and noise, after which both repeat together: a linear scene's map over it.

The noise of potentiometers is what a run draws (`cosim.loop.noise`): independent values on a grid, linear
between its ticks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from cosim.analysis.covariance_steps import repeated
from cosim.analysis.period_map import Lifted, Stretch
from cosim.scene import PotNoise, Scene
from cosim.types import Array

__all__ = ["CommonPeriod", "Grid", "Piece", "common_period", "noise_grid"]


#: Samples and ticks must coincide again within this many of the longer of both.
_MOST_TURNS = 64


@dataclass(frozen=True)
class Grid:
    """Independent values on a grid, linear between them.

    Attributes
    ----------
    variance
        [rad^2] of the values at the ticks.
    periods, ticks
        So many sampling periods are so many spacings of the grid.
    shift
        Relative change of the spacing that this takes; 0 where they meet exactly.
    """

    variance: float
    periods: int
    ticks: int
    shift: float


def noise_grid(scene: Scene) -> Grid:
    """Return the grid of the scene's potentiometer noise, of kind white or peak_to_peak."""
    pot, period = scene.device.potentiometer, scene.computer.period_s
    # linear interpolation keeps two thirds of the mean square; `noise_rad` is the rms in between for white
    white = scene.effects.pot_noise is PotNoise.WHITE
    variance = pot.noise_rad**2 * (1.5 if white else 1.0 / 12.0)
    ratio = Fraction(2.0 * pot.noise_bandwidth_hz) * Fraction(period)
    turns = math.ceil(_MOST_TURNS * max(1.0, 1.0 / float(ratio)))
    near = ratio.limit_denominator(turns)
    return Grid(variance, near.denominator, near.numerator, abs(float(near / ratio) - 1.0))


@dataclass(frozen=True)
class Piece:
    """An event, then a stretch of time, `count` times; `fresh` where the noise gets a new value."""

    event: Array
    fresh: bool
    stretch: Stretch
    count: int


def _pieces(lifted: Lifted, grid: Grid) -> Iterator[Piece]:
    """Walk through the common period, from the first sample to just before the sample behind it."""
    assert lifted.noise is not None
    period = lifted.system.period_s
    spacing = grid.periods * period / grid.ticks
    last, following = lifted.noise
    tick = np.eye(lifted.size)
    tick[last] = np.eye(lifted.size)[following]
    tick[following] = 0.0
    instants = lifted.instants()
    close = 1e-9 * min(period, spacing)
    for number in range(grid.periods):
        for start, end in zip(instants, [*instants[1:], period], strict=True):
            base = number * period
            index = math.floor((base + start + close) / spacing)  # of the last tick
            event = lifted.at(start)
            fresh = abs(index * spacing - base - start) <= close
            if fresh:
                event = event @ tick
            now = start
            while True:
                following_tick = (index + 1) * spacing - base
                to = following_tick if following_tick < end - close else end
                place = (base + now) / spacing - index, (base + to) / spacing - index
                noise = max(place[0], 0.0), min(place[1], 1.0)
                count = 1
                if event is tick and not lifted.ramping(now):
                    count = max(1, math.floor((end - now + close) / spacing))
                if count > 1:
                    to, noise = now + spacing, (0.0, 1.0)
                yield Piece(event, fresh, lifted.stretch(now, to - now, noise), count)
                index += count
                now = index * spacing - base if to != end else end
                if now >= end - close:
                    break
                event, fresh = tick, True


@dataclass(frozen=True)
class CommonPeriod:
    """The period after which samples and ticks repeat together, for X = (x, samples, DACs, noise).

    Attributes
    ----------
    pieces
        Its events and stretches.
    steps
        Of each piece, done once: map of X, and what noise adds to its covariance.
    step, added
        The same of the whole, from just before a sample to just before one.
    draw
        Covariance of X behind a tick from the tick's new value alone.
    """

    pieces: tuple[Piece, ...]
    steps: tuple[tuple[Array, Array], ...]
    step: Array
    added: Array
    draw: Array


def common_period(lifted: Lifted, grid: Grid) -> CommonPeriod:
    """Return the common period of a scene lifted with noise."""
    assert lifted.noise is not None
    size = lifted.size
    pieces = tuple(_pieces(lifted, grid))
    draw = np.zeros((size, size))
    draw[lifted.noise[1], lifted.noise[1]] = grid.variance * np.eye(lifted.system.joints)
    steps = []
    product, added = np.eye(size), np.zeros((size, size))
    for piece in pieces:
        leave = piece.stretch.leave
        step, more = leave @ piece.event, leave @ draw @ leave.T if piece.fresh else np.zeros((size, size))
        steps.append((step, more))
        if piece.count > 1:
            step, more, _ = repeated(step, more, piece.count)
        added = step @ added @ step.T + more
        product = step @ product
    return CommonPeriod(pieces, tuple(steps), product, added, draw)
