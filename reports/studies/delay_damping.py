"""The headline of footnote 1: damping eaten by delay against the device's own, over stiffness."""

import numpy as np

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult
from reports.style import FAINT, INK, JOINTS, LIMIT, WALL, Drawn, figure

__all__ = ["draw"]

#: Stiffness drawn [N/m], and the least of what delay eats [N s/m].
_K = (10.0, 1e8)
_LEAST = 1e-6
#: Limits nearer to each other than this, in the logarithm, share a label.
_APART = 0.5
_DASHES = ((0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return k against k sum(tau), with b as a band and crossings marked."""
    blocks, limits = result.table("blocks").columns, result.table("limits").columns
    spread = result.table("viscosity").columns
    b = dict(zip(spread[col.SHARE_OF_VISCOSITY], spread[col.VISCOSITY_B], strict=True))
    drawing, grid = figure(5.4)
    axes = grid[0, 0]
    k = np.geomspace(*_K, 2)
    cases = list(limits["case"])
    here = limits[col.VISCOSITY_AT_THE_WALL][0]
    axes.axhspan(b["5 %"], b["95 %"], color=WALL, alpha=0.55, linewidth=0, zorder=0,
                 label="device's viscosity b, 5 to 95 % of the poses")  # fmt: skip
    axes.axhline(here, color=FAINT, linewidth=1.0, label=f"b at the wall's pose, {here:.3g} N s/m")
    rows = [
        (name, 1e-6 * late, cross)
        for case, name, late, cross in zip(
            blocks["case"], blocks["block"], blocks[col.DELAY],
            blocks[col.LIMIT_BY_TAU], strict=True,
        )
        if case == cases[0] and cross is not None
    ]  # fmt: skip
    rows.sort(key=lambda row: -row[1])
    for number, (name, late, cross) in enumerate(rows):
        colour = JOINTS[number % len(JOINTS)]
        axes.plot(k, k * late, color=colour, label=f"{name}, {_time(late)}: {_stiffness(cross)}")
        axes.plot(cross, here, "o", color=colour, markersize=4)
    marked: list[float] = []
    for number, case in enumerate(cases):
        total = 1e-6 * limits[col.SUM_OF_DELAYS][number]
        limit = limits[col.LIMIT_BY_SUM][number]
        dash = "-" if number == 0 else _DASHES[(number - 1) % len(_DASHES)]
        level = limits[col.VISCOSITY_AT_THE_WALL][number]
        axes.plot(k, k * total, color=INK, linewidth=4.0 if number == 0 else 1.3, linestyle=dash,
                  alpha=0.35 if number == 0 else 1.0, zorder=1.5,
                  label=f"all blocks, {case}, {_time(total)}: {_stiffness(limit)}")  # fmt: skip
        if limit is not None:
            axes.plot(limit, level, "s", color=LIMIT, markersize=6, zorder=5)
            if all(abs(np.log(limit / other)) > _APART for other in marked):
                axes.annotate(
                    f"practical limit {_stiffness(limit)}", (limit, level), (10, -14),
                    textcoords="offset points", color=LIMIT, fontweight="bold", fontsize=9,
                    bbox={"facecolor": "white", "alpha": 0.85, "pad": 1.0, "linewidth": 0},
                )  # fmt: skip
            marked.append(limit)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*_K)
    axes.set_ylim(_LEAST, 100.0)
    axes.set_xlabel("stiffness k [N/m]")
    axes.set_ylabel("damping eaten by delay, k sum(tau) [N s/m]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8.5)
    caption = (
        "A spring k that acts late by tau takes k tau from the damping. Where a line crosses the device's "
        "viscosity b nothing is left: the practical limit of analog stiffness (squares: all blocks; dots: "
        "each block alone). A case with another viscosity has its square at that."
    )
    return [("eta", "Damping eaten by delay", Drawn(drawing, caption))]


def _time(seconds: float) -> str:
    return f"{1e9 * seconds:.3g} ns" if seconds < 1e-6 else f"{1e6 * seconds:.3g} µs"


def _stiffness(value: float | None) -> str:
    if value is None:
        return "no limit"
    for unit, scale in (("MN/m", 1e6), ("kN/m", 1e3)):
        if value >= scale:
            return f"{value / scale:.3g} {unit}"
    return f"{value:.3g} N/m"
