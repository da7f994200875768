"""How many elements a deck asks ngspice to evaluate at every time point: what the point costs."""

from __future__ import annotations

from dataclasses import dataclass

from cosim.ngspice.deck import Deck
from cosim.ngspice.netlist import Block, Netlist, parse

__all__ = ["ElementCount", "element_count"]

#: Letters of elements with a bent characteristic; a source with an expression is one as well.
_BENT = frozenset("bdqjmzsw")
_EXPRESSION = ("value", "vol=", "cur=", "poly", "table")


@dataclass(frozen=True)
class ElementCount:
    """Elements that are straight, and those that are evaluated anew at every Newton step."""

    straight: int
    bent: int


def element_count(board: Deck) -> ElementCount:
    """Count the elements of a board and of all that it instantiates."""
    net = parse(board.lines[1:])
    known: dict[str, tuple[int, int]] = {}
    straight, bent = _count(net, net.blocks[board.board], known)
    return ElementCount(straight, bent)


def _count(net: Netlist, block: Block, known: dict[str, tuple[int, int]]) -> tuple[int, int]:
    if block.name not in known:
        depth, counts = 0, [0, 0]
        for line in block.body:
            word = line.keyword
            depth += (word == ".subckt") - (word in (".ends", ".eom"))
            if depth or not word[0].isalpha() or word[0] == "x":
                continue
            text = line.text.lower()
            bent = word[0] in _BENT or (word[0] in "eg" and any(mark in text for mark in _EXPRESSION))
            counts[bent] += 1
        for instance in block.instances():
            child = net.blocks.get(instance.block)
            if child is not None:
                inside = _count(net, child, known)
                counts = [mine + more for mine, more in zip(counts, inside, strict=True)]
        known[block.name] = counts[0], counts[1]
    return known[block.name]
