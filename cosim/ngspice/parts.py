"""Parts by name or role: which file, which level, and which other part stands in for it."""

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from cosim.errors import InputError, Problem, fail, nearest
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.flatten import Reader
from cosim.ngspice.lines import Line, assignments, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist, parse
from cosim.ngspice.vendor import chosen

__all__ = ["ROLES", "Feature", "Part", "PartSwap", "Shelf", "described"]

ROLES = ("opamp", "vca", "driver", "motor", "potentiometer")
"""What a part can be, as the ``*@ role=`` line of its file says."""


@dataclass(frozen=True)
class PartSwap:
    """A vendor's model in place of a part.

    Attributes
    ----------
    file
        The vendor's file.
    subckt
        Name of the subcircuit in it.
    pins
        How its pins meet those of the part it replaces: either the vendor's pin names in the order of the
        part's pins (``"1 2 3 4 5"``), or the part's pin names in the order of the vendor's pins
        (``"p m vcc vee out"``).
    dialect
        ``"ngspice"``, ``"pspice"`` or ``"ltspice"`` (`Dialect`); the latter two switch one of ngspice's
        compatibility modes on for the deck.
    """

    file: str | Path
    subckt: str
    pins: str | Iterable[str] = ""
    dialect: str = "ngspice"


@dataclass(frozen=True)
class Feature:
    """A single effect of parts or blocks: a ``.param`` of their files that is 0 or 1.

    Attributes
    ----------
    name
        Name of the parameter.
    on
        Whether the effect is in force.
    roles
        Roles whose parts must carry it then; none where a block may.
    """

    name: str
    on: bool
    roles: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """A part as used in a deck.

    Attributes
    ----------
    out, swing
        Output pin, and name of the parameter with its limit [V].
    noise, density
        Pin at which its voltage noise stands in series, and name of the parameter with its density
        [V/sqrt(Hz)].
    """

    name: str
    role: str | None
    out: str | None = None
    swing: str | None = None
    level: str | None = None
    noise: str | None = None
    density: str | None = None


@dataclass
class Shelf:
    """The ``parts`` and ``blocks`` folders beside a board, with the levels and swaps that a scene asks for.

    Attributes
    ----------
    folder
        Folder of the board file.
    reader
        Reads what the shelf holds.
    levels
        Level of each role; ``driver`` is the kind of drive, ``driver_level`` the level of its amplifier.
    swaps
        Name or role of a part -> what stands in for it.
    used
        Parts taken from the shelf so far.
    dialects
        Dialects of the vendors' models taken so far.
    """

    folder: Path
    reader: Reader
    levels: Mapping[str, str]
    swaps: Mapping[str, "PartSwap | str"]
    used: dict[str, Part] = field(default_factory=dict)
    dialects: set[Dialect] = field(default_factory=set)
    _described: dict[str, Part] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        known = {*ROLES, "driver_level"}
        problems = [
            Problem(
                f"unknown role, nearest is {nearest(role, known)}", key=role, allowed=", ".join(sorted(known))
            )
            for role in self.levels
            if role not in known
        ]
        places = [*ROLES, *self.names()]
        for key, swap in self.swaps.items():
            if key not in places:
                near = nearest(key, places)
                hint = f", nearest is {near}" if near else ""
                problems.append(Problem(f"no such part or role{hint}", key=key, allowed=", ".join(places)))
            if not isinstance(swap, str) and swap.dialect not in list(Dialect):
                allowed = ", ".join(Dialect)
                problems.append(Problem("unknown dialect", key=key, value=swap.dialect, allowed=allowed))
        if problems:
            raise InputError(problems)

    def names(self) -> list[str]:
        """Return the names of all parts on the shelf."""
        return sorted(self._files)

    def take(self, name: str) -> Netlist | None:
        """Return the netlist that defines the subcircuit `name`, or ``None`` if the shelf has none.

        A part comes at the level its role has in `levels` (``ideal`` where nothing is said); the role
        ``driver`` comes from one of the two driver blocks.
        """
        file = self._file(name)
        if file is not None:
            part = self._part(name, file)
            named = self.reader.sections(file)
            level = part.level if named else None
            if level is not None and level not in named:
                fail(f"part {name} has no such level", file=str(file), key=part.role, value=level,
                     allowed=", ".join(s for s in named if s != "data"))  # fmt: skip
            self.used[name] = part
            return parse(self.reader.read(file, level), is_part=True)
        if name == "driver":
            kind = self.levels.get("driver", "voltage")
            block = self.folder / "blocks" / f"driver_{kind}.cir"
            if not os.path.isfile(block):
                kinds = [
                    file.stem.partition("_")[2] for file in (self.folder / "blocks").glob("driver_*.cir")
                ]
                fail("there is no such kind of driver", file=str(block), key="driver", value=kind,
                     allowed=", ".join(sorted(kinds)))  # fmt: skip
            return parse(self.reader.read(block))
        return None

    def swapped(self, instance: Instance) -> tuple[Line, Netlist] | None:
        """Return the instance's line with what stands in for its part, and the netlist that defines that."""
        file = self._file(instance.block)
        if file is None:
            return None
        part = self._part(instance.block, file)
        swap = self.swaps.get(part.name, self.swaps.get(part.role or ""))
        if swap is None or swap == part.name:
            return None
        original = self._block(part.name)
        if isinstance(swap, str):
            name = swap.lower()
            net = self.take(name)
            if net is None:
                near = nearest(name, self.names())
                fail("no such part" + (f", nearest is {near}" if near else ""), key=part.name, value=swap,
                     allowed=", ".join(self.names()))  # fmt: skip
            order = _by_name(original, net.blocks[name])
        else:
            name = swap.subckt.lower()
            net = self._vendor(swap)
            order = _pin_map(swap, original, net.blocks[name])
            self.used[name] = Part(name, part.role, out=order[part.out] if part.out else None)
        if len(instance.nodes) != len(original.pins):
            fail(f"{part.name} has {len(original.pins)} pins, {instance.name} connects {len(instance.nodes)}",
                 file=instance.line.file, line=instance.line.lineno)  # fmt: skip
        here = dict(zip(original.pins, instance.nodes, strict=True))
        there = {vendor: here[mine] for mine, vendor in order.items()}
        nodes = [there[pin] for pin in net.blocks[name].pins]
        return instance.rewritten(nodes=nodes, block=name, extra=()), net

    @cached_property
    def _files(self) -> dict[str, Path]:
        """Files by the part's name in lower case: letter case counts in a folder but not in SPICE."""
        files = sorted((self.folder / "parts").glob("*.lib"), reverse=True)  # of two alike the first counts
        return {file.stem.lower(): file for file in files}

    def _file(self, name: str) -> Path | None:
        return self._files.get(name)

    def _part(self, name: str, file: Path) -> Part:
        if name not in self._described:
            about = next((row.text for row in self.reader.rows(file) if row.text.startswith("*@")), "")
            part = described(name, about, str(file))
            role = "driver_level" if part.role == "driver" else part.role or ""
            self._described[name] = replace(part, level=self.levels.get(role, "ideal"))
        return self._described[name]

    def _block(self, name: str) -> Block:
        """Return a part's subcircuit at any level; all levels have the same pins."""
        file = self._file(name)
        assert file is not None
        for section in [*self.reader.sections(file), None]:
            block = parse(self.reader.read(file, section), is_part=True).blocks.get(name)
            if block is not None:
                return block
        fail(f"the file does not define .subckt {name}", file=str(file))

    def _vendor(self, swap: PartSwap) -> Netlist:
        """Return what a vendor's file says about one subcircuit, the rest of the file left out."""
        file, dialect = Path(swap.file), Dialect(swap.dialect)
        self.dialects.add(dialect)
        reader = Reader(file.parent, self.reader.trust, dialect)
        return chosen(parse(reader.read(file), is_part=True, lenient=True), swap.subckt.lower(), file)


