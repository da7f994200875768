"""Force and motion at the fingertip over time, and between two samples."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from cosim.units import scale
from reports.style import (
    FAINT,
    FORCE,
    JOINTS,
    POSITION,
    Drawn,
    curve,
    figure,
    held,
    legend,
    sample_ticks,
    shade,
)
from reports.view import View

__all__ = ["tangent_normal", "zoom"]


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
        caption += (
            " The motors' force includes the braking by their back-EMF while the tip moves; inertia, weight "
            "and friction make up the difference to what the operator feels."
        )
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
