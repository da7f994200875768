"""Resistors that nobody builds a board with: most come of `M`, which is milli in SPICE."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping

from cosim.caution import Caution
from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import number
from cosim.plausibility.board_rows import own_lines, own_rows, sets

__all__ = ["resistors"]

#: Resistors that a board is built with [Ohm]: less is a track, more is its surface.
_LEAST_OHM, _MOST_OHM = 1.0, 1e8
_CAPITAL_M = re.compile(r".*[\d.]M(?:Ohms?|Ω)?")
_MILLI = re.compile(r"[-+]?[\d.]+(?:e[-+]?\d+)?(m)(?!eg|il)\w*", re.IGNORECASE)


def resistors(values: Mapping[str, str], board: Deck, bare: Callable[[], Deck]) -> Iterator[Caution]:
    """Yield the resistors that an edit made absurd, and those that the netlist writes with a capital M."""
    rows = own_rows(board)
    before: dict[str, float] | None = None
    for name, written in values.items():
        key, ohms = name.lower().rpartition(".")[2], number(written)
        if ohms is not None and (doubt := _absurd(ohms)) and sets(key, "r", rows):
            before = dict(_stated(own_rows(bare()))) if before is None else before
            if not _absurd(before.get(key, _LEAST_OHM)):  # a shunt of 0.5 Ohm may become one of 0.4
                yield _resistor(f"{name} = {written}", ohms, doubt, written)
    edited = {name.lower().rpartition(".")[2] for name in values}
    for line, words in own_lines(board):
        where = f"{line.file}:{line.lineno}: " if line.file else ""
        for name, written in _resistances(words):
            ohms = number(written)
            if name in edited or ohms is None or _CAPITAL_M.fullmatch(written) is None or not _absurd(ohms):
                continue
            if line.keyword.startswith("r") or sets(name, "r", rows):
                yield _resistor(f"{where}{name} = {written}", ohms, _absurd(ohms), written)


def _absurd(ohms: float) -> str:
    size = abs(ohms)
    return "less than 1 Ohm" if size < _LEAST_OHM else "more than 100 MOhm" if size > _MOST_OHM else ""


def _resistor(what: str, ohms: float, doubt: str, written: str) -> Caution:
    match = _MILLI.fullmatch(written)
    milli = match is not None and ohms < _LEAST_OHM
    mega = f"{written[: match.start(1)]}meg" if match is not None else ""
    return Caution(
        "resistor-absurd",
        f"{what} makes a resistor of {ohms:.4g} Ohm, {doubt}",
        f"in SPICE m and M are milli: write {mega} for mega" if milli else "look at its unit",
    )


def _stated(rows: list[list[str]]) -> Iterator[tuple[str, float]]:
    for words in rows:
        for name, written in _resistances(words):
            value = number(written)
            if value is not None:
                yield name, value


def _resistances(words: list[str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of what may be resistances: an element's own, and parameters."""
    if words and words[0][:1].lower() == "r" and len(words) > 3:
        yield words[0].lower(), words[3]
    elif words and words[0].lower() in (".param", ".params", ".subckt"):
        for word in words[1:]:
            name, separator, value = word.partition("=")
            if separator:
                yield name.lower(), value
