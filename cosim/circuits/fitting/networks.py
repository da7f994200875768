"""The networks before and after the multipliers: measured paths in, state space out, part by part.

A part is a group of inputs and outputs that share nothing with the others, such as all that hangs on one
joint's potentiometer: it has poles of its own and is fitted and reduced alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.circuits.fitting.rational_fit import WORST, FitError, Modes, fit
from cosim.circuits.fitting.reduction import Bound, error_bound, path_scale, reduce
from cosim.errors import InputError, Problem
from cosim.types import Array, Complex
from cosim.units import quantity

__all__ = ["ROUNDING", "Block", "fit_block"]


#: A path below this share of the strongest one to the same output is rounding.
ROUNDING = 1e-13


@dataclass(frozen=True)
class Block:
    """A network in parts.

    Attributes
    ----------
    shape
        Outputs and inputs.
    places
        Outputs and inputs of each part.
    parts
        State space of each part; parts that are built alike share it.
    """

    shape: tuple[int, int]
    places: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    parts: tuple[Modes, ...]

    def joined(self) -> Modes:
        """Return one state space of all parts."""
        rows, columns = self.shape
        b, c, d, error = (
            [np.zeros((0, columns))],
            [np.zeros((rows, 0))],
            np.zeros(self.shape),
            np.zeros(self.shape),
        )
        for (outputs, inputs), part in zip(self.places, self.parts, strict=True):
            d[np.ix_(outputs, inputs)], error[np.ix_(outputs, inputs)] = part.d, part.error
            into, out = np.zeros((len(part.a), columns)), np.zeros((rows, len(part.a)))
            into[:, list(inputs)], out[list(outputs)] = part.b, part.c
            b.append(into)
            c.append(out)
        return Modes(
            scipy.linalg.block_diag(np.zeros((0, 0)), *[part.a for part in self.parts]),
            np.concatenate(b),
            np.concatenate(c, axis=1),
            d,
            np.concatenate([np.empty(0, complex), *[part.poles for part in self.parts]]),
            tuple(size for part in self.parts for size in part.blocks),
            error,
        )

    def reduced(self, omega: float, tolerance: float) -> tuple[Block, Bound]:
        """Return the block with every part at its lowest order, see `reduce`, and the bound of every path."""
        upper, lower, parts = np.zeros(self.shape), np.zeros(self.shape), []
        known: dict[int, tuple[Modes, Bound]] = {}
        for (outputs, inputs), part in zip(self.places, self.parts, strict=True):
            if id(part) not in known:
                known[id(part)] = reduce(part, omega, tolerance)
            small, bound = known[id(part)]
            parts.append(small)
            upper[np.ix_(outputs, inputs)], lower[np.ix_(outputs, inputs)] = bound.upper, bound.lower
        return replace(self, parts=tuple(parts)), Bound(upper, lower)

    def static_error(self, omega: float, static: Array, slope: Array) -> Bound:
        """Bound how far the block is from `static + s * slope` up to `omega` [rad/s]."""
        upper, lower = np.zeros(self.shape), np.zeros(self.shape)
        for (outputs, inputs), part in zip(self.places, self.parts, strict=True):
            at = np.ix_(outputs, inputs)
            none = Modes(
                np.zeros((0, 0)), np.zeros((0, len(inputs))), np.zeros((len(outputs), 0)), static[at],
                np.empty(0, complex), (), part.error,
            )  # fmt: skip
            bound = error_bound(part, none, omega, path_scale(part, omega), slope[at])
            upper[at], lower[at] = bound.upper, bound.lower
        return Bound(upper, lower)


def fit_block(s: Complex, h: Complex, where: str, file: str, worst: float = WORST) -> Block:
    """Fit the paths [F, outputs, inputs] of a block, each part alone, to an error of at most `worst`.

    Raises
    ------
    InputError
        For a pole in the right half plane, or responses that no rational function fits.
    """
    peak = np.abs(h).max(axis=0)
    linked = (peak > ROUNDING * peak.max(axis=1, keepdims=True)) & (peak > 0.0)
    places = _groups(linked)
    parts: list[Modes] = []
    measured: list[Complex] = []
    for rows, columns in places:
        here = np.where(linked[np.ix_(rows, columns)], h[:, list(rows)][:, :, list(columns)], 0.0)
        same = next((k for k, other in enumerate(measured) if _equal(here, other)), None)
        try:
            parts.append(fit(s, here, worst) if same is None else parts[same])
        except FitError as reason:
            raise InputError(_problem(reason, where, file)) from reason
        measured.append(here)
    return Block((h.shape[1], h.shape[2]), places, tuple(parts))


def _equal(first: Complex, second: Complex) -> bool:
    """Whether two parts are the same but for rounding: joints often are built alike."""
    if first.shape != second.shape:
        return False
    return bool((np.abs(first - second).max(axis=0) <= ROUNDING * np.abs(second).max(axis=0)).all())


def _groups(linked: NDArray[np.bool_]) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]:
    """Split a table of which input reaches which output into parts that share neither."""
    groups = []
    left = set(np.flatnonzero(linked.any(axis=1)).tolist())
    while left:
        rows, columns = {min(left)}, set[int]()
        size = 0
        while size != len(rows) + len(columns):
            size = len(rows) + len(columns)
            columns |= set(np.flatnonzero(linked[sorted(rows)].any(axis=0)).tolist())
            rows |= set(np.flatnonzero(linked[:, sorted(columns)].any(axis=1)).tolist())
        left -= rows
        groups.append((tuple(sorted(rows)), tuple(sorted(columns))))
    return tuple(groups)


def _problem(reason: FitError, where: str, file: str) -> Problem:
    if reason.poles is None:
        return Problem(
            f"no `linear` model of the paths {where}: {reason}; a run can take the model `spice`", file=file
        )
    worst = reason.poles[np.argmax(reason.poles.real)]
    shown = f"{worst.real:.4g}" + (f" +- {worst.imag:.4g}j" if worst.imag else "")
    return Problem(
        f"the board is unstable: {where} there is a pole at {shown} rad/s "
        f"({quantity(abs(worst) / (2.0 * np.pi), 'Hz', 4)}); look for a loop with positive feedback",
        file=file,
    )
