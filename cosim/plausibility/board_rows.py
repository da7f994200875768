"""The board's own lines, parts left aside: what an edit of a value reaches."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line, tokens

__all__ = ["own_lines", "own_rows", "sets"]


def own_lines(board: Deck) -> Iterator[tuple[Line, list[str]]]:
    """Yield the lines that are the board's own, not a part's nor what a part is made of, with their words."""
    inside, lines, needs = "", list[tuple[str, Line, list[str]]](), dict[str, set[str]]()
    for line in board.lines:
        words = tokens(line.text)
        if not words:
            continue
        if line.keyword == ".subckt":
            inside = words[1].lower()
        elif line.keyword[0] == "x":
            plain = [word.lower() for word in words if "=" not in word and word.lower() != "params:"]
            needs.setdefault(inside, set()).add(plain[-1])
        lines.append((inside, line, words))
        if line.keyword == ".ends":
            inside = ""
    parts = {part.name for part in board.parts}
    own, wanted = {""}, [board.board.lower()]
    while wanted:
        name = wanted.pop()
        if name not in own and name.partition("__")[0] not in parts:
            own.add(name)
            wanted += needs.get(name, ())
    yield from ((line, words) for block, line, words in lines if block in own)


def own_rows(board: Deck) -> list[list[str]]:
    """Return the words of the board's own lines in lower case."""
    return [[word.lower() for word in words] for _, words in own_lines(board)]


def sets(key: str, letter: str, rows: list[list[str]]) -> bool:
    """Whether `key` is an element with this letter or becomes the value of one, through parameters too."""
    names = {key}
    for words in rows:
        if words[0] == ".subckt" or words[0].startswith("x"):
            names |= {w.partition("=")[0] for w in words if w.partition("=")[2] == f"{{{key}}}"}
    used = {f"{{{name}}}" for name in names}
    return any(words[0].startswith(letter) and (words[0] == key or used & set(words[3:4])) for words in rows)
