"""The page of a comparison: changed figures, rendered paths, poles."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cosim.caution import grouped
from cosim.storage.owned_files import manifest_of
from cosim.units import quantity
from reports.compare import overlay
from reports.page import Picture, picture, render, write_page
from reports.style import FAINT, JOINTS, Drawn, figure, legend, look
from reports.tables import Table, Trial, command_line

if TYPE_CHECKING:
    from cosim.circuits.linear_circuit import LinearCircuit
    from cosim.comparisons.compare_boards import Row, Side

_DASHES = ("-", (0, (5, 2)), (0, (2, 1.5)), (0, (6, 1.5, 1, 1.5)))
_MARKS = ("o", "x", "+", "d")
MANIFEST = manifest_of("compare")
#: Most bars in a picture, and most sides that it tells apart.
_MOST_BARS, _MOST_SIDES = 16, 4
_TITLES = {
    "measures": "Measures of the run",
    "gains": "Gains: what the computer believes in, as measured",
    "paths": "Signal paths: delay, bandwidth, and what the delay costs",
    "poles": "Poles",
    "bounds": "Bounds of the circuit models",
    "loops": "Margins of the loops",
    "headroom": "Headroom",
    "noise": "Noise at the tip",
    "dissipation": "Dissipation in this scene",
    "out of contact": "Out of contact, all gains zero",
}


def write_comparison(sides: "Sequence[Side]", rows: "Sequence[Row]", folder: Path) -> Path:
    """Write ``report.html`` and its figures; returns the page.

    Raises
    ------
    InputError
        When the folder cannot be written.
    """
    shown = sides[:_MOST_SIDES]
    pictures: list[Picture] = []
    with look():
        for name, title, drawn in (
            ("changed", "What changed", bars(sides, rows)),
            ("paths", "Stiffness and damping as rendered", bode(shown)),
            ("poles", "Poles", poles(shown)),
            ("compare", "The scene", overlay([Trial(s.label, s.run.measures, s.run) for s in sides])),
        ):
            if drawn is not None:
                pictures.append(picture(name, title, drawn))
    html = render(
        "run.html.j2",
        title=f"{sides[0].plan.scene.title}: {' against '.join(side.label for side in sides)}",
        command=command_line(sides[-1].run.provenance.get("command")),
        warnings=grouped(
            [replace(each, text=f"{side.label}: {each.text}") for side in sides for each in side.run.warnings]
        ),
        tiles=[],
        summary=_summary(sides, rows),
        compare=None,
        compared=[],
        inputs=None,
        pictures=pictures,
        absent=[],
        tables=tables(sides, rows),
        printed=[],
        scene="",
    )
    return write_page(folder, html, pictures, manifest=MANIFEST)


def cells(row: "Row") -> list[str]:
    """Return the values of a figure with unit, each further one with its change."""
    first = row.values[0]
    return [_cell(value, row.unit, first if k else None) for k, value in enumerate(row.values)]


def _cell(value: float | None, unit: str, first: float | None) -> str:
    if value is None:
        return "none"
    text = quantity(value, unit, 4)
    if first is None or first == 0.0 or value == first:
        return text
    change = 100.0 * (value / first - 1.0)
    return f"{text} ({change:+.3g} %)" if abs(change) < 1000.0 else f"{text} (x {value / first:.3g})"


def tables(sides: "Sequence[Side]", rows: "Sequence[Row]") -> list[Table]:
    """Return one table a section with all that changed."""
    head = ("", "where", *(side.label for side in sides))
    numbers = frozenset(range(2, len(head)))
    out = []
    for section, title in _TITLES.items():
        inside = tuple((r.quantity, r.where, *cells(r)) for r in rows if r.section == section)
        if inside:
            out.append(Table(section.replace(" ", "-"), title, head, inside, "", numbers))
    return out


def felt(rows: "Sequence[Row]", most: int = 4) -> list[str]:
    """Say which changes are felt, the largest first, and how many others there are."""
    beyond = [row for row in rows if row.felt is not None and row.felt >= 1.0]
    if not beyond:
        return ["No force, stiffness or damping at the hand changes by what is noticed or tolerated."]
    lines = [
        f"{row.quantity}{f' ({row.where})' if row.where else ''}: {', '.join(cells(row))}; "
        + (f"{row.felt:.3g} times" if math.isfinite(row.felt or 0.0) else "beyond any")
        + f" what matters: {row.by}"
        for row in beyond[:most]
    ]
    more = len(beyond) - len(lines)
    return [f"Felt: {line}." for line in lines] + ([f"{more} more are felt."] if more else [])


def _summary(sides: "Sequence[Side]", rows: "Sequence[Row]") -> list[str]:
    lines = []
    changed = {row.section for row in rows}
    same = [title for section, title in _TITLES.items() if section not in changed]
    lines.append(
        f"{len(rows)} figures differ by more than rounding."
        if rows
        else "No figure differs by more than rounding."
    )
    lines += felt(rows) if rows else []
    if same and rows:
        lines.append(f"Nothing changed in: {'; '.join(title[0].lower() + title[1:] for title in same)}.")
    for name in dict.fromkeys(name for side in sides for name, _ in side.findings):
        words = [(side.label, dict(side.findings).get(name, "not known")) for side in sides]
        if len({text for _, text in words}) == 1:
            lines.append(f"{name[0].upper()}{name[1:]}, on all sides: {words[0][1]}.")
        else:
            lines.append(
                f"{name[0].upper()}{name[1:]}: "
                + "; ".join(f"{label}: {text}" for label, text in words)
                + "."
            )
    return lines


def bars(sides: "Sequence[Side]", rows: "Sequence[Row]") -> Drawn | None:
    """Relative changes against the first side, the largest on top."""
    drawn = [row for row in rows if row.values[0] and row.values[1] is not None][:_MOST_BARS]
    if not drawn:
        return None
    drawing, grid = figure(1.1 + 0.36 * len(drawn))
    axes = grid[0, 0]
    others = sides[1 : 1 + _MOST_SIDES]
    height = 0.8 / len(others)
    places = np.arange(len(drawn))[::-1]
    limit = 0.0
    for number, side in enumerate(others, 1):
        change = np.array(
            [100.0 * ((r.values[number] or 0.0) / (r.values[0] or 1.0) - 1.0) for r in drawn],
            dtype=np.float64,
        )
        limit = max(limit, float(np.abs(change).max()))
        at = places + height * (0.5 * (len(others) - 1) - (number - 1))
        axes.barh(at, change, height=0.9 * height, color=JOINTS[number], label=side.label)
    axes.set_yticks(places, [_bar_name(row) for row in drawn], linespacing=1.05)
    if limit > 300.0:
        axes.set_xscale("symlog", linthresh=10.0)
    axes.axvline(0.0, color=FAINT, linewidth=0.8)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel(f"change against {sides[0].label} [%]")
    legend(axes)
    caption = "The largest relative changes; where one reads the same at several places, it stands once."
    if len(rows) > len(drawn):
        caption += f" {len(drawn)} of {len(rows)} are drawn, the tables hold all."
    return Drawn(drawing, caption)


def _bar_name(row: "Row") -> str:
    """Return a name of at most two lines: the figure, and where it is read."""
    words = textwrap.shorten(row.quantity, 52, placeholder="...")
    if not row.places:
        return words
    place = row.places[0] if len(row.places) == 1 else f"{len(row.places)} places"
    return f"{words}\n{textwrap.shorten(place, 52, placeholder='...')}"


def bode(sides: "Sequence[Side]") -> Drawn | None:
    """Stiffness and damping of a joint at full-scale gain over frequency, each with its phase."""
    known = [(side, side.circuit) for side in sides if side.circuit is not None]
    if not known:
        return None
    hz = np.geomspace(0.1, 1e6, 500)
    joint = _joint(known, hz)
    drawing, grid = figure(5.2, 2, 2, sharex=True)
    for number, (side, circuit) in enumerate(known):
        spring, damper = rendered(side, circuit, joint, hz)
        line = {"color": JOINTS[number], "linestyle": _DASHES[number], "label": side.label}
        for column, response in enumerate((spring, damper)):
            grid[0, column].loglog(hz, np.abs(response), **line)
            grid[1, column].semilogx(hz, np.degrees(np.unwrap(np.angle(response))), **line)
    grid[0, 0].set_ylabel("stiffness [N m/rad]")
    grid[0, 1].set_ylabel("damping [N m s/rad]")
    for axes in grid[1]:
        axes.set_ylabel("phase [deg]")
        axes.set_xlabel("frequency [Hz]")
        axes.set_ylim(max(axes.get_ylim()[0], -360.0), max(axes.get_ylim()[1], 10.0))
    for axes in grid[0]:
        top = axes.get_ylim()[1]
        axes.set_ylim(max(axes.get_ylim()[0], 1e-5 * top), top)
    legend(grid[0, 0])
    caption = (
        f"Joint {joint + 1}: torque per angle through its spring, and torque per speed through its damper, "
        "one at a time at full-scale gain, from the fitted small-signal model. A flat line with no phase is "
        "what the computer believes in."
    )
    return Drawn(drawing, caption)


def rendered(
    side: "Side", circuit: "LinearCircuit", joint: int, hz: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return stiffness [N m/rad] and damping [N m s/rad] of a joint over frequency at full-scale gain."""
    stated, n = side.plan.stated(), circuit.joints
    s = 2j * np.pi * hz
    responses = []
    for first, rate in ((0, np.ones_like(s)), (n * n, s)):
        volts = np.zeros(2 * n * n)
        volts[first + joint * n + joint] = stated.v_fs
        current = circuit.response(s, volts)[:, joint, joint]
        responses.append(-current / rate * stated.kt * stated.gear)
    return responses[0], responses[1]


