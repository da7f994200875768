"""The structure of a netlist: subcircuits, the statements outside them, and instances."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from cosim.errors import InputError, Problem, fail
from cosim.ngspice.lines import Line, assignments, join, tokens
from cosim.ngspice.safety import DROPPED

__all__ = ["DECLARED", "Block", "Instance", "Netlist", "doubled", "element_nodes", "parse"]

MOST_NESTED = 40
"""Depth of subcircuits that are defined inside each other."""
DECLARED = ("bistable", "oscillating")
"""What a block may declare itself to be where it is not meant to be stable."""

_TERMINALS = {"r": 2, "c": 2, "l": 2, "v": 2, "i": 2, "d": 2, "b": 2, "e": 4, "g": 4, "f": 2, "h": 2, "k": 0,
              ".": 0, "q": 3, "j": 3, "m": 4, "s": 4, "w": 2}  # fmt: skip
_POLY = re.compile(r"\S+ \S+ \S+ poly ?\( ?(\d{1,3}) ?\)")
_FORMULA = re.compile(r"[={']|\b(vol|value|table|laplace|freq|cur)\b", re.IGNORECASE)
_PARTS = re.compile(r"[\s(),]+")
_VOLTAGE = re.compile(r"\bv\(\s*([^\s,()]+)\s*(?:,\s*([^\s,()]+)\s*)?\)")


@dataclass
class Block:
    """One subcircuit.

    Attributes
    ----------
    name, pins
        As on the ``.subckt`` line, in lower case.
    params
        Parameters with their default values.
    header, body
        The lines; nested definitions stay in the body as they are.
    local
        Names of nested subcircuits.
    is_part
        Whether it came from a part's or a vendor's file and not from the board or its blocks.
    origin
        Name of the subcircuit it is a copy of; its own name if it is none.
    about
        The ``*@`` comment before it in its file.
    stability
        What its ``*@ stability=`` line declares, one of `DECLARED`; empty without one.
    """

    name: str
    pins: tuple[str, ...]
    params: dict[str, str]
    header: Line
    body: list[Line] = field(default_factory=list)
    local: set[str] = field(default_factory=set)
    is_part: bool = False
    origin: str = ""
    about: str = ""
    stability: str = ""

    def __post_init__(self) -> None:
        self.origin = self.origin or self.name

    @property
    def lines(self) -> list[Line]:
        """All lines of the definition."""
        return [self.header, *self.body, Line(f".ends {self.name}", self.header.file, self.header.lineno)]

    def instances(self) -> list["Instance"]:
        """Return the instances of other subcircuits, those in nested definitions left out."""
        out, depth = [], 0
        for index, line in enumerate(self.body):
            if line.keyword == ".subckt":
                depth += 1
            elif line.keyword in (".ends", ".eom"):
                depth -= 1
            elif depth == 0 and line.keyword.startswith("x"):
                out.append(Instance.of(line, index))
        return out

    def references(self) -> list["Instance"]:
        """Return all instances of subcircuits that are not defined inside this one."""
        every = (Instance.of(line, i) for i, line in enumerate(self.body) if line.keyword.startswith("x"))
        return [instance for instance in every if instance.block not in self.local]

    def loose_nodes(self) -> list[str]:
        """Return nodes that only one terminal touches: mostly misspelt names.

        Elements whose terminals cannot be counted by their letter alone make no node suspicious.
        """
        counts: dict[str, int] = dict.fromkeys(self.pins, 1)
        for line in self.body:
            spoken = (name for pair in _VOLTAGE.findall(line.text.lower()) for name in pair if name)
            for node in (*element_nodes(line), *spoken):
                counts[node] = counts.get(node, 0) + 1
        return [node for node, count in counts.items() if count == 1 and node not in (*self.pins, "0", "gnd")]


def element_nodes(line: Line) -> list[str]:
    """Return the nodes that an element touches; all its words where its letter does not tell how many."""
    words = [word.lower() for word in tokens(line.text)]
    if words[0].startswith("x"):
        return list(Instance.of(line, 0).nodes)
    count = _TERMINALS.get(words[0][0], len(words))
    if words[0][0] not in "eg":
        return words[1 : 1 + count]
    poly = _POLY.match(line.text.lower())
    if poly is None and _FORMULA.search(line.text):  # what stands behind the second node is no node
        return words[1:3]
    ports = 2 if poly is None else 2 * int(poly[1])
    rest = join(words[3:]) if poly is None else line.text.lower()[poly.end() :]
    return [*words[1:3], *[part for part in _PARTS.split(rest) if part][:ports]]


@dataclass(frozen=True)
class Instance:
    """An X line: ``xname node ... block param=value ...``, in lower case; `index` is its place."""

    name: str
    nodes: tuple[str, ...]
    block: str
    extra: tuple[str, ...]
    line: Line
    index: int

    @classmethod
    def of(cls, line: Line, index: int) -> "Instance":
        """Read an X line."""
        words = tokens(line.text)
        plain = [word for word in words if "=" not in word and word.lower() not in ("params:", "params")]
        if len(plain) < 2:
            fail("an instance needs a subcircuit's name", file=line.file, line=line.lineno, value=line.text)
        extra = tuple(word for word in words if "=" in word)
        return cls(
            plain[0].lower(), tuple(n.lower() for n in plain[1:-1]), plain[-1].lower(), extra, line, index
        )

    def rewritten(
        self,
        *,
        nodes: Iterable[str] | None = None,
        block: str | None = None,
        extra: Iterable[str] | None = None,
    ) -> Line:
        """Return the line with other nodes, another subcircuit or other parameters."""
        words = tokens(self.line.text)[:1]
        words += self.nodes if nodes is None else nodes
        words.append(self.block if block is None else block)
        words += self.extra if extra is None else extra
        return self.line.rewritten(join(words))


@dataclass
class Netlist:
    """What a set of lines defines.

    Attributes
    ----------
    blocks
        Subcircuits by name.
    top
        Statements outside subcircuits that describe the circuit (``.param``, ``.model``, ...).
    bench
        Elements outside subcircuits.
    dropped
        Harmless statements that are ignored.
    slips
        Faults of the structure, where it was read leniently.
    """

    blocks: dict[str, Block] = field(default_factory=dict)
    top: list[Line] = field(default_factory=list)
    bench: list[Line] = field(default_factory=list)
    dropped: list[Line] = field(default_factory=list)
    slips: list[Problem] = field(default_factory=list)

    def add(self, other: "Netlist") -> None:
        """Take over what `other` defines; two different things of one name are an error."""
        problems = []
        for name, block in other.blocks.items():
            mine = self.blocks.setdefault(name, block)
            if [line.text for line in mine.lines] != [line.text for line in block.lines]:
                problems.append(_twice(f"subcircuit {name}", block.header, mine.header))
        known = {line.text for line in self.top}
        named = {_definition(line): line for line in self.top}
        for line in other.top:
            if line.text in known:
                continue
            rival = named.get(_definition(line))
            if rival is not None and line.keyword in (".model", ".func"):
                problems.append(_twice(f"{line.keyword[1:]} {_definition(line)[1]}", line, rival))
            self.top.append(line)
        self.bench += other.bench
        self.dropped += other.dropped
        if problems:
            raise InputError(problems)


def parse(lines: Iterable[Line], *, is_part: bool = False, lenient: bool = False) -> Netlist:
    """Sort lines into subcircuits and the rest.

    Parameters
    ----------
    lines
        Logical lines.
    is_part
        Whether they come from a part's or a vendor's file.
    lenient
        Whether to keep what is wrong in `Netlist.slips` instead of raising: in a vendor's library it may
        stand in another part. Of two subcircuits of one name the first counts, as in ngspice.

    Raises
    ------
    InputError
        For ``.subckt`` without ``.ends``, ``.ends`` without ``.subckt``, and two definitions of one name.
    """
    net = Netlist()
    slips = net.slips
    stack: list[Block] = []
    in_control, about = False, Line("")
    for line in lines:
        word = line.keyword
        if in_control or word.startswith(".control"):  # only trusted netlists get here with one
            in_control = not word.startswith(".endc")
            net.top.append(line)
        elif word == ".subckt":
            block = _header(line, is_part, about.text if about.file == line.file else "", slips)
            if stack:
                stack[0].body.append(line)
                stack[0].local.add(block.name)
            stack.append(block)
            if len(stack) > MOST_NESTED:
                fail(f"subcircuits are defined inside each other more than {MOST_NESTED} deep",
                     file=line.file, line=line.lineno)  # fmt: skip
        elif word in (".ends", ".eom") or (lenient and _closes(line, stack)):
            if not stack:
                slips.append(Problem(f"{word} without .subckt", file=line.file, line=line.lineno))
                continue
            block = stack.pop()
            if stack:
                stack[0].body.append(line)
            elif block.name not in net.blocks:
                net.blocks[block.name] = block
            elif [row.text for row in block.lines] != [row.text for row in net.blocks[block.name].lines]:
                slips.append(_twice(f"subcircuit {block.name}", block.header, net.blocks[block.name].header))
        elif word in DROPPED:
            net.dropped.append(line)
        elif word.startswith("*@"):
            slips += _declare(line, stack)
            about = about if stack else line
        elif stack:
            stack[0].body.append(line)
        elif word.startswith(".") and not (lenient and word.strip(".") == ""):
            net.top.append(line)
        else:
            net.bench.append(line)
    for block in stack:
        slips.append(
            Problem(f".subckt {block.name} without .ends", file=block.header.file, line=block.header.lineno)
        )
    if slips and not lenient:
        raise InputError(slips)
    return net


def _closes(line: Line, stack: list[Block]) -> bool:
    """Whether an ``.end`` with the name of the open subcircuit stands for its ``.ends``."""
    return line.keyword == ".end" and bool(stack) and line.text.lower().split()[1:] == [stack[-1].name]


def _declare(line: Line, stack: list[Block]) -> list[Problem]:
    """Take what a ``*@ stability=`` line says of its block; other ``*@`` lines are not for us."""
    stability = assignments(tokens(line.text)).get("stability")
    if stability is None:
        return []
    if stability.lower() not in DECLARED:
        return [
            Problem(
                "unknown declaration", file=line.file, line=line.lineno, key="stability", value=stability,
                allowed=", ".join(DECLARED),
            )
        ]  # fmt: skip
    if not stack:
        return [Problem("the line must stand inside the .subckt that it is about", file=line.file,
                        line=line.lineno, key="stability", value=stability)]  # fmt: skip
    stack[0].stability = stability.lower()
    return []


def doubled(block: Block) -> list[Problem]:
    """Return the elements of a subcircuit that bear the name of an earlier one."""
    problems, depth, seen = [], 0, dict[str, Line]()
    for line in block.body:
        depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
        if depth == 0 and not line.keyword.startswith("."):
            if line.keyword in seen:
                problems.append(_twice(f"element {tokens(line.text)[0]}", line, seen[line.keyword]))
            seen.setdefault(line.keyword, line)
    return problems


def _header(line: Line, is_part: bool, about: str, slips: list[Problem]) -> Block:
    words = tokens(line.text)
    if len(words) < 2:
        slips.append(Problem(".subckt needs a name", file=line.file, line=line.lineno))
        words.append("")
    pins: list[str] = []
    for word in words[2:]:
        if "=" in word or word.lower() in ("params:", "optional:", "text:"):
            break
        pins.append(word.lower())
    return Block(words[1].lower(), tuple(pins), assignments(words[2:]), line, is_part=is_part, about=about)


def _definition(line: Line) -> tuple[str, str]:
    words = tokens(line.text)
    name = words[1].lower() if len(words) > 1 else ""
    return line.keyword, name.partition("(")[0]


def _twice(what: str, here: Line, there: Line) -> Problem:
    return Problem(f"{what} is defined again, after {there.file}:{there.lineno}", file=here.file,
                   line=here.lineno)  # fmt: skip
