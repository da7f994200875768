"""What is drawn by us: one seeded stream a source, the same in every circuit model.

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
#: Places between two points at which a curve's largest value is looked for.
_PER_POINT = 16
#: A linearity error is drawn for a turn either way; a calibration holds wherever a scene's joints may be.
_TURN_RAD, _FARTHEST_RAD = 2.0 * np.pi, 100.0


@dataclass(frozen=True)
class Noise:
    """What the potentiometers add to the angles [rad].

    Attributes
    ----------
    grid : [ticks, n] values at multiples of `dt`, empty without grid noise
    dt : s, spacing of the grid (0 without)
    table : [points, n] values over angle, empty without position noise; a cubic between them
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
        table, knots = _over_angle(streams, period_rad, span_rad)
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


def _over_angle(
    streams: list[np.random.Generator], period_rad: float, span_rad: float
) -> tuple[NDArray[np.float64], int]:
    """Draw a smooth function of the angle from -span to +span with unit rms for each stream.

    Returns the table [points, n], spaced by period / `_POINTS_PER_PERIOD`, and the draws of each stream.
    """
    knots = int(np.ceil(2 * span_rad / period_rad)) + 4
    fine = (knots - 3) * _POINTS_PER_PERIOD
    values = np.column_stack([g.standard_normal(knots) for g in streams])
    at = np.arange(fine + 1) / _POINTS_PER_PERIOD + 1.0
    base = np.minimum(at.astype(int), knots - 3)
    x = (at - base)[:, None]
    # cosine blend: unit mean square at and between the knots
    table = np.cos(np.pi / 2 * x) * values[base] + np.sin(np.pi / 2 * x) * values[base + 1]
    return table, knots


def with_errors(
    noise: Noise, seed: int, *, linearity_rad: float, period_rad: float, gain_error: float, zero_rad: float
) -> Noise:
    """Add the potentiometers' errors that belong to the angle to their noise.

    Parameters
    ----------
    linearity_rad, period_rad
        Largest linearity error within a turn either way and the angle over which it varies, drawn for each
        joint from a stream of its own.
    gain_error, zero_rad
        Calibration: (1 + gain_error) q + zero_rad is shown for q.

    Returns
    -------
    Noise
        The same object when every error is zero. Values of the noise's own table are kept at its points.
    """
    joints = noise.grid.shape[1]
    lo, step, table, draws = noise.lo, noise.step, noise.table, noise.draws
    if linearity_rad > 0.0:
        streams = [stream(seed, "potentiometer/linearity", j) for j in range(joints)]
        curve, knots = _over_angle(streams, period_rad, _TURN_RAD)
        turn = int(np.ceil(2 * _TURN_RAD / period_rad * _POINTS_PER_PERIOD)) + 1
        within = np.linspace(0.0, turn - 1.0, _PER_POINT * (turn - 1) + 1)
        curve *= linearity_rad / np.abs(_values(within, 0.0, 1.0, curve)).max(axis=0)
        lo, step, table = _sum(lo, step, table, -_TURN_RAD, period_rad / _POINTS_PER_PERIOD, curve)
        draws += knots * joints
    if gain_error != 0.0 or zero_rad != 0.0:
        ends = np.array([[-_FARTHEST_RAD], [_FARTHEST_RAD]])
        line = np.repeat(gain_error * ends + zero_rad, joints, axis=1)
        lo, step, table = _sum(lo, step, table, -_FARTHEST_RAD, 2 * _FARTHEST_RAD, line)
    return noise if table is noise.table else Noise(noise.grid, noise.dt, table, lo, step, draws)


def _sum(
    lo: float, step: float, table: NDArray[np.float64], other_lo: float, other_step: float,
    other: NDArray[np.float64],
) -> tuple[float, float, NDArray[np.float64]]:  # fmt: skip
    """Add two functions of the angle, each a cubic between its points and constant beyond them.

    The sum stands at the points of the finer one, continued over the span of both.
    """
    if not len(table):
        return other_lo, other_step, other
    fine_lo, fine = (lo, step) if step <= other_step else (other_lo, other_step)
    first = min(lo, other_lo)
    last = max(lo + (len(table) - 1) * step, other_lo + (len(other) - 1) * other_step)
    before = int(np.ceil((fine_lo - first) / fine - 1e-9))
    points = np.arange(-before, int(np.ceil((last - fine_lo) / fine - 1e-9)) + 1)
    at: NDArray[np.float64] = np.asarray(fine_lo + fine * points, np.float64)
    total = _values(at, lo, step, table) + _values(at, other_lo, other_step, other)
    return float(at[0]), fine, total


def _values(
    angle: NDArray[np.float64], lo: float, step: float, table: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what a table [points, n] that begins at `lo` says at angles [rad].

    The cubics are those of `cosim.loop.pin_voltages.position_noise`.
    """
    x = np.clip((angle - lo) / step, 0.0, len(table) - 1.0)
    i = np.minimum(x.astype(int), len(table) - 2)
    x = (x - i)[:, None]
    slope = np.gradient(table, axis=0)
    left, right, rise = table[i], table[i + 1], table[i + 1] - table[i]
    bent = x * (1.0 - x) * ((1.0 - x) * (slope[i] - rise) - x * (slope[i + 1] - rise))
    return np.asarray((1.0 - x) * left + x * right + bent, np.float64)
