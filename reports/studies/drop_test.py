"""Drop test: limits over the sampling period (Figs 13 and 14), and how sharp they are."""

from collections import defaultdict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, ScalarFormatter

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from reports.style import FAINT, INK, JOINTS, Drawn, figure, legend

__all__ = ["draw"]

_MARKS = ("o", "s", "^", "D", "v", "P")


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the limits over the period, and the share of the phases at rest around them."""
    return [
        (
            "limits",
            "Largest discrete stiffness over the sampling period",
            _limits(result.table("limits"), result.table("passive")),
        ),
        ("shares", "How sharp the limit is", _shares(result.table("limits"), result.table("shares"))),
    ]


def _curves(table: Table, column: str) -> dict[str, tuple[list[float], list[float]]]:
    curves: dict[str, tuple[list[float], list[float]]] = defaultdict(lambda: ([], []))
    rows = zip(table.columns["curve"], table.columns[col.PERIOD], table.columns[column], strict=True)
    for name, period, value in rows:
        if value is not None:
            curves[name][0].append(period)
            curves[name][1].append(value)
    return curves


def _limits(table: Table, passive: Table) -> Drawn:
    columns = list(table.columns)
    exact, first = _curves(table, columns[2]), _curves(table, columns[3])
    kinds = dict(zip(table.columns["curve"], table.columns["kind"], strict=True))
    main = [name for name in first if kinds[name] == "curve"]
    drawing, axes = figure(5.0)
    place: Axes = axes[0, 0]
    for number, name in enumerate(main):
        colour, mark = JOINTS[number % len(JOINTS)], _MARKS[number % len(_MARKS)]
        place.plot(*exact[name], color=colour, linewidth=1.0)
        place.plot(*first[name], mark, color=colour, markersize=4.5, label=name)
    place.plot([], [], color=FAINT, linewidth=1.0, label="lines: exact limit, contact held")
    periods, values = first[main[0]] if main else ([], [])
    if len(periods) > 2:
        power, factor = np.polyfit(np.log(periods), np.log(values), 1)
        place.plot(periods, np.exp(factor) * np.array(periods) ** power, "--", color=FAINT, linewidth=1.0,
                   label=f"fit of {main[0]}: T^{power:.2f}")  # fmt: skip
    line = [(t, k) for t, k in zip(*passive.columns.values(), strict=True) if k is not None]
    if line:
        place.plot(*zip(*line, strict=True), ":", color=INK, linewidth=1.2, label=f"passive: {main[0]}")
    band = [first[name] for name in first if kinds[name] == "sensitivity"]
    if band:
        shared = sorted(set.intersection(*(set(x) for x, _ in band)) & set(periods))
        rows = [[dict(zip(x, y, strict=True))[t] for t in shared] for x, y in [*band, first[main[0]]]]
        place.fill_between(shared, np.min(rows, axis=0), np.max(rows, axis=0), color=JOINTS[0], alpha=0.15,
                           linewidth=0, label="other masses, viscosity, friction, height")  # fmt: skip
    place.set_xscale("log")
    place.set_yscale("log")
    for axis in (place.xaxis, place.yaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    if periods:
        place.set_xticks(
            [t for t in (1, 2, 3, 5, 10, 20, 30, 50, 100, 200) if periods[0] <= t <= 1.01 * periods[-1]]
        )
    place.set_xlabel("sampling period [ms]")
    place.set_ylabel("largest discrete stiffness [N/m]")
    legend(place, columns=3)
    caption = (
        "Marks: first stiffness at which the dropped mass no longer rests at enough phases of the samples. "
        "Lines: exact limit of the held contact, from the eigenvalues of one period."
    )
    return Drawn(drawing, caption)


def _shares(limits: Table, table: Table) -> Drawn:
    exact = dict(
        zip(
            zip(limits.columns["curve"], limits.columns[col.PERIOD], strict=True),
            limits.columns[list(limits.columns)[2]],
            strict=True,
        )
    )
    name = next((curve for (curve, _), limit in exact.items() if limit), "")
    by_period: dict[float, list[tuple[float, float]]] = defaultdict(list)
    rows = zip(*table.columns.values(), strict=True)
    for curve, period, stiffness, share in rows:
        if curve == name and exact[curve, period]:
            by_period[period].append((stiffness / exact[curve, period], 100.0 * share))
    drawing, axes = figure(3.6)
    place: Axes = axes[0, 0]
    shades = np.linspace(0.0, 0.9, len(by_period))
    import matplotlib as mpl

    for shade, (period, points) in zip(shades, sorted(by_period.items()), strict=True):
        x, y = zip(*sorted(points), strict=True)
        place.plot(x, y, ".-", color=mpl.colormaps["cividis"](shade), label=f"{period:.3g} ms", markersize=4)
    place.axvline(1.0, color=FAINT, linewidth=1.0)
    place.set_xlabel("discrete stiffness, over the exact limit of the held contact")
    place.set_ylabel("phases that rest [%]")
    if by_period:
        legend(place, columns=6)
    caption = (
        f"{name or 'No curve has an exact limit'}: below the exact limit a bouncing mass may still not come "
        "to rest, depending on the phase."
    )
    return Drawn(drawing, caption)
