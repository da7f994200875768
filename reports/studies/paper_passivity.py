"""Needed viscosity over frequency, and what the display takes up over time."""

import numpy as np

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import INK, JOINTS, LIMIT, Drawn, figure

__all__ = ["draw"]


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return one figure: the search of (16) and the energies of (20)."""
    drawing, axes = figure(4.6, columns=2)
    left, right = axes[0]
    curves = result.table("curves").columns
    names = list(dict.fromkeys(curves["wall"]))
    for number, name in enumerate(names):
        own = np.array([which == name for which in curves["wall"]])
        x, y = (np.array(curves[key])[own] for key in (col.FREQUENCY_OVER_PI_T, col.NEEDED_OVER_CLOSED_FORM))
        left.plot(x, y, color=JOINTS[number % len(JOINTS)], label=name)
    left.axhline(1.0, color=INK, linewidth=1.0, linestyle=":")
    left.set_title("Viscosity that a wall needs, (16)")
    left.set_xlabel("frequency over pi/T")
    left.set_ylabel("needed over k_p T/2 + |k_d|")
    left.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=2, fontsize=8.0)
    over, energies = result.table("taken").columns, result.table("energies").columns
    bounds = zip(energies["run"], energies[col.SPRING_ENERGY], strict=True)
    for number, (name, bound) in enumerate((name, bound) for name, bound in bounds if bound):
        own = np.array([which == name for which in over["run"]])
        x, y = (np.array(over[key])[own] for key in (col.TIME, col.TAKEN_UP))
        right.plot(x, y, color=JOINTS[number % len(JOINTS)], label=name)
        label = "-k x(0)^2/2" if number == 0 else None
        right.axhline(bound, color=LIMIT, linewidth=1.0, linestyle="--", label=label)
    right.set_title("Energy taken up by the display, (20)")
    right.set_xlabel("time [s]")
    right.set_ylabel("energy [mJ]")
    right.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=2, fontsize=8.0)
    caption = (
        "Left: the viscosity that keeps a sampled wall passive at every frequency, over the closed form, "
        "which is its maximum. Right: a passive hand lets go of the spring inside the wall; the display "
        "never gives more than the spring held. (A mass that is dropped is another matter, in the table "
        "below: the spring is switched on at a sample, already compressed.)"
    )
    return [("passive", "Passivity by search and in time", Drawn(drawing, caption))]
