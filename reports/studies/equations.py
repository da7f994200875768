"""Commanded against measured gains, and the force of the wall over the workspace."""

import numpy as np
from matplotlib.colors import BoundaryNorm

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import JOINTS, LIMIT, Drawn, figure, legend

__all__ = ["draw"]

_MARKS = ("o", "s", "^", "D")
#: Error of a gain that is drawn at the bottom [%].
_LEAST = 1e-5
_LEVELS = (-50, -20, -10, -5, -2, -1, 1, 2, 5, 10, 20, 50)


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the gains' errors by level, and the maps of the normal force's error."""
    return [
        ("gains", "Commanded against measured gains", _gains(result)),
        ("force", "Normal force of the wall at a depth", _force(result)),
    ]


def _gains(result: StudyResult) -> Drawn:
    table = result.table("gains").columns
    rows = list(
        zip(*(table[name] for name in ("level", col.Q1, col.Q2, "gain", col.ERROR_PERCENT)), strict=True)
    )
    poses = list(dict.fromkeys((row[1], row[2]) for row in rows))
    drawing, axes = figure(3.6, columns=len(poses), sharey=True)
    for place, pose in zip(axes[0], poses, strict=True):
        for number, level in enumerate(dict.fromkeys(table["level"])):
            own = [(row[3], row[4]) for row in rows if row[0] == level and row[1:3] == pose]
            place.plot(
                range(len(own)), [max(abs(off or 0.0), _LEAST) for _, off in own],
                _MARKS[number % len(_MARKS)], color=JOINTS[number % len(JOINTS)], label=level, markersize=5,
            )  # fmt: skip
        place.axhline(0.1, color=LIMIT, linewidth=1.0, label="0.1 %")
        place.set_yscale("log")
        place.set_xlabel(f"gain at q = ({pose[0]:g}, {pose[1]:g}) rad")
        place.set_xticks(range(len(own)), [name for name, _ in own], rotation=60)
    axes[0, 0].set_ylabel("|measured/commanded - 1| [%]")
    legend(axes[0, -1])
    caption = (
        "Every spring (ksp), equilibrium input (u) and damper (ksd) of the board, as ngspice finds it, "
        "against what the control law asks for with the constants that the board states."
    )
    return Drawn(drawing, caption)


def _force(result: StudyResult) -> Drawn:
    table = result.table("workspace").columns
    side = int(np.sqrt(len(table[col.X])))  # a grid: bend of the elbow by turn of the base
    x, y = (np.reshape(table[name], (side, side)) for name in (col.X, col.Y))
    drawing, axes = figure(4.3, columns=2, sharey=True)
    norm = BoundaryNorm(_LEVELS, 256, extend="both")
    for place, column, title in (
        (axes[0, 0], col.ERROR_OF_THE_POSE, "Gains with J(q), as the paper"),
        (axes[0, 1], col.ERROR_HALF_WAY, "Gains with J half way to the wall"),
    ):
        error = np.ma.masked_invalid(np.reshape(np.array(table[column], float), (side, side)))
        marks = place.pcolormesh(x, y, error[:-1, :-1], norm=norm, cmap="RdBu_r", rasterized=True)
        place.set_aspect("equal")
        place.set_title(title)
        place.set_xlabel("x [m]")
    axes[0, 0].set_ylabel("y [m]")
    drawing.colorbar(marks, ax=axes.ravel().tolist(), label="error of the normal force [%]", ticks=_LEVELS)
    caption = (
        "The wall's normal force against k times the depth, at every place of the fingertip. r - r_d = "
        "J(q)(q - q_d) of (11) is exact to first order only; taken half way between tip and wall, the "
        "Jacobian makes it exact to second order. White: not within reach at that depth."
    )
    return Drawn(drawing, caption)
