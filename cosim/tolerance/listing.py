"""What varies of a device, as a table for people, rows for machines, and a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.tolerance.distributions import SIGMAS
from cosim.tolerance.intervals import CONFIDENCE
from cosim.tolerance.random_variables import Component, Tolerances
from cosim.units import quantity

__all__ = ["CONVENTION", "component_rows", "table"]

#: Conventions differ between tools: ours is stated wherever tolerances are shown.
CONVENTION = (
    f"A tolerance is a Gaussian with sigma = tol/{SIGMAS:g}, cut off at +-tol, where nothing else is said; "
    "agauss and gauss are not cut, as in ngspice. Each placed component draws its own value. Intervals hold "
    f"with {100 * CONFIDENCE:g} %."
)
_HEAD = ("component", "nominal", "distribution", "shared draws", "stated in")


def component_rows(tolerances: Tolerances) -> list[dict[str, Any]]:
    """Return what varies, JSON-ready."""
    return [
        {
            "key": each.key,
            "nominal": each.nominal,
            "unit": each.unit,
            "distribution": each.distribution,
            "lots": " ".join(each.lots),
            "file": each.file,
            "line": each.line,
        }
        for each in tolerances.components
    ]


def table(tolerances: Tolerances) -> list[str]:
    """Return what varies, a line a component, and how many random variables there are."""
    rows = [_HEAD, *(_cells(each) for each in tolerances.components)]
    count = (
        f"{len(tolerances.components)} components, {len(tolerances.variables)} independent random variables"
    )
    return [*_aligned(rows), count]


def _cells(of: Component) -> tuple[str, ...]:
    where = Path(of.file).name + (f":{of.line}" if of.line else "")
    return of.key, quantity(of.nominal, of.unit, 4), of.distribution, " ".join(of.lots), where


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
