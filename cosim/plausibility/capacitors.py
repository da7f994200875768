"""Capacitors of a quadrillionth of what was meant: `F` is femto in SPICE, not farad."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from cosim.caution import Caution
from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import assignments
from cosim.plausibility.board_rows import own_lines, own_rows, sets

__all__ = ["capacitors"]

_FARAD = re.compile(r"([-+]?[\d.]+(?:e[-+]?\d+)?)f(?:arads?)?", re.IGNORECASE)


def capacitors(values: Mapping[str, str], board: Deck) -> Iterator[Caution]:
    """Yield the capacitors in farad that an edit or the board's own lines make of femtofarad."""
    for name, written in values.items():
        if sets(name.lower().rpartition(".")[2], "c", own_rows(board)):
            yield from _doubt(f"{name} = {written}", written)
    edited = {name.lower().rpartition(".")[2] for name in values}
    rows = own_rows(board)
    for line, words in own_lines(board):
        where = f"{line.file}:{line.lineno}: " if line.file else ""
        if line.keyword.startswith("c") and len(words) > 3 and line.keyword not in edited:
            yield from _doubt(f"{where}{words[0]} = {words[3]}", words[3])
        elif line.keyword in (".param", ".params", ".subckt"):
            for name, written in assignments(words[1:]).items():
                if name not in edited and _FARAD.fullmatch(written) and sets(name, "c", rows):
                    yield from _doubt(f"{where}{name} = {written}", written)


def _doubt(what: str, written: str) -> Iterator[Caution]:
    if (match := _FARAD.fullmatch(written)) is not None:
        yield Caution(
            "capacitor-absurd",
            f"{what} makes a capacitor of {match[1]} fF",
            f"in SPICE f and F are femto: write {match[1]} for farad",
        )
