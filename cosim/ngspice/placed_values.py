"""Values of placed components: every flattened element of a board, and every placed part, has its own.

A ``.param`` names what several elements share by design; what is soldered on a board are parts from a bag.
Each instance on the way to a named element gets a subcircuit of its own, so that it alone changes.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, assignments, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist, parse
from cosim.ngspice.overrides import elements_of, own_copy, set_element

__all__ = ["Placed", "board_netlist", "split", "walk"]

_BRACES = "{}'"
#: Names on the ways from a parameter to others that depend on it: more of them go in a circle.
_MOST_NAMES = 1000
#: Stands for the value of a component until it has one.
_MARK = "cosim_placed_{}"
_MARKS = re.compile(r"\{cosim_placed_(\d+)\}|cosim_placed_(\d+)")


def board_netlist(board: Deck) -> Netlist:
    """Return the subcircuits of a deck; `is_part` tells parts, and what only parts have inside."""
    net = parse(board.lines[1:])
    named = {part.name for part in board.parts}
    parts = {name for name in net.blocks if name.partition("__")[0] in named}
    outside = _within(net, {board.board}, parts)
    for name in _within(net, parts) - outside:
        net.blocks[name].is_part = True
    return net


def _within(net: Netlist, names: set[str], apart: Collection[str] = ()) -> set[str]:
    """Return these subcircuits and all that they are made of, apart from some and what is in those."""
    found: set[str] = set()
    waiting = [name for name in names if name in net.blocks]
    while waiting:
        name = waiting.pop()
        if name not in found and name not in apart:
            found.add(name)
            inner = (instance.block for instance in net.blocks[name].references())
            waiting += [each for each in inner if each in net.blocks]
    return found


def walk(net: Netlist, board: str) -> Iterator[tuple[str, Block, Instance | None, dict[str, str]]]:
    """Yield every instance: its path, its subcircuit, its line, and ngspice's names of its pins' nodes."""
    pins = {pin: pin for pin in net.blocks[board].pins}
    waiting: list[tuple[str, Block, Instance | None, dict[str, str]]] = [
        ("xboard", net.blocks[board], None, pins)
    ]
    while waiting:
        path, block, instance, nets = waiting.pop()
        yield path, block, instance, nets
        for inner in block.instances():
            child = net.blocks.get(inner.block)
            if child is not None:
                names = [node_name(node, path, nets) for node in inner.nodes]
                inside = dict(zip(child.pins, names, strict=False))
                waiting.append((f"{path}.{inner.name}", child, inner, inside))


def node_name(node: str, path: str, nets: dict[str, str]) -> str:
    """Return what ngspice calls a node of the instance at `path`."""
    return nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}")


def split(key: str) -> tuple[list[str], str, str]:
    """Split a component's key: the instances on the way, the element, or else the part's parameter.

    ``xdiff1.r11`` -> (['xdiff1'], 'r11', ''); ``xdiff1.xop:tl072_gbw`` -> (['xdiff1', 'xop'], '', ...).
    """
    path, _, parameter = key.strip().lower().partition(":")
    steps = path.removeprefix("xboard.").split(".")
    return (steps, "", parameter) if parameter else (steps[:-1], steps[-1], "")


@dataclass(frozen=True)
class Placed:
    """A board whose named components get values of their own.

    Attributes
    ----------
    board
        The board as it is.
    keys
        The components.
    lines
        The deck with marks in place of the values.
    marked
        Places of the lines with marks.
    """

    board: Deck
    keys: tuple[str, ...]
    lines: tuple[Line, ...]
    marked: tuple[int, ...]

    @classmethod
    def of(cls, board: Deck, keys: Sequence[str]) -> "Placed":
        """Find the components.

        Raises
        ------
        InputError
            For every key that is no component of the board, or one without a single value.
        """
        net = board_netlist(board)
        problems = []
        for number, key in enumerate(keys):
            wrong = _mark(net, board.board, key, _MARK.format(number))
            if wrong:
                problems.append(Problem(wrong, file=str(board.path), key=key))
        if problems:
            raise InputError(problems)
        heads = [line for line in board.lines if line.keyword.startswith("*@")]
        lines = [board.lines[0], *heads, *net.top]
        for block in net.blocks.values():
            lines += block.lines
        marked = tuple(k for k, line in enumerate(lines) if _MARKS.search(line.text))
        return cls(board, tuple(keys), tuple(lines), marked)

    def deck(self, values: Sequence[float]) -> Deck:
        """Return the board with these values of its components, in the order of `keys` [SI]."""
        texts = [repr(float(value)) for value in values]

        def value(match: re.Match[str]) -> str:
            return texts[int(match[1])] if match[1] else f"({texts[int(match[2])]})"

        lines = list(self.lines)
        for place in self.marked:
            lines[place] = lines[place].rewritten(_MARKS.sub(value, lines[place].text))
        return replace(self.board, lines=tuple(lines))


def _mark(net: Netlist, board: str, key: str, mark: str) -> str | None:
    """Put a mark in place of a component's value; return what is wrong."""
    steps, element, parameter = split(key)
    block = net.blocks[board]
    for depth, step in enumerate(steps):
        instances = {x.name: x for x in block.instances()}
        if step not in instances:
            near = nearest(step, list(instances))
            return f"{block.name} has no instance {step}" + (f", nearest is {near}" if near else "")
        child = net.blocks.get(instances[step].block)
        if child is None:
            return f"{step} is defined inside a vendor's model"
        if parameter and depth == len(steps) - 1:
            line = instances[step].line
            block.body[instances[step].index] = line.rewritten(_substituted(line.text, parameter, mark))
            instances = {x.name: x for x in block.instances()}
        block = own_copy(net, block, instances[step], child)
    if not parameter:
        if element not in elements_of(block):
            near = nearest(element, list(elements_of(block)))
            return f"{block.name} has no element {element}" + (f", nearest is {near}" if near else "")
        return set_element(block, element, f"{{{mark}}}")
    for name, text in [*_made_of(net, block, parameter).items(), (parameter, mark)]:
        block.header = block.header.rewritten(_substituted(block.header.text, name, text))
        block.params = {each: _substituted(value, name, text) for each, value in block.params.items()}
        block.body = [line.rewritten(_substituted(line.text, name, text)) for line in block.body]
    used = re.compile(rf"{mark}(?!\d)")
    if not any(used.search(line.text) for each in net.blocks.values() for line in each.lines):
        return f"nothing in {block.name} uses a parameter {parameter}"
    return None


