"""Values that the user sets and that nothing in the board as it is uses."""

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from cosim.ngspice.conditionals import flags
from cosim.ngspice.expression import evaluate
from cosim.ngspice.lines import Line, tokens
from cosim.ngspice.netlist import Block, Netlist

__all__ = ["unused"]

_NAME = re.compile(r"[a-z_]\w*")
_CHOICE = re.compile(r"(?P<if>[\w.!()&| ]+)\?(?P<then>[^?:{}]*):(?P<else>[^?:{}]*)")


def unused(
    net: Netlist,
    blocks: list[Block],
    overrides: Mapping[str, str],
    *,
    shelf: Path,
    constants: Collection[str],
) -> list[str]:
    """Say which of the overridden parameters no element of the board depends on.

    Parameters
    ----------
    net, blocks
        The netlist with its conditions settled, and the subcircuits that the board needs.
    overrides
        Names of parameters (and of elements, which are not looked at) -> values.
    shelf
        Folder of the parts, whose constants tell data of the parts and steer nothing.
    constants
        Names of those among them that are used.
    """
    plain = [name.strip().lower() for name in overrides if "." not in name]
    if not plain:
        return []
    known = flags(net)
    alive = _of_constants(net, shelf, constants, known)
    for block in blocks:
        alive |= _of_block(block, known)
    definitions = list(_definitions(net.top))
    alive = _closure(alive, definitions, known)
    stated = {name for name, _ in definitions}
    return [
        f"{name} = {overrides[name]}: nothing in the board as it is depends on it (an effect that is off, or "
        "a level of a part that leaves it out)"
        for name in overrides
        if name.strip().lower() in stated - alive
    ]


def _definitions(lines: Iterable[Line]) -> Iterable[tuple[str, str]]:
    for line in lines:
        if line.keyword in (".param", ".params"):
            for word in tokens(line.text)[1:]:
                name, _, value = word.partition("=")
                yield name.lower(), value.lower()


def _of_constants(
    net: Netlist, shelf: Path, constants: Collection[str], known: Mapping[str, float]
) -> set[str]:
    """Return the names in constants of the board, and in those of parts that are used."""
    alive: set[str] = set()
    for line in net.top:
        if line.keyword != ".csparam":
            if line.keyword not in (".param", ".params"):
                alive |= _names(line.text.lower(), known)
            continue
        name, _, value = line.text.split(None, 1)[1].lower().partition("=")
        if Path(line.file).parent != shelf or name.strip() in constants:
            alive |= _names(value, known)
    return alive


def _of_block(block: Block, known: Mapping[str, float]) -> set[str]:
    """Return the names outside that a subcircuit's elements depend on."""
    definitions = [
        *((name, value.lower()) for name, value in block.params.items()),
        *_definitions(block.body),
    ]
    inside = {name for name, _ in definitions}
    others = (line for line in block.body if line.keyword not in (".param", ".params"))
    used = set().union(*(_names(line.text.lower(), known) for line in others))
    return _closure(used, definitions, known) - inside


def _closure(alive: set[str], definitions: Iterable[tuple[str, str]], known: Mapping[str, float]) -> set[str]:
    alive = set(alive)
    waiting = list(definitions)
    while True:
        now = [(name, value) for name, value in waiting if name in alive]
        if not now:
            return alive
        waiting = [pair for pair in waiting if pair not in now]
        for _, value in now:
            alive |= _names(value, known)


def _names(text: str, known: Mapping[str, float]) -> set[str]:
    """Return the names in an expression; of ``c ? a : b`` with a known ``c``, those of its branch."""

    def branch(match: re.Match[str]) -> str:
        value = evaluate(match["if"], known)
        if value is None:
            return match[0].replace("?", " ").replace(":", " ")
        return match["then" if value else "else"]

    if "?" in text:
        text = _CHOICE.sub(branch, text)
    return set(_NAME.findall(text))
