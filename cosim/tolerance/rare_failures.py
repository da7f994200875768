"""Failures that plain samples never show: found on the cheap model, counted by importance sampling.

All variables are independent standard normals u. The places of the failure region that are nearest to the
design are searched from many sides (first-order reliability: Rackwitz and Fiessler, Computers and Structures
9, 489, 1978); samples come from a mixture of unit normals about all of them, and a share about the design, so
that no weight exceeds its inverse. One place alone is wrong for a curved region or for two of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.types import Array

__all__ = [
    "Places", "RareEstimate", "failure_estimate", "importance_points", "nearest_failures",
]  # fmt: skip

#: Standard normals (n, variables) -> margin (n,): a device fails where it is negative.
Margin = Callable[[Array], Array]

#: Share of the samples about the design.
_DEFENSIVE = 0.1
#: Inflation of the draws from which failures are looked for, and how many.
_WIDE, _STARTS = (1.0, 2.0, 3.0, 4.0, 6.0), 512
_STEPS, _STEP = 30, 1e-4
#: Shares of a step that are tried at once.
_LENGTHS = np.array([1.0, 0.7, 0.4, 0.2, 0.1, 0.03])
_HALVINGS = 30
#: Anything farther from the design than this counts as impossible.
_FARTHEST = 9.0
#: Places nearer to each other than this are one.
_SAME = 0.3
#: Places farther than the nearest by this much add less than 1e-3 of its failures.
_FARTHER = 1.5
_MOST = 64
#: With fewer effective failures the estimate's spread is unknown.
_FEWEST = 2.0


@dataclass(frozen=True)
class Places:
    """Where a device fails first.

    Attributes
    ----------
    at
        [K, variables], standard normals.
    evaluations
        Of the cheap model.
    """

    at: Array
    evaluations: int

    @property
    def distance(self) -> float:
        """Distance of the nearest one, in standard deviations; infinite where nothing fails."""
        return float(np.linalg.norm(self.at, axis=1).min()) if len(self.at) else math.inf

    @property
    def nearest(self) -> Array:
        """The nearest place (variables)."""
        return np.asarray(self.at[np.linalg.norm(self.at, axis=1).argmin()])

    @property
    def first_order(self) -> float:
        """Failure rate if the region were a half space behind the nearest place."""
        return float(scipy.special.ndtr(-self.distance))


@dataclass(frozen=True)
class RareEstimate:
    """A failure rate.

    Attributes
    ----------
    rate, error
        Estimate, and its standard error.
    effective
        Effective number of failing samples: (sum w)^2 / sum w^2.
    samples
        Dear samples.
    word
        What to know of it, if anything.
    """

    rate: float
    error: float
    effective: float
    samples: int
    word: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """Its 95 % interval, of the logarithm, since weights lean to one side.

        With less than two effective failures it is what the samples about the design leave.
        """
        if self.effective < _FEWEST:
            return 0.0, min(3.0 / (_DEFENSIVE * self.samples), 1.0) if self.samples else 1.0
        freedom = max(self.effective - 1.0, 0.1)
        reach = float(scipy.stats.t.ppf(0.975, freedom)) * self.error / self.rate
        return self.rate * math.exp(-min(reach, 700.0)), min(self.rate * math.exp(min(reach, 700.0)), 1.0)


def nearest_failures(
    margin: Margin,
    variables: int,
    *,
    seed: int = 0,
    most: int = _MOST,
    starts: int = _STARTS,
    begin: Array | None = None,
) -> Places:
    """Search the cheap model for the places where it fails first.

    From points that fail under inflated draws each search follows the margin's slope to the nearest point at
    which it is zero: steps of Hasofer, Lind, Rackwitz and Fiessler, each as long as lowers a merit of
    distance and margin most (Zhang and Der Kiureghian, Reliability and Optimization of Structural Systems,
    297, 1995), since where distributions end the slopes fade and whole steps go astray.

    Parameters
    ----------
    most
        Searches, each of which takes some slopes of all variables.
    starts
        Draws of each inflation that failures are looked for in.
    begin
        [K, variables], points that fail, in place of the draws.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    count, failing = 0, np.empty((0, variables)) if begin is None else _at_the_border(margin, begin)
    low = np.empty((0, variables))
    for wide in _WIDE if begin is None else ():
        drawn = wide * rng.standard_normal((starts, variables))
        values = margin(drawn)
        failures = drawn[values < 0.0]
        count += len(drawn)
        failing = np.concatenate([failing, failures[: most // 2]])
        low = np.concatenate([low, drawn[np.argsort(values)[:1]]])
        if len(failing) >= most:
            break
    # where few fail, or none, slopes from the design and from what came nearest may still lead there
    u = failing[:most]
    if len(u) < most and begin is None:
        u = np.concatenate([u, np.zeros((1, variables)), low])
    arrived = np.empty((0, variables))
    for _ in range(_STEPS):
        value, slope = _slope(margin, u)
        count += len(u) * (variables + 1 + len(_LENGTHS))
        size = np.maximum((slope**2).sum(axis=1), 1e-300)
        wanted = ((slope * u).sum(axis=1) - value)[:, None] * slope / size[:, None]
        far = np.linalg.norm(wanted, axis=1, keepdims=True) / _FARTHEST
        step = wanted / np.maximum(far, 1.0) - u
        # the step lowers this merit for any weight of the margin above |u| / |slope|
        weight = 2.0 * np.maximum(np.linalg.norm(u, axis=1), 1.0) / np.sqrt(size)
        tried = u[:, None, :] + _LENGTHS[:, None] * step[:, None, :]
        margins = margin(tried.reshape(-1, variables)).reshape(len(u), -1)
        merit = 0.5 * (tried**2).sum(axis=2) + weight[:, None] * np.abs(margins)
        best = np.argmin(merit, axis=1)
        lower = merit.min(axis=1) < 0.5 * (u**2).sum(axis=1) + weight * np.abs(value)
        moving = lower & (np.linalg.norm(step, axis=1) > 1e-3)
        arrived = np.concatenate([arrived, u[~moving]])
        u = tried[np.arange(len(u)), best][moving]
        if not len(u):
            break
    u = np.concatenate([arrived, u])
    u = _apart(u[np.isfinite(u).all(axis=1)], math.inf)
    value, slope = _slope(margin, u)
    scale = np.linalg.norm(slope, axis=1) * np.maximum(np.linalg.norm(u, axis=1), 1.0)
    count += len(u) * (variables + 1)
    kept = u[np.abs(value) < 0.05 * scale]
    if not len(kept):  # no slope leads to a failure: take the failing draws themselves, the nearest first
        kept = failing[np.argsort(np.linalg.norm(failing, axis=1))][:most]
    return Places(_apart(kept), count)


def _at_the_border(margin: Margin, u: Array) -> Array:
    """Return where the ways from the design to failing points meet the border."""
    inside, outside = np.zeros((len(u), 1)), np.ones((len(u), 1))
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        fails = margin(middle * u)[:, None] < 0.0
        inside, outside = np.where(fails, inside, middle), np.where(fails, middle, outside)
    return np.asarray(outside * u)


def _slope(margin: Margin, u: Array) -> tuple[Array, Array]:
    """Return the margin and its gradient [n, variables] by differences."""
    n, d = u.shape
    moved = u[:, None, :] + np.concatenate([np.zeros((1, d)), _STEP * np.eye(d)])
    values = margin(moved.reshape(-1, d)).reshape(n, d + 1)
    return values[:, 0], (values[:, 1:] - values[:, :1]) / _STEP


def _apart(u: Array, farther: float = _FARTHER) -> Array:
    """Return the places that matter, the nearest first, without duplicates."""
    kept: list[Array] = []
    for place in u[np.argsort(np.linalg.norm(u, axis=1))]:
        if kept and np.linalg.norm(place) > np.linalg.norm(kept[0]) + farther:
            break
        if all(np.linalg.norm(place - other) > _SAME for other in kept):
            kept.append(place)
    return np.array(kept).reshape(len(kept), u.shape[1])


def _mixture(places: Places) -> tuple[Array, Array]:
    """Return weights and centres of the normals that samples come from: the design, then the places."""
    share = np.exp(-0.5 * ((places.at**2).sum(axis=1) - places.distance**2))
    share *= (1.0 - _DEFENSIVE) / share.sum()
    centres = np.concatenate([np.zeros((1, places.at.shape[1])), places.at])
    return np.concatenate([[_DEFENSIVE], share]), centres


def importance_points(places: Places, samples: int, seed: int) -> Array:
    """Return points about the places (samples, variables): each gets its share, what is left by chance."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    weights, centres = _mixture(places)
    exact = weights * samples
    numbers = np.floor(exact).astype(int)
    left = exact - numbers
    if samples > numbers.sum():
        more = rng.choice(len(weights), samples - numbers.sum(), replace=False, p=left / left.sum())
        numbers[more] += 1
    points = np.repeat(centres, numbers, axis=0) + rng.standard_normal((samples, centres.shape[1]))
    return np.asarray(points)


def failure_estimate(places: Places, u: Array, failed: NDArray[np.bool_]) -> RareEstimate:
    """Return the failure rate from which of the points of `importance_points` failed on the dear model."""
    samples = len(u)
    weights, centres = _mixture(places)
    # log of phi(u) / phi(u - c) = c (c / 2 - u)
    ratio = -(u @ centres.T - 0.5 * (centres**2).sum(axis=1))
    weight = np.where(failed, np.exp(-scipy.special.logsumexp(-ratio, b=weights, axis=1)), 0.0)
    rate = float(weight.mean())
    error = float(weight.std(ddof=1) / math.sqrt(samples))
    share = weight / max(weight.max(), np.finfo(float).tiny)  # squares of far failures would underflow
    effective = float(share.sum() ** 2 / (share**2).sum()) if share.any() else 0.0
    word = ""
    if failed.any() and not share.any():
        word = "all failing samples lie so far out that no double holds their weight"
    elif not failed.any():
        word = "no sample of the dear model fails where the cheap one does: the two disagree there"
    elif effective < 10.0:
        word = f"only {effective:.1f} effective failing samples: believe no more than the order of magnitude"
    return RareEstimate(rate, error, effective, samples, word)
