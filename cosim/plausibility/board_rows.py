"""The board's own lines, parts left aside: what an edit of a value reaches."""

from __future__ import annotations

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import tokens

__all__ = ["own_rows", "sets"]


def own_rows(board: Deck) -> list[list[str]]:
    """Return the words of the lines that are the board's own, not a part's, in lower case."""
    parts = {part.name for part in board.parts}
    rows, inside = [], ""
    for line in board.lines:
        words = [word.lower() for word in tokens(line.text)]
        if not words:
            continue
        if words[0] == ".subckt":
            inside = words[1]
        elif words[0] == ".ends":
            inside = ""
        elif inside.partition("__")[0] in parts:
            continue
        rows.append(words)
    return rows


def sets(key: str, letter: str, rows: list[list[str]]) -> bool:
    """Whether `key` is an element with this letter or becomes the value of one, through parameters too."""
    names = {key}
    for words in rows:
        if words[0] == ".subckt" or words[0].startswith("x"):
            names |= {w.partition("=")[0] for w in words if w.partition("=")[2] == f"{{{key}}}"}
    used = {f"{{{name}}}" for name in names}
    return any(words[0].startswith(letter) and (words[0] == key or used & set(words[3:4])) for words in rows)
