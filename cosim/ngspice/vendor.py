"""One subcircuit out of a vendor's library, with what it needs and nothing else."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Netlist
from cosim.ngspice.safety import INLINED, KEPT
from cosim.ngspice.syntax import malformed

__all__ = ["chosen"]

_WORD = re.compile(r"[^\s(){}\[\]=,'\"*/+^<>&|?:!-]+")
#: Letter of an element -> the first place where the name of its model can stand.
_MODEL_PLACE = {"d": 3, "q": 4, "j": 4, "m": 5, "s": 5, "w": 4}


def chosen(library: Netlist, name: str, file: Path) -> Netlist:
    """Return the subcircuit `name` with the subcircuits, models, functions and parameters that it needs.

    Parameters
    ----------
    library
        The whole file, leniently parsed.
    name
        Name of the subcircuit in lower case.
    file
        The library's file.

    Raises
    ------
    InputError
        If the library has no such subcircuit; with what is wrong with the library's structure.
    """
    if name not in library.blocks:
        near = nearest(name, library.blocks)
        problem = Problem(f"no such subcircuit{f', nearest is {near}' if near else ''}", file=str(file),
                          key="subckt", value=name,
                          allowed=", ".join(list(library.blocks)[:8]) or "the file defines none")  # fmt: skip
        raise InputError([problem, *library.slips, *(_problem(line) for line in _unread(library))])
    wanted, blocks = [name], dict[str, Block]()
    missing: set[str] = set()
    while wanted:
        block = library.blocks[wanted.pop()]
        if block.name in blocks:
            continue
        blocks[block.name] = _with_slips(block, library)
        for instance in block.references():
            if instance.block in library.blocks:
                wanted.append(instance.block)
            else:
                missing.add(instance.block)
    top, rest = _needed(library.top, [line for block in blocks.values() for line in block.lines])
    unread = _unread(library)
    if unread and (missing or _without_model(blocks.values(), top)):
        top += unread  # what is missing may stand there: report why it cannot be read
        unread = []
    return Netlist(blocks, top, [], [*library.dropped, *unread, *rest])


def _unread(library: Netlist) -> list[Line]:
    return [line for line in library.top if line.keyword in INLINED]


def _problem(line: Line) -> Problem:
    return Problem(line.fault, file=line.file, line=line.lineno, value=line.text)


def _with_slips(block: Block, library: Netlist) -> Block:
    """Note on the subcircuit's header that the library defines it once more."""
    again = next(
        (slip for slip in library.slips if slip.message.startswith(f"subcircuit {block.name} is")), None
    )
    if again is None:
        return block
    note = f"{again.message}, at line {again.line}: the first counts, as in ngspice"
    return replace(block, header=replace(block.header, note=note))


def _words(lines: Iterable[Line]) -> set[str]:
    return {word for line in lines for word in _WORD.findall(line.text.lower())}


def _needed(top: list[Line], lines: list[Line]) -> tuple[list[Line], list[Line]]:
    """Return what the lines need of the statements outside subcircuits, and what is not known there."""
    defining = {line: set(_defined(line)) for line in top if line.keyword in KEPT}
    words = _words(lines)
    always = (".opt", ".global", ".temp", ".csparam")  # constants are for whoever asks
    kept: set[Line] = {line for line in defining if line.keyword.startswith(always) and not malformed(line)}
    while True:
        more = {line for line, names in defining.items() if line not in kept and names & words}
        if not more:
            break
        kept |= more
        words |= _words(more)
    # a second model of one name is none to ngspice either
    first: dict[tuple[str, str], Line] = {}
    for line in (each for each in top if each in kept and each.keyword == ".model"):
        first.setdefault((line.keyword, next(iter(_defined(line)), "")), line)
    models = set(first.values())
    in_order = [
        line
        for line in dict.fromkeys(top)
        if (line in kept and (line.keyword != ".model" or line in models))
        or line.keyword.startswith(".control")
    ]
    unknown = [line for line in top if line.keyword not in KEPT and line.keyword not in INLINED]
    return in_order, [line for line in unknown if line.keyword.startswith(".") and line not in in_order]


def _defined(line: Line) -> Iterator[str]:
    """Yield the names that a statement defines."""
    words = [word.lower() for word in tokens(line.text)[1:]]
    if line.keyword in (".param", ".params"):
        yield from (word.partition("=")[0] for word in words)
    elif line.keyword in (".model", ".func") and words:
        yield words[0].partition("(")[0]


def _without_model(blocks: Iterable[Block], top: list[Line]) -> bool:
    """Whether a device has a model that is nowhere defined."""
    for block in blocks:
        known = {n for line in (*top, *block.body) if line.keyword == ".model" for n in _defined(line)}
        for line in block.body:
            place = _MODEL_PLACE.get(line.keyword[:1])
            if place is not None and not known & {word.lower() for word in tokens(line.text)[place:]}:
                return True
    return False
