"""Stability as a picture: where the eigenvalues go as the wall stiffens, and the limits over the period."""

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.analysis.held_contact import HeldContact
from cosim.analysis.stiffness_limits import Limits, limits, locus
from cosim.scene import Scene
from cosim.storage.owned_files import manifest_of, write_files
from cosim.studies.grid import decimal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Files that `write_stability` writes, and their manifest.
FILES, MANIFEST = ("stability.csv", "stability.svg", "stability.png"), manifest_of("stability")
#: Points of the locus, and sampling periods of the map as shares of the scene's.
_POINTS, _PERIODS = 161, np.geomspace(0.2, 5.0, 9)


def write_stability(limits: Limits, contact: HeldContact, folder: Path) -> Path:
    """Write ``stability.png``, ``.svg`` and ``.csv`` (limits over the period); return the PNG.

    Raises
    ------
    InputError
        As `cosim.storage.owned_files.write_files`.
    """
    from reports.style import look, pictures

    rows = over_period(contact)
    table = io.StringIO()
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with look():
        drawn = pictures(draw(limits, contact, rows))
    content = (table.getvalue().encode(), drawn["svg"], drawn["png"])
    write_files(folder, dict(zip(FILES, content, strict=True)), MANIFEST)
    return folder / FILES[-1]


def over_period(contact: HeldContact) -> list[dict[str, float | None]]:
    """Return border, passive, Gil and Hulin's and the board's stiffness [N/m] over the period."""
    rows: list[dict[str, float | None]] = []
    for share in _PERIODS:
        period = decimal(float(share) * contact.scene.computer.period_s)
        each = limits(contact.with_computer(period_s=period)).as_dict()
        rows.append(
            {
                "period_s": period,
                "border_n_per_m": each["border_n_per_m"],
                "passive_n_per_m": each["passive_n_per_m"],
                "gil_hulin_n_per_m": each["gil_hulin_n_per_m"],
                "board_n_per_m": each["board_n_per_m"],
            }
        )
    return rows


def draw(limits: Limits, contact: HeldContact, rows: list[dict[str, float | None]]) -> "Figure":
    """Return the figure: root locus beside limits over the sampling period."""
    from reports.style import figure as new_figure

    drawing, axes = new_figure(4.6, columns=2, gridspec_kw={"width_ratios": (1, 1)})
    plane, over = axes[0]
    edge = limits.border.value if np.isfinite(limits.border.value) and limits.border.value > 0.0 else 1e4
    values = np.geomspace(edge / 30.0, edge * 3.0, _POINTS)
    _locus(plane, locus(contact, values), values, edge)
    if limits.border.stability is not None and limits.border.stability.critical is not None:
        at = limits.border.stability.critical.z
        plane.plot([at.real] * 2, [at.imag, -at.imag], "o", color="#B2182B", markersize=5,
                   label=f"border, {limits.border.value:.4g} N/m")  # fmt: skip
    z = np.array([mode.z for mode in limits.stability.modes if abs(mode.z) > 0.05])
    if len(z):
        plane.plot(
            np.concatenate([z.real, z.real]), np.concatenate([z.imag, -z.imag]), "x", color="#222222",
            label=f"scene, {limits.stiffness:.4g} N/m",
        )  # fmt: skip
    plane.legend(loc="lower left")
    _over(over, rows, contact.scene, limits)
    return drawing


def _locus(plane: "Axes", roots: list[Any], values: Any, edge: float) -> None:
    from matplotlib.colors import LogNorm

    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    plane.plot(circle.real, circle.imag, color="#8C8C8C", linewidth=1.0)
    points = np.concatenate(roots)
    shades = np.concatenate([np.full(len(z), value) for z, value in zip(roots, values, strict=True)])
    near = np.abs(points) < 1.6
    drawn = plane.scatter(
        points.real[near], points.imag[near], c=shades[near], s=7, cmap="cividis", linewidths=0,
        norm=LogNorm(values[0], values[-1]),
    )  # fmt: skip
    # the part of the plane where something happens, and the circle beside it
    shown = points[near & (np.abs(points) > 0.3)]
    wide = 1.15 * float(max(np.abs(shown.imag).max(initial=0.0), 0.3))
    left = float(min(shown.real.min(initial=0.7), 1.15 - 2.0 * wide)) - 0.05
    plane.set_aspect("equal")
    plane.set_xlim(left, 1.15)
    plane.set_ylim(-wide, wide)
    plane.set_xlabel("real part")
    plane.set_ylabel("imaginary part")
    plane.set_title("Eigenvalues of one period")
    assert plane.figure is not None
    bar = plane.figure.colorbar(drawn, ax=plane, shrink=0.8)
    bar.set_label("stiffness [N/m]")
    bar.ax.axhline(edge, color="#B2182B", linewidth=2)


def _over(over: "Axes", rows: list[dict[str, float | None]], scene: Scene, limits: Limits) -> None:
    from matplotlib.ticker import NullFormatter

    from reports.style import JOINTS, LIMIT

    period = [1e3 * float(row["period_s"] or 0.0) for row in rows]

    def column(name: str) -> list[float]:
        return [np.nan if row[name] is None else float(row[name] or 0.0) for row in rows]

    over.loglog(period, column("border_n_per_m"), "o-", color=LIMIT, label="exact border", markersize=4)
    over.loglog(period, column("passive_n_per_m"), "s-", color=JOINTS[0], label="passive", markersize=4)
    for name, line, shade, label in (
        ("gil_hulin_n_per_m", "--", JOINTS[2], "Gil and Hulin"),
        ("board_n_per_m", ":", "#222222", "board's range"),
    ):
        if rows[0][name] is not None:
            over.loglog(period, column(name), line, color=shade, label=label)
    if limits.stiffness > 0.0:
        over.plot([1e3 * scene.computer.period_s], [limits.stiffness], "x", color="#222222", label="scene")
    ticks = [m * 10.0**d for d in range(-3, 4) for m in (1, 2, 5)]
    over.set_xticks([x for x in ticks if period[0] * 0.9 < x < period[-1] * 1.1])
    over.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    over.xaxis.set_minor_formatter(NullFormatter())
    over.set_xlabel("sampling period [ms]")
    name = limits.key.split("_")[0]
    over.set_ylabel(f"{name} stiffness [N/m]")
    over.set_title("How stiff the wall may be")
    over.legend(loc="lower left")
