"""A board's deck with the data-sheet noise of its parts in it, at whatever level they are.

The transient analysis has no noise, so a part's noise is put in for `.noise` and `.ac` only: the levels of a
part stay free of it. The density comes from the part's own parameter, as its ``*@ ... noise= density=`` says.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, join, tokens
from cosim.ngspice.netlist import Block, parse
from cosim.ngspice.parts import Part

__all__ = ["ROOM_C", "Element", "elements", "noisy"]

#: Temperature at which data sheets state noise, and ngspice's own [degC].
ROOM_C = 27.0
_OUTSIDE, _NODE = "noise_pin", "noise_node"
#: The resistor whose thermal noise is a part's voltage noise; its name in ngspice ends so.
SOURCE = "rnoise_source"
#: Letters of elements that make noise, and the places of the two nodes between which most of it flows.
_TEMP = re.compile(r"temp\b")
_MAKERS = {"r": (1, 2), "d": (1, 2), "j": (1, 3), "q": (1, 3), "m": (1, 3)}


@dataclass(frozen=True)
class Element:
    """An element that can make noise.

    Attributes
    ----------
    name
        ngspice's name: ``r.xboard.xdiff1.r11``.
    device
        The part that it belongs to, or itself: ``xdiff1.xop``, ``xdiff1.r11``.
    nodes
        ngspice's names of the nodes between which its noise current flows.
    resistor
        Whether it is a resistor of a stated value: its noise is 4 k T / R whatever `.noise` says.
    warmed
        Whether its line states its own temperature (``temp=``), which `.noise` takes differently by version:
        39 ignores it, 44 adds it to 27 degC, 47 takes it as it is.
    """

    name: str
    device: str
    nodes: tuple[str, str]
    resistor: bool
    warmed: bool = False

    @property
    def from_data_sheet(self) -> bool:
        """Whether it stands for a density that a part states: at `ROOM_C`, however warm the circuit."""
        return self.name.endswith(SOURCE)


def noisy(board: Deck) -> Deck:
    """Return the board with the noise of every part that states a density in series with its pin.

    Inside such a part nothing else makes noise: its resistors are stages of a model, not components.
    """
    parts = {part.name: part for part in board.parts if part.noise and part.density}
    lines: list[Line] = []
    depth, part = 0, None
    for line in board.lines:
        word = line.keyword
        if word == ".subckt":
            words = tokens(line.text)
            if depth == 0:
                part = _part(words[1].lower(), parts)
            depth += 1
            if depth == 1 and part is not None:
                at = next(k for k, word in enumerate(words) if k > 1 and word.lower() == part.noise)
                words[at] = _OUTSIDE
                lines += [line.rewritten(join(words)), *_source(part, line)]
                continue
        elif word in (".ends", ".eom"):
            depth -= 1
        elif part is not None and depth > 0 and word[:1] == "r" and "noisy=" not in line.text.lower():
            line = line.rewritten(f"{line.text} noisy=0")
        lines.append(line)
    return replace(board, lines=tuple(lines))


def _part(block: str, parts: dict[str, Part]) -> Part | None:
    return next(
        (part for name, part in parts.items() if block == name or block.startswith(name + "__")), None
    )


def _source(part: Part, line: Line) -> list[Line]:
    """Return a voltage source of the part's noise between its pin's outer and inner side.

    Its resistor has the circuit's temperature, since ``temp=`` means something else in every version;
    measurements scale its noise back (`Element.from_data_sheet`).
    """
    from scipy.constants import Boltzmann  # 30 ms that a run does not need

    four_kt = 4.0 * Boltzmann * (ROOM_C + 273.15)
    texts = (
        f"{SOURCE} {_NODE} 0 {{{part.density}*{part.density}/{four_kt!r}}}",
        f"enoise_source {part.noise} {_OUTSIDE} {_NODE} 0 1",
    )
    return [replace(line, text=text, comment="") for text in texts]


def elements(board: Deck) -> list[Element]:
    """Return what can make noise in a `noisy` deck, in the order of the netlist."""
    net = parse(board.lines[1:])
    names = {part.name: part for part in board.parts if part.out}
    stated = {part.name: part for part in board.parts if part.noise and part.density}
    every: list[Element] = []

    def walk(block: Block, path: str, nets: dict[str, str], device: str) -> None:
        def named(node: str) -> str:
            return nets.get(node, "0" if node in ("0", "gnd") else f"{path}.{node}")

        depth = 0
        for line in block.body:
            depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
            words = [word.lower() for word in tokens(line.text)]
            places = _MAKERS.get(words[0][0])
            if depth or places is None or len(words) <= max(places) or "noisy=0" in words:
                continue
            if words[0] != SOURCE and _part(block.name, stated) is not None:
                continue
            own = f"{path}.{words[0]}"
            every.append(
                Element(
                    f"{words[0][0]}.{own}",
                    (device or own).removeprefix("xboard."),
                    (named(words[places[0]]), named(words[places[1]])),
                    words[0][0] == "r",
                    words[0][0] == "r" and any(_TEMP.match(word) for word in words[3:]),
                )
            )
        for instance in block.instances():
            child = net.blocks.get(instance.block)
            if child is not None:
                here = f"{path}.{instance.name}"
                inner = dict(zip(child.pins, map(named, instance.nodes), strict=False))
                is_part = _part(child.name, names) is not None
                walk(child, here, inner, device or (here if is_part else ""))

    walk(net.blocks[board.board], "xboard", {pin: pin for pin in board.pins}, "")
    return every
