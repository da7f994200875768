"""Sources on the board that change with time: the model `linear` has no place for them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from cosim.caution import Caution
from cosim.ngspice.deck import Deck
from cosim.plausibility.board_rows import own_lines

__all__ = ["sources"]

#: Functions of time of an independent source, and the variable of an expression.
_FUNCTION = re.compile(r"\b(?:pulse|sin|exp|pwl|sffm|am|trnoise|trrandom)\b", re.IGNORECASE)
_TIME = re.compile(r"\btime\b", re.IGNORECASE)


def sources(model: str, board: Deck) -> Iterator[Caution]:
    """Yield the board's own sources that change with time, where `linear` holds them at rest."""
    if model != "linear":
        return
    for line, words in own_lines(board):
        kind = line.keyword[0]
        changes = _FUNCTION if kind in "vi" else _TIME if kind in "begh" else None
        if changes is None or not changes.search(" ".join(words[3:])):
            continue
        where = f"{line.file}:{line.lineno}: " if line.file else ""
        yield Caution(
            "source-held",
            f"{where}{words[0]} changes with time; the model linear holds it at its value at rest",
            'take solver.model = "spice" if it matters',
        )
