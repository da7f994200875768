"""An analog wall switched on at samples: rest over period and stiffness, jump and energy of the onset."""

from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import NullFormatter, ScalarFormatter

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from reports.style import FAINT, INK, JOINTS, Drawn, figure

__all__ = ["draw"]

_MARKS = ("o", "s", "^", "D")
#: From never to always at rest.
_REST = LinearSegmentedColormap.from_list("rest", ["#B2182B", "#F4E3D7", "#0072B2"])


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the maps of rest, and jump and energy over the period."""
    table = result.table("onset")
    return [
        ("rest", "Phases at which a dropped mass comes to rest", _rest(table)),
        ("onset", "Jump of force and energy of a contact", _onset(table)),
    ]


def _ways(table: Table) -> list[str]:
    return list(dict.fromkeys(table.columns["way"]))


def _rows(table: Table, way: str) -> dict[str, np.ndarray[Any, Any]]:
    keep = np.array([name == way for name in table.columns["way"]])
    return {name: np.array(values, float)[keep] for name, values in table.columns.items() if name != "way"}


def _rest(table: Table) -> Drawn:
    ways = _ways(table)
    drawing, axes = figure(3.9, columns=len(ways), sharey=True)
    drawn: Any = None
    for place, way in zip(axes[0], ways, strict=True):
        rows = _rows(table, way)
        periods, springs = np.unique(rows[col.PERIOD]), np.unique(rows[col.ANALOG_STIFFNESS])
        share = np.full((len(springs), len(periods)), np.nan)
        at = (
            np.searchsorted(springs, rows[col.ANALOG_STIFFNESS]),
            np.searchsorted(periods, rows[col.PERIOD]),
        )
        share[at] = 100.0 * rows[col.PHASES_THAT_REST]
        drawn = place.pcolormesh(
            _edges(periods), _edges(springs), share, cmap=_REST, vmin=0, vmax=100, rasterized=True
        )
        _logarithmic(place, periods)
        place.set_title("\n".join(wrap(way, 22)))
        place.set_xlabel("sampling period [ms]")
        place.grid(visible=False)
    axes[0, 0].set_ylabel("analog stiffness [N/m]")
    drawing.colorbar(drawn, ax=list(axes[0]), label="phases that rest [%]", shrink=0.9)
    return Drawn(
        drawing,
        "A mass dropped on a wall of analog springs alone. What the samples add at each contact must be "
        "braked away; bands of rest come back above the first stiffness that fails.",
    )


def _edges(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    log = np.log(values)
    middle = (log[1:] + log[:-1]) / 2
    edges: np.ndarray[Any, Any] = np.exp([2 * log[0] - middle[0], *middle, 2 * log[-1] - middle[-1]])
    return edges


def _logarithmic(place: Axes, periods: np.ndarray[Any, Any]) -> None:
    place.set_xscale("log")
    place.set_yscale("log")
    for axis in (place.xaxis, place.yaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    place.set_xticks([t for t in (3, 10, 30, 100) if 0.9 * periods[0] <= t <= 1.1 * periods[-1]])


def _onset(table: Table) -> Drawn:
    stiffness = min(set(table.columns[col.ANALOG_STIFFNESS]), key=lambda k: abs(k - 100.0))
    drawing, axes = figure(4.8, columns=2)
    for number, way in enumerate(_ways(table)):
        rows = _rows(table, way)
        keep = rows[col.ANALOG_STIFFNESS] == stiffness
        period = rows[col.PERIOD][keep]
        colour, mark = JOINTS[number % len(JOINTS)], _MARKS[number % len(_MARKS)]
        axes[0, 0].plot(
            period, rows[col.ONSET_JUMP][keep], mark + ":", color=colour,
            markerfacecolor="none", markersize=4.5, linewidth=0.9,
        )  # fmt: skip
        axes[0, 0].plot(
            period, rows[col.LARGEST_JUMP][keep], mark + "-", color=colour,
            markersize=4.5, linewidth=0.9, label=way,
        )  # fmt: skip
        axes[0, 1].plot(
            period, rows[col.CONTACT_ENERGY][keep], mark + "-", color=colour,
            markersize=4.5, linewidth=0.9, label=way,
        )  # fmt: skip
        if number == 0:
            axes[0, 0].plot(
                period, rows[col.JUMP_CLOSED_FORM][keep], "--", color=INK, linewidth=0.9, label="k v T"
            )
            axes[0, 1].plot(
                period, rows[col.ONSET_CLOSED_FORM][keep], "--", color=INK, linewidth=0.9,
                label="onset, closed form of the mean",
            )  # fmt: skip
            axes[0, 1].plot(
                period, rows[col.ENERGY_CLOSED_FORM][keep], ":", color=FAINT, label="k (v T)² / 2: at worst"
            )
    for place, name in zip(axes[0], ("jump of force [N]", "energy added by the samples [mJ]"), strict=True):
        place.set_xscale("log")
        place.set_xlabel("sampling period [ms]")
        place.set_ylabel(name)
        place.xaxis.set_major_formatter(ScalarFormatter())
        place.xaxis.set_minor_formatter(NullFormatter())
        place.set_xticks([3, 10, 30, 100])
        place.legend(loc="upper left")
        place.set_yscale("symlog", linthresh=0.01, linscale=0.5)
        low, high = place.get_ylim()
        place.set_ylim(max(low, -0.02), 60.0 * high)  # room for the legend
    return Drawn(
        drawing,
        f"First contact of a drop, {stiffness:g} N/m, mean over the phases. Left: largest jump of the force "
        "at any sample of the contact (lines), and at its first (dotted, open).",
    )
