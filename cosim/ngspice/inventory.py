"""What a board holds: its amplifiers by the names that ngspice gives their outputs, and its reactances."""

from dataclasses import dataclass

from cosim.errors import fail
from cosim.ngspice.lines import tokens
from cosim.ngspice.netlist import Block, Netlist
from cosim.ngspice.parts import Shelf

__all__ = ["Amplifier", "amplifiers", "declared", "global_nodes", "reactances"]


@dataclass(frozen=True)
class Amplifier:
    """An amplifier inside the board, for headroom figures.

    Attributes
    ----------
    path
        Instance path, for example ``xboard.xsum1.xop``.
    part, role
        Name and role of the part.
    out_node
        Name that ngspice gives its output node; a pin of the board has the net's name, taken to be the pin's.
    swing_param
        Name of the deck's parameter (readable as ``const.<name>`` if it is a ``.csparam``) with the output
        limit [V], or ``None`` if the part states none.
    supplies
        Nodes at its pins ``vcc`` and ``vee``, named as `out_node`; empty where the part has no such pins.
    """

    path: str
    part: str
    role: str | None
    out_node: str
    swing_param: str | None
    supplies: tuple[str, str] = ("", "")


def amplifiers(net: Netlist, board: Block, shelf: Shelf) -> list[Amplifier]:
    """Walk the instances and list the amplifiers with the names ngspice gives their outputs."""
    every: list[Amplifier] = []

    def walk(block: Block, path: str, nets: dict[str, str]) -> None:
        for instance in block.instances():
            if instance.block not in net.blocks:
                continue  # defined inside a vendor's model
            child = net.blocks[instance.block]
            names = [
                nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}") for node in instance.nodes
            ]
            inner = dict(zip(child.pins, names, strict=True))
            here = f"{path}.{instance.name}"
            part = shelf.used.get(child.origin)
            if part is not None and part.out is not None:
                if part.out not in inner:
                    fail(f"part {part.name} has no pin {part.out}", file=child.header.file, key="out")
                supplies = inner.get("vcc", ""), inner.get("vee", "")
                every.append(Amplifier(here, part.name, part.role, inner[part.out], part.swing, supplies))
            elif part is None:
                walk(child, here, inner)

    walk(board, "xboard", {pin: pin for pin in board.pins} | global_nodes(net))
    return every


def reactances(net: Netlist, block: Block) -> int:
    """Count the capacitors and inductors of a subcircuit and of all it instantiates."""
    known: dict[str, int] = {}

    def count(block: Block) -> int:
        if block.name not in known:
            own = sum(line.keyword[0] in "cl" for line in block.body)
            inside = (net.blocks[each.block] for each in block.instances() if each.block in net.blocks)
            known[block.name] = own + sum(map(count, inside))
        return known[block.name]

    return count(block)


def declared(net: Netlist, board: Block) -> list[str]:
    """Return the paths of the outermost instances that are declared not to be stable."""
    known: dict[str, bool] = {}

    def holds(block: Block) -> bool:
        if block.name not in known:
            known[block.name] = bool(block.stability) or any(holds(child) for _, child in inside(block))
        return known[block.name]

    def inside(block: Block) -> list[tuple[str, Block]]:
        return [(x.name, net.blocks[x.block]) for x in block.instances() if x.block in net.blocks]

    def walk(block: Block, path: str) -> list[str]:
        if block.stability:
            return [path]
        return [
            inner for name, child in inside(block) if holds(child) for inner in walk(child, f"{path}.{name}")
        ]

    return walk(board, "xboard")


def global_nodes(net: Netlist) -> dict[str, str]:
    """Return the names of the global nodes -> themselves."""
    words = [tokens(line.text)[1:] for line in net.top if line.keyword == ".global"]
    return {name.lower(): name.lower() for row in words for name in row}
