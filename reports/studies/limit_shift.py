"""By how much k_max moves without a part of the circuit, over the sampling period."""

import numpy as np

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import JOINTS, Drawn, figure

__all__ = ["draw"]

_MARKS = "osDv^P"
_LINEAR = 1e-3


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the picture: one panel for each set of gains."""
    table = result.table("limits").columns
    gains = list(dict.fromkeys(table["gains"]))
    cases = [name for name in table if name.endswith("[%]")]
    drawing, axes = figure(4.4, columns=len(gains), sharey=True)
    for place, name in zip(axes[0], gains, strict=True):
        rows = [n for n, value in enumerate(table["gains"]) if value == name]
        period = [table[col.SAMPLING_PERIOD][n] for n in rows]
        for number, case in enumerate(cases):
            moved = np.array([table[case][n] for n in rows], float)
            place.plot(period, moved, color=JOINTS[number % len(JOINTS)], marker=_MARKS[number % len(_MARKS)],
                       markersize=4, label=case.removesuffix(" [%]"))  # fmt: skip
        place.set_xscale("log")
        place.set_yscale("symlog", linthresh=_LINEAR)
        place.axhline(0.0, color="#666666", linewidth=0.8)
        place.set_title(name)
        place.set_xlabel("sampling period [ms]")
    axes[0, 0].set_ylabel("shift of k_max [%]")
    drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    caption = (
        "Change of the exact largest discrete stiffness when one part of the circuit's dynamics is taken "
        "away: what that part costs. Logarithmic on both sides of zero."
    )
    return [("shift", "Shift of the largest stiffness", Drawn(drawing, caption))]
