"""A watch within a run on ngspice: outputs that hang at their limit while the device stands still.

An output that latches later in a run, or an operating point that time integration has left, is no error of
the simulation, and no check before the run can see it. The watch only records the pins; whether these command
that output is judged after the run (`cosim.stability_gate`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.circuits.decks import AT_LIMIT, AT_SUPPLY, MOST_NODES, REST_RAD_PER_S, SUPPLY_V, Drive
from cosim.errors import CosimError
from cosim.ngspice.simulator import Simulator
from mech.compiled import inner

__all__ = ["begin", "hung", "operating_point", "watch"]

#: Shortest time at the limit [s] that is no transient, and how long after the last jump of the DACs, as a
#: share of the period, the pins count as quiet.
_WAIT_S, _QUIET = 0.02, 0.4


def begin(state: np.void, nodes: Sequence[str], limits: Mapping[str, float], period_s: float) -> None:
    """Set from which voltage on each output may hang; without a stated limit by the supply."""
    bounds = [AT_LIMIT * limits[node] if node in limits else AT_SUPPLY * SUPPLY_V for node in nodes]
    state["hang"]["limit"][:MOST_NODES] = math.inf
    state["hang"]["limit"][: len(nodes)] = bounds
    state["hang"]["wait"], state["hang"]["quiet"] = max(period_s, _WAIT_S), _QUIET * period_s


@inner
def watch(s: Any, i: int, value: float, t: float) -> None:
    """Note the pins at the first moment at which output `i` has hung long enough; called at every point."""
    moving = False
    for j in range(s.n):
        moving = moving or abs(s.v[j]) > REST_RAD_PER_S
    if moving or abs(value) < s.hang.limit[i]:
        s.hang.start[i] = t
    elif s.hang.volts[i] == 0.0 and t - s.hang.start[i] >= s.hang.wait:
        if t - max(s.dac.start[0], s.dac.start[1]) >= s.hang.quiet:
            s.hang.volts[i], s.hang.since[i] = value, s.hang.start[i]
            for k in range(len(s.out)):
                s.hang.pins[i, k] = s.out[k]


def hung(state: np.void, nodes: Sequence[str], circuit: Drive) -> list[dict[str, Any]]:
    """Return 'node', 'volts', 'since_s' and 'pins' [V] of every output that hung at its limit for a while."""
    return [
        {
            "node": node,
            "volts": float(state["hang"]["volts"][i]),
            "since_s": float(state["hang"]["since"][i]),
            "pins": dict(zip(circuit.sources(), state["hang"]["pins"][i].tolist(), strict=False)),
        }
        for i, node in enumerate(nodes)
        if state["hang"]["volts"][i] != 0.0
    ]


def operating_point(simulator: Simulator, pins: Sequence[float], nodes: Sequence[str]) -> dict[str, float]:
    """Return the volts of `nodes` at the operating point of the run's own deck with its pins held.

    Empty where Newton's method finds none: the run itself has come to its end.
    """
    held = {f"v{k:02d}": float(volts) for k, volts in enumerate(pins)}
    try:
        simulator.attach(source=lambda name, t: held.get(name, 0.0))
        simulator.command("op")
        return {node: float(simulator.vector(node)[-1]) for node in nodes}
    except CosimError:
        return {}
