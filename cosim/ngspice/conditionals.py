"""``.if`` blocks, decided before ngspice sees them: branches not taken leave no line behind."""

import re
from collections.abc import Mapping

from cosim.errors import fail
from cosim.ngspice.expression import evaluate, is_well_formed
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Netlist

__all__ = ["flags", "mentions", "settle"]

_ROUNDS = 20
"""Depth of parameters that are stated by later ones."""


def flags(net: Netlist) -> dict[str, float]:
    """Return the parameters outside subcircuits whose value comes to a plain number."""
    pairs = [
        (name.lower(), text.strip("{}'"))
        for line in net.top
        if line.keyword in (".param", ".params")
        for name, _, text in (word.partition("=") for word in tokens(line.text)[1:])
    ]
    known: dict[str, float] = {}
    for _ in range(_ROUNDS):  # a value may be stated behind its use
        values = {name: evaluate(text, known) for name, text in pairs}  # the last definition counts
        now = {name: value for name, value in values.items() if value is not None}
        if now == known:
            break
        known = now
    return known


def mentions(block: Block, name: str) -> bool:
    """Whether a subcircuit's lines use a parameter."""
    word = re.compile(rf"\b{re.escape(name)}\b", re.IGNORECASE)
    return any(word.search(line.text) for line in block.lines)


def settle(net: Netlist) -> None:
    """Decide every ``.if`` of the subcircuits that depends on plain parameters alone; ngspice has the rest.

    Raises
    ------
    InputError
        For ``.else`` or ``.endif`` without ``.if``, and ``.if`` without ``.endif``.
    """
    known = flags(net)
    for block in net.blocks.values():
        if any(line.keyword in (".if", ".elseif", ".else", ".endif") for line in block.body):
            own = _own(block)
            block.body = _settled(block.body, {k: v for k, v in known.items() if k not in own})


def _own(block: Block) -> set[str]:
    """Return the names of a subcircuit's own parameters, which hide those outside."""
    rows = [tokens(line.text)[1:] for line in block.body if line.keyword in (".param", ".params")]
    return {*block.params, *(word.partition("=")[0].lower() for row in rows for word in row)}


def _settled(body: list[Line], known: Mapping[str, float]) -> list[Line]:
    kept: list[Line] = []
    # per open .if: whether its present branch is read, whether one was read already (None: ngspice decides)
    stack: list[tuple[bool, bool | None]] = []
    opened: list[Line] = []
    for line in body:
        read = all(branch for branch, _ in stack)
        if line.keyword == ".if":
            decided = _holds(line, known) if read else False
            stack.append((decided is not False, decided))
            opened.append(line)
            if read and decided is None:
                kept.append(line)
        elif line.keyword in (".elseif", ".else", ".endif"):
            if not stack:
                fail(f"{line.keyword} without .if", file=line.file, line=line.lineno, value=line.text)
            _, taken = stack.pop()
            outside = all(branch for branch, _ in stack)
            if taken is None:
                if outside:
                    kept.append(line)
            elif line.keyword == ".elseif":
                decided = None if taken else _holds(line, known)
                if decided is None and not taken:
                    fail("depends on more than plain parameters, and the .if before it does not",
                         file=line.file, line=line.lineno, value=line.text)  # fmt: skip
                stack.append((bool(decided), taken or bool(decided)))
                continue
            if line.keyword == ".endif":
                opened.pop()
            else:
                stack.append((True, None) if taken is None else (not taken, True))
        elif read:
            kept.append(line)
    if opened:
        fail(".if without .endif", file=opened[-1].file, line=opened[-1].lineno, value=opened[-1].text)
    return kept


def _holds(line: Line, known: Mapping[str, float]) -> bool | None:
    """Return the truth of a condition, ``None`` where it holds more than plain parameters."""
    text = line.text.partition(" ")[2].strip()
    if not text or not is_well_formed(text):
        fail("is not a condition", file=line.file, line=line.lineno, value=line.text)
    value = evaluate(text, known)
    return None if value is None else bool(value)
