"""Stability maps: both planes with every limit on the same axes, and the Z-width over frequency."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from reports.style import FAINT, INK, JOINTS, WALL, Drawn, figure

__all__ = ["draw"]

#: Heading of a limit -> its line: colour, dashes, width. Where rules fall together all stay to be seen.
_LINES: Mapping[str, tuple[str, Any, float]] = {
    col.EXACT_BORDER: (INK, "-", 2.0),
    col.PASSIVE: (JOINTS[0], "-", 1.4),
    col.GIL_HULIN: (JOINTS[1], (0, (6, 3)), 1.4),
    col.ABBOTT_OKAMURA: (JOINTS[2], (0, (1.5, 2.5)), 2.2),
    col.DIOLAITI_BETA_1_2: (JOINTS[3], (3, (6, 6)), 1.4),
    col.DIOLAITI_SIGMA_1_2: (JOINTS[4], "-.", 1.4),
    col.DIOLAITI_LARGE_CYCLE: (JOINTS[4], ":", 1.8),
}
_GREEK = {"beta": "\N{GREEK SMALL LETTER BETA}", "sigma": "\N{GREEK SMALL LETTER SIGMA}"}


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the K-T and the K-B plane and the Z-width."""
    pictures = [
        ("kt", "Stiffness over the sampling period", _plane(result, "kt", logarithmic=True)),
        ("kb", "Stiffness over virtual damping", _plane(result, "kb", logarithmic=False)),
    ]
    if result.table("walls").columns["wall"]:
        pictures.append(("zwidth", "Z-width", _widths(result.table("zwidth"), result.table("walls"))))
    return pictures


def _plane(result: StudyResult, name: str, *, logarithmic: bool) -> Drawn:
    limits, points = result.table(f"{name}_limits"), result.table(f"{name}_points")
    panels = list(dict.fromkeys(limits.columns["panel"]))
    rows = math.ceil(len(panels) / 2)
    drawing, axes = figure(0.9 + 3.5 * rows, rows, 2, sharex=True, sharey=True)
    for place in axes.flat[len(panels) :]:
        place.set_visible(False)
    across = list(limits.columns)[1]
    exact = [k for k in limits.columns[col.EXACT_BORDER] if k]
    tried = points.columns[col.STIFFNESS]
    lowest, highest = min([*exact, *tried]), max([*exact, *tried])
    bottom, top = (0.7 * lowest, 1.4 * highest) if logarithmic else (0.0, 1.08 * highest)
    for place, panel in zip(axes.flat, panels, strict=False):
        _limits(place, limits, panel, across, top)
        _points(place, points, panel, across)
        place.set_title(panel)
        if logarithmic:
            place.set_xscale("log")
            place.set_yscale("log")
            for axis in (place.xaxis, place.yaxis):
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
    for place in axes.flat:
        place.set_ylim(bottom, top)
    for place in axes[:, 0]:
        place.set_ylabel("discrete stiffness [N/m]")
    for place in axes[-1]:
        place.set_xlabel(across)
    handles, labels = _all_handles(axes.flat)
    drawing.legend(handles, labels, loc="outside upper center", ncols=4, handlelength=2.6, columnspacing=1.4)
    return Drawn(
        drawing,
        "Shaded: stable by the exact border. Circles: a dropped mass, simulated; full where it comes to "
        "rest, grey where at some phases of the samples only, open where it goes on bouncing.",
    )


