"""Other values for parameters and elements, without another file."""

import re
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite

from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.lines import join, number, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist

__all__ = ["apply_overrides", "set_param"]

_VALUE_PLACE = {"r": 3, "c": 3, "l": 3, "v": 3, "i": 3, "e": 5, "g": 5, "f": 4, "h": 4}
"""Where the value stands on an element's line, by the element's letter."""

_EXPRESSION = re.compile(r"[{'][^{}'\"\n;]*[}']")


def apply_overrides(net: Netlist, board: Block, overrides: Mapping[str, str]) -> None:
    """Substitute values in `net`; all that is wrong is told at once.

    A name is looked for as a ``.param`` (every definition of it changes, so every use sees the value), then
    as an element's designator outside the parts, then inside them. A path such as ``xdiff1.r12`` names one
    instance's parameter or element; the subcircuits on the way are copied for that instance.

    Raises
    ------
    InputError
        For an unknown or ambiguous name, a value that is no SPICE number and no ``{expression}``, or a
        resistor of 0 Ohm.
    """
    problems = []
    # bare names first: they change a subcircuit before some instance gets its own copy of it
    for name, value in sorted(overrides.items(), key=lambda item: "." in item[0]):
        key, text = name.strip().lower(), str(value).strip()
        parsed = number(text)
        if (parsed is None and not _EXPRESSION.fullmatch(text)) or not isfinite(parsed or 0.0):
            problems.append(Problem("is not a SPICE number or {expression}", key=name, value=value))
            continue
        path = key.removeprefix("xboard.")
        error = _short(net, path.split(".")[-1]) if parsed == 0.0 else None
        if error is None:
            steps = path.split(".")
            error = _instance(net, board, steps, text) if len(steps) > 1 else _name(net, board, key, text)
        if error:
            problems.append(Problem(error, key=name, value=value))
    if problems:
        raise InputError(problems)


def _short(net: Netlist, key: str) -> str | None:
    """Say what is wrong with a value of zero: ngspice takes 1 mOhm for a resistor, and gains run away.

    A part may have a resistor that its ideal level sets to zero; a board's is a slip.
    """
    for block in net.blocks.values():
        for line in block.body if not block.is_part else ():
            words = line.text.lower().split()
            if words[0].startswith("r") and (key == words[0] or f"{{{key}}}" in words[3:4]):
                return f"makes {words[0]} of {block.name} a resistor of 0 Ohm; a short is a small value"
    return None


def _name(net: Netlist, board: Block, key: str, value: str) -> str | None:
    """Set a parameter or an element by its bare name; return what is wrong."""
    if set_param(net, key, value):
        return None
    for is_part in (False, True):
        owners = [
            block for block in net.blocks.values() if block.is_part is is_part and key in _elements(block)
        ]
        if len(owners) > 1:
            names = ", ".join(block.name for block in owners)
            return f"is an element of several subcircuits ({names}): name the instance, as in xdiff1.{key}"
        if owners:
            return _set_element(owners[0], key, value)
    known = [
        *_params(net),
        *(name for block in net.blocks.values() if not block.is_part for name in _elements(block)),
    ]
    return "no such parameter or element" + _near(key, known)


def _instance(net: Netlist, board: Block, path: list[str], value: str) -> str | None:
    """Set a parameter or an element of one instance; return what is wrong."""
    block = board
    for depth, step in enumerate(path[:-1]):
        found = [x for x in block.instances() if x.name == step]
        if not found:
            return f"{block.name} has no instance {step}" + _near(step, [x.name for x in block.instances()])
        instance = found[0]
        child = net.blocks[instance.block]
        last = depth == len(path) - 2
        if last and path[-1] in child.params:
            kept = [word for word in instance.extra if not word.lower().startswith(path[-1] + "=")]
            block.body[instance.index] = instance.rewritten(extra=[*kept, f"{path[-1]}={value}"])
            return None
        if last and path[-1] not in _elements(child):
            return f"{child.name} has no parameter or element {path[-1]}" + _near(
                path[-1], [*child.params, *_elements(child)]
            )
        block = _own_copy(net, block, instance, child)
    return _set_element(block, path[-1], value)


def _own_copy(net: Netlist, block: Block, instance: Instance, child: Block) -> Block:
    """Give an instance a subcircuit of its own."""
    name = f"{child.name}__{block.name}_{instance.name}"
    if child.name.endswith(f"__{block.name}_{instance.name}"):
        return child
    words = tokens(child.header.text)
    words[1] = name
    header = child.header.rewritten(join(words))
    copy = replace(child, name=name, header=header, body=list(child.body))  # `origin` stays
    net.blocks[name] = copy
    block.body[instance.index] = instance.rewritten(block=name)
    return copy


def set_param(net: Netlist, key: str, value: str) -> bool:
    """Give a ``.param`` another value wherever it is defined; return whether it is."""
    found = False
    for rows in (net.top, *(block.body for block in net.blocks.values())):
        for index, line in enumerate(rows):
            if line.keyword not in (".param", ".params"):
                continue
            words = tokens(line.text)
            for place, word in enumerate(words):
                if word.lower().startswith(key + "="):
                    words[place] = f"{word.split('=', 1)[0]}={value}"
                    rows[index] = line.rewritten(join(words))
                    found = True
    return found


def _set_element(block: Block, key: str, value: str) -> str | None:
    place = _VALUE_PLACE.get(key[0])
    index = _elements(block)[key]
    line = block.body[index]
    words = tokens(line.text)
    named = next((i for i, word in enumerate(words) if word.lower().startswith(f"{key[0]}=")), None)
    if named is not None:
        words[named] = f"{key[0]}={value}"
    elif place is None or len(words) <= place:
        return f"is not an element with one value: {line.text}"
    else:
        place += words[place].lower() == "dc"
        if number(words[place]) is None and not _EXPRESSION.fullmatch(words[place]):
            return f"is not an element with one value: {line.text}"
        words[place] = value
    block.body[index] = line.rewritten(join(words))
    return None


def _elements(block: Block) -> dict[str, int]:
    """Return the designators of a subcircuit's elements -> their place in the body."""
    found, depth = {}, 0
    for index, line in enumerate(block.body):
        depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
        if depth == 0 and not line.keyword.startswith((".", "*")):
            found[line.keyword] = index
    return found


def _params(net: Netlist) -> list[str]:
    rows = [*net.top, *(line for block in net.blocks.values() if not block.is_part for line in block.body)]
    words = [word for line in rows if line.keyword in (".param", ".params") for word in tokens(line.text)[1:]]
    return [word.partition("=")[0].lower() for word in words]


def _near(key: str, known: list[str]) -> str:
    near = nearest(key, known)
    return f", nearest is {near}" if near else ""
