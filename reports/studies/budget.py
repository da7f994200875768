"""Both budgets as bars, on logarithmic scales."""

from collections.abc import Sequence

from matplotlib.axes import Axes

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from cosim.units import quantity
from reports.style import JOINTS, Drawn, figure

__all__ = ["draw"]

_GROUPS = {"potentiometer": JOINTS[0], "quantisation": JOINTS[1], "components": JOINTS[2]}


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the bars of errors and of noise."""
    errors, forces = result.table("errors").columns, result.table("forces").columns
    millimetres = next(name for name in errors if name.startswith("one joint"))
    drawing, axes = figure(7.2, rows=2)
    left, right = axes[:, 0]
    labels = [f"{s} ({m})" for s, m in zip(errors["source"], errors["meant as"], strict=True)]
    _bars(left, labels, errors[millimetres], [JOINTS[0]] * len(labels), ("m", 1e-3))
    left.set_xlabel("error at the tip, " + millimetres.replace(" [mm]", "") + " [mm]")
    left.set_title("What is measured wrongly")
    colours = [_GROUPS.get(group, JOINTS[5]) for group in forces["group"]]
    names = [f"{g}: {s}" for g, s in zip(forces["group"], forces["source"], strict=True)]
    _bars(right, names, forces[col.FORCE_RMS], colours, ("N", 1.0))
    right.set_xlabel("force along the normal [N rms]")
    right.set_title("What makes the force noisy")
    caption = f"{result.table('errors').note} {result.table('forces').note}"
    return [("budget", "Error and noise budgets", Drawn(drawing, caption))]


def _bars(
    place: Axes, labels: list[str], values: Sequence[float], colours: list[str], unit: tuple[str, float]
) -> None:
    least = min(value for value in values if value > 0.0)
    rows = range(len(labels))
    place.barh(rows, [max(v, 0.0) for v in values], color=colours, height=0.7)
    for number, value in enumerate(values):
        text = quantity(value * unit[1], unit[0], 2) if value > 0.0 else "none"
        place.annotate(text, (max(value, 0.4 * least), number), (3, 0), textcoords="offset points",
                       va="center", fontsize=7.5)  # fmt: skip
    place.set_xscale("log")
    place.set_xlim(0.4 * least, 12.0 * max(values))
    place.set_yticks(list(rows), labels, fontsize=8)
    place.invert_yaxis()
    place.grid(visible=False, axis="y")
