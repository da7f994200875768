"""Inputs in which runs differ, so that a change of a measure has a cause: scene, board and versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cosim.ngspice.deck import Deck
from cosim.results import Run

__all__ = ["Differing", "differing"]

#: An input: its name, and its value in each run; None where a run lacks it.
Differing = tuple[str, tuple[str | None, ...]]
#: Entries of the provenance that are shown elsewhere, or say nothing of the input.
_APART = ("command", "scene_digest", "effects_digest", "deck_digest", "scene_file", "seed")


def differing(runs: Sequence[Run], boards: Sequence[Deck | None]) -> list[Differing]:
    """Return every input that is not the same in all runs, in the order of scene, board, versions.

    Parameters
    ----------
    runs
        Two or more.
    boards
        What each of them keeps of its board; None where that cannot be read: then
        digests tell boards apart.
    """
    scenes = [dict(_flat(run.scene.model_dump(mode="json"))) for run in runs]
    rows = _apart(scenes)
    if all(board is not None for board in boards):
        rows += _apart([_statements(board) for board in boards if board is not None])
    else:
        rows += _apart([{"board (digest)": str(run.provenance.get("deck_digest"))} for run in runs])
    about = [{k: v for k, v in run.provenance.items() if k not in _APART} for run in runs]
    return rows + _apart([dict(_flat(each)) for each in about])


def _apart(sides: Sequence[Mapping[str, str]]) -> list[Differing]:
    names = dict.fromkeys(name for side in sides for name in side)
    rows = [(name, tuple(side.get(name) for side in sides)) for name in names]
    return [row for row in rows if len(set(row[1])) > 1]


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield ``computer.period_s`` and the like with their values."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", str(value)


def _statements(board: Deck) -> dict[str, str]:
    """Return the statements of a flat board by what they state: a parameter or an element with its block."""
    statements: dict[str, str] = {}
    block = ""
    for line in board.lines[1:]:
        words = line.text.split()
        if not words:
            continue
        head = words[0].lower()
        if head == ".subckt" and len(words) > 1:
            block = f"{words[1]}."
        elif head == ".ends":
            block = ""
        elif head in (".param", ".csparam"):
            name, _, value = " ".join(words[1:]).partition("=")
            statements.setdefault(f"{head} {block}{name.strip()}", value.strip())
        else:
            statements.setdefault(f"{block}{words[0]}", " ".join(words[1:]))
    return statements
