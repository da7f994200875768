"""What the value of a placed component is in the linear network: admittances that change, and where.

A resistor, capacitor or inductor is one admittance between its nodes. A part's parameter arrives at several
elements of its model: resistors, capacitors, inductors, linear controlled sources and current sources. What
arrives anywhere else (an expression of voltages, a gain of voltages) is refused with the reason.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import InputError, Problem
from cosim.ngspice.conditionals import flags
from cosim.ngspice.deck import NOMINAL_C, Deck
from cosim.ngspice.expression import evaluate
from cosim.ngspice.lines import Line, assignments, number, tokens
from cosim.ngspice.netlist import Block, Instance, Netlist
from cosim.ngspice.placed_values import board_netlist, node_name, split, walk

__all__ = ["Change", "Unlike", "changes", "nominal_values"]

Pair = tuple[str, str]

#: Kinds of admittance: G, s C, 1/(s L), and a current that flows at rest.
CONDUCTANCE, CAPACITANCE, INDUCTANCE, CURRENT = range(4)
_KINDS = {"r": CONDUCTANCE, "c": CAPACITANCE, "l": INDUCTANCE, "g": CONDUCTANCE, "i": CURRENT}
_ROUNDS = 8
_EXPONENTS = (-2.0, -1.0, 0.0, 1.0, 2.0)
_SAME = 1e-12


class Unlike(Exception):
    """A component whose value is no admittance; the message says why."""


@dataclass(frozen=True)
class Change:
    """One element whose admittance follows the values of some components.

    Attributes
    ----------
    kind
        One of the four above.
    into
        ngspice's names of the nodes between which its current flows.
    across
        Nodes whose voltage drives it; those of `into` but for a controlled source.
    keys
        Places of the components among all.
    admittance
        Their values -> S, F, 1/H or A.
    """

    kind: int
    into: Pair
    across: Pair
    keys: tuple[int, ...]
    admittance: Callable[[Sequence[float]], float]


def changes(board: Deck, keys: Sequence[str]) -> list[Change]:
    """Return the elements that the components' values reach.

    Parameters
    ----------
    board
        The board as it is.
    keys
        Components as `cosim.ngspice.placed_values.Placed` takes them.

    Raises
    ------
    Unlike
        For a component that is no admittance.
    """
    net = board_netlist(board)
    where = {path: (block, instance, nets) for path, block, instance, nets in walk(net, board.board)}
    known, warm = flags(net), _temperature(net) - NOMINAL_C
    rows: list[Change] = []
    parts: dict[str, list[tuple[int, str]]] = {}
    for place, key in enumerate(keys):
        steps, element, parameter = split(key)
        path = ".".join(["xboard", *steps])
        if parameter:
            parts.setdefault(path, []).append((place, parameter))
            continue
        block, instance, nets = where[path]
        line = next(line for line in block.body if line.keyword == element)
        if element[0] not in "rcl":
            raise Unlike(f"{key} is no resistor, capacitor or inductor")
        factor = _warmed(line, _scope(block, instance, known), warm)
        ends = _ends(line, path, nets, 1)
        rows.append(Change(_KINDS[element[0]], ends, ends, (place,), _passive(element[0], factor)))
    for path, given in parts.items():
        block, instance, nets = where[path]
        rows += _of_part(block, instance, path, nets, given, known, warm)
    return rows


def nominal_values(board: Deck, keys: Sequence[str]) -> list[float]:
    """Return the components' values on the board as it is, SI.

    Raises
    ------
    InputError
        For every component whose value is no number by itself, and for what is no component.
    """
    net = board_netlist(board)
    where = {path: (block, instance) for path, block, instance, _ in walk(net, board.board)}
    known, problems, values = flags(net), [], []
    for key in keys:
        steps, element, parameter = split(key)
        block, instance = where.get(".".join(["xboard", *steps]), (None, None))
        line = next((line for line in block.body if line.keyword == element), None) if block else None
        value = None
        if parameter:
            value = known.get(parameter)
        elif block is not None and line is not None and element[0] in "rcl":
            words = tokens(line.text)
            text = words[3].removeprefix(f"{element[0]}=") if len(words) > 3 else ""
            value = _value(text, _scope(block, instance, known))
        if value is None:
            problems.append(Problem("has no plain value on the board", file=str(board.path), key=key))
        else:
            values.append(value)
    if problems:
        raise InputError(problems)
    return values


def _passive(letter: str, factor: float) -> Callable[[Sequence[float]], float]:
    if letter == "c":
        return lambda values: values[0] * factor
    return lambda values: 1.0 / (values[0] * factor)


def _of_part(
    block: Block,
    instance: Instance | None,
    path: str,
    nets: dict[str, str],
    given: Sequence[tuple[int, str]],
    known: Mapping[str, float],
    warm: float,
) -> list[Change]:
    """Return the elements of one placed part that its varied parameters reach."""
    names = [name for _, name in given]
    reached = _reached(block, instance, set(names))
    rows = []
    for line in block.body:
        words = tokens(line.text)
        letter = line.keyword[0]
        if letter in ".*" or not any(_mentions(word, reached) for word in words[1:]):
            continue
        place = {"r": 3, "c": 3, "l": 3, "g": 5, "i": 3}.get(letter)
        if place is None or len(words) <= place or any("=" in w and letter == "g" for w in words):
            raise Unlike(f"{words[0]} of {path} takes {', '.join(names)} otherwise than as an admittance")
        place += words[place].lower() == "dc"
        text = words[place].removeprefix(f"{letter}=")
        factor = _warmed(line, _scope(block, instance, known), warm) if letter in "rcl" else 1.0

        def admittance(
            values: Sequence[float], text: str = text, letter: str = letter, factor: float = factor
        ) -> float:
            scope = _scope(block, instance, dict(known) | dict(zip(names, values, strict=True)))
            value = _value(text, scope)
            if value is None or (letter in "rl" and value == 0.0):
                raise Unlike(f"{text} of {path} is none of the expressions that are known here")
            return 1.0 / (value * factor) if letter in "rl" else value * factor

        into = _ends(line, path, nets, 1)
        across = _ends(line, path, nets, 3) if letter == "g" else into
        nominal = [known.get(name, math.nan) for name in names]
        places = tuple(place for place, _ in given)
        rows.append(Change(_KINDS[letter], into, across, places, _shortcut(admittance, nominal)))
    return rows


def _shortcut(f: Callable[[Sequence[float]], float], nominal: list[float]) -> Callable[..., float]:
    """Return the same function as a product of powers, where it is one: text is evaluated slowly."""
    about = np.array([value if math.isfinite(value) and value else 1.0 for value in nominal])
    middle = f(about.tolist())
    if middle == 0.0:
        return f
    exponents = []
    for k in range(len(about)):
        moved = about.copy()
        moved[k] *= 2.0
        ratio = f(moved.tolist()) / middle
        power = next((e for e in _EXPONENTS if abs(ratio / 2.0**e - 1.0) < _SAME), None)
        if power is None:
            return f
        exponents.append(power)
    powers = np.array(exponents)

    def product(values: Sequence[float]) -> float:
        return float(middle * np.prod((np.asarray(values) / about) ** powers))

    tried = about * (1.0 + 0.1 * np.arange(1, len(about) + 1))
    return product if abs(f(tried.tolist()) / product(tried.tolist()) - 1.0) < _SAME else f


def _reached(block: Block, instance: Instance | None, names: set[str]) -> set[str]:
    """Return the names of parameters of a part whose value depends on one of `names`."""
    reached = set(names)
    pairs = [*block.params.items(), *(assignments(list(instance.extra)) if instance else {}).items()]
    for line in block.body:
        if line.keyword in (".param", ".params"):
            pairs += assignments(tokens(line.text)[1:]).items()
    for _ in range(_ROUNDS):
        reached |= {name for name, text in pairs if _mentions(text, reached)}
    return reached


def _scope(block: Block, instance: Instance | None, known: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters that an instance's elements see, as far as they come to numbers."""
    scope = dict(known)
    given = assignments(list(instance.extra)) if instance else {}
    pairs = [(name, given.get(name, text), name in given) for name, text in block.params.items()]
    for line in block.body:
        if line.keyword in (".param", ".params"):
            pairs += [(name, text, False) for name, text in assignments(tokens(line.text)[1:]).items()]
    for name, text, outside in pairs:
        value = _value(text, known if outside else scope)
        if value is None:
            scope.pop(name, None)
        else:
            scope[name] = value
    return scope


