"""Which nodes have a DC path to ground, and which sources close a loop, found in a flat deck's structure.

ngspice reports all causes of a singular matrix alike: a node that nothing ties to ground or a loop of voltage
sources, which are mistakes in the netlist, and a state of a model in which Newton's method got lost, which is
not.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Instance, parse

__all__ = ["has_dc_path", "in_voltage_loop"]

_PROBED = re.compile(r"\bv\(([^()]*)\)", re.IGNORECASE)
_SETS_VOLTAGE = re.compile(r"\bv ?=", re.IGNORECASE)
#: Places of the nodes that an element ties together at DC, by its letter; of the other letters all its words.
_TIES: Mapping[str, tuple[int, ...]] = {
    "r": (1, 2), "l": (1, 2), "v": (1, 2), "e": (1, 2), "h": (1, 2), "d": (1, 2), "s": (1, 2), "w": (1, 2),
    "q": (1, 2, 3), "j": (1, 2, 3), "m": (1, 3, 4), "c": (), "i": (), "k": (), "f": (), ".": (), "*": (),
}  # fmt: skip

Named = Callable[[str], str]


def has_dc_path(rows: Sequence[str], node: str) -> bool:
    """Whether something ties `node` to ground at DC in a flat deck; an unknown node counts as tied.

    Parameters
    ----------
    rows
        The deck, its title first.
    node
        Name as ngspice gives it: ``xboard.xdiff1.inn``.
    """
    nets = _Nets()
    for line, _, named in _elements(rows):
        tied = [named(word) for word in _tied(line)]
        for other in tied[1:]:
            nets.join(tied[0], other)
        for word in tokens(line.text)[1:3]:
            nets.of(named(word))  # now it is known
    return node not in nets or nets.of(node) == nets.of("0")


def in_voltage_loop(rows: Sequence[str], element: str) -> bool:
    """Whether voltage sources and inductors alone join the ends of such an element; unknown ones count as so.

    Parameters
    ----------
    rows
        The deck, its title first.
    element
        Name as ngspice gives it: ``v.xboard.xksp11.vpx``, ``vin``.
    """
    nets, ends = _Nets(), None
    for line, path, named in _elements(rows):
        letter = line.keyword[0]
        if letter not in "vlehb" or (letter == "b" and _SETS_VOLTAGE.search(line.text) is None):
            continue
        first, second = (named(word) for word in tokens(line.text)[1:3])
        if element == (f"{letter}.{path}{line.keyword}" if path else line.keyword):
            ends = first, second
        else:
            nets.join(first, second)
    return ends is None or nets.of(ends[0]) == nets.of(ends[1])


class _Nets:
    """Sets of nodes that are one."""

    def __init__(self) -> None:
        self._root: dict[str, str] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._root

    def of(self, name: str) -> str:
        """Return the node that stands for all that are one with this."""
        root = self._root
        while root.setdefault(name, name) != name:
            root[name] = root[root[name]]
            name = root[name]
        return name

    def join(self, first: str, second: str) -> None:
        """Make two nodes one."""
        self._root[self.of(first)] = self.of(second)


def _elements(rows: Sequence[str]) -> Iterator[tuple[Line, str, Named]]:
    """Yield each element of a flat deck, its instance path, and what names a node that it touches."""
    net = parse([Line(row.strip()) for row in rows[1:] if row.strip()], lenient=True)
    yield from _walk(net.bench, net.blocks, "", {})


def _walk(
    lines: list[Line], scope: Mapping[str, Block], path: str, nets: Mapping[str, str]
) -> Iterator[tuple[Line, str, Named]]:
    def named(word: str) -> str:
        word = word.lower()
        return nets.get(word, "0" if word in ("0", "gnd") else path + word)

    for index, line in enumerate(lines):
        if not line.keyword.startswith("x"):
            yield line, path, named
            continue
        instance = Instance.of(line, index)
        block = scope.get(instance.block)
        if block is not None:
            inner = parse(block.body, lenient=True)
            outside = dict(zip(block.pins, map(named, instance.nodes), strict=False))
            yield from _walk(inner.bench, {**scope, **inner.blocks}, f"{path}{instance.name}.", outside)


def _tied(line: Line) -> list[str]:
    """Return the nodes that an element ties together."""
    words = tokens(line.text.lower())
    letter = words[0][0]
    if letter in "gb":  # a current source is a conductance where its own voltage steers it
        own = set(words[1:3])
        steering = set(words[3:5]) if letter == "g" else set()
        for probe in _PROBED.findall(line.text.lower()):
            steering |= {name.strip() for name in probe.split(",")}
        return words[1:3] if _SETS_VOLTAGE.search(line.text) or steering & (own - {"0"}) else []
    return [words[k] for k in _TIES.get(letter, range(1, len(words))) if k < len(words)]
