"""How far the output of a part goes: what its file states, or what a `.dc` sweep of it alone shows.

A vendor's model states no limit, yet its output stops some volts before the supplies. The part stands alone
on a bench between the supplies of the board, lightly loaded, its input driven far beyond what it amplifies.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cosim.circuits.cache import load_arrays, store_arrays
from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.operating_point import AtRest
from cosim.errors import CosimError
from cosim.ngspice.deck import Deck
from cosim.ngspice.netlist import Block, Netlist, parse
from cosim.ngspice.simulator import Simulator

__all__ = ["Swing", "SwingFrom", "swings"]

#: Load of the bench [Ohm]: what data sheets take for the output swing of a small op-amp.
_LOAD_OHM = 10e3
#: Reach of the sweep [V]: an op-amp's input, and a multiplier's second input with 10 V at its first.
_REACH_V = {"opamp": 1.0, "driver": 1.0, "vca": 2.0 * SUPPLY_V}
_STEPS = 20
#: An output that moves less than this [V] is not driven by what was taken for the inputs.
_DEAD_V = 0.5


class SwingFrom(StrEnum):
    """Where an output limit is known from."""

    STATED = "stated"
    MEASURED = "measured"
    SUPPLIES = "supplies"
    """The model goes beyond its supplies, which the real part does not."""


@dataclass(frozen=True)
class Swing:
    """Output limit of a part [V], of either sign, and where it is known from."""

    limit_v: float
    source: SwingFrom


def swings(simulator: Simulator, board: Deck) -> dict[str, Swing]:
    """Return the output limits of the amplifiers whose parts state none, by instance path.

    One is missing where it cannot be measured. A deck of its own is loaded for each such part.
    """
    measured: dict[str, Swing | None] = {}
    by_node: dict[str, Swing] = {}
    stated = board.text.lower()
    wanted = [
        a for a in board.amplifiers if a.swing_param is None or f".csparam {a.swing_param}" not in stated
    ]
    if wanted:
        net = parse(board.lines[1:])
        wired = dict(_instances(net, net.blocks[board.board], "xboard", {pin: pin for pin in board.pins}))
        for a in wanted:
            if a.part not in measured:
                measured[a.part] = _measured(simulator, board, a.part, a.role or "", wired.get(a.path))
            swing = measured[a.part]
            if swing is not None:
                by_node[a.path] = swing
    return by_node


def _instances(
    net: Netlist, block: Block, path: str, nets: dict[str, str]
) -> Iterator[tuple[str, tuple[Block, dict[str, str]]]]:
    """Walk all instances below a block: path, definition, and the outer net at each of its pins."""
    for instance in block.instances():
        child = net.blocks.get(instance.block)
        if child is not None:
            here = f"{path}.{instance.name}"
            outer = [
                nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}") for node in instance.nodes
            ]
            inner = dict(zip(child.pins, outer, strict=False))
            yield here, (child, inner)
            yield from _instances(net, child, here, inner)


def _measured(
    simulator: Simulator, board: Deck, part: str, role: str, wired: tuple[Block, dict[str, str]] | None
) -> Swing | None:
    """Measure a part alone, or take what is known of the same deck and part."""
    reach = _REACH_V.get(role)
    out = next((known.out for known in board.parts if known.name == part), None)
    if reach is None or wired is None or out is None:
        return None
    block, nets = wired
    inputs = [pin for pin in block.pins if pin != out and nets.get(pin) not in ("vcc", "vee")]
    if role == "vca":
        inputs = [pin for pin in inputs if nets.get(pin) != "0"]
    if len(inputs) < 2 or not {"vcc", "vee"} <= set(nets.values()):
        return None
    swept = inputs[1] if role == "vca" else inputs[0]
    at = {pin: nets[pin] if nets.get(pin) in ("vcc", "vee") else "0" for pin in block.pins}
    at |= {out: "swing_out", swept: "swing_in"}
    if role == "vca":
        at[inputs[0]] = "swing_x"
    bench = [
        f"Vcc vcc 0 {SUPPLY_V}",
        f"Vee vee 0 {-SUPPLY_V}",
        "Vswing swing_in 0 0",
        "Vswingx swing_x 0 10",
        f"Xswing {' '.join(at[pin] for pin in block.pins)} {block.name}",
        f"Rswing swing_out 0 {_LOAD_OHM!r}",
        ".save v(swing_out)",
    ]
    name = hashlib.sha256("\n".join(["swing 2", board.text, *bench]).encode()).hexdigest()
    known = load_arrays(name)
    if known is None:
        known = {}, {"limits": np.array(_limits(simulator, board, bench, reach))}
        store_arrays(name, *known)
    low, high = (float(limit) for limit in known[1]["limits"])
    if not min(-low, high) > _DEAD_V:
        return None
    beyond = min(-low, high) > SUPPLY_V
    return Swing(min(-low, high, SUPPLY_V), SwingFrom.SUPPLIES if beyond else SwingFrom.MEASURED)


def _limits(simulator: Simulator, board: Deck, bench: list[str], reach: float) -> tuple[float, float]:
    """Return the lowest and the highest output [V]; zeros where no sweep converges."""
    rows = ["cosim swing", *board.text.splitlines()[1:], *bench]
    seen, file = [0.0], str(board.path)
    try:
        alone = AtRest(
            simulator, lambda more: simulator.load("\n".join([*rows, *more, ".end\n"]), board.lines, file)
        )
        for end in (reach, -reach):
            alone.analyse(f"dc vswing 0 {end!r} {end / _STEPS!r}")
            seen += np.asarray(simulator.vector("swing_out"), float).tolist()
            simulator.command("destroy all")
    except CosimError:  # nothing is claimed of a part that does not work alone
        return 0.0, 0.0
    return min(seen), max(seen)
