"""A flattened board as a file: a result keeps the board that ran, whatever happens to the netlists."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

from typing_extensions import TypedDict

from cosim.errors import InputError, Problem, fail
from cosim.ngspice import gate
from cosim.ngspice.deck import MOST_JOINTS, Amplifier, Deck, board_pins
from cosim.ngspice.lines import Line
from cosim.ngspice.parts import Part
from cosim.ngspice.safety import KEPT, refusal
from cosim.storage import field_types
from cosim.storage.checksums import read_object

__all__ = ["FILE", "load", "save"]

FILE = "board.json"


class _Record(TypedDict):
    """The form of the file; a trusted run does not make its lines trusted."""

    lines: tuple[Line, ...]
    board: str
    pins: tuple[str, ...]
    joints: int
    amplifiers: tuple[Amplifier, ...]
    parts: tuple[Part, ...]
    notes: tuple[str, ...]
    path: Path
    reactances: int
    declared: tuple[str, ...]
    digest: str


def save(board: Deck, folder: Path) -> None:
    """Write a board into an existing folder."""
    record = {**vars(board), "path": str(board.path), "digest": board.digest}
    # no indentation: it is for programs, and would take the encoder in Python, an eighth of a `spice` sample
    text = json.dumps(record, ensure_ascii=False, default=vars)  # of its lines, amplifiers, parts
    (folder / FILE).write_text(text + "\n", encoding="utf-8")


def load(folder: Path, *, trust: bool = False) -> Deck:
    """Read the board that a result keeps; it is checked like any netlist.

    Raises
    ------
    InputError
        Where there is none, a damaged one, or one with statements that are not allowed.
    """
    file = folder / FILE
    if not os.path.isfile(file):
        fail(
            "the result keeps no board: it was written by an earlier version; run the scene again",
            file=str(file),
        )
    record = field_types.made(read_object(file), _Record, str(file))
    digest = record.pop("digest")
    lines = tuple(replace(line, trusted=trust and line.trusted) for line in record.pop("lines"))
    board = Deck(lines=lines, **record)
    if not 1 <= board.joints <= MOST_JOINTS or not lines:
        fail("is not a board", file=str(file), key="joints", value=board.joints)
    if not set(board.pins) >= set(board_pins(board.joints)):
        fail("is not a board: it lacks pins", file=str(file), key="pins")
    if board.digest != digest:
        fail("is not what the run has written: its content was changed", file=str(file))
    problems = [] if trust else [p for line in board.lines[1:] if (p := _refusal(line)) is not None]
    if problems:
        raise InputError(problems)
    gate.check(board.lines)
    return board


def _refusal(line: Line) -> Problem | None:
    """Refuse what a flat board never holds, since the loader executes or drops it."""
    if line.keyword.startswith(".") and line.keyword not in KEPT:
        return Problem("is not allowed in a flat board", file=line.file, line=line.lineno, value=line.text)
    return refusal(line)