def _value(text: str, known: Mapping[str, float]) -> float | None:
    """Return the value of a number, an expression, or a choice ``a ? b : c`` between two."""
    text = text.strip().strip("{}'").strip()
    plain = number(text)
    if plain is not None:
        return plain
    depth, marks = 0, dict[str, int]()
    for at, c in enumerate(text):
        depth += (c == "(") - (c == ")")
        if depth == 0 and c in "?:":
            marks.setdefault(c, at)
    if len(marks) == 2 and marks["?"] < marks[":"]:
        condition = _value(text[: marks["?"]], known)
        if condition is None:
            return None
        chosen = text[marks["?"] + 1 : marks[":"]] if condition else text[marks[":"] + 1 :]
        return _value(chosen, known)
    return evaluate(text, known)


def _mentions(text: str, names: set[str]) -> bool:
    value = text.partition("=")[2] if "=" in text else text
    return any(word in names for word in re.findall(r"[a-z_]\w*", value.lower()))


def _ends(line: Line, path: str, nets: dict[str, str], first: int) -> Pair:
    words = [word.lower() for word in tokens(line.text)[first : first + 2]]
    return node_name(words[0], path, nets), node_name(words[1], path, nets)


def _temperature(net: Netlist) -> float:
    for line in net.top:
        if line.keyword == ".temp":
            return float(line.text.split()[1])
    return NOMINAL_C


def _warmed(line: Line, known: Mapping[str, float], warm: float) -> float:
    """Return by how much its temperature changes an element."""
    if warm == 0.0:
        return 1.0
    given = assignments(tokens(line.text)[1:])
    rates = [_value(given.get(name, "0"), known) for name in ("tc1", "tc2")]
    plain = set(given) - {"tc1", "tc2", "noisy", "r", "c", "l"}
    if rates[0] is None or rates[1] is None or plain:
        raise Unlike(f"{line.keyword} has a temperature of its own")
    return 1.0 + rates[0] * warm + rates[1] * warm * warm
