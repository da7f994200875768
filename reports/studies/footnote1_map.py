"""Where footnote 1 holds: over stiffness and damping, and over driver and differentiator."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.interpolate import RegularGridInterpolator

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from cosim.types import Array
from reports.style import INK, LIMIT, Drawn, figure

__all__ = ["draw"]


#: Holds; what fails most: stiffness error, delay, noise; nothing known.
_COLOURS = ("#DCEBD9", "#F3DFB8", "#F0C9B8", "#C9D6EA", "#EEEEEE")
_WORDS = ("holds", "stiffness error", "delay (eta)", "force noise", "unstable board")
_KINDS: tuple[tuple[str, str, Any], ...] = (
    ("position", INK, "-"),
    ("peak_to_peak", "#0072B2", "--"),
    ("white", "#A3438A", ":"),
)
_FINE = 161
_CRITERIA = (col.ERROR_OVER_LIMIT, col.ETA_OVER_LIMIT)


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the map over gains and the map over parts."""
    return [
        ("gains", "Where footnote 1 holds, over gains", _over_gains(result)),
        ("parts", "Where footnote 1 holds, over parts", _over_parts(result)),
    ]


def _over_gains(result: StudyResult) -> Drawn:
    table = result.table("gains").columns
    opamps = list(dict.fromkeys(table["op-amp"]))
    drawing, axes = figure(4.6, columns=len(opamps), sharey=True)
    limits = result.table("viscosities").columns
    at = result.table("at").columns
    here = result.table("board").columns[col.STIFFNESS][0]
    for place, opamp in zip(axes[0], opamps, strict=True):
        _map(place, _chosen(table, {"op-amp": opamp}), col.STIFFNESS_K, col.DAMPING_C)
        for b, k in zip(*limits.values(), strict=True):
            place.axvline(k, color=LIMIT, linewidth=0.9, linestyle=(0, (2, 2)))
            place.annotate(f"b = {b:.3g} N s/m", (k, 0.98), xycoords=("data", "axes fraction"), rotation=90,
                           fontsize=7.5, color=LIMIT, ha="left", va="top")  # fmt: skip
        readings = sorted(
            {c for name, c in zip(at["op-amp"], at[col.DAMPING_C], strict=True) if name == opamp}
        )
        low, high = place.get_ylim()
        seen = [c for c in readings if low <= c <= high]
        place.plot([here] * len(seen), seen, "o", color=INK, markersize=4, clip_on=False)
        place.set_title(opamp)
        place.set_xlabel("stiffness k [N/m]")
    axes[0, 0].set_ylabel("damping c [N s/m]")
    _legend(drawing, True)
    return Drawn(
        drawing,
        "What fails most where footnote 1 does not hold; potentiometers silent at rest. Border lines: with "
        "potentiometer noise of each kind. Red: where delay eats its share of a device with the viscosity b. "
        "Dots: the paper's gains in three readings.",
    )


def _over_parts(result: StudyResult) -> Drawn:
    table = result.table("parts").columns
    opamps = list(dict.fromkeys(table["op-amp"]))
    dampings = list(dict.fromkeys(table[col.DAMPING_C]))
    drawing, axes = figure(1.2 + 2.3 * len(dampings), len(dampings), len(opamps), sharex=True, sharey=True)
    x, y = col.CORNER, col.DRIVER_BANDWIDTH
    board = result.table("board").columns
    for i, damping in enumerate(dampings):
        for j, opamp in enumerate(opamps):
            place = axes[i, j]
            _map(place, _chosen(table, {"op-amp": opamp, col.DAMPING_C: damping}), x, y)
            if board[y][0] is not None:
                place.plot(board[x], board[y], "o", color=INK, markersize=4, clip_on=False)
            place.set_title(f"{opamp}, c = {damping:g} N s/m")
        axes[i, 0].set_ylabel("driver's GBW [Hz]")
    for place in axes[-1]:
        place.set_xlabel("corner of the differentiator [Hz]")
    _legend(drawing, False)
    return Drawn(
        drawing,
        f"At {board[col.STIFFNESS][0]:g} N/m, over the driver's gain-bandwidth and the corner of the "
        "differentiator. Dot: the board as it is.",
    )


def _chosen(table: Any, wanted: dict[str, Any]) -> dict[str, list[Any]]:
    rows = [n for n in range(len(table["op-amp"])) if all(table[k][n] == v for k, v in wanted.items())]
    return {name: [values[n] for n in rows] for name, values in table.items()}


def _map(place: Axes, table: dict[str, list[Any]], x: str, y: str) -> None:
    xs, ys = (np.array(sorted(set(table[name]))) for name in (x, y))
    pairs = zip(table[x], table[y], strict=True)
    where = [(int(np.searchsorted(ys, b)), int(np.searchsorted(xs, a))) for a, b in pairs]

    def grid(name: str) -> Array:
        out = np.full((len(ys), len(xs)), np.nan)
        for (row, column), value in zip(where, table[name], strict=True):
            out[row, column] = np.nan if value is None else value
        return out

    names = (*_CRITERIA, *(f"noise, {kind} / limit" for kind, _, _ in _KINDS))
    fine = [_finer(np.log(xs), np.log(ys), np.log(grid(name))) for name in names]
    xs, ys = np.exp(fine[0][0]), np.exp(fine[0][1])
    values = np.exp([value for _, _, value in fine])
    shares = values[:3].copy()
    known = np.isfinite(shares).all(axis=0)
    worst = np.argmax(np.nan_to_num(shares), axis=0) + 1
    code = np.where(known, np.where(shares.max(axis=0) < 1.0, 0, worst), 4)
    place.pcolormesh(xs, ys, code, cmap=ListedColormap(list(_COLOURS)), vmin=-0.5, vmax=4.5,
                     shading="nearest", rasterized=True)  # fmt: skip
    place.set_xscale("log")
    place.set_yscale("log")
    place.set_xlim(xs[0], xs[-1])
    place.set_ylim(ys[0], ys[-1])
    place.grid(visible=False)
    for number, (_, colour, dash) in enumerate(_KINDS):
        shares[2] = values[2 + number]
        level = np.log(np.ma.masked_invalid(shares.max(axis=0)))
        if level.min() < 0.0 < level.max():
            place.contour(xs, ys, level, levels=[0.0], colors=[colour], linestyles=[dash], linewidths=1.6)


def _finer(x: Array, y: Array, values: Array) -> tuple[Array, Array, Array]:
    """Interpolate between grid points; in logarithms what is a power of x and y is exact."""
    finer_x, finer_y = (np.linspace(axis[0], axis[-1], _FINE) for axis in (x, y))
    interpolated = RegularGridInterpolator((y, x), values)
    return finer_x, finer_y, interpolated(tuple(np.meshgrid(finer_y, finer_x, indexing="ij")))


def _legend(drawing: Any, gains: bool) -> None:
    shown = _COLOURS[:4] if gains else _COLOURS
    patches: list[Any] = [Patch(color=c, label=w) for c, w in zip(shown, _WORDS, strict=False)]
    lines = [
        Line2D([], [], color=c, linestyle=d, linewidth=1.6, label=f"border, pot noise {k.replace('_', ' ')}")
        for k, c, d in _KINDS
    ]
    drawing.legend(handles=[*patches, *lines], loc="outside lower center", ncols=4, fontsize=8.5)
