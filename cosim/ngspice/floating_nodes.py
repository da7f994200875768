"""Nodes that only current sources touch, found in the netlist's structure.

Such a node has no row in ngspice's matrix (a current source puts nothing there), so that nothing is singular
and nothing is said: version 39 reports the current's number as the node's voltage. Every other node without a
DC path to ground makes the matrix singular and is reported by `cosim.ngspice.messages`.
"""

import re
from collections.abc import Iterator, Mapping

from cosim.errors import Problem
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Instance

__all__ = ["unfed_nodes"]

_WORD = re.compile(r"[^\s,(){}=\[\]%~*/'\"]+")


def unfed_nodes(blocks: Mapping[str, Block], board: Block, shared: set[str]) -> list[Problem]:
    """Return one problem for each node inside the board that nothing but current sources touch.

    Parameters
    ----------
    blocks
        All subcircuits by name.
    board
        The board's; its pins are connected outside.
    shared
        Global nodes.
    """
    sides: dict[str, tuple[set[str], dict[str, Line]]] = {}
    problems: dict[tuple[str, str], Problem] = {}
    for path, block in _instances("xboard", board, blocks):
        held, fed = _sides(block, blocks, sides)
        for node in fed.keys() - held - set(block.pins) - shared - {"0", "gnd"}:
            words = f"floating node: {path}.{node} has no DC path to ground, only current sources touch it"
            line = fed[node]
            problems.setdefault(
                (block.name, node), Problem(words, file=line.file, line=line.lineno, value=line.text)
            )
    return list(problems.values())


def _instances(path: str, block: Block, blocks: Mapping[str, Block]) -> Iterator[tuple[str, Block]]:
    yield path, block
    for instance in block.instances():
        child = _child(instance, block, blocks)
        if child is not None:
            yield from _instances(f"{path}.{instance.name}", child, blocks)


def _child(instance: Instance, block: Block, blocks: Mapping[str, Block]) -> Block | None:
    return None if instance.block in block.local else blocks.get(instance.block)


def _sides(
    block: Block, blocks: Mapping[str, Block], known: dict[str, tuple[set[str], dict[str, Line]]]
) -> tuple[set[str], dict[str, Line]]:
    """Return the nodes that something holds, and those that a current source feeds, with its line.

    What cannot be looked into (a vendor's nested subcircuits, branches that ngspice decides) counts as
    holding all that it names.
    """
    if block.name in known:
        return known[block.name]
    held: set[str] = set()
    fed: dict[str, Line] = {}
    undecided = any(line.keyword == ".if" for line in block.body)
    depth = 0
    for index, line in enumerate(block.body):
        depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
        if depth or line.keyword.startswith("."):
            continue
        if line.keyword.startswith("i") and not undecided:
            for node in tokens(line.text)[1:3]:
                fed.setdefault(node.lower(), line)
        elif line.keyword.startswith("x"):
            instance = Instance.of(line, index)
            child = _child(instance, block, blocks)
            if child is None:
                held.update(instance.nodes)
                continue
            inside, from_inside = _sides(child, blocks, known)
            for node, pin in zip(instance.nodes, child.pins, strict=False):
                if pin in inside:
                    held.add(node)
                elif pin in from_inside:
                    fed.setdefault(node, from_inside[pin])
        else:
            held.update(word.lower() for word in _WORD.findall(line.text))
    known[block.name] = held, fed
    return held, fed
