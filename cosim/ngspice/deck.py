"""One flat deck from a board file, its blocks, and parts at the levels that the effects ask for.

The deck holds the board's subcircuit and all it needs, but no sources and no instance of the board: whoever
simulates adds ``xboard <nets> <board>`` and the sources behind `Deck.text`. ngspice never sees an include.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.caution import Caution, warn
from cosim.errors import InputError, Problem, fail, nearest
from cosim.ngspice import conditionals, gate
from cosim.ngspice.deck_checks import check_size, judged, judged_bench, judged_block
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.flatten import Reader
from cosim.ngspice.floating_nodes import unfed_nodes
from cosim.ngspice.inventory import Amplifier, amplifiers, declared, global_nodes, reactances
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Netlist, parse
from cosim.ngspice.overrides import apply_overrides, set_param, shorts
from cosim.ngspice.parts import Feature, Part, PartSwap, Shelf, described
from cosim.ngspice.reader_notes import notes
from cosim.ngspice.safety import refusal
from cosim.ngspice.unused_values import unused

__all__ = ["NOMINAL_C", "Amplifier", "Deck", "Feature", "PartSwap", "board_pins", "load_deck"]

_JOINT_PINS = ("pot{j}", "vel{j}", "u{j}", "cmd{j}", "imot{j}")
_PAIR_PINS = ("ksp{i}{j}", "ksd{i}{j}")
MOST_JOINTS = 6
#: Temperature at which parts have their nominal values, ngspice's own [C].
NOMINAL_C = 27.0
_NUMBERED_PIN = re.compile(r"(pot|vel|cmd|imot)\d+|ks[pd]\d\d")


@dataclass(frozen=True)
class Deck:
    """A flat, checked netlist of a board; equal inputs give equal text.

    Attributes
    ----------
    lines
        Its lines with their origins; the first is the title.
    board, pins, joints
        Name of the board's subcircuit, its pins in order (lower case), and the number of joints.
    amplifiers
        All instances of parts that state an output pin.
    parts
        Parts in the deck with their levels.
    notes
        What was ignored, in words.
    path
        The board file.
    reactances
        Capacitors and inductors, each a state; without those inside a vendor's nested subcircuits.
    declared
        Instance paths of blocks that are meant to be bistable or to oscillate.
    """

    lines: tuple[Line, ...]
    board: str
    pins: tuple[str, ...]
    joints: int
    amplifiers: tuple[Amplifier, ...]
    parts: tuple[Part, ...]
    notes: tuple[str, ...]
    path: Path
    reactances: int = 0
    declared: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The deck without ``.end``, ready for more lines behind it."""
        return "".join(line.text + "\n" for line in self.lines)

    @property
    def digest(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def board_pins(joints: int) -> tuple[str, ...]:
    """Return the pins that a board for so many joints must have, in the customary order."""
    each = [form.format(j=j) for form in _JOINT_PINS[:3] for j in range(1, joints + 1)]
    pairs = [
        form.format(i=i, j=j)
        for form in _PAIR_PINS
        for i in range(1, joints + 1)
        for j in range(1, joints + 1)
    ]
    last = [form.format(j=j) for form in _JOINT_PINS[3:] for j in range(1, joints + 1)]
    return (*each, *pairs, *last, "vcc", "vee")


def load_deck(
    path: str | Path,
    *,
    levels: Mapping[str, str] | None = None,
    parts: Mapping[str, PartSwap | str] | None = None,
    overrides: Mapping[str, str] | None = None,
    features: Iterable[Feature] = (),
    temperature_c: float = NOMINAL_C,
    trust: bool = False,
    root: str | Path | None = None,
) -> Deck:
    """Read a board and all that belongs to it into one flat deck.

    Parameters
    ----------
    path
        Board file: a netlist fragment with one subcircuit that has the pins of `board_pins`.
    levels
        Role of a part (`ROLES`) -> section of its ``.lib`` file, ``ideal`` where nothing is said. ``driver``
        is the kind of drive (``voltage`` or ``current``), ``driver_level`` the level of its amplifier.
    parts
        Name or role of a part -> the part's name or the vendor's model that stands in for it.
    overrides
        Name of a ``.param``, designator of an element, or ``instance.parameter`` -> new value.
    features
        Single effects that parts and blocks carry as a ``.param`` of 0 or 1; others keep their file's value.
    temperature_c
        Temperature of the whole board [C].
    trust
        Whether to let control blocks, file access and includes from anywhere pass.
    root
        Folder that includes may not leave; the board's own by default.

    Raises
    ------
    InputError
        For a missing file or pin, a refused statement or name, an unknown part, level or override, and a
        node that only current sources touch.
    """
    path = Path(path)
    reader = Reader(Path(root) if root is not None else path.parent, trust)
    shelf = Shelf(path.parent, reader, dict(levels or {}), _lower(parts or {}))
    net = parse(_without_title(reader.rows(path), reader.read(path)))
    refused = judged(net.top, trust) + judged_bench(net.bench, trust)
    try:
        board = _board(path, net)
    except InputError:
        if refused:  # what could not be read may be what is missing
            raise InputError(refused) from None
        raise
    _complete(net, board, shelf, refused)
    check_size(net.blocks, board)
    features = tuple(features)
    _check_overrides(overrides or {}, features, temperature_c)
    changes = apply_overrides(net, board, overrides or {}) + _switch(net, shelf, features)
    warm = _heat(net, temperature_c)
    conditionals.settle(net)
    joints = _joints(board)
    blocks = _reachable(net, board)
    idle = unused(
        net, blocks, overrides or {}, shelf=shelf.folder / "parts", constants=_used_constants(shelf)
    )
    warn(*(Caution("value-unused", text, "take it out, or switch on what reads it") for text in idle))
    short = shorts(net, blocks)
    if short:
        raise InputError(short)
    unfed = unfed_nodes(net.blocks, board, set(global_nodes(net)))
    if unfed:
        raise InputError(unfed)
    lines = [Line(f"{board.name}: {joints} joint{'s' if joints > 1 else ''}")]
    behaviour = Dialect.behaviour(shelf.dialects)
    if behaviour is not None:
        lines.append(Line(f"*@ ngbehavior={behaviour}"))
    lines += net.top + warm
    for block in blocks:
        lines += block.lines
    if trust:
        lines = [replace(line, trusted=refusal(line) is not None) for line in lines]
    gate.check(lines)
    return Deck(
        tuple(lines),
        board.name,
        board.pins,
        joints,
        tuple(amplifiers(net, board, shelf)),
        tuple(shelf.used[name] for name in sorted(shelf.used) if name in net.blocks),
        (*notes(net, blocks), *changes),
        path,
        reactances(net, board),
        tuple(declared(net, board)),
    )


def _check_overrides(overrides: Mapping[str, str], features: Iterable[Feature], temperature_c: float) -> None:
    """Refuse values that an effect of the scene would set again."""
    owners = {feature.name: f"effects.{feature.name}" for feature in features}
    if temperature_c != NOMINAL_C:
        owners["temperature_c"] = "device.temperature_c"
    problems = [
        Problem(f"is what {owners[name.strip().lower()]} sets: state it there", key=name, value=value)
        for name, value in overrides.items()
        if name.strip().lower() in owners
    ]
    if problems:
        raise InputError(problems)


def _used_constants(shelf: Shelf) -> set[str]:
    """Return the constants of parts that are used where no element uses them."""
    return {name for part in shelf.used.values() for name in (part.swing, part.density) if name is not None}


def _switch(net: Netlist, shelf: Shelf, features: Iterable[Feature]) -> list[str]:
    """Set the parameter of every single effect; return what cannot be switched, in words.

    Raises
    ------
    InputError
        Naming each part that cannot carry an effect in force.
    """
    problems, notes = [], dict[str, None]()
    for feature in features:
        switched = set_param(net, feature.name, str(int(feature.on)))
        for part in (shelf.used[name] for name in sorted(shelf.used) if name in net.blocks):
            if part.role not in feature.roles or part.level == "full":
                continue
            if part.level is None:
                notes[f"{part.name} is a vendor's model: it carries what its file holds, the effects of "
                     f"{part.role} (level, offset, slew and the like) do not switch it"] = None  # fmt: skip
            elif feature.on and not (switched and conditionals.mentions(net.blocks[part.name], feature.name)):
                problems.append(
                    Problem(
                        f"the part {part.name} does not carry this effect at its level {part.level}: its "
                        f"section would have to use .param {feature.name}",
                        file=net.blocks[part.name].header.file,
                        key=f"effects.{feature.name}",
                        value=feature.on,
                    )
                )
        if not switched and not feature.roles:
            notes[f"no block of the board states .param {feature.name}: it is as the netlist has it"] = None
    if problems:
        raise InputError(problems)
    return list(notes)


def _heat(net: Netlist, temperature_c: float) -> list[Line]:
    """Tell ngspice and the parameter of that name the temperature, where it is not the nominal one."""
    if temperature_c == NOMINAL_C:
        return []
    set_param(net, "temperature_c", repr(temperature_c))
    return [Line(f".temp {temperature_c!r}")]


def _lower(parts: Mapping[str, PartSwap | str]) -> dict[str, PartSwap | str]:
    return {key.lower(): value.lower() if isinstance(value, str) else value for key, value in parts.items()}


def _without_title(rows: list[Line], lines: list[Line]) -> list[Line]:
    """Drop the first line if it can only be a title; one that starts with a dot or star is read."""
    first = rows[:1]
    if first and lines and lines[0] == first[0] and first[0].lineno == 1 and first[0].text[0] not in ".*":
        return lines[1:]
    return lines


def _board(path: Path, net: Netlist) -> Block:
    """Return the subcircuit that is a board: the one with numbered pins such as ``imot1``."""
    boards = [block for block in net.blocks.values() if any(map(_NUMBERED_PIN.fullmatch, block.pins))]
    if len(boards) != 1:
        names = ", ".join(block.name for block in boards or net.blocks.values()) or "none"
        fail(
            f"the file must hold one board, a .subckt with pins such as imot1; found: {names}", file=str(path)
        )
    _check_pins(boards[0])
    return boards[0]


def _joints(board: Block) -> int:
    """Return the number of joints whose pins are most like the board's: a missing pin does not change it."""
    pins = set(board.pins)
    return min(range(MOST_JOINTS, 0, -1), key=lambda joints: len(pins ^ set(board_pins(joints))))


def _check_pins(board: Block) -> None:
    """Raise an `InputError` that lists every missing, unknown and doubled pin."""
    joints = _joints(board)
    file, line = board.header.file, board.header.lineno
    motors = sum(re.fullmatch(r"imot\d+", pin) is not None for pin in board.pins)
    if motors > MOST_JOINTS:
        fail(f"a board has at most {MOST_JOINTS} joints", file=file, line=line, key=board.name, value=motors)
    wanted = board_pins(joints)
    problems = [
        Problem(
            f"board {board.name} of {joints} joint{'s' if joints > 1 else ''} lacks the pin",
            file=file,
            line=line,
            key=pin,
        )
        for pin in wanted
        if pin not in board.pins
    ]
    problems += [
        Problem(
            f"board {board.name} has an unknown pin, nearest is {nearest(pin, wanted)}",
            file=file,
            line=line,
            key=pin,
        )
        for pin in board.pins
        if pin not in wanted
    ]
    doubled = sorted({pin for pin in board.pins if board.pins.count(pin) > 1})
    problems += [
        Problem(f"board {board.name} has the pin twice", file=file, line=line, key=pin) for pin in doubled
    ]
    if problems:
        raise InputError(problems)


def _complete(net: Netlist, board: Block, shelf: Shelf, refused: list[Problem]) -> None:
    """Swap parts, add every part that is instantiated but not defined, and judge what is needed.

    `refused` are problems outside subcircuits; all problems are raised together.
    """
    problems = list(refused)
    wanted, seen = [board.name], {board.name}
    top, bench = len(net.top), len(net.bench)
    while wanted:
        block = net.blocks[wanted.pop(0)]
        wrong = judged_block(block, shelf.reader.trust)
        if wrong:
            problems += wrong
            continue
        _take_as_part(block, shelf)
        for instance in block.references():
            swapped = None if block.is_part else shelf.swapped(instance)
            name = instance.block
            if swapped is not None:
                line, model = swapped
                block.body[instance.index] = line
                name = line_block = tokens(line.text)[-1].lower()
                if line_block not in seen:
                    net.add(model)
            elif name not in net.blocks:
                part = shelf.take(name)
                if part is None:
                    near = nearest(name, [*net.blocks, *shelf.names()])
                    problems.append(
                        Problem(
                            f"subcircuit '{name}' is not defined" + (f", nearest is {near}" if near else ""),
                            file=instance.line.file,
                            line=instance.line.lineno,
                            value=instance.line.text,
                        )
                    )
                    continue
                net.add(part)
            pins = net.blocks[name].pins if name in net.blocks else ()
            nodes = len(instance.nodes)
            if name not in net.blocks:
                fail(f"the part's file does not define .subckt {name}", file=instance.line.file)
            if swapped is None and nodes != len(pins):
                problems.append(
                    Problem(
                        f"{instance.name} connects {nodes} nodes, {name} has {len(pins)} ({' '.join(pins)})",
                        file=instance.line.file,
                        line=instance.line.lineno,
                        value=instance.line.text,
                    )
                )
            if name not in seen:
                seen.add(name)
                wanted.append(name)
    problems += judged(net.top[top:], shelf.reader.trust) + judged_bench(
        net.bench[bench:], shelf.reader.trust
    )
    if problems:
        raise InputError(problems)


def _take_as_part(block: Block, shelf: Shelf) -> None:
    """Let a subcircuit that the board includes itself be the part that a ``*@`` line before it describes."""
    part = described(block.name, block.about, block.header.file) if block.about else None
    if part is not None and part.role is not None and not block.is_part:
        block.is_part = True
        shelf.used.setdefault(block.name, part)


def _reachable(net: Netlist, board: Block) -> list[Block]:
    """Return the board and all it instantiates, the board last."""
    blocks: dict[str, Block] = {}

    def visit(block: Block) -> None:
        for instance in block.references():
            if instance.block not in blocks:
                visit(net.blocks[instance.block])
        blocks[block.name] = block

    visit(board)
    return list(blocks.values())
