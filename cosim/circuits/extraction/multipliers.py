"""Which probes of a board belong to which gain pin: found by what moves when a pin is driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cosim.circuits.extraction.probes import Probe
from cosim.types import Complex

__all__ = ["LOW_HZ", "Multiplier", "find_multipliers"]


#: Smaller responses count as zero [V/V]: parasitic paths of macro-models are far below, working paths above.
_NONE = 1e-6
#: Where wiring is identified and DC gains are read [Hz]: below every pole that matters, above rounding.
LOW_HZ = (1e-5, 1e-4)
_ONCE = f"lin 1 {LOW_HZ[1]} {LOW_HZ[1]}"
#: Of the two ends of a driven source, one stays below the first, the other is above the second [V/V].
_STILL, _MOVED = 1e-3, 0.5


@dataclass(frozen=True)
class Multiplier:
    """The probes of one multiplier.

    Attributes
    ----------
    channel
        Its gain pin.
    x, z
        Names of the sources in series with X and (if there is one) Z.
    x_node, z_node
        Nodes behind them, as the multiplier sees them.
    """

    channel: str
    x: str
    x_node: str
    z: str | None
    z_node: str | None


class Responding(Protocol):
    """What is asked: the response of nodes to sources of given amplitudes."""

    def respond(self, source: str | Mapping[str, float], sweep: str, nodes: Sequence[str]) -> Complex:
        """Return [F, len(nodes)]."""
        ...


def find_multipliers(
    board: Responding, probes: Sequence[Probe], channels: Sequence[str], signals: Sequence[Sequence[str]]
) -> list[Multiplier]:
    """Return the multipliers in the order of their gain pins, or none where some pin has none with probes.

    Parameters
    ----------
    board
        A session with every gain pin at 0 V.
    probes
        All 0 V sources.
    channels
        Gain pins.
    signals
        Pins that reach the multipliers' X inputs, in sets that are driven together.
    """
    groups: dict[str, list[Probe]] = {}
    for probe in probes:
        groups.setdefault(probe.group, []).append(probe)
    groups = {path: members for path, members in groups.items() if len(members) > 1}
    if not groups:
        return []
    nodes = list(dict.fromkeys(probe.nodes[1] for members in groups.values() for probe in members))
    pin_of = _controlled(board, nodes, channels)
    shaken = np.zeros(len(nodes))
    for together in signals:
        shaken += np.abs(board.respond(dict.fromkeys(together, 1.0), _ONCE, nodes)[0])
    from_signals = {node for node, size in zip(nodes, shaken, strict=True) if size > 0.0}
    cores: dict[str, tuple[Probe, Probe | None]] = {}
    for members in groups.values():
        control = [probe for probe in members if probe.nodes[1] in pin_of]
        if len(control) != 1 or (pin := pin_of[control[0].nodes[1]]) is None or pin in cores:
            continue
        rest = [probe for probe in members if probe is not control[0]]
        driven = [probe for probe in rest if probe.nodes[1] in from_signals]
        if len(driven) != 1 or len(rest) > 2:
            continue
        cores[pin] = driven[0], next((probe for probe in rest if probe is not driven[0]), None)
    if len(cores) < len(channels):
        return []
    behind = _behind(board, [x for x, _ in cores.values()])
    behind |= _behind(board, [z for _, z in cores.values() if z is not None])
    return [
        Multiplier(pin, x.source, behind[x.source], z.source if z else None, behind[z.source] if z else None)
        for pin, (x, z) in ((pin, cores[pin]) for pin in channels)
    ]


def _controlled(board: Responding, nodes: Sequence[str], channels: Sequence[str]) -> dict[str, str | None]:
    """Return the nodes that gain pins move, each with its pin, or ``None`` where it has several.

    Half of the pins are driven at a time: those with a certain bit in their number, then those without.
    """
    bits = max(len(channels) - 1, 1).bit_length()
    number = np.zeros(len(nodes), int)
    some, unclear = np.zeros(len(nodes), bool), np.zeros(len(nodes), bool)
    for bit in range(bits):
        seen = []
        for value in (0, 1):
            half = {pin: 1.0 for k, pin in enumerate(channels) if k >> bit & 1 == value}
            moved = np.abs(board.respond(half, _ONCE, nodes)[0]) if half else np.zeros(len(nodes))
            seen.append(moved > _NONE)
        number |= seen[1].astype(int) << bit
        some |= seen[0] | seen[1]
        unclear |= seen[0] == seen[1]
    return {
        node: None if unclear[k] or number[k] >= len(channels) else channels[number[k]]
        for k, node in enumerate(nodes)
        if some[k]
    }


def _behind(board: Responding, probes: Sequence[Probe]) -> dict[str, str]:
    """Return the end of each probe that follows when it is driven; what stands before holds the other."""
    if not probes:
        return {}
    ends = [node for probe in probes for node in probe.nodes]
    moved = np.abs(board.respond({probe.source: 1.0 for probe in probes}, _ONCE, ends)[0]).reshape(-1, 2)
    names = {}
    for probe, both in zip(probes, moved, strict=True):
        if min(both) > _STILL or max(both) < _MOVED:  # another probe moves it as well: alone, then
            both = np.abs(board.respond({probe.source: 1.0}, _ONCE, list(probe.nodes))[0])
        names[probe.source] = probe.nodes[int(np.argmax(both))]
    return names
