"""Potentiometer noise, drawn by us: one seeded stream a source, the same in every circuit model.

The streams are keyed by (seed, source, joint), so that adding a source never changes another's values. Grid
noise is linear between ticks of the grid; each tick is landed on by the step control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Linear interpolation between independent values keeps two thirds of their mean square.
_INTERPOLATED_RMS = np.sqrt(2.0 / 3.0)
#: Points of the table of position noise in one period.
_POINTS_PER_PERIOD = 64


@dataclass(frozen=True)
class Noise:
    """What the potentiometers add to the angles [rad].

    Attributes
    ----------
    grid : [ticks, n] values at multiples of `dt`, empty without grid noise
    dt : s, spacing of the grid (0 without)
    table : [points, n] values over angle, empty without position noise
    lo, step : rad, first angle and spacing of the table
    draws : how many random numbers were drawn
    """

    grid: NDArray[np.float64]
    dt: float
    table: NDArray[np.float64]
    lo: float
    step: float
    draws: int


def stream(seed: int, source: str, joint: int) -> np.random.Generator:
    """Random generator of one source: independent of every other and of the order of asking."""
    words = [seed & 0xFFFFFFFF, seed >> 32, *source.encode(), joint]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(words)))


def no_noise(joints: int) -> Noise:
    """Return the null form: nothing drawn, nothing to land on."""
    empty = np.zeros((0, joints))
    return Noise(empty, 0.0, empty, 0.0, 0.0, 0)


def potentiometer_noise(
    kind: str,
    joints: int,
    seed: int,
    duration_s: float,
    noise_rad: float,
    bandwidth_hz: float,
    period_rad: float,
    span_rad: float,
) -> Noise:
    """Noise of the potentiometers in the four readings of the paper's 0.006 rad.

    Parameters
    ----------
    kind : 'none', 'white' (`noise_rad` is the rms up to `bandwidth_hz`), 'peak_to_peak' (uniform, `noise_rad`
        wide, redrawn at the grid), 'static' (one offset, standard deviation `noise_rad`), 'position' (a fixed
        function of the angle with rms `noise_rad` and correlation length `period_rad`)
    span_rad : angles from -span to +span are covered by the position noise

    Returns
    -------
    Noise
        Grid kinds are sampled at twice the bandwidth.
    """
    if kind == "none":
        return no_noise(joints)
    streams = [stream(seed, f"potentiometer/{kind}", j) for j in range(joints)]
    empty = np.zeros((0, joints))
    if kind == "static":
        offsets = np.array([g.standard_normal() * noise_rad for g in streams])
        return Noise(empty, 0.0, np.vstack([offsets, offsets]), -span_rad, 2 * span_rad, joints)
    if kind == "position":
        knots = int(np.ceil(2 * span_rad / period_rad)) + 4
        fine = (knots - 3) * _POINTS_PER_PERIOD
        values = np.column_stack([g.standard_normal(knots) for g in streams])
        at = np.arange(fine + 1) / _POINTS_PER_PERIOD + 1.0
        base = np.minimum(at.astype(int), knots - 3)
        x = (at - base)[:, None]
        # cosine blend: unit mean square at and between the knots
        table = np.cos(np.pi / 2 * x) * values[base] + np.sin(np.pi / 2 * x) * values[base + 1]
        return Noise(
            empty, 0.0, noise_rad * table, -span_rad, period_rad / _POINTS_PER_PERIOD, knots * joints
        )
    dt = 1.0 / (2.0 * bandwidth_hz)
    ticks = int(np.ceil(duration_s / dt)) + 2
    if kind == "white":
        values = np.column_stack([g.standard_normal(ticks) for g in streams])
        grid = values * (noise_rad / _INTERPOLATED_RMS)
    else:
        grid = np.column_stack([(g.random(ticks) - 0.5) * noise_rad for g in streams])
    return Noise(grid, dt, empty, 0.0, 0.0, ticks * joints)
