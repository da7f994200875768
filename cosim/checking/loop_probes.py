"""Loop-gain probes in a flat deck: a 0 V source in series with a terminal, a 0 A source beside it.

The probe stands inside the part's subcircuit, at one of its pins: every instance of the part brings its own,
and the rest of the deck stays as it is. Both sources are at zero, so nothing else changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, join, tokens
from cosim.ngspice.netlist import Block, Netlist, parse

AMPLIFIERS = ("opamp", "driver")
"""Roles of parts around which somebody closes a loop; a multiplier drives forward only."""
_OUTSIDE, _SERIES, _SHUNT = "loop_probe", "vloop_probe", "iloop_probe"


@dataclass(frozen=True)
class Probe:
    """One place where a loop can be measured.

    Attributes
    ----------
    path
        Instance path of the part, for example ``xboard.xsum1.xop``.
    part, role
        Name and role of the part.
    pin
        The part's pin that the probe stands at.
    """

    path: str
    part: str
    role: str
    pin: str

    @property
    def node(self) -> str:
        """Name in ngspice of the node on the part's side."""
        return f"{self.path}.{self.pin}"

    @property
    def series(self) -> str:
        """Name in ngspice of the voltage source; its current enters the part's side."""
        return f"v.{self.path}.{_SERIES}"

    @property
    def shunt(self) -> str:
        """Name in ngspice of the current source; its current enters the other side."""
        return f"i.{self.path}.{_SHUNT}"


def insert_probes(board: Deck) -> tuple[list[Line], list[Probe]]:
    """Return the deck's lines with a probe at every amplifier's output and every motor's first pin.

    Only a loop that is closed around the motor, as in a current drive, has a loop gain at the latter.
    """
    net = parse(board.lines[1:])
    pins = {part.name: (part.role, part.out) for part in board.parts}
    amplifiers = {a.path: a.part for a in board.amplifiers if a.role in AMPLIFIERS}
    motors = [part.name for part in board.parts if part.role == "motor"]
    probes: list[Probe] = []
    chosen: dict[str, str] = {}
    for path, block in _instances(net, net.blocks[board.board], "xboard"):
        if path in amplifiers:
            part = amplifiers[path]
            role, pin = pins[part]
        elif any(block.name == name or block.name.startswith(name + "__") for name in motors):
            part, role, pin = block.name.partition("__")[0], "motor", block.pins[0]
        else:
            continue
        if role is not None and pin is not None:
            probes.append(Probe(path, part, role, pin))
            chosen[block.name] = pin
    return _rewritten(list(board.lines), chosen), probes


def _instances(net: Netlist, block: Block, path: str) -> Iterator[tuple[str, Block]]:
    """Walk all instances below a block; what a vendor's model defines inside itself is left out."""
    for instance in block.instances():
        child = net.blocks.get(instance.block)
        if child is not None and instance.block not in block.local:
            here = f"{path}.{instance.name}"
            yield here, child
            yield from _instances(net, child, here)


def _rewritten(lines: list[Line], chosen: dict[str, str]) -> list[Line]:
    """Put the probe's sources behind the header of each chosen subcircuit, between its pin and its body."""
    rows: list[Line] = []
    depth = 0
    for line in lines:
        if line.keyword == ".subckt":
            words = tokens(line.text)
            pin = chosen.get(words[1].lower()) if depth == 0 else None
            depth += 1
            if pin is not None:
                at = next(k for k, word in enumerate(words) if k > 1 and word.lower() == pin)
                words[at] = _OUTSIDE
                rows += [
                    line.rewritten(join(words)),
                    replace(line, text=f"{_SERIES} {_OUTSIDE} {pin} 0", comment=""),
                    replace(line, text=f"{_SHUNT} 0 {_OUTSIDE} 0", comment=""),
                ]
                continue
        elif line.keyword in (".ends", ".eom"):
            depth -= 1
        rows.append(line)
    return rows
