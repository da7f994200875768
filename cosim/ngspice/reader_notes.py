"""What the netlist reader left out, changed or found odd, in words."""

from cosim.ngspice.lines import assignments, tokens
from cosim.ngspice.netlist import Block, Netlist

__all__ = ["notes"]

#: What is done about initial conditions, which need not agree with the circuit.
_CONSISTENT = ": a run starts from the circuit's operating point"


def notes(net: Netlist, blocks: list[Block]) -> list[str]:
    """Say what was ignored, once per file and kind, and which nodes look misspelt."""
    counts: dict[tuple[str, str], int] = {}
    for line in net.dropped:
        if line.keyword not in (".end", ".title"):
            key = (line.file, line.keyword)
            counts[key] = counts.get(key, 0) + 1
    lines = [
        f"{file}: ignored {count} {word} line{'s' if count > 1 else ''}"
        + (_CONSISTENT if word == ".ic" else "")
        for (file, word), count in counts.items()
    ]
    lines += [
        f"{line.file}: {tokens(line.text)[0]} in {block.name}: ic = {stated} is not used{_CONSISTENT}"
        for block in blocks
        for line in block.body
        if (stated := assignments(tokens(line.text)).get("ic")) is not None
    ]
    lines += [
        f"{line.file}:{line.lineno}: {line.note}"
        for line in (*net.top, *(line for block in blocks for line in block.lines[:-1]))
        if line.note
    ]
    outside: dict[str, list[str]] = {}
    for line in net.bench:
        outside.setdefault(line.file, []).append(tokens(line.text)[0])
    lines += [
        f"{file}: ignored elements outside the board's subcircuit: {', '.join(names[:8])}"
        + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        for file, names in outside.items()
    ]
    lines += _unlisted_amplifiers(blocks)
    lines += [
        f"{block.header.file}: in {block.name} only one terminal touches node {node}"
        for block in blocks
        if not block.is_part
        for node in block.loose_nodes()
    ]
    return lines


def _unlisted_amplifiers(blocks: list[Block]) -> list[str]:
    """Say why no table of loops or headroom lists an amplifier that the board includes itself.

    A subcircuit with supplies among five pins or more, sources of its own and no instances counts as an
    amplifier.
    """
    board = blocks[-1]
    users = {x.block: f"{x.name} in {block.name}" for block in blocks for x in block.instances()}
    return [
        f"{block.header.file}: {block.name} ({users[block.name]}) is in no table of loops and headroom: "
        "a line `*@ role=opamp out=PIN` before its .subckt puts it there"
        for block in blocks
        if block is not board
        and not block.is_part
        and len(block.pins) >= 5
        and block.name in users
        and not block.references()
        and any(line.keyword[0] in "egfhbqjm" for line in block.body)
    ]
