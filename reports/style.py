"""One look for all figures: sizes, colours that colour-blind readers tell apart, and the recurring marks.

Figures are made without pyplot, so that drawing leaves no state behind and needs no display.
"""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter
from numpy.typing import NDArray

from reports.decimate import keep_peaks

__all__ = [
    "CONTACT",
    "FAINT",
    "FORCE",
    "INK",
    "JOINTS",
    "LIMIT",
    "POSITION",
    "WALL",
    "Drawn",
    "curve",
    "figure",
    "held",
    "legend",
    "look",
    "pictures",
    "sample_ticks",
    "shade",
]

# Okabe and Ito's set, the pale members darkened until they carry a thin line on white.
JOINTS = ("#0072B2", "#D55E00", "#00805E", "#A3438A", "#8A6D00", "#4D4D4D")
FORCE = JOINTS[0]
POSITION = JOINTS[1]
INK = "#222222"
FAINT = "#8C8C8C"
LIMIT = "#B2182B"
WALL = "#C9C4BA"
CONTACT = "#EFEBDD"

WIDTH_IN = 9.2

# As Any: the keys that matplotlib types differ between its versions.
_RC: Any = {
    "font.family": "DejaVu Sans",  # ships with matplotlib: the same picture on every machine
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.labelcolor": INK,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "axes.prop_cycle": cycler(color=JOINTS),
    "grid.color": "#E2E2E2",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "path.simplify": True,
    "svg.fonttype": "path",  # letters as outlines: the page needs no font of the reader's
    "svg.hashsalt": "cosim",  # the same run gives the same bytes
}


@dataclass(frozen=True)
class Drawn:
    """A finished figure and the sentence that says what to see in it."""

    figure: Figure
    caption: str

    def __post_init__(self) -> None:
        _take_literally(self.figure)


def _take_literally(figure: Figure) -> None:
    """Draw every ``$`` as it is: labels hold the user's names, which are no formulas.

    Only what matplotlib itself writes at the ticks of a scale is left a formula.
    """
    ticks: set[int] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            for formatter, marks in (
                (axis.get_major_formatter(), axis.get_major_ticks()),
                (axis.get_minor_formatter(), axis.get_minor_ticks()),
            ):
                if not isinstance(formatter, FixedFormatter | FuncFormatter):
                    ticks |= {id(label) for mark in marks for label in (mark.label1, mark.label2)}
    for text in figure.findobj(Text):
        if isinstance(text, Text) and id(text) not in ticks:
            text.set_parse_math(False)


@contextmanager
def look() -> Iterator[None]:
    """Use this look, and matplotlib's own defaults elsewhere, whatever the user's matplotlibrc says."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


class _Shown(Figure):
    """A figure that shows itself in a notebook without pyplot."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=100)
        return stream.getvalue()


def figure(height_in: float, rows: int = 1, columns: int = 1, **grid: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of the page's width with its axes as an array of shape ``(rows, columns)``."""
    drawing = _Shown(figsize=(WIDTH_IN, height_in))
    return drawing, drawing.subplots(rows, columns, squeeze=False, **grid)


def pictures(drawing: Figure) -> dict[str, bytes]:
    """Return a figure as files: ``svg`` and ``png``."""
    svg, png = io.BytesIO(), io.BytesIO()
    # `savefig` lays a figure out and walks through it once more for every file: once is enough for both
    drawing.draw_without_rendering()
    drawing.set_layout_engine("none")
    as_svg: Any = FigureCanvasSVG(drawing)  # matplotlib types neither method
    as_svg.print_svg(svg, metadata={"Date": None})
    drawing.set_dpi(150)
    as_png: Any = FigureCanvasAgg(drawing)
    as_png.print_png(png)
    return {"svg": svg.getvalue(), "png": png.getvalue()}


def curve(axes: Axes, time: NDArray[np.float64], value: NDArray[np.float64], **line: Any) -> Line2D:
    """Draw a signal, thinned without losing its peaks."""
    return axes.plot(*keep_peaks(time, value), **line)[0]


def held(
    axes: Axes, time: NDArray[np.float64], value: NDArray[np.float64], end_s: float, **line: Any
) -> Line2D:
    """Draw what the computer holds from one sample to the next, until `end_s`."""
    stop = max(end_s, float(time[-1]))
    return curve(axes, np.append(time, stop), np.append(value, value[-1]), drawstyle="steps-post", **line)


def shade(axes: Axes, spans: Sequence[tuple[float, float]], label: str = "contact") -> None:
    """Shade spans of time behind the curves."""
    for number, (start, stop) in enumerate(spans):
        axes.axvspan(start, stop, color=CONTACT, linewidth=0, zorder=0, label=label if number == 0 else None)


def sample_ticks(axes: Axes, samples: NDArray[np.float64], most: int = 250) -> bool:
    """Mark the samples with short strokes at the foot, where they are few enough to be told apart."""
    low, high = axes.get_xlim()
    inside = samples[(samples >= low) & (samples <= high)]
    if not 0 < inside.size <= most:
        return False
    axes.vlines(inside, 0.0, 0.025, transform=axes.get_xaxis_transform(), color=FAINT, linewidth=0.6)
    return True


def legend(axes: Axes, *others: Axes, columns: int = 6) -> None:
    """Put one legend for `axes` and its twins above the plot, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    for other in others:
        more, names = other.get_legend_handles_labels()
        handles, labels = handles + more, labels + names
    if handles:
        axes.legend(
            handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns,
            borderaxespad=0.2, handlelength=1.8, columnspacing=1.2,
        )  # fmt: skip
