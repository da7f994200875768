"""Practical upper limit of the analog wall: which limit comes first, delay by board, force of the noise."""

import numpy as np
from matplotlib.axes import Axes

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from cosim.units import figures
from reports.style import FAINT, JOINTS, LIMIT, Drawn, figure, legend

__all__ = ["draw"]


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the limits side by side, and noise over stiffness and damping."""
    return [
        ("limits", "What bounds the analog wall", _limits(result.table("limits"))),
        ("delay", "Delay eats the damping", _delay(result.table("delay"))),
        ("noise", "Force of the potentiometer's noise", _noise(result.table("noise"))),
    ]


def _limits(table: Table) -> Drawn:
    drawing, axes = figure(3.2, columns=2, sharey=True)
    names = list(table.columns["limit"])
    for place, column in zip(axes[0], list(table.columns)[1:], strict=True):
        values = table.columns[column]
        known = [value for value in values if value is not None]
        low = 10.0 ** np.floor(np.log10(min(known)) - 0.3)
        for row, value in enumerate(values):
            if value is None:
                place.text(low * 1.2, row, "none", va="center", color=FAINT)
                continue
            place.barh(row, value - low, left=low, height=0.55, color=JOINTS[0], alpha=0.75)
            place.text(value * 1.15, row, figures(value, 3), va="center")
        place.set_xscale("log")
        place.set_xlim(low, max(known) * 8.0)
        place.set_xlabel(f"analog {column}")
        place.grid(visible=False, axis="y")
    axes[0, 0].set_yticks(range(len(names)), names)
    axes[0, 0].invert_yaxis()
    return Drawn(
        drawing,
        "The shortest bar comes first. Only the first two are of the circuit's dynamics; the others are the "
        "choice of a resistor, the motor, and the potentiometer.",
    )


def _delay(table: Table) -> Drawn:
    drawing, axes = figure(3.8)
    place: Axes = axes[0, 0]
    lags, ends = table.columns[col.SUM_OF_TIME_CONSTANTS], table.columns[col.STABLE_SPRING_UP_TO]
    viscosities = table.columns[col.VISCOSITY]
    points = [
        row for row in zip(table.columns["board"], lags, viscosities, ends, strict=True) if row[3] is not None
    ]
    span = np.geomspace(min(row[1] for row in points) / 3.0, max(row[1] for row in points) * 3.0, 50)
    for number, (name, tau, b, end) in enumerate(points):
        colour = JOINTS[number % len(JOINTS)]
        place.plot(span, b / (1e-6 * span), color=colour, linewidth=1.0, alpha=0.6)
        place.plot(
            [tau],
            [end],
            "o",
            color=colour,
            fillstyle="none",
            markersize=12 - 2.5 * number,
            label=f"{name}: b = {b:.3g} N s/m",
            zorder=3,
        )
    place.set_xscale("log")
    place.set_yscale("log")
    place.set_xlabel("sum of the time constants of the spring's path [µs]")
    place.set_ylabel("stiffest stable spring [N/m]")
    legend(place, columns=2)
    return Drawn(
        drawing,
        "Marks: exact border of the held contact, from the netlist. Lines: b / sum(tau) of each board.",
    )


def _noise(table: Table) -> Drawn:
    drawing, axes = figure(3.4, columns=2, sharey=True)
    kinds, values, forces, thresholds = table.columns.values()
    for place, kind, unit in zip(axes[0], ("spring", "damper"), ("N/m", "N s/m"), strict=True):
        rows = [
            (x, y) for name, x, y in zip(kinds, values, forces, strict=True) if name == kind and y is not None
        ]
        place.plot(*zip(*rows, strict=True), ".-", color=JOINTS[0])
        place.axhline(thresholds[0], color=LIMIT, linewidth=1.0)
        place.text(rows[0][0], 1.1 * thresholds[0], f"{thresholds[0]:g} N", color=LIMIT)
        place.set_xscale("log")
        place.set_yscale("log")
        place.set_xlabel(f"analog {'stiffness' if kind == 'spring' else 'damping'} [{unit}]")
    axes[0, 0].set_ylabel("force in the loop, rms [N]")
    return Drawn(drawing, f"{table.note} It grows without bound where delay makes the contact unstable.")
