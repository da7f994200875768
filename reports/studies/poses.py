"""Drag, mismatch and curl over the workspace."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, SymLogNorm

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import Drawn, figure

__all__ = ["draw"]


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the maps of joint PD and of mismatched multipliers."""
    columns = result.table("workspace").columns
    drawing, axes = figure(4.2, columns=2, sharey=True)
    norm: Any = SymLogNorm(0.03, vmin=-10.0, vmax=10.0)
    _map(
        axes[0, 0],
        columns,
        col.DRAG_OF_JOINT_PD,
        "Joint PD: drag, F_t/F_n",
        norm,
        "RdBu_r",
        (-3, -0.3, 0, 0.3, 3),
    )
    norm = LogNorm(1e-3, 1e-1)
    _map(
        axes[0, 1], columns, col.DRAG_OF_MISMATCH, "Unequal multipliers: F_t/F_n, rms", norm, "cividis", None
    )
    axes[0, 0].set_ylabel("y [m]")
    drag = Drawn(
        drawing,
        "Tangential over normal force of a wall. Left: gains at the joints without cross terms drag to one "
        "side or the other, by the pose. Right: with cross terms but unequal multipliers (rms).",
    )
    drawing, axes = figure(4.2, columns=2, sharey=True)
    _map(axes[0, 0], columns, col.CURL, "Curl of the force [N/m], rms", LogNorm(0.1, 10.0), "cividis", None)
    _map(
        axes[0, 1],
        columns,
        col.CIRCLE_ENERGY,
        "Energy round the circle [µJ], rms",
        LogNorm(30.0, 3e3),
        "cividis",
        None,
    )
    axes[0, 0].set_ylabel("y [m]")
    curl = Drawn(drawing, "Unequal multipliers make Ksp unsymmetric: a hand that goes round is fed energy.")
    drawing, axes = figure(4.6)
    _map(axes[0, 0], columns, col.LEAST_EIGENVALUE, "Least eigenvalue of sym(Ksp) [mN m/rad]",
         SymLogNorm(0.1, vmin=-30.0, vmax=30.0), "RdBu", (-10, -1, -0.1, 0, 0.1, 1, 10))  # fmt: skip
    axes[0, 0].set_ylabel("y [m]")
    least = Drawn(
        drawing,
        "A frictionless wall has a direction without stiffness: its least eigenvalue is zero. One standard "
        "deviation of mismatch, signs at their worst, makes it negative: it pushes along that direction.",
    )
    return [
        ("drag", "Drag along the wall", drag),
        ("curl", "Curl of the rendered force", curl),
        ("least", "Least eigenvalue of the rendered stiffness", least),
    ]


def _map(
    place: Axes, columns: Any, name: str, title: str, norm: Any, colours: str, ticks: Sequence[float] | None
) -> None:
    side = int(np.sqrt(len(columns[col.X])))  # a grid: bend of the elbow by turn of the base
    x, y, value = (np.reshape(np.array(columns[key], float), (side, side)) for key in (col.X, col.Y, name))
    drawn = place.pcolormesh(
        x, y, np.ma.masked_invalid(value[:-1, :-1]), norm=norm, cmap=colours, rasterized=True
    )
    place.set_aspect("equal")
    place.set_title(title)
    place.set_xlabel("x [m]")
    place.locator_params(axis="x", nbins=5)
    plain = None if ticks is None else "%g"
    place.figure.colorbar(drawn, ax=place, ticks=ticks, format=plain, shrink=0.85, extend="both")
