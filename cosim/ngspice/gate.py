"""The only way to load a deck into ngspice: checked row by row, with aliases for names.

What comes here is flat: includes, levels, overrides and dialects are behind it. One row is one line, the
title is ours, every statement and element is one that `cosim.ngspice.safety` allows, and every name has an
alias of a strict alphabet, so that what is left of the user's text are numbers, operators and words.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cosim.errors import InputError, Problem
from cosim.ngspice.aliases import Aliases
from cosim.ngspice.expression_names import Name, Refused, arguments, checked, parts
from cosim.ngspice.lines import Line, number, tokens
from cosim.ngspice.safety import KEPT, refusal

__all__ = ["TITLE", "Admitted", "admit", "check"]

TITLE = "cosim"
"""First row of every deck: ngspice reads commands from a file whose title says so."""

_BREAK = re.compile("[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029]")
_COMMENT = re.compile(r"\* [ -~]*")
_BEHAVIOUR = re.compile(r"\*@\s*ngbehavior=(\w+)\s*")
_BEHAVIOURS = frozenset({"ps", "psa", "lt", "lta", "ltps", "ltpsa", "hs", "hsa", "ki", "kia"})
_OURS = KEPT | {".save", ".ic", ".tran", ".meas", ".end"}
"""Statements of a deck: those of a netlist, and what whoever simulates adds."""

_TERMINALS = {"r": 2, "c": 2, "l": 2, "v": 2, "i": 2, "b": 2, "t": 4}
"""Nodes of elements whose other words are values."""
_NAMING = frozenset("rclt")
"""Those of them that may name a model; a source's `dc` is a keyword, even where a diode is called so."""
_MODELLED = {
    "d": (2, 3),
    "q": (3, 5),
    "j": (3, 3),
    "z": (3, 3),
    "m": (4, 7),
    "s": (4, 4),
    "o": (4, 4),
    "u": (3, 3),
}
"""Fewest and most nodes of elements that name a model behind them."""
_EXPRESSION = re.compile(r"(value|vol|cur|table|laplace|freq)(?=[={(']|$)", re.IGNORECASE)
_POLY = re.compile(r"poly\s*\(\s*(\d{1,3})\s*\)", re.IGNORECASE)
_CSPARAM = re.compile(r"\.csparam\s+([a-z_]\w*)\s*=\s*(\S.*)", re.IGNORECASE | re.ASCII)
_FUNCTION = re.compile(r"\.func\s+([a-z_]\w*)\s*\(([\w\s,]*)\)\s*=?\s*(\S.*)", re.IGNORECASE | re.ASCII)
_PAIRS = frozenset({"%vd", "%id", "%gd", "%hd"})
_PORT = re.compile(r"%(?:vnam|vd|v|id|i|gd|g|hd|h|d)(?![a-z])", re.IGNORECASE)

Part = str | Name


@dataclass(frozen=True)
class Admitted:
    """A deck as ngspice may see it.

    Attributes
    ----------
    rows
        One for each row of the deck, in the same order; the last is ``.end``.
    aliases
        The names in it.
    behaviour
        Compatibility mode that the deck asks for.
    """

    rows: list[str]
    aliases: Aliases
    behaviour: str | None


def check(lines: Sequence[Line]) -> None:
    """Check the lines of a flat deck, the first of which is its title.

    Raises
    ------
    InputError
        Naming file and line of all that is refused.
    """
    admit([line.text for line in lines], lines)


def admit(rows: Sequence[str], lines: Sequence[Line] = (), *, readable: bool = False) -> Admitted:
    """Return a deck as ngspice may see it.

    Parameters
    ----------
    rows
        The deck; the first row is the title.
    lines
        Where its first rows come from. With a line that the user trusts (`Line.trusted`) the deck is handed
        on as it is, since commands in it may speak of any name.
    readable
        Whether the deck is for people, too: it keeps its comments, and names of letters, digits and
        underscores.

    Raises
    ------
    InputError
        Naming file and line of all that is refused.
    """
    broken = [
        _problem("holds a control character or a line break", row, k, lines)
        for k, row in enumerate([*rows, *(line.text for line in lines)])
        if _BREAK.search(row)
    ]
    if broken:
        raise InputError(broken)
    modes = [match[1].lower() for row in rows if (match := _BEHAVIOUR.fullmatch(row.strip()))]
    trusted = any(line.trusted for line in lines)
    writer = _Writer(Aliases("\n".join(rows[1:]), plain=trusted, readable=readable))
    out = [TITLE, *rows[1:]] if trusted else writer.deck(rows, lines)
    if not any(row.strip().lower() == ".end" for row in out):
        out.append(".end")
    if readable and not trusted:
        kept = [k for k, row in enumerate(rows) if k and _COMMENT.fullmatch(row)]
        for k in kept:
            out[k] = rows[k]
    return Admitted(out, writer.aliases, modes[0] if modes and modes[0] in _BEHAVIOURS else None)


