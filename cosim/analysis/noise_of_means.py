"""How far the noise of the potentiometers moves means over time: their exact covariance in a held contact.

The integrals of outputs are states of their own, z' = C x + D i + E r, so that the map of the common period
of samples and ticks takes them along, and their covariance over many periods follows by doubling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cosim.analysis.covariance_steps import repeated
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.linearise import System, linearise
from cosim.analysis.noise_covariance import beyond_linear, require_linear, static_covariance
from cosim.analysis.noise_period import common_period, noise_grid
from cosim.analysis.period_map import lift
from cosim.scene import PotNoise
from cosim.types import Array

__all__ = ["NoiseOfMeans", "noise_of_means"]


@dataclass(frozen=True)
class NoiseOfMeans:
    """What another path of the noise changes in means over time.

    Attributes
    ----------
    covariance
        [k, k], of the outputs' means, their components in the order asked for, in the products of their
        units (N^2, N m, ...).
    notes
        What a linear system at rest leaves out.
    """

    covariance: Array
    notes: tuple[str, ...]


def noise_of_means(
    at_rest: HeldContact, names: Sequence[str], settled_s: float, span_s: float
) -> NoiseOfMeans:
    """Return the covariance of outputs' means over `span_s` [s], which begin `settled_s` [s] after contact.

    A span that is no multiple of the common period of samples and ticks counts as the nearest one, and the
    covariance is scaled to its length.

    Parameters
    ----------
    at_rest
        Contact at its pose of rest.
    names
        Of `System.outputs`.

    Raises
    ------
    InputError
        Where noise or scene are not linear about rest, with the reason.
    """
    scene = at_rest.scene
    require_linear(scene)
    system = linearise(at_rest)
    if scene.effects.pot_noise is PotNoise.STATIC:
        moments = static_covariance(lift(system, noise=True), scene.device.potentiometer.noise_rad**2)
        rows = np.vstack([moments.rows[name] for name in names])
        return NoiseOfMeans(rows @ moments.state @ rows.T, system.notes)
    grid = noise_grid(scene)
    states, watched = len(system.a), ("penetration", "currents")
    lifted = lift(_with_integrals(system, names), noise=True)
    period = common_period(lifted, grid)
    length = grid.periods * system.period_s
    begun = repeated(period.step, period.added, round(settled_s / length))[1]
    sums = slice(states, lifted.states)
    leave = period.pieces[-1].stretch.exit
    spread = []
    for name in watched:
        out = system.outputs[name]
        row = lifted.output(replace(out, c=_padded(out.c, lifted.states))) @ leave
        spread.append(np.sqrt(np.diag(row @ begun @ row.T).clip(0.0)))
    begun[sums], begun[:, sums] = 0.0, 0.0
    turns = max(1, round(span_s / length))
    power, cover, _ = repeated(period.step, period.added, turns)
    integrals = (power @ begun @ power.T + cover)[sums, sums]
    notes = beyond_linear(at_rest, float(spread[0][0]), spread[1], system.current_a)
    return NoiseOfMeans(integrals / (turns * length) / span_s, (*system.notes, *notes))


def _with_integrals(system: System, names: Sequence[str]) -> System:
    """Return the system with the integrals of outputs as its last states; its outputs stay as they are."""
    outputs = [system.outputs[name] for name in names]
    rates, by_input, by_slope = (np.vstack([getattr(o, part) for o in outputs]) for part in "cde")
    states = len(system.a) + len(rates)
    return replace(
        system,
        a=np.vstack([_padded(system.a, states), _padded(rates, states)]),
        b=np.vstack([system.b, by_input]),
        e=np.vstack([system.e, by_slope]),
    )


def _padded(rows: Array, width: int) -> Array:
    """Return rows with zeros behind them, up to a width."""
    return np.hstack([rows, np.zeros((len(rows), width - rows.shape[1]))])
