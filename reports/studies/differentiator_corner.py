"""Noise and passive stiffness over the corner of the differentiator."""

import numpy as np

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import CONTACT, FAINT, INK, JOINTS, LIMIT, Drawn, figure

__all__ = ["draw"]

_CURVES = (
    ("white [N rms]", "white", "-"),
    (col.HELD_NOISE, "white, contact held", (0, (5, 2))),
    ("peak_to_peak [N rms]", "peak to peak", "-"),
    ("position [N rms]", "position, moving", "-"),
    ("static [N rms]", "static", "-"),
)


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return noise over corner, stiffness over corner, and one against the other."""
    table = result.table("corner").columns
    corner = np.array(table[col.CORNER], float)
    own = result.table("board").columns[col.CORNER][0]
    stiff = np.array(table[col.PASSIVE_STIFFNESS], float)
    drawing, axes = figure(4.0, columns=3)
    for number, (name, label, dash) in enumerate(_CURVES):
        noise = np.array(table[name], float)
        if not np.nanmax(noise) > 0.0:
            continue
        colour = JOINTS[number % len(JOINTS)]
        axes[0, 0].plot(corner, noise, color=colour, linestyle=dash, label=label)
        axes[0, 2].plot(stiff, noise, color=colour, linestyle=dash, label=label)
    axes[0, 1].plot(corner, stiff, color=INK, label="passive")
    axes[0, 1].plot(corner, np.array(table[col.EXACT_BORDER], float), color=LIMIT, label="exact border")
    for place in (axes[0, 0], axes[0, 1]):
        place.set_xscale("log")
        place.axvline(own, color=FAINT, linestyle=":", linewidth=1.0)
        place.set_xlabel("corner [Hz]; dotted: the board's")
    for place in (axes[0, 0], axes[0, 2]):
        place.set_yscale("log")
        place.set_ylabel("force noise [N rms]")
    axes[0, 1].set_ylabel("largest discrete stiffness [N/m]")
    axes[0, 1].set_ylim(0.0, None)
    active = corner[np.isnan(stiff)]
    if active.size:
        axes[0, 1].axvspan(active.min(), corner[-1], color=CONTACT, linewidth=0, label="damper itself active")
    axes[0, 2].set_xlabel("passive stiffness [N/m]")
    for place, title in zip(axes[0], ("Noise", "Stiffness", "One against the other"), strict=True):
        place.set_title(title)
    axes[0, 0].legend(fontsize=8)
    axes[0, 1].legend(fontsize=8)
    return [("corner", "Noise against passive stiffness", Drawn(drawing, result.table("corner").note))]