def _problem(why: str, row: str, index: int, lines: Sequence[Line]) -> Problem:
    origin = lines[index] if index < len(lines) else Line("")
    return Problem(why, file=origin.file or None, line=origin.lineno or None, value=origin.text or row)


def _statements(rows: Sequence[str]) -> Iterable[tuple[int, str]]:
    """Join continuations; yield each statement with the place of its first row, without the title."""
    start, text = 0, ""
    for index, row in enumerate(rows[1:], 1):
        row = row.strip()
        if row.startswith("+") and text:
            text += " " + row[1:]
        else:
            if text:
                yield start, text
            start, text = index, "" if row.startswith("*") else row
    if text:
        yield start, text


class _Writer:
    """Writes a deck's statements with aliases."""

    def __init__(self, aliases: Aliases) -> None:
        self.aliases = aliases

    def deck(self, rows: Sequence[str], lines: Sequence[Line]) -> list[str]:
        """Return the rows with aliases; a comment or a continuation becomes an empty comment."""
        statements = list(_statements(rows))
        for _, text in statements:
            words = text.split(None, 2)
            if words[0].lower() == ".model" and len(words) > 1:
                self.aliases.model(words[1])
        problems: list[Problem] = []
        written: dict[int, list[Part]] = {}
        for index, text in statements:
            try:
                refused = None if text.split()[0].lower() in _OURS - KEPT else refusal(Line(text))
                if refused is not None:
                    raise Refused(refused.message)
                written[index] = self._statement(text)
            except ValueError as reason:
                problems.append(_problem(str(reason), text, index, lines))
        if problems:
            raise InputError(problems)
        out = [TITLE, *["*"] * (len(rows) - 1)]
        for index, row in written.items():  # every name of the deck is known by now
            try:
                out[index] = "".join(part if isinstance(part, str) else self._spelled(part) for part in row)
            except ValueError as reason:
                problems.append(_problem(str(reason), rows[index], index, lines))
        if problems:
            raise InputError(problems)
        return out

    def _spelled(self, name: Name) -> str:
        """Return the alias of a name in an expression, which may be a path into a subcircuit."""
        if name.is_element:
            path = self.aliases.element_path(name.text)
            return self.aliases.element(name.text) if path is None else path
        return self.aliases.node_path(name.text) or self.aliases.node(name.text)

    def _statement(self, text: str) -> list[Part]:
        word = text.split(None, 1)[0].lower()
        if not word.startswith("."):
            return self._element(text)
        words = tokens(text)
        if word not in _OURS:
            raise Refused("unknown statement")
        if word == ".subckt":
            return self._header(words)
        if word in (".ends", ".eom", ".end"):
            return [word, *([" ", self.aliases.block(checked(words[1]))] if len(words) > 1 else [])]
        if word == ".model":
            return self._model(words)
        if word == ".global":
            return [".global", *self._nodes(words[1:])]
        if word == ".csparam":
            return self._csparam(text)
        if word == ".func":
            match = _FUNCTION.fullmatch(text)
            if match is None:
                raise Refused("is not .func name(arguments) {expression}")
            formals = [each for each in re.split(r"[\s,]+", match[2]) if each]
            text = match[3].strip()
            text = text[1:-1] if text[0] + text[-1] in ("{}", "''") else text
            return [f".func {match[1]}({','.join(formals)}) {{", *parts(text), "}"]
        return [word, " ", *parts(" ".join(words[1:]))]

    def _csparam(self, text: str) -> list[Part]:
        match = _CSPARAM.fullmatch(text)
        value = match[2].strip() if match else ""
        if match is None or not (number(value) is not None or value[0] + value[-1] in ("{}", "''")):
            raise Refused("is not .csparam name={expression}")
        return [f".csparam {match[1]}=", *parts(value)]

    def _model(self, words: list[str]) -> list[Part]:
        alias, rest = self.aliases.model(checked(words[1])), words[2:]
        head = ""
        if rest[0].lower().startswith("ako:"):
            base = rest[0][4:] or rest.pop(1)
            head, rest = f"ako:{self.aliases.model(checked(base))} ", rest[1:]
        return [f".model {alias} {head}", *parts(" ".join(rest))]

    def _header(self, words: list[str]) -> list[Part]:
        if len(words) < 2:
            raise Refused(".subckt needs a name")
        name = self.aliases.block(checked(words[1]))
        plain, extra = _positional(words[2:])
        return [f".subckt {name}", *self._nodes(plain), *self._values(extra)]

    def _element(self, text: str) -> list[Part]:
        words = tokens(text)
        letter, rest = words[0][0].lower(), words[1:]
        name = self.aliases.element(checked(words[0]))
        if letter == "x":
            plain, extra = _positional(rest)
            if not plain:
                raise Refused("names no subcircuit")
            nodes, block = self._nodes(plain[:-1]), self.aliases.block(checked(plain[-1]))
            return [name, *nodes, f" {block}", *self._values(extra)]
        if letter == "k":
            return [name, *self._elements(rest[:-1]), *self._values(rest[-1:])]
        if letter == "a":
            return [name, *self._ports(" ".join(rest[:-1])), " ", self.aliases.model(checked(rest[-1]))]
        if letter in _MODELLED:
            return [name, *self._modelled(letter, rest)]
        if letter in _TERMINALS:
            nodes, rest = self._take(rest, _TERMINALS[letter])
            return [name, *nodes, *self._values(rest, models=letter in _NAMING)]
        nodes, rest = self._take(rest, 2)
        if letter == "w":
            if len(rest) < 2:
                raise Refused("needs a source and a model")
            model = self.aliases.model(checked(rest[1]))
            return [name, *nodes, *self._elements(rest[:1]), f" {model}", *self._values(rest[2:])]
        return [name, *nodes, *self._controlled(rest, by_voltage=letter in "eg")]

    def _controlled(self, rest: list[str], *, by_voltage: bool) -> list[Part]:
        """Write what controls a controlled source, and how."""
        if not rest:
            raise Refused("names nothing that controls it")
        if _EXPRESSION.match(rest[0]) and (
            "=" in rest[0] or "{" in rest[0] or (rest[1:2] and rest[1][0] in "{('=")
        ):
            return self._values(rest)
        count, head = 1, ""
        if rest[0].lower() == "poly":
            rest = [rest[0] + "".join(rest[1:2]), *rest[2:]]
        poly = _POLY.fullmatch(rest[0])
        if poly is not None:
            count, head, rest = int(poly[1]), f" poly({int(poly[1])})", rest[1:]
        if by_voltage:
            control, rest = self._take(rest, 2 * count)
        else:
            control, rest = self._elements(rest[:count]), rest[count:]
        return [head, *control, *self._values(rest)]

    def _modelled(self, letter: str, words: list[str]) -> list[Part]:
        least, most = _MODELLED[letter]
        flat = [each for word in words[:most] for each in _split(word)] + words[most:]
        at = next(
            (k for k in range(least, most + 1) if k < len(flat) and self.aliases.is_model(flat[k])), least
        )
        if len(flat) <= at:
            raise Refused(f"needs {least} nodes and a model")
        model = self.aliases.model(checked(flat[at]))
        return [*self._nodes(flat[:at]), f" {model}", *self._values(flat[at + 1 :])]

    def _ports(self, text: str) -> list[Part]:
        """Write the ports of an XSPICE element: nodes with brackets, types and signs around them."""
        out: list[Part] = []
        pair, is_element = 0, False
        for word in re.findall(r"[\[\]]|%\w+|[^\s\[\]()%,]+", text):
            if word in "[]":
                out += [" ", word]
                is_element = False
            elif _PORT.fullmatch(word):
                out += [" ", word]
                is_element, pair = word.lower() == "%vnam", 2 * (word.lower() in _PAIRS)
            elif word.lower() == "null":
                out += [" ", word]
            else:
                sign = "~" if word.startswith("~") else ""
                out += ["(" if pair == 2 else " ", sign, self._name(word.removeprefix("~"), is_element)]
                out += [")"] if pair == 1 else []
                pair = max(pair - 1, 0)
        return out

    def _take(self, words: list[str], count: int) -> tuple[list[Part], list[str]]:
        """Write so many nodes; return them and the words behind."""
        taken: list[str] = []
        rest = list(words)
        while len(taken) < count:
            if not rest:
                raise Refused(f"needs {count} nodes")
            taken += _split(rest.pop(0))
        if len(taken) != count:
            raise Refused(f"has {len(taken)} nodes where {count} belong")
        return self._nodes(taken), rest

    def _nodes(self, names: Iterable[str]) -> list[Part]:
        return [part for name in names for each in _split(name) for part in (" ", self._name(each))]

    def _elements(self, names: Iterable[str]) -> list[Part]:
        return [part for name in names for each in _split(name) for part in (" ", self._name(each, True))]

    def _name(self, name: str, is_element: bool = False) -> Part:
        """Write a node or an element; one with a dot may be a path, which is known at the end."""
        if "." in checked(name):
            return Name(name, is_element)
        return self.aliases.element(name) if is_element else self.aliases.node(name)

    def _values(self, words: Sequence[str], *, models: bool = False) -> list[Part]:
        """Write values, each behind a blank; where `models` can stand, the name of one gets its alias."""
        out: list[Part] = []
        for word in words:
            out.append(" ")
            out += [self.aliases.model(word)] if models and self.aliases.is_model(word) else parts(word)
        return out


def _positional(words: list[str]) -> tuple[list[str], list[str]]:
    """Split the words of an instance or a header before its parameters."""
    at = next((k for k, w in enumerate(words) if "=" in w or w.lower() == "params:"), len(words))
    return words[:at], words[at:]


def _split(word: str) -> list[str]:
    """Return the nodes of one word: ``(a,b)`` and ``a,b`` are two."""
    if "," not in word and "(" not in word:
        return [word]
    if word.startswith("(") and word.endswith(")"):
        return [each for each in arguments(word[1:-1], blanks=True) if each]
    return [each for each in arguments(word) if each]