def _made_of(net: Netlist, block: Block, parameter: str) -> dict[str, str]:
    """Return the parameters outside a block that depend on another one, with their expressions.

    What depends on others comes first: put in place one after the other, only `parameter` is left.
    """
    outside: dict[str, str] = {}
    for line in net.top:
        if line.keyword in (".param", ".params"):
            outside |= assignments(tokens(line.text)[1:])
    inside = set(block.params)
    for line in block.body:
        if line.keyword in (".param", ".params"):
            inside |= set(assignments(tokens(line.text)[1:]))
    found: dict[str, str] = {}
    names = [parameter]
    for name in names:  # grows while what depends on it is found
        for other, text in outside.items() if len(names) < _MOST_NAMES else ():
            if other not in inside and _uses(text, name):
                names.append(other)
                found.pop(other, None)  # again, behind what it depends on
                found[other] = f"({text.strip(_BRACES)})"
    return dict(reversed(found.items()))


def _uses(text: str, name: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.])", text, re.IGNORECASE) is not None


def _substituted(text: str, name: str, mark: str) -> str:
    """Put a mark in place of a parameter wherever its value is used."""
    return re.sub(rf"(?<![\w.]){re.escape(name)}(?![\w.]|\s*=(?!=))", mark, text, flags=re.IGNORECASE)
