"""Other values on a board that ngspice holds: which elements, or which parameter, a name stands for.

Elements are altered where they are, in microseconds. A parameter whose value arrives unchanged at resistors,
capacitors and inductors only stands for these; any other takes `alterparam` and a new reading of the deck.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, assignments, number, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist
from cosim.ngspice.overrides import apply_overrides
from cosim.ngspice.placed_values import board_netlist as netlist

__all__ = ["Handle", "Way", "altered", "handle", "netlist", "nominal_value", "walk"]

_PASSIVE = "rcl"
#: Place of the value on the line of a resistor, capacitor or inductor.
_PLACE = 3
#: Statements outside subcircuits that only tell a parameter's value.
_TELLS = (".csparam", ".param", ".params")


class Way(Enum):
    """How a value gets into ngspice."""

    ELEMENTS = "alter"
    PARAMETER = "alterparam"
    DECK = "another deck"


@dataclass(frozen=True)
class Handle:
    """How a name is given another value.

    Attributes
    ----------
    way
        The command.
    targets
        ngspice's names of the elements, or the parameter.
    rank
        Of two names for one element the one with the higher rank counts: a parameter, an element everywhere,
        one of an instance.
    """

    way: Way
    targets: tuple[str, ...] = ()
    rank: int = 0


def altered(board: Deck, values: Mapping[str, str]) -> Deck:
    """Return the deck with other values, as `load_deck` with these overrides gives it.

    Raises
    ------
    InputError
        For names that the board does not have, and for invalid values.
    """
    net = netlist(board)
    apply_overrides(net, net.blocks[board.board], values)
    heads = [line for line in board.lines if line.keyword.startswith("*@")]
    lines = [board.lines[0], *heads, *net.top]
    for block in net.blocks.values():
        lines += block.lines
    return replace(board, lines=tuple(lines))


def handle(board: Deck, name: str) -> Handle:
    """Return how `name`, as in `altered`, gets another value.

    Raises
    ------
    InputError
        For a name that the board does not have.
    """
    altered(board, {name: "1"})
    key = name.strip().lower().removeprefix("xboard.")
    net = netlist(board)
    if "." in key:
        return _of_instance(net, board.board, key)
    where = [block for block in net.blocks.values() if any(_defines(line, key) for line in block.body)]
    if where:
        return Handle(Way.DECK)
    if any(_defines(line, key) for line in net.top):
        elements = _identical(net, board.board, key)
        return Handle(Way.ELEMENTS, elements) if elements else Handle(Way.PARAMETER, (key,))
    owners = [b for part in (False, True) for b in net.blocks.values() if b.is_part is part and _has(b, key)]
    return _passive(key, [path for path, block, _ in walk(net, board.board) if block is owners[0]], 1)


def nominal_value(board: Deck, name: str) -> float | None:
    """Return a parameter's own value, if it is a plain number."""
    for line in reversed(board.lines):
        if line.keyword in (".param", ".params"):
            value = assignments(tokens(line.text)[1:]).get(name)
            if value is not None:
                return number(value)
    return None


def _of_instance(net: Netlist, board: str, key: str) -> Handle:
    *path, leaf = key.split(".")
    at = ".".join(["xboard", *path])
    block = next(block for where, block, _ in walk(net, board) if where == at)
    if leaf not in block.params:
        return _passive(leaf, [at], 2)
    elements = _used(block, at, {leaf})
    inside = any(word.partition("=")[2] for x in block.instances() for word in x.extra if _says(word, {leaf}))
    return Handle(Way.ELEMENTS, tuple(elements), 2) if elements and not inside else Handle(Way.DECK)


def _passive(key: str, paths: list[str], rank: int) -> Handle:
    if key[0] not in _PASSIVE or not paths:
        return Handle(Way.DECK)
    return Handle(Way.ELEMENTS, tuple(f"{key[0]}.{path}.{key}" for path in paths), rank)


def walk(
    net: Netlist, board: str, path: str = "xboard", instance: Instance | None = None
) -> Iterator[tuple[str, Block, Instance | None]]:
    """Yield every instance: its path, its subcircuit, its line."""
    block = net.blocks[board]
    yield path, block, instance
    for inner in block.instances():
        if inner.block in net.blocks:
            yield from walk(net, inner.block, f"{path}.{inner.name}", inner)


def _identical(net: Netlist, board: str, key: str) -> tuple[str, ...] | None:
    """Return the elements whose value is the parameter itself, or ``None`` where it is used otherwise."""
    for line in net.top:
        if line.keyword not in _TELLS and _says(line.text, {key}):
            return None
        if line.keyword != ".csparam":
            values = assignments(tokens(line.text)[1:])
            if any(_says(value, {key}) for value in values.values()):
                return None
    names: dict[str, set[str]] = {}
    copies: list[str] = []
    for path, block, instance in walk(net, board):
        outside = names.get(path.rpartition(".")[0], {key})
        given = assignments(list(instance.extra)) if instance else {}
        inside = set() if key in block.params else {key}
        for param, default in block.params.items():
            value, known = (given[param], outside) if param in given else (default, {key})
            if value.strip("{}'").lower() in known:
                inside.add(param)
            elif _says(value, known):
                return None
        if any(param not in block.params and _says(value, outside) for param, value in given.items()):
            return None
        names[path] = inside
        elements = _used(block, path, inside)
        if elements is None:
            return None
        copies += elements
    return tuple(copies) or None


def _used(block: Block, path: str, names: set[str]) -> list[str] | None:
    """Return the elements of one instance whose value is one of `names`; ``None`` for any other use."""
    elements = []
    for line in block.body:
        words = tokens(line.text)
        letter = line.keyword[0]
        if letter == "x":
            continue  # its parameters are checked in the subcircuit that uses them
        for place, word in enumerate(words[1:], 1):
            if not _says(word, names):
                continue
            if letter in _PASSIVE and place < _PLACE:
                continue  # a node of that name
            if (
                letter in _PASSIVE
                and place == _PLACE
                and word.strip("{}'").lower() in names
                and not block.local
            ):
                elements.append(f"{letter}.{path}.{line.keyword}")
            else:
                return None
    return elements


def _defines(line: Line, key: str) -> bool:
    return line.keyword in (".param", ".params") and key in assignments(tokens(line.text)[1:])


def _has(block: Block, key: str) -> bool:
    return any(line.keyword == key for line in block.body)


def _says(text: str, names: set[str]) -> bool:
    return any(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.])", text.lower()) for name in names)
