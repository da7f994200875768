"""What an edit did: two boards under one scene, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.check.check import check
from cosim.check.subject import load_subject
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.results import Run
from cosim.run import run
from cosim.scene import load_scene
from cosim.settings import Variant

#: Keys that name an entry of a list in a check's result, in the order in which they make its name.
_NAMES = ("name", "path", "kind", "block", "gains", "joint", "where")
#: Parts of a check that are no figures of the board.
_NO_FIGURES = (
    *("set", "file", "pins", "parts", "notes", "deck_digest", "findings", "stated", "top"),
    *("deviation_percent", "ideal_deviation_percent", "spread_percent", "headroom_percent"),
)
#: Differences below this share are rounding of the measurement, not the edit.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Side:
    """One board: its label, the figures of `cosim check` by name, and its run of the scene."""

    label: str
    figures: dict[str, float]
    run: Run


def figures(value: Any, name: str = "") -> dict[str, float]:
    """Flatten a check's result to numbers by name; list entries are named by what they are about."""
    if isinstance(value, bool) or value is None:
        return {}
    if isinstance(value, int | float):
        return {name: float(value)}
    found: dict[str, float] = {}
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key not in _NO_FIGURES and key not in _NAMES:
                found.update(figures(item, f"{name} {key}".strip()))
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            label = str(number + 1)
            if isinstance(item, Mapping):
                label = " ".join(str(item[key]) for key in _NAMES if item.get(key) is not None) or label
            found.update(figures(item, f"{name} {label}".strip()))
    return found


def compare(
    scene_file: str | Path,
    boards: list[str],
    folder: Path,
    *,
    child: Child | None = None,
    trust: bool = False,
) -> list[Side]:
    """Check and run every board under one scene.

    Parameters
    ----------
    scene_file
        The scene; its own board is replaced by each of `boards`.
    folder
        Where the runs are kept, one folder a board.

    Raises
    ------
    InputError
        For a board that does not fit the scene.
    """
    sides = []
    for number, board in enumerate(boards):
        label = f"{chr(ord('A') + number)} {Path(board).stem}"
        override = f"device.board={Path(board).resolve().as_posix()!r}"
        plan = resolve(load_scene(scene_file, [override]), trust=trust)
        subject = load_subject(str(scene_file), Variant((), (override,), label), None, None, trust=trust)
        measured = check(subject, child=child)
        result = run(plan, folder / label.replace(" ", "_"), formats=(), child=child)
        sides.append(Side(label, figures(measured.as_dict()), result))
    return sides


def changes(sides: list[Side]) -> list[tuple[str, list[float | None]]]:
    """Return the figures that differ between the sides, the largest relative change first."""
    rows = []
    for name in dict.fromkeys(key for side in sides for key in side.figures):
        values = [side.figures.get(name) for side in sides]
        first = values[0]
        size = max(
            (
                abs(v - first) / max(abs(first), abs(v), 1e-300)
                if v is not None and first is not None
                else 1.0
                for v in values[1:]
            ),
            default=0.0,
        )
        if size > _ROUNDING:
            rows.append((size, name, values))
    return [(name, values) for _, name, values in sorted(rows, key=lambda row: -row[0])]
