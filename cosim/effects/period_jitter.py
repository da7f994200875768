"""Samples come early or late, as under an operating system that is busy with something else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.loop.noise import stream
from cosim.scene import Scene

__all__ = ["PERIOD_JITTER", "lateness"]

#: Samples come early or late by less than half a period, so that they keep their order.
_LATEST = 0.45


def lateness(kind: str, seed: int, ticks: int, share: float) -> NDArray[np.float64]:
    """By how much of a period each sample comes late; [ticks]. The first, at power-up, comes in time.

    Parameters
    ----------
    kind
        'uniform' (`share` is half the width) or 'normal' (its standard deviation, cut
        off at `_LATEST`: a value beyond is drawn again)
    """
    random = stream(seed, f"period_jitter/{kind}", 0)
    late = np.zeros(ticks)
    if kind == "uniform":
        late[1:] = share * (2.0 * random.random(ticks - 1) - 1.0)
        return late
    missing = np.arange(1, ticks)
    while len(missing):
        late[missing] = share * random.standard_normal(len(missing))
        missing = missing[np.abs(late[missing]) > _LATEST]
    return late


def _size(scene: Scene, constants: Stated) -> Size:
    late = scene.computer.jitter_share * scene.computer.period_s
    return Size(late, "s", scale(scene, constants).of_delay(late), "early or late", "k v dt")


def _cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, 0, "intervals of ever new length: their maps are made anew in ideal and linear")


def _pack(state: np.void, scene: Scene) -> NDArray[np.float64]:
    """Draw by how much each sample comes early or late [s]."""
    share, kind = scene.computer.jitter_share, scene.effects.period_jitter.value
    if share == 0.0:
        return np.zeros(0)
    late = scene.computer.period_s * lateness(kind, scene.seed, int(state["clock"]["last_tick"]) + 1, share)
    state["clock"]["jitter"] = late.ctypes.data  # `cosim.loop.events.instant` adds it
    return late


PERIOD_JITTER = Effect(
    "period_jitter", "none", ("uniform", "normal"), "computer", ALL,
    size=_size, cost=_cost, keys=("computer.jitter_share",), pack=_pack, fresh_intervals=True,
    not_held="the jitter of the sampling instants",
    not_exported="the clocks of an exported deck tick evenly",
)  # fmt: skip
