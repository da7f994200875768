"""Other values for parameters and elements, without another file."""

import re
from collections.abc import Mapping
from dataclasses import replace

from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.conditionals import flags
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.expression import evaluate
from cosim.ngspice.lines import Line, join, number, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist
from cosim.ngspice.syntax import malformed
from cosim.ngspice.values import as_meant

__all__ = [
    "LARGEST", "SMALLEST", "apply_overrides", "elements_of", "own_copy", "set_element", "set_param",
    "shared_name", "shorts",
]  # fmt: skip

SMALLEST, LARGEST = 1e-30, 1e30
"""Magnitudes of values other than 0: beyond them products overflow or vanish, in ngspice and here."""

_VALUE_PLACE = {"r": 3, "c": 3, "l": 3, "v": 3, "i": 3, "e": 5, "g": 5, "f": 4, "h": 4}
"""Where the value stands on an element's line, by the element's letter."""

_EXPRESSION = re.compile(r"[{'][^{}'\"\n;]*[}']")


def apply_overrides(net: Netlist, board: Block, overrides: Mapping[str, str]) -> list[str]:
    """Substitute values in `net`; raises all problems at once.

    A name is looked for as a ``.param`` (every definition of it changes, so every use sees the value), then
    as an element's designator outside the parts, then inside them. A path such as ``xdiff1.r12`` names one
    instance's parameter or element; the subcircuits on the way are copied for that instance.

    Returns
    -------
    list of str
        What was read differently from how it was written, in words.

    Raises
    ------
    InputError
        For an unknown or ambiguous name, a value that is no SPICE number and no ``{expression}``, one beyond
        `SMALLEST` and `LARGEST`, or a resistor of 0 Ohm.
    """
    problems, notes = [], []
    known = flags(net)
    # bare names first: they change a subcircuit before some instance gets its own copy of it
    for name, value in sorted(overrides.items(), key=lambda item: "." in item[0]):
        key, text = name.strip().lower(), str(value).strip()
        line = as_meant(Line(f".param value={text}"), Dialect.NGSPICE)
        text = line.text.partition("=")[2]
        parsed = number(text)
        wrong = None
        if parsed is None and not _EXPRESSION.fullmatch(text):
            wrong = "is not a SPICE number or {expression}"
        elif parsed is None and (form := malformed(line)) is not None:
            wrong = form.message
        elif parsed and not SMALLEST <= abs(parsed) <= LARGEST:
            wrong = "is beyond what can be computed with"
        if wrong:
            allowed = f"0, or {SMALLEST:g} to {LARGEST:g} in magnitude" if parsed is not None else None
            problems.append(Problem(wrong, key=name, value=value, allowed=allowed))
            continue
        if parsed is None:
            parsed = evaluate(text[1:-1], known)
        notes += [f"{name} = {value}: {line.note}"] if line.note else []
        path = key.removeprefix("xboard.")
        error = _short(net, path.split(".")[-1]) if parsed == 0.0 else None
        if error is None:
            steps = path.split(".")
            error = _instance(net, board, steps, text) if len(steps) > 1 else _name(net, board, key, text)
        if error:
            problems.append(Problem(error, key=name, value=value))
    if problems:
        raise InputError(problems)
    return notes


def shorts(net: Netlist, blocks: list[Block]) -> list[Problem]:
    """Return one problem for each resistor outside the parts whose value comes to 0 Ohm."""
    known = flags(net)
    problems = []
    for block in blocks:
        inside = known | _block_values(block, known)
        for line in () if block.is_part else block.body:
            words = tokens(line.text)
            if words[0][0] not in "rR" or len(words) < 4:
                continue
            value = words[3].lower().removeprefix("r=")
            if evaluate(value.strip("{}'"), inside) == 0.0:
                problems.append(
                    Problem(
                        f"{words[0]} of {block.name} is a resistor of 0 Ohm: ngspice takes 1 mOhm, and gains "
                        "run away; a short is a small value, 10m",
                        file=line.file,
                        line=line.lineno,
                        value=line.text,
                    )
                )
    return problems


