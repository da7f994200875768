"""Checks of what goes into a deck, and only of that: permission, form, and size."""

from collections.abc import Iterable, Mapping

from cosim.errors import Problem, fail
from cosim.ngspice.lines import Line, strange_character
from cosim.ngspice.netlist import Block, Instance, doubled, parse
from cosim.ngspice.safety import refusal
from cosim.ngspice.syntax import malformed

__all__ = ["check_size", "judged", "judged_bench", "judged_block"]

MOST_ELEMENTS = 200_000
"""Elements of a board, those of every instance counted; six joints of vendors' parts have some 30,000."""
MOST_DEEP = 60
"""Depth of instances within instances."""


def judged(lines: Iterable[Line], trust: bool) -> list[Problem]:
    """Return what is wrong with statements that the deck needs; with `trust`, only what cannot be read."""
    if trust:
        return [Problem(line.fault, file=line.file, line=line.lineno, value=line.text)
                for line in lines if line.fault]  # fmt: skip
    return [problem for line in lines if (problem := refusal(line) or malformed(line)) is not None]


def judged_block(block: Block, trust: bool) -> list[Problem]:
    """Return what is wrong with a subcircuit that the deck needs."""
    return judged([block.header, *block.body], trust) + doubled(block)


def judged_bench(lines: Iterable[Line], trust: bool) -> list[Problem]:
    """Return what is wrong with what is left out since no subcircuit holds it: commands, hidden lines."""
    problems = []
    for line in () if trust else lines:
        strange = strange_character(line.text)
        if strange:
            problems.append(Problem(strange, file=line.file, line=line.lineno, value=line.text))
        elif line.keyword[:1].isalpha() and (refused := refusal(line)) is not None:
            problems.append(refused)
    return problems


def check_size(blocks: Mapping[str, Block], board: Block) -> None:
    """Refuse a board that instantiates itself, or that grows beyond `MOST_ELEMENTS` or `MOST_DEEP`.

    Raises
    ------
    InputError
        Naming the instance at which it happens.
    """
    _elements(board, {name: block for name, block in blocks.items()}, {}, ())


def _elements(
    block: Block, scope: Mapping[str, Block], known: dict[int, int], path: tuple[Block, ...]
) -> int:
    """Return the number of elements of a subcircuit with all that it instantiates."""
    if id(block) in known:
        return known[id(block)]
    header = block.header
    if block in path:
        fail(f"subcircuit {block.name} instantiates itself", file=header.file, line=header.lineno,
             value=" -> ".join(each.name for each in (*path, block)))  # fmt: skip
    if len(path) > MOST_DEEP:
        fail(f"instances within instances are more than {MOST_DEEP} deep", file=header.file,
             line=header.lineno, value=block.name)  # fmt: skip
    inner = parse(block.body)  # nested definitions apart, which are known in here only
    here = {**scope, **inner.blocks} if inner.blocks else scope
    count = 0
    for index, line in enumerate(inner.bench):
        count += 1
        child = here.get(Instance.of(line, index).block) if line.keyword.startswith("x") else None
        if child is not None:
            count += _elements(child, here, known, (*path, block))
    if count > MOST_ELEMENTS:
        fail(f"subcircuit {block.name} grows to {count} elements", file=header.file, line=header.lineno,
             allowed=f"<= {MOST_ELEMENTS}")  # fmt: skip
    known[id(block)] = count
    return count
