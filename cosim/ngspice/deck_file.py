"""A flattened board as a file: a result keeps the board that ran, whatever happens to the netlists."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cosim.errors import InputError, Problem, fail
from cosim.ngspice import gate
from cosim.ngspice.deck import Amplifier, Deck
from cosim.ngspice.lines import Line
from cosim.ngspice.parts import Part
from cosim.ngspice.safety import KEPT, refusal

__all__ = ["FILE", "load", "save"]

FILE = "board.json"


def save(board: Deck, folder: Path) -> None:
    """Write a board into an existing folder."""
    record = {**asdict(board), "path": str(board.path), "digest": board.digest}
    (folder / FILE).write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def load(folder: Path, *, trust: bool = False) -> Deck:
    """Read the board that a result keeps; it is checked like any netlist.

    Raises
    ------
    InputError
        Where there is none, a damaged one, or one with statements that are not allowed.
    """
    file = folder / FILE
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        board = Deck(
            lines=tuple(_line(line, trust) for line in record["lines"]),
            board=record["board"],
            pins=tuple(record["pins"]),
            joints=record["joints"],
            amplifiers=tuple(Amplifier(**each) for each in record["amplifiers"]),
            parts=tuple(Part(**each) for each in record["parts"]),
            notes=tuple(record["notes"]),
            path=Path(record["path"]),
            reactances=record["reactances"],
        )
    except FileNotFoundError:
        fail(
            "the result keeps no board: it was written by an earlier version; run the scene again",
            file=str(file),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        fail(f"cannot be read: {error}", file=str(file))
    if board.digest != record["digest"]:
        fail("is not what the run has written: its content was changed", file=str(file))
    problems = [] if trust else [p for line in board.lines[1:] if (p := _refusal(line)) is not None]
    if problems:
        raise InputError(problems)
    gate.check(board.lines)
    return board


def _line(record: dict[str, Any], trust: bool) -> Line:
    """Read a line; that its run was trusted does not make it so."""
    return Line(**{**record, "trusted": trust and bool(record.get("trusted"))})


def _refusal(line: Line) -> Problem | None:
    """Refuse what a flat board cannot hold either: the loader carries it out, or leaves it away."""
    if line.keyword.startswith(".") and line.keyword not in KEPT:
        return Problem("is not allowed in a flat board", file=line.file, line=line.lineno, value=line.text)
    return refusal(line)