def _block_values(block: Block, known: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of a subcircuit with their default values, where these are plain."""
    own: dict[str, float] = {}
    rows = [tokens(line.text)[1:] for line in block.body if line.keyword in (".param", ".params")]
    pairs = [*block.params.items(), *(word.partition("=")[::2] for row in rows for word in row)]
    for name, text in pairs:
        value = evaluate(text.strip("{}'"), {**known, **own})
        own[name.lower()] = float("nan") if value is None else value
    return own


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
            block for block in net.blocks.values() if block.is_part is is_part and key in elements_of(block)
        ]
        if len(owners) > 1:
            names = ", ".join(block.name for block in owners)
            return f"is an element of several subcircuits ({names}): name the instance, as in xdiff1.{key}"
        if owners:
            return set_element(owners[0], key, value)
    known = [
        *_params(net),
        *(name for block in net.blocks.values() if not block.is_part for name in elements_of(block)),
    ]
    return "no such parameter or element" + _near(key, known)


def _instance(net: Netlist, board: Block, path: list[str], value: str) -> str | None:
    """Set a parameter or an element of one instance; return what is wrong."""
    block = board
    for depth, step in enumerate(path[:-1]):
        instances = [x for x in block.instances() if x.name == step]
        if not instances:
            return f"{block.name} has no instance {step}" + _near(step, [x.name for x in block.instances()])
        instance = instances[0]
        child = net.blocks[instance.block]
        last = depth == len(path) - 2
        if last and path[-1] in child.params:
            kept = [word for word in instance.extra if not word.lower().startswith(path[-1] + "=")]
            block.body[instance.index] = instance.rewritten(extra=[*kept, f"{path[-1]}={value}"])
            return None
        if last and path[-1] not in elements_of(child):
            return f"{child.name} has no parameter or element {path[-1]}" + _near(
                path[-1], [*child.params, *elements_of(child)]
            )
        block = own_copy(net, block, instance, child)
    return set_element(block, path[-1], value)


def own_copy(net: Netlist, block: Block, instance: Instance, child: Block) -> Block:
    """Give an instance in `block` a subcircuit of its own, unless it has one, and return it."""
    mark = _mark_of_copy(block, instance)
    if child.name.endswith(mark):
        return child
    name = child.name + mark
    words = tokens(child.header.text)
    words[1] = name
    header = child.header.rewritten(join(words))
    copy = replace(child, name=name, header=header, body=list(child.body))  # `origin` stays
    net.blocks[name] = copy
    block.body[instance.index] = instance.rewritten(block=name)
    return copy


def _mark_of_copy(block: Block, instance: Instance) -> str:
    return f"__{block.name}_{instance.name}"


def shared_name(block: Block, instance: Instance) -> str:
    """Return the name of an instance's subcircuit as its netlist spells it, of a copy of its own too."""
    return instance.block.removesuffix(_mark_of_copy(block, instance))


def set_param(net: Netlist, key: str, value: str) -> bool:
    """Give a ``.param`` another value wherever it is defined; return whether it is."""
    is_set = False
    for rows in (net.top, *(block.body for block in net.blocks.values())):
        for index, line in enumerate(rows):
            if line.keyword not in (".param", ".params"):
                continue
            words = tokens(line.text)
            for place, word in enumerate(words):
                if word.lower().startswith(key + "="):
                    words[place] = f"{word.split('=', 1)[0]}={value}"
                    rows[index] = line.rewritten(join(words))
                    is_set = True
    return is_set


def set_element(block: Block, key: str, value: str) -> str | None:
    """Give an element of a subcircuit another value; return what is wrong."""
    place = _VALUE_PLACE.get(key[0])
    index = elements_of(block)[key]
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


def elements_of(block: Block) -> dict[str, int]:
    """Return the designators of a subcircuit's elements -> their place in the body."""
    counts, depth = {}, 0
    for index, line in enumerate(block.body):
        depth += (line.keyword == ".subckt") - (line.keyword in (".ends", ".eom"))
        if depth == 0 and not line.keyword.startswith((".", "*")):
            counts[line.keyword] = index
    return counts


def _params(net: Netlist) -> list[str]:
    rows = [*net.top, *(line for block in net.blocks.values() if not block.is_part for line in block.body)]
    words = [word for line in rows if line.keyword in (".param", ".params") for word in tokens(line.text)[1:]]
    return [word.partition("=")[0].lower() for word in words]


def _near(key: str, known: list[str]) -> str:
    near = nearest(key, known)
    return f", nearest is {near}" if near else ""
