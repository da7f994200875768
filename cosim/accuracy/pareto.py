"""Settings with their cost and error: the Pareto front, and the cheapest that will do."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from cosim.accuracy.solver_settings import Setting

__all__ = ["RESOLVED", "Row", "cheapest", "clipped", "finest", "marked", "resolved"]

#: An error is known where it is so many times what the references disagree by; a smaller one is a bound.
RESOLVED = 10.0


@dataclass(frozen=True)
class Row:
    """One setting and its outcome.

    Attributes
    ----------
    setting : what was asked for; a peer's has no overrides
    wall_s, cpu_s, setup_s : each repetition's seconds: the simulation's own, its processor time, all before
    points, rejected, states : of the simulation
    errors : quantity -> share; a quantity is 'position', 'force' or a measure
    failed : why there are no errors
    front : whether no other is both cheaper and better, by the worst error
    """

    setting: Setting
    wall_s: tuple[float, ...] = ()
    cpu_s: tuple[float, ...] = ()
    setup_s: tuple[float, ...] = ()
    points: int = 0
    rejected: int = 0
    states: int | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    failed: str = ""
    front: bool = False

    @property
    def seconds(self) -> float:
        """Median of the simulation's wall time."""
        return statistics.median(self.wall_s) if self.wall_s else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Return the row JSON-ready."""
        asked = self.setting
        return {
            "setting": asked.label,
            "model": asked.model,
            "series": asked.series,
            "overrides": list(asked.overrides),
            **{name: list(getattr(self, name)) for name in ("wall_s", "cpu_s", "setup_s")},
            **{name: getattr(self, name) for name in ("points", "rejected", "states", "failed", "front")},
            "errors": dict(self.errors),
        }

    def worst(self, quantities: Iterable[str]) -> float:
        """Return the largest error of several quantities, infinite where one is missing."""
        return max((self.errors.get(name, math.inf) for name in quantities), default=math.inf)


def clipped(row: Row, floor: Mapping[str, float]) -> Row:
    """Claim no error below the floor."""
    return replace(row, errors={name: max(e, floor.get(name, 0.0)) for name, e in row.errors.items()})


def resolved(row: Row, name: str, floor: Mapping[str, float]) -> bool:
    """Return whether the error of a quantity is known, ten times above the floor, and not only bounded."""
    return row.errors.get(name, 0.0) >= RESOLVED * floor.get(name, 0.0)


def marked(rows: Sequence[Row], quantities: Sequence[str]) -> list[Row]:
    """Mark the rows that no other beats in both time and error; peers have no measures and do not compete."""
    own = [row for row in rows if row.errors and row.setting.model != "peer"]
    best: set[str] = set()
    least = math.inf
    for row in sorted(own, key=lambda r: (r.seconds, r.worst(quantities))):
        if row.worst(quantities) < least:
            least = row.worst(quantities)
            best.add(row.setting.label)
    return [replace(row, front=row.setting.label in best) for row in rows]


def finest(rows: Sequence[Row], model: str) -> dict[str, float]:
    """Return the smallest errors that any setting of a model reaches."""
    own = [row for row in rows if row.setting.model == model and row.errors]
    names = dict.fromkeys(name for row in own for name in row.errors)
    return {name: min(row.errors[name] for row in own if name in row.errors) for name in names}


def cheapest(rows: Sequence[Row], quantities: Sequence[str], tolerance: float) -> Row | None:
    """Return the fastest own setting whose errors are all within a tolerance, if there is one."""
    good = [row for row in rows if row.setting.model != "peer" and row.worst(quantities) <= tolerance]
    return min(good, key=lambda row: row.seconds, default=None)
