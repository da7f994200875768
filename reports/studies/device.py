"""Four numbers of a device: force over the reach of its arm, and beside published devices."""

import numpy as np
from matplotlib.ticker import FuncFormatter, NullFormatter

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from reports.style import FAINT, JOINTS, Drawn, figure

__all__ = ["draw"]


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the comparison, and for an arm the forces over its reach."""
    pictures = [("presets", "Beside published devices", _presets(result.table("presets")))]
    if any(table.name == "reach" for table in result.tables):
        pictures.append(("reach", "Force and full scale over the reach", _reach(result.table("reach"))))
    return pictures


def _presets(table: Table) -> Drawn:
    names = table.columns["device"]
    keys = [key for key in table.columns if key != "device"]
    keys = [key for key in keys if table.columns[key][0] is not None and key != col.CONTINUOUS_FORCE]
    drawing, axes = figure(2.6, 1, len(keys), sharey=True)
    places = np.arange(len(names))[::-1]
    for place, key in zip(axes[0], keys, strict=True):
        values = [float(value) for value in table.columns[key]]
        colours = [JOINTS[0], *[FAINT] * (len(names) - 1)]
        place.barh(places, values, color=colours, height=0.6)
        for y, value in zip(places, values, strict=True):
            text = f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
            place.annotate(text, (value, y), xytext=(3, 0), textcoords="offset points", va="center",
                           fontsize=8)  # fmt: skip
        place.set_xlim(0.0, 1.25 * max(values))
        place.set_title(key)
        place.grid(visible=False)
    axes[0, 0].set_yticks(places, names)
    return Drawn(
        drawing,
        "Published values are limits that a controller library recommends, not identified dynamics; ours are "
        "what board and sampling period allow.",
    )


def _reach(table: Table) -> Drawn:
    drawing, axes = figure(3.6, 1, 2, sharex=True)
    x = np.array(table.columns[col.REACH])
    left, right = axes[0]
    for number, (key, dashes) in enumerate(
        (
            ("continuous, any direction", "-"),
            ("continuous, best direction", "--"),
            ("peak, any direction", "-"),
        )
    ):
        left.semilogy(x, table.columns[f"{key} [N]"], dashes, color=JOINTS[number], label=key)
    left.set_ylabel("force at the tip [N]")
    left.set_yticks([1, 2, 5, 10, 20, 50])
    left.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    left.yaxis.set_minor_formatter(NullFormatter())
    right.set_ylim(0.0, 1.1 * max(table.columns[col.FULL_SCALE_STIFFNESS]))
    right.plot(x, table.columns[col.FULL_SCALE_STIFFNESS], color=JOINTS[0])
    right.set_ylabel("analog stiffness at full scale [N/m]")
    for place in axes[0]:
        place.set_xlabel("distance of the tip from the base [m]")
    left.legend(loc="upper center")
    return Drawn(
        drawing,
        "Equal torques give less force, and equal gains less stiffness, the farther the tip is off the base.",
    )
