"""Paths of a held contact's deviations under noise, drawn: for what is not linear in noise, as peaks and rms.

The vectors drawn have the exact covariance of the linear model (`cosim.analysis.noise_covariance`), its
beginning included: the noise moves nothing before the contact is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.analysis.held_contact import HeldContact
from cosim.analysis.linearise import linearise
from cosim.analysis.noise_period import Grid, Piece, common_period, noise_grid
from cosim.analysis.period_map import Lifted, lift
from cosim.scene import PotNoise
from cosim.types import Array

__all__ = ["PLACES", "WEIGHTS", "Drawn", "drawn"]

#: Places within a stretch without events, and weights of the integral over it: the ends for peaks, and the
#: squares of Gauss's nodes, dense behind the event, where what it has kicked dies away.
_NODES, _SHARES = np.polynomial.legendre.leggauss(4)
PLACES = np.concatenate([[0.0], (0.5 * (1.0 + _NODES)) ** 2, [1.0]])
WEIGHTS = np.concatenate([[0.0], 0.5 * (1.0 + _NODES) * _SHARES, [0.0]])


@dataclass(frozen=True)
class Drawn:
    """Deviations over one stretch without events.

    Attributes
    ----------
    begin_s, length_s
        Time since the run's start, and length.
    values
        [places, outputs, paths], at `PLACES` of the stretch, in the outputs' units.
    """

    begin_s: float
    length_s: float
    values: Array


def drawn(
    at_rest: HeldContact, names: Sequence[str], begin_s: float, end_s: float, paths: int, seed: int
) -> Iterator[Drawn]:
    """Yield deviations of outputs from where a contact is made to the run's end, stretch by stretch.

    Parameters
    ----------
    at_rest
        Contact at its pose of rest, in a scene whose noise is linear (`require_linear`).
    names
        Of `System.outputs`; their components in this order.
    begin_s
        Of the sample that makes the contact, since the run's start.
    """
    scene = at_rest.scene
    lifted = lift(linearise(at_rest), noise=True)
    assert lifted.noise is not None
    static = scene.effects.pot_noise is PotNoise.STATIC
    grid = Grid(scene.device.potentiometer.noise_rad**2, 1, 1, 0.0) if static else noise_grid(scene)
    pieces = [piece for piece in common_period(lifted, grid).pieces for _ in range(piece.count)]
    rows = np.vstack([lifted.output(lifted.system.outputs[name]) for name in names])
    count, (last, following) = len(PLACES) * len(rows), lifted.noise
    stepped = {id(piece): _stepped(lifted, piece, rows, following) for piece in pieces}
    tick = _tick(scene.effects.pot_noise, grid, (lifted.system.joints, paths), seed)
    state = np.zeros((lifted.size, paths))
    state[last], state[following] = tick(), tick()
    turn = sum(piece.stretch.length_s for piece in pieces)
    now = begin_s - begin_s % turn if turn - begin_s % turn > 1e-9 * turn else begin_s
    while now < end_s * (1.0 - 1e-12):
        for piece in pieces:
            length = piece.stretch.length_s
            if now > begin_s - 0.5 * length:
                kept, fresh = stepped[id(piece)]
                moved = kept @ state
                if piece.fresh:
                    moved += fresh @ tick()
                yield Drawn(now, length, moved[:count].reshape(len(PLACES), len(rows), paths))
                state = moved[count:]
            now += length


def _stepped(lifted: Lifted, piece: Piece, rows: Array, following: slice) -> tuple[Array, Array]:
    """Return what takes X before a piece's event to the outputs at `PLACES` and to X at its end.

    The second matrix does it for the noise's new value at the event, which replaces the older one.
    """
    enter, h = piece.stretch.enter, piece.stretch.length_s
    seen = [rows @ enter, *(rows @ lifted.step(place * h) @ enter for place in PLACES[1:])]
    after, event = np.vstack([*seen, piece.stretch.leave]), piece.event.copy()
    if piece.fresh:
        event[following] = 0.0
    return after @ event, after[:, following]


def _tick(kind: PotNoise, grid: Grid, shape: tuple[int, int], seed: int) -> Callable[[], Array]:
    """Return what draws the noise at a tick, [joints, paths] rad, as a run's noise is distributed."""
    draws, size = np.random.default_rng(seed), np.sqrt(grid.variance)
    if kind is PotNoise.STATIC:
        offset = size * draws.standard_normal(shape)
        return lambda: offset
    if kind is PotNoise.WHITE:
        return lambda: size * draws.standard_normal(shape)
    half = np.sqrt(3.0) * size  # uniform
    return lambda: draws.uniform(-half, half, shape)
