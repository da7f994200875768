"""Where a board lets us look: its 0 V sources, found by walking the netlist."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import join, number, tokens
from cosim.ngspice.netlist import Block, parse

__all__ = ["Probe", "external_probes", "find_probes"]


@dataclass(frozen=True)
class Probe:
    """A 0 V source inside the board.

    Attributes
    ----------
    group
        Path of the instance it stands in, ``xboard.xksp11``; the probes of one multiplier share it.
    source
        Name by which ngspice alters it.
    nodes
        ngspice's names of the nodes at its two ends.
    """

    group: str
    source: str
    nodes: tuple[str, str]


def find_probes(board: Deck) -> list[Probe]:
    """Return every 0 V source of the board outside nested definitions, in the order of the netlist."""
    net = parse(board.lines[1:])
    probes: list[Probe] = []

    def walk(block: Block, path: str, nets: dict[str, str]) -> None:
        def named(node: str) -> str:
            return nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}")

        for words in _sources(block):
            first, second = (named(word.lower()) for word in words[1:3])
            probes.append(Probe(path, f"v.{path}.{words[0].lower()}", (first, second)))
        for instance in block.instances():
            child = net.blocks.get(instance.block)
            if child is not None:
                inner = dict(zip(child.pins, map(named, instance.nodes), strict=False))
                walk(child, f"{path}.{instance.name}", inner)

    walk(net.blocks[board.board], "xboard", {pin: pin for pin in board.pins})
    return probes


def external_probes(board: Deck, sources: Collection[str]) -> Deck:
    """Return the board with these probes EXTERNAL: whoever simulates sets their voltage at any time.

    `sources` are names as in `Probe.source`. What stands in one subcircuit becomes EXTERNAL in all its
    instances.
    """
    net = parse(board.lines[1:])
    wanted: set[tuple[str, str]] = set()

    def walk(block: Block, path: str) -> None:
        for words in _sources(block):
            if f"v.{path}.{words[0].lower()}" in sources:
                wanted.add((block.name, words[0].lower()))
        for instance in block.instances():
            if instance.block in net.blocks:
                walk(net.blocks[instance.block], f"{path}.{instance.name}")

    walk(net.blocks[board.board], "xboard")
    lines, depth, name = [], 0, ""
    for line in board.lines:
        if line.keyword == ".subckt":
            name = tokens(line.text)[1].lower() if depth == 0 else name
            depth += 1
        elif line.keyword in (".ends", ".eom"):
            depth -= 1
        elif depth == 1 and (name, line.keyword) in wanted:
            line = line.rewritten(join([*tokens(line.text)[:3], "external"]))
        lines.append(line)
    return replace(board, lines=tuple(lines))


def _sources(block: Block) -> list[list[str]]:
    """Return the words of each ``Vname a b [dc] 0`` line outside nested definitions."""
    sources, depth = [], 0
    for line in block.body:
        depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
        words = tokens(line.text)
        if depth == 0 and words[0][0] in "vV" and len(words) >= 3:
            value = [word for word in words[3:] if word.lower() != "dc"]
            if not value or (len(value) == 1 and number(value[0]) == 0.0):
                sources.append(words)
    return sources
