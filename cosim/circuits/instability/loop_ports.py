"""Places on a board that together see every loop: with all of them grounded nothing can oscillate.

A loop needs gain, and gain comes from active elements. For a part of the shelf its output is enough; of an
active element that a board or a part of its own brings along, all nodes that it touches. The ends of
inductors come first: a tank resonates on while an amplifier's output is grounded, so that there its pole and
the zero beside it are too near to each other to be seen.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist, element_nodes, parse

__all__ = ["Port", "loop_ports"]

#: Nodes of an element by its letter: what it drives and what it listens to.
_NODES = {"f": 2, "h": 2, "q": 3, "j": 3, "m": 4, "z": 3, "s": 4, "w": 2, "u": 3, "t": 4}
_VOLTAGE = re.compile(r"\bv\(\s*([^\s,()]+)\s*(?:,\s*([^\s,()]+)\s*)?\)")


@dataclass(frozen=True)
class Port:
    """A node of the board at which a loop passes.

    Attributes
    ----------
    node
        ngspice's name.
    owner
        Instance path of the amplifier or element that touches it; an inductor only where nothing else does.
    active
        Whether the owner is no inductor.
    resonant
        Whether an inductor ends here.
    """

    node: str
    owner: str
    active: bool = True
    resonant: bool = False


def loop_ports(board: Deck, inside: Collection[str] = ()) -> list[Port]:
    """Return one port for each node.

    Parameters
    ----------
    board
        The flat deck.
    inside
        Paths of amplifiers whose output is held by a voltage source, where no current shows anything: all
        nodes that the active elements inside them touch take its place.
    """
    ports = _Walk(board, inside).ports.values()
    return sorted(ports, key=lambda port: not port.resonant)


class _Walk:
    """One pass through the instances of a flat deck."""

    def __init__(self, board: Deck, inside: Collection[str]) -> None:
        self.net: Netlist = parse(board.lines[1:])
        self.amplifiers = {a.path: a for a in board.amplifiers if a.path not in inside}
        #: What closes no loop whatever is connected to it.
        self.passive = {part.name for part in board.parts if part.role in ("motor", "potentiometer")}
        self.fixed = {"0", "vcc", "vee"}
        self.ports: dict[str, Port] = {}
        self._block(self.net.blocks[board.board], "xboard", {pin: pin for pin in board.pins})

    def _block(self, block: Block, path: str, nets: Mapping[str, str], quiet: bool = False) -> None:
        def named(node: str) -> str:
            return nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}")

        depth = 0
        for index, line in enumerate(block.body):
            depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
            if depth or line.keyword.startswith((".", "*")) or not line.text.strip():
                continue
            if line.keyword.startswith("x"):
                self._instance(Instance.of(line, index), path, named)
            elif line.keyword.startswith("l"):
                for node in tokens(line.text.lower())[1:3]:
                    self._add(named(node), f"{path}.{line.keyword}", inductor=True)
            elif not quiet:
                owner = f"{path}.{line.keyword}"
                for node in map(named, _touched(line)):
                    self._add(node, owner)

    def _instance(self, instance: Instance, path: str, named: Callable[[str], str]) -> None:
        here, child = f"{path}.{instance.name}", self.net.blocks.get(instance.block)
        nodes = [named(node) for node in instance.nodes]
        known = self.amplifiers.get(here)
        if known is not None:
            self._add(known.out_node, here)
        elif child is None:  # defined inside a vendor's model: its pins are all that can be reached
            for node in nodes:
                self._add(node, here)
        else:
            quiet = child.name.partition("__")[0] in self.passive
            self._block(child, here, dict(zip(child.pins, nodes, strict=False)), quiet)

    def _add(self, node: str, owner: str, inductor: bool = False) -> None:
        if node in self.fixed:
            return
        known = self.ports.get(node)
        if known is None:
            self.ports[node] = Port(node, owner, not inductor, inductor)
        elif inductor:
            self.ports[node] = replace(known, resonant=True)
        elif not known.active:
            self.ports[node] = Port(node, owner, resonant=True)


def _touched(line: Line) -> list[str]:
    """Return the nodes of an active element in lower case; none for a passive one."""
    words = [word.lower() for word in tokens(line.text)]
    kind = words[0][0]
    if kind in "beg":
        spoken = [node for pair in _VOLTAGE.findall(line.text.lower()) for node in pair if node]
        return [*(words[1:3] if kind == "b" else element_nodes(line)), *spoken]
    return words[1 : 1 + _NODES.get(kind, 0)]