def described(name: str, about: str, file: str) -> Part:
    """Return the part that a ``*@ role= out= swing= noise= density=`` comment describes, without a level."""
    facts = assignments(tokens(about)[1:])
    role = facts.get("role")
    if role is not None and role not in ROLES:
        fail("unknown role", file=file, key="role", value=role, allowed=", ".join(ROLES))
    out, swing, noise, density = (
        facts[key].lower() if key in facts else None for key in ("out", "swing", "noise", "density")
    )
    return Part(name, role, out, swing, None, noise, density)


def _by_name(original: Block, other: Block) -> dict[str, str]:
    if set(original.pins) != set(other.pins):
        fail(f"pins of {other.name} ({' '.join(other.pins)}) are not those of {original.name} "
             f"({' '.join(original.pins)})", file=other.header.file, line=other.header.lineno)  # fmt: skip
    return {pin: pin for pin in original.pins}


def _pin_map(swap: PartSwap, original: Block, vendor: Block) -> dict[str, str]:
    """Return the part's pin name -> the vendor's pin name."""
    words = [
        w.lower()
        for w in (re.split(r"[\s,]+", swap.pins.strip()) if isinstance(swap.pins, str) else swap.pins)
    ]
    if sorted(original.pins) == sorted(vendor.pins) == sorted(words):  # named alike: each meets its namesake
        if words not in (list(original.pins), list(vendor.pins)):
            fail(
                "the model's pins have the names of the part's: list them in the model's order, "
                f"{' '.join(vendor.pins)}, or in the part's, {' '.join(original.pins)}",
                file=str(swap.file), key="pins", value=" ".join(words),
            )  # fmt: skip
        return {pin: pin for pin in original.pins}
    if sorted(words) == sorted(original.pins) and len(words) == len(vendor.pins):
        return dict(zip(words, vendor.pins, strict=True))
    if sorted(words) == sorted(vendor.pins) and len(words) == len(original.pins):
        return dict(zip(original.pins, words, strict=True))
    fail(
        f"the pin map must list the model's pins ({' '.join(vendor.pins)}) in the order of the part's "
        f"({' '.join(original.pins)}), or the part's pins in the order of the model's",
        file=str(swap.file),
        key="pins",
        value=" ".join(words),
    )
