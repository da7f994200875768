"""Parameters that one file defines twice; SPICE takes the last one without a word."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.caution import Caution
from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line
from cosim.plausibility.board_rows import own_lines

__all__ = ["definitions"]


def definitions(board: Deck) -> Iterator[Caution]:
    """Yield parameters to which one file gives two values, in the same subcircuit or outside of all.

    A value in another file is meant so: a board sets what a block has as its default.
    """
    inside, seen = "", dict[tuple[str, str, str], tuple[Line, str]]()
    for line, words in own_lines(board):
        if line.keyword == ".subckt":
            inside = words[1].lower()
        elif line.keyword == ".ends":
            inside = ""
        elif line.keyword == ".param":
            for word in words[1:]:
                name, _, value = word.partition("=")
                first, before = seen.setdefault((line.file, inside, name.lower()), (line, value))
                if before != value:
                    yield Caution(
                        "parameter-twice",
                        f"{line.file}:{line.lineno}: {name} = {value}: has the value {before} in line"
                        f" {first.lineno}; SPICE takes the last one",
                        "take one of the two out",
                    )
