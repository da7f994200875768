"""Where the fingertip went, what it felt, and what happened between two samples."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reports.decimate import keep_peaks
from reports.source import View, WallFrame
from reports.style import (
    FAINT,
    FORCE,
    INK,
    JOINTS,
    POSITION,
    WALL,
    Drawn,
    curve,
    figure,
    held,
    legend,
    sample_ticks,
    shade,
)
from reports.text import scale

__all__ = ["nodes", "path", "tangent_normal", "zoom"]

Array = NDArray[np.float64]

#: The largest arrow is the panel's height divided by this.
_ARROWS = 3.2


def _linkage(view: View, at: int) -> tuple[Array, Array]:
    """Corners of the linkage [m] at point `at`, from its base to its tip."""
    lengths = view.scene_at("device", "chain", "lengths_m", default=())
    if len(lengths) != view.joints or not view.has(*(f"q{j + 1}" for j in range(view.joints))):
        return np.zeros(0), np.zeros(0)
    angle = np.cumsum([view.signal(f"q{j + 1}")[at] for j in range(view.joints)])
    size = np.asarray(lengths, dtype=np.float64)
    return (
        np.concatenate(([0.0], np.cumsum(size * np.cos(angle)))),
        np.concatenate(([0.0], np.cumsum(size * np.sin(angle)))),
    )


def _thin_path(view: View, first: Array, second: Array) -> tuple[Array, Array]:
    """Thin a path in the plane: the points that either coordinate needs."""
    times = np.union1d(*(keep_peaks(view.time, part, 800)[0] for part in (first, second)))
    at = np.searchsorted(view.time, times)
    return first[at], second[at]


def _square(axes: Axes) -> None:
    """Frame what is drawn in a square of equal scales."""
    axes.set_aspect("equal")
    box = axes.dataLim
    half = 0.54 * max(box.width, box.height) or 1.0
    axes.set_xlim((box.x0 + box.x1) / 2 - half, (box.x0 + box.x1) / 2 + half)
    axes.set_ylim((box.y0 + box.y1) / 2 - half, (box.y0 + box.y1) / 2 + half)


def _draw_wall(axes: Axes, wall: WallFrame) -> None:
    """Fill the inside of the wall over what the axes show, without changing their limits."""
    x, y = axes.get_xlim(), axes.get_ylim()
    point, normal, tangent = 1e3 * np.array(wall.point), np.array(wall.normal), np.array(wall.tangent)
    # From the foot of the frame's centre, a diagonal and more to all sides covers the frame.
    centre = np.array([sum(x), sum(y)]) / 2
    foot = point + float((centre - point) @ tangent) * tangent
    far = 2.0 * (x[1] - x[0]) + float(np.abs((centre - point) @ normal))
    corners = np.array([foot - far * tangent, foot + far * tangent])
    corners = np.concatenate((corners, corners[::-1] - far * normal))
    axes.fill(corners[:, 0], corners[:, 1], color=WALL, alpha=0.55, linewidth=0, zorder=0, label="wall")
    axes.plot(*corners[:2].T, color=INK, linewidth=1.0, zorder=1)
    axes.set_xlim(x)
    axes.set_ylim(y)


def path(view: View) -> Drawn | None:
    """Fingertip path over the wall; the linkage at four instants, and the force it gives near the wall.

    Needs ``x, y``; with ``q1..`` and link lengths the linkage, with a wall and ``fx, fy`` the second panel.
    """
    if not view.has("x", "y"):
        return None
    near = view.place is not None
    drawing, grid = figure(3.9, 1, 2 if near else 1, **({"width_ratios": (1.0, 1.25)} if near else {}))
    space = grid[0, 0]
    x, y = 1e3 * view.signal("x"), 1e3 * view.signal("y")
    space.plot(*_thin_path(view, x, y), color=FORCE, linewidth=1.6, label="fingertip", zorder=4)
    moments = np.searchsorted(view.time, np.linspace(view.time[0], view.end_s, 4)).clip(0, view.time.size - 1)
    for number, at in enumerate(moments.tolist()):
        corners = _linkage(view, at)
        if corners[0].size:
            shade_of = str(0.75 - 0.2 * number)
            space.plot(
                1e3 * corners[0], 1e3 * corners[1], "-o", color=shade_of, linewidth=2.0, markersize=3.5,
                zorder=2, label=f"t = {view.time[at]:.2f} s",
            )  # fmt: skip
    _square(space)
    space.set_xlabel("x [mm]")
    space.set_ylabel("y [mm]")
    if view.wall is not None:
        _draw_wall(space, view.wall)
    space.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3, handlelength=1.5, columnspacing=1.0
    )
    space.set_title("workspace")
    jointed = bool(_linkage(view, 0)[0].size)
    caption = "Left: the fingertip's path" + (
        " and the linkage at four instants, light to dark." if jointed else "."
    )
    if not near:
        return Drawn(drawing, caption.removeprefix("Left: "))
    return Drawn(drawing, caption + (_phase if view.straight else _near_the_wall)(view, grid[0, 1]))


def _phase(view: View, axes: Axes) -> str:
    """Draw speed over position: what there is to see of a motion straight onto the wall."""
    assert view.place is not None
    across = 1e3 * view.place[1]
    apart = np.concatenate(([True], np.diff(view.time) > 0.0))
    speed = np.interp(view.time, view.time[apart], np.gradient(view.place[1][apart], view.time[apart]))
    axes.plot(*_thin_path(view, across, speed), color=FORCE, linewidth=1.3, zorder=3)
    axes.margins(0.06)
    axes.set_xlim(axes.get_xlim())
    axes.axvspan(axes.get_xlim()[0], 0.0, color=WALL, alpha=0.55, linewidth=0, zorder=0)
    axes.axvline(0.0, color=INK, linewidth=1.0, zorder=1)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    axes.set_xlabel("off the wall [mm]")
    axes.set_ylabel("speed away from the wall [m/s]")
    axes.set_title("speed over position")
    return (
        " Right: speed over position; the grey half is inside the wall, and a spiral inwards comes to rest."
    )


def _near_the_wall(view: View, axes: Axes) -> str:
    assert view.place is not None
    along, across = (1e3 * part for part in view.place)
    axes.plot(*_thin_path(view, along, across), color=FORCE, linewidth=1.3, zorder=3)
    axes.set_xlabel("along the wall [mm]")
    axes.set_ylabel("off the wall [mm]")
    axes.set_title("near the wall")
    axes.margins(0.1, 0.06)
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, 0.25 * (high - low)))
    axes.axhspan(axes.get_ylim()[0] - 10 * (high - low), 0.0, color=WALL, alpha=0.55, linewidth=0, zorder=0)
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1)
    axes.set_ylim(low, max(high, 0.25 * (high - low)))
    caption = " Right: the same path in the wall's frame, the depth stretched; the grey half is inside."
    inside = np.flatnonzero(view.contact)
    if view.force is not None and inside.size:
        instants = np.linspace(view.time[inside[0]], view.time[inside[-1]], 18)
        chosen = np.unique(inside[np.searchsorted(view.time[inside], instants).clip(0, inside.size - 1)])
        push = (view.force[0][chosen], view.force[1][chosen])
        largest = float(np.hypot(*push).max()) or 1.0
        arrows = axes.quiver(
            along[chosen],
            across[chosen],
            *push,
            angles="uv",
            scale_units="height",
            scale=_ARROWS * largest,
            width=0.0045,
            color=POSITION,
            zorder=5,
        )
        # Room for the tips: the panel is about 1.7 times as wide as it is high.
        left, right = axes.get_xlim()
        tips = along[chosen] + push[0] / largest * (right - left) / (1.6 * _ARROWS)
        margin = 0.02 * (right - left)
        axes.set_xlim(min(left, tips.min() - margin), max(right, tips.max() + margin))
        unit = _round_force(largest)
        axes.quiverkey(arrows, 0.86, 1.045, unit, f"{unit:g} N", labelpos="E", coordinates="axes")
        caption += (
            " Arrows: force on the operator; an upright arrow is a frictionless wall, a leaning one drags."
        )
    return caption


def _round_force(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12)))


def tangent_normal(view: View) -> Drawn | None:
    """Force (solid) and position (dotted) along tangent and normal, as the paper's Figs 16 to 18.

    Needs a wall and ``x, y, fx, fy``.
    """
    if view.place is None or view.force is None:
        return None
    panels = list(zip(("(a) along the tangent", "(b) along the normal"), view.force, view.place, strict=True))
    if view.straight:
        panels = panels[1:]
    drawing, grid = figure(0.6 + 2.5 * len(panels), len(panels), 1, sharex=True)
    marked = False
    for axes, (name, force, place) in zip(grid[:, 0], panels, strict=True):
        shade(axes, view.contact_spans)
        other = axes.twinx()
        other.grid(False)
        other.spines["right"].set_visible(True)
        curve(axes, view.time, force, color=FORCE, label="force on the operator", zorder=3)
        dots = (0, (1.5, 1.5))
        curve(other, view.time, 1e3 * place, color=POSITION, linestyle=dots, label="position")
        axes.axhline(0.0, color=FAINT, linewidth=0.7)
        axes.set_ylabel("force [N]", color=FORCE)
        other.set_ylabel("position [mm]", color=POSITION)
        axes.set_title(name)
        axes.set_xlim(view.time[0], view.end_s)
        legend(axes, other)
        marked = sample_ticks(axes, view.sample_time) or marked
    _same_scale(*grid[:, 0])
    grid[-1, 0].set_xlabel("time [s]")
    caption = (
        "As the paper's Figs 16 to 18: solid force (left axis), dotted position (right axis, from the wall's "
        "reference point; along the normal, below zero is inside the wall)."
    )
    if view.straight:
        caption += " Along the tangent nothing moves."
    else:
        caption += " Both forces are on one scale; a frictionless wall alone leaves (a) without force."
    if marked:
        caption += " Strokes at the foot are the computer's samples."
    elif view.sample_time.size:
        caption += " The samples are too many to be marked."
    return Drawn(drawing, caption)


def _same_scale(*axes: Axes) -> None:
    limits = np.array([each.get_ylim() for each in axes])
    for each in axes:
        each.set_ylim(limits[:, 0].min(), limits[:, 1].max())


def _window(view: View, periods: int = 3) -> tuple[float, float] | None:
    """Return the `periods` sample periods in unbroken contact over which the normal force changes most."""
    ticks = view.sample_time
    if ticks.size <= periods or view.time.size < 2:
        return None
    signal = view.force[1] if view.force is not None else view.signal("imot1")
    edges = np.searchsorted(view.time, ticks)
    edges = np.append(edges[edges < view.time.size], view.time.size - 1)
    highest = np.maximum.reduceat(signal, edges[:-1])
    lowest = np.minimum.reduceat(signal, edges[:-1])
    seen = view.sampled("contact")[: highest.size] > 0.5
    best, window = -1.0, None
    for first in range(highest.size - periods):
        piece = slice(first, first + periods)
        touching = bool(seen[piece].all()) if seen.any() else True
        change = float(np.median(highest[piece] - lowest[piece]))
        if touching and change > best:
            best, window = change, (float(ticks[first]), float(ticks[first + periods]))
    return window


def zoom(view: View) -> Drawn | None:
    """Three sample periods: the force goes on between samples while the DACs stand still.

    Needs samples and ``imot1..``; with a wall the force and depth, with ``u1.., cmd1..`` the DAC outputs.
    """
    window = _window(view)
    if window is None or not view.has("imot1"):
        return None
    margin = 0.04 * (window[1] - window[0])
    low, high = window[0] - margin, window[1] + margin
    part = (view.time >= low) & (view.time <= high)
    time = 1e3 * view.time[part]
    ticks = view.sample_time[(view.sample_time >= low) & (view.sample_time <= high)]
    joints = range(1, view.joints + 1)
    outputs = {
        "equilibria u (DAC outputs), change since the left edge": [f"u{joint}" for joint in joints],
        "commands cmd (DAC outputs), change since the left edge": [f"cmd{joint}" for joint in joints],
    }
    still = [n for names in outputs.values() for n in names if not np.ptp(view.signal(n)[part]) > 0.0]
    moving = {title: names for title, names in outputs.items() if not set(names) <= set(still)}
    walled = view.force is not None and view.place is not None
    rows = int(walled) + 1 + len(moving)
    drawing, grid = figure(0.6 + 1.75 * rows + 0.4 * walled, rows, 1, sharex=True)
    panels = iter(grid[:, 0])
    if walled:
        _zoom_force(view, next(panels), part, (low, high))
    motors = next(panels)
    for joint in joints:
        curve(
            motors, time, view.signal(f"imot{joint}")[part], color=JOINTS[joint - 1], label=f"motor {joint}"
        )
    motors.set_ylabel("current [A]")
    motors.set_title("motor currents")
    for (title, names), axes in zip(moving.items(), panels, strict=True):
        changes = [view.signal(name)[part] - view.signal(name)[part][0] for name in names]
        factor, unit = scale(max(float(np.abs(change).max()) for change in changes), "V")
        for joint, (name, change) in enumerate(zip(names, changes, strict=True)):
            curve(axes, time, factor * change, color=JOINTS[joint], label=name)
        axes.set_ylabel(f"[{unit}]")
        axes.set_title(title)
    grid[-1, 0].set_xlabel("time [ms]")
    for axes in grid[:, 0]:
        for tick in (1e3 * ticks).tolist():
            axes.axvline(tick, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        axes.set_xlim(1e3 * low, 1e3 * high)
        legend(axes)
    caption = (
        "Three sample periods, dashed upright lines are the samples. The DAC outputs stand still between "
        "samples; what the currents and the force do there is the circuit and the linkage."
    )
    if walled and view.stiffness > 0.0:
        caption += (
            f" A computer alone would hold the dashed force ({view.stiffness:g} N/m times the depth at the "
            "sample), a wall without sampling would give the dotted one; the analog spring lets the motors' "
            "force follow the depth."
        )
    if walled:
        caption += " The operator feels the motors' force less what inertia, weight and friction take."
    if still:
        caption += f" Constant here: {', '.join(still)}."
    return Drawn(drawing, caption)


def _zoom_force(view: View, axes: Axes, part: NDArray[np.bool_], limits: tuple[float, float]) -> None:
    assert view.force is not None
    assert view.place is not None
    time = 1e3 * view.time[part]
    curve(axes, time, view.force[1][part], color=FORCE, label="on the operator", zorder=4)
    motors = view.motor_force(part)
    if motors is not None:
        curve(axes, time, motors, color=JOINTS[2], label="of the motors", zorder=3)
    stiffness = view.stiffness
    if stiffness > 0.0:
        depth = np.maximum(-view.place[1][part], 0.0)
        line: dict[str, Any] = {
            "color": POSITION,
            "linestyle": (0, (1.5, 1.5)),
            "label": "wall, not sampled",
            "zorder": 5,
        }
        curve(axes, time, stiffness * depth, **line)
        seen = (view.sample_time >= limits[0] - (view.period_s or 0.0)) & (view.sample_time <= limits[1])
        if seen.any() and "pen" in view.run.samples:
            sampled = stiffness * np.maximum(view.sampled("pen")[seen], 0.0)
            line = {"color": FAINT, "linestyle": "--", "label": "wall, sampled"}
            held(axes, 1e3 * view.sample_time[seen], sampled, 1e3 * limits[1], **line)
        per_mm = 1e-3 * stiffness
        depth_axis = axes.secondary_yaxis(
            "right",
            functions=(lambda force: np.divide(force, per_mm), lambda deep: np.multiply(deep, per_mm)),
        )
        depth_axis.set_ylabel("depth [mm]")
    axes.set_ylabel("force [N]")
    axes.set_title("normal force")


def nodes(view: View, most: int = 6) -> Drawn | None:
    """Draw the recorded nodes of the netlist (signals with a dot in their name), one panel each."""
    names = [name for name in view.run.signals if "." in name]
    if not names or view.time.size < 2:
        return None
    drawn = names[:most]
    drawing, grid = figure(0.9 + 1.15 * len(drawn), len(drawn), 1, sharex=True)
    for name, axes in zip(drawn, grid[:, 0], strict=True):
        shade(axes, view.contact_spans)
        curve(axes, view.time, view.signal(name), color=INK, linewidth=1.0)
        axes.set_title(name, fontsize=9.5)
        axes.set_ylabel("[V]")
        axes.set_xlim(view.time[0], view.end_s)
    grid[-1, 0].set_xlabel("time [s]")
    caption = "Nodes of the netlist that the scene records; the shade is contact."
    if len(names) > most:
        caption += f" {len(names) - most} further nodes are in the data only: {', '.join(names[most:])}."
    return Drawn(drawing, caption)