def _joint(known: "Sequence[tuple[Side, LinearCircuit]]", hz: NDArray[np.float64]) -> int:
    """Return the joint whose paths differ most."""

    def apart(joint: int) -> float:
        first, *others = (np.stack(rendered(side, circuit, joint, hz[:400:20])) for side, circuit in known)
        return max((float(np.abs(each / first - 1.0).max()) for each in others), default=0.0)

    joints = range(min(circuit.joints for _, circuit in known))
    return max(joints, key=lambda joint: (round(apart(joint), 6), -joint))


def poles(sides: "Sequence[Side]") -> Drawn | None:
    """Poles by frequency and damping ratio."""
    known = [(side, side.circuit.poles) for side in sides if side.circuit is not None and side.circuit.order]
    if not known:
        return None
    drawing, grid = figure(3.4)
    axes = grid[0, 0]
    for number, (side, roots) in enumerate(known):
        upper = roots[roots.imag >= 0.0]
        hz, ratio = np.abs(upper) / (2 * np.pi), -upper.real / np.abs(upper)
        mark = _MARKS[number]
        filled = (
            {"facecolors": "none", "edgecolors": JOINTS[number]}
            if mark in "od"
            else {"color": JOINTS[number]}
        )
        axes.scatter(
            hz, ratio, s=46 if mark in "od" else 34, marker=mark, linewidths=1.3, label=side.label, **filled
        )
    axes.set_xscale("log")
    axes.set_ylim(min(axes.get_ylim()[0], -0.05), 1.1)
    axes.set_xlabel("natural frequency [Hz]")
    axes.set_ylabel("damping ratio")
    legend(axes)
    return Drawn(
        drawing,
        "Poles of the signal paths, pairs as one mark: 1 is a real pole, below 0.7 it rings, below 0 it is "
        "unstable. A mark without its partner has moved.",
    )
