"""Which nodes have a DC path to ground, found in a flat deck's structure.

A singular matrix has two causes that ngspice tells alike: a node that nothing ties to ground, which is a slip
in the netlist, and a state of a model in which Newton's method got lost, which is none.
"""

import re
from collections.abc import Mapping, Sequence

from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Instance, parse

__all__ = ["has_dc_path"]

_PROBED = re.compile(r"\bv\(([^()]*)\)", re.IGNORECASE)
#: Places of the nodes that an element ties together at DC, by its letter; of the other letters all its words.
_TIES: Mapping[str, tuple[int, ...]] = {
    "r": (1, 2), "l": (1, 2), "v": (1, 2), "e": (1, 2), "h": (1, 2), "d": (1, 2), "s": (1, 2), "w": (1, 2),
    "q": (1, 2, 3), "j": (1, 2, 3), "m": (1, 3, 4), "c": (), "i": (), "k": (), "f": (), ".": (), "*": (),
}  # fmt: skip


def has_dc_path(rows: Sequence[str], node: str) -> bool:
    """Whether something ties `node` to ground at DC in a flat deck; an unknown node counts as tied.

    Parameters
    ----------
    rows
        The deck, its title first.
    node
        Name as ngspice gives it: ``xboard.xdiff1.inn``.
    """
    net = parse([Line(row.strip()) for row in rows[1:] if row.strip()], lenient=True)
    root: dict[str, str] = {}

    def find(name: str) -> str:
        while root.setdefault(name, name) != name:
            root[name] = root[root[name]]
            name = root[name]
        return name

    def walk(lines: list[Line], scope: Mapping[str, Block], path: str, nets: Mapping[str, str]) -> None:
        def named(word: str) -> str:
            word = word.lower()
            return nets.get(word, "0" if word in ("0", "gnd") else path + word)

        for index, line in enumerate(lines):
            if line.keyword.startswith("x"):
                instance = Instance.of(line, index)
                block = scope.get(instance.block)
                if block is not None:
                    inner = parse(block.body, lenient=True)
                    outside = dict(zip(block.pins, map(named, instance.nodes), strict=False))
                    walk(inner.bench, {**scope, **inner.blocks}, f"{path}{instance.name}.", outside)
                continue
            tied = [find(named(word)) for word in _tied(line)]
            for other in tied[1:]:
                root[find(tied[0])] = find(other)
            for word in tokens(line.text)[1:3]:
                find(named(word))  # now it is known

    walk(net.bench, net.blocks, "", {})
    return node not in root or find(node) == find("0")


def _tied(line: Line) -> list[str]:
    """Return the nodes that an element ties together."""
    words = tokens(line.text.lower())
    letter = words[0][0]
    if letter in "gb":  # a current source is a conductance where its own voltage steers it
        own = set(words[1:3])
        steering = set(words[3:5]) if letter == "g" else set()
        for probe in _PROBED.findall(line.text.lower()):
            steering |= {name.strip() for name in probe.split(",")}
        return words[1:3] if "v=" in line.text.lower().replace(" ", "") or steering & (own - {"0"}) else []
    return [words[k] for k in _TIES.get(letter, range(1, len(words))) if k < len(words)]
