"""Footnote 2: the shift of the apparent stiffness over the workspace."""

import numpy as np
from matplotlib.colors import BoundaryNorm

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import JOINTS, Drawn, figure, legend

__all__ = ["draw"]

_LEVELS = (0, 1, 2, 5, 10, 20, 50, 100)


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the maps of the shift without and with the compensating term."""
    table = result.table("workspace").columns
    side = int(np.sqrt(len(table[col.X])))  # a grid: bend of the elbow by turn of the base
    x, y = (np.reshape(table[name], (side, side)) for name in (col.X, col.Y))
    drawing, axes = figure(4.3, columns=2, sharey=True)
    norm = BoundaryNorm(_LEVELS, 256, extend="max")
    for place, column, title in (
        (axes[0, 0], col.SHIFT_WORST_DIRECTION, "As the paper commands it"),
        (axes[0, 1], col.COMPENSATED_WORST_DIRECTION, "With the term of footnote 2"),
    ):
        shift = np.reshape(table[column], (side, side))
        marks = place.pcolormesh(x, y, shift, norm=norm, cmap="cividis", shading="gouraud", rasterized=True)
        place.set_aspect("equal")
        place.set_title(title)
        place.set_xlabel("x [m]")
    axes[0, 0].set_ylabel("y [m]")
    drawing.colorbar(
        marks, ax=axes.ravel().tolist(), label="shift of the stiffness, worst direction [%]", ticks=_LEVELS
    )
    caption = (
        "By how much the stiffness that the hand finds differs from the commanded one, in the direction "
        "where it differs most, at every place of the fingertip (elbow bent one way). "
        "Left: gains J^T K J. Right: K_g(F) added."
    )
    drawn = [("congruence", "Stiffness under a preload", Drawn(drawing, caption))]
    if any(table.name == "preloads" for table in result.tables):
        drawn.append(("preloads", "With and without the compensating law, in runs", _preloads(result)))
    return drawn


def _preloads(result: StudyResult) -> Drawn:
    table = result.table("preloads").columns
    preload = table[col.PRELOAD]
    drawing, grid = figure(3.6)
    axes = grid[0, 0]
    for number, (which, label) in enumerate((("plain", "as the paper commands it"),
                                             ("compensated", "K_g(F) added by the law"))):  # fmt: skip
        seen, theory = (
            table[f"{which}: {what}, worst direction [N/m]"] for what in ("off the commanded", "theory")
        )
        colour = JOINTS[number]
        axes.plot(preload, seen, "os"[number], color=colour, label=f"{label}: runs")
        axes.plot(preload, theory, color=colour, linewidth=1.0, label=f"{label}: theory")
    axes.set_xlabel("preload along the wall's normal [N]")
    axes.set_ylabel("off the commanded stiffness [N/m]")
    axes.set_xlim(left=0.0)
    legend(axes, columns=2)
    caption = (
        "What the hand finds between two samples, in the direction where it is furthest from what was "
        "commanded: the circuit holds gains and equilibria of a preload while the force changes a little."
    )
    return Drawn(drawing, caption)