def _all_handles(places: Any) -> tuple[list[Any], list[str]]:
    """Return the legend's entries of all panels, each once, in the order of the limits."""
    handles: dict[str, Any] = {}
    for place in places:
        for handle, label in zip(*place.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    order = [_label(heading) for heading in _LINES]
    names = sorted(handles, key=lambda label: order.index(label) if label in order else len(order))
    return [handles[name] for name in names], names


def _label(heading: str) -> str:
    label = heading.removesuffix(" [N/m]")
    for word, sign in _GREEK.items():
        label = label.replace(word, sign)
    return label


def _of(table: Table, panel: str, heading: str) -> NDArray[np.float64]:
    values = zip(table.columns["panel"], table.columns[heading], strict=True)
    return np.array([value for name, value in values if name == panel], float)


def _limits(place: Axes, table: Table, panel: str, across: str, top: float) -> None:
    x = _of(table, panel, across)
    for heading, (colour, dashes, width) in _LINES.items():
        y = _of(table, panel, heading)
        if not (y < top).any():  # nowhere, or beyond the picture
            continue
        if heading.startswith("exact"):
            place.fill_between(x, y, 1e-9, color=WALL, alpha=0.35, linewidth=0)
        place.plot(x, y, color=colour, linestyle=dashes, linewidth=width, label=_label(heading))


def _points(place: Axes, table: Table, panel: str, across: str) -> None:
    x, y, share = (_of(table, panel, key) for key in (across, col.STIFFNESS, col.SHARE_AT_REST))
    kinds = (
        ("rests", share >= 1.0, INK), ("rests at some phases", (share > 0.0) & (share < 1.0), FAINT),
        ("does not rest", share == 0.0, "white"),
    )  # fmt: skip
    for label, mine, face in kinds:
        if mine.any():
            place.plot(x[mine], y[mine], "o", markersize=4.2, markerfacecolor=face, markeredgecolor=INK,
                       markeredgewidth=0.8, label=label, zorder=4)  # fmt: skip


def _widths(table: Table, walls: Table) -> Drawn:
    drawing, axes = figure(6.4, 2, 1, sharex=True, gridspec_kw={"height_ratios": (2, 1)})
    upper, lower = axes[:, 0]
    names = walls.columns["wall"]
    kinds = list(dict.fromkeys(name.split(",")[0] for name in names))
    keys = (col.FREQUENCY, col.FREE_AIR, col.WALL_IMPEDANCE, col.WIDTH)
    for number, name in enumerate(names):
        at = [i for i, wall in enumerate(table.columns["wall"]) if wall == name]
        hz, free, wall, width = (np.array(_taken(table.columns[key], at)) for key in keys)
        kind = name.split(",")[0]  # the same wall in another circuit keeps its colour
        colour = JOINTS[kinds.index(kind) % len(JOINTS)]
        dashes = "--" if walls.columns["circuit"][number] == "ideal" else "-"
        if number == 0:
            for place in (upper, lower):
                half = 0.5e3 / walls.columns[col.PERIOD][0]
                place.axvline(half, color=FAINT, linewidth=0.8, linestyle=":")
            upper.annotate("half the sampling rate", (half, 0.98), xycoords=("data", "axes fraction"),
                           xytext=(-3, 0), textcoords="offset points", rotation=90, ha="right", va="top",
                           fontsize=8, color=FAINT)  # fmt: skip
            upper.loglog(hz, free, color=INK, linewidth=1.8, label="free air")
            upper.fill_between(hz, free, wall, where=list(wall > free), color=WALL, alpha=0.45, linewidth=0)
        text = f"{name}: {walls.columns[col.DISPLAYED][number]:.0f} N/m"
        upper.loglog(hz, wall, dashes, color=colour, label=text)
        lower.semilogx(hz, width, dashes, color=colour)
    upper.set_ylabel("|Z| at the tip [N s/m]")
    lower.set_ylabel("width [dB]")
    lower.axhline(0.0, color=FAINT, linewidth=0.8)
    lower.set_xlabel("frequency [Hz]")
    upper.legend(loc="lower right")
    return Drawn(
        drawing,
        "From free air to the stiffest wall that is stable with a margin; shaded: the computer alone. What "
        "the analog path adds is at low frequency. At its resonance with the device's mass a wall feels "
        "lighter than free air; above, all that is felt is the mass.",
    )


def _taken(column: Sequence[Any], at: Sequence[int]) -> list[float]:
    return [float(column[i]) for i in at]
