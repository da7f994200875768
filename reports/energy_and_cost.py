"""Where the energy went, and what the run cost: time steps and points per sample."""

import numpy as np

from cosim.types import Array
from cosim.units import quantity, scale
from reports.style import FAINT, INK, JOINTS, Drawn, curve, figure, held, legend, shade
from reports.view import View

__all__ = ["energy", "steps", "work"]


#: Energies below this share of the largest are within the trapezoidal rule's error.
_SHOWN = 1e-3
_LOSSES = ("p_visc", "p_coul", "p_stop", "p_shaft")


def work(view: View, *powers: str) -> Array:
    """Return the work [J] done on the linkage by `powers` [W] since the start, by the trapezoidal rule."""
    power = np.sum([view.signal(name) for name in powers], axis=0)
    pieces = 0.5 * (power[1:] + power[:-1]) * np.diff(view.time)
    return np.concatenate(([0.0], np.cumsum(pieces)))


def energy(view: View) -> Drawn | None:
    """Energy ledger: work of operator, motors and friction, stored energy, and what does not close.

    Needs ``p_mot, p_op, e_kin``; ``p_visc, p_coul, p_stop, p_shaft, e_grav, e_shaft,
    e_spring`` where they are in force.
    """
    if not view.has("p_mot", "p_op", "e_kin"):
        return None
    operator, motors, losses = work(view, "p_op"), work(view, "p_mot"), work(view, *_LOSSES)
    stored = view.signal("e_kin") + view.signal("e_grav") + view.signal("e_shaft")
    stored = stored - stored[0]
    residual = operator + motors + losses - stored
    spring = view.signal("e_spring")
    lost = "friction, stops and shafts" if view.has("p_shaft") else "friction and stops"
    rows = [
        (operator, "work of the operator", JOINTS[0], "-"),
        (motors, "work of the motors", JOINTS[1], "-"),
        (losses, lost, JOINTS[4], "-"),
        (stored, "linkage: kinetic and gravity", JOINTS[2], "-"),
        (spring, "analog spring (inside the motors' work)", JOINTS[3], (0, (4, 1.5))),
    ]
    drawing, grid = figure(4.9, 2, 1, sharex=True, height_ratios=(3.2, 1.0))
    above, below = grid[:, 0]
    shade(above, view.contact_spans)
    moved = max(float(np.abs(part).max()) for part in (operator, motors, losses, stored, spring))
    factor, unit = scale(moved, "J")
    absent = []
    for value, label, color, dash in rows:
        if value.any():
            curve(above, view.time, factor * value, color=color, linestyle=dash, label=label, zorder=3)
        else:
            absent.append(label)
    above.axhline(0.0, color=FAINT, linewidth=0.7)
    above.set_ylabel(f"energy [{unit}]")
    above.set_xlim(view.time[0], view.end_s)
    legend(above, columns=3)
    shade(below, view.contact_spans)
    largest = float(np.abs(residual).max())
    factor, unit = scale(largest, "J")
    curve(below, view.time, factor * residual, color=INK)
    below.set_ylabel(f"residual [{unit}]")
    below.set_xlabel("time [s]")
    caption = (
        "Work done on the linkage since the start: operator, motors and losses together must equal what the "
        f"linkage stores. Below, what is left over: at most {quantity(largest, 'J')}"
        + (f", {largest / moved:.1e} of the largest entry" if moved > 0.0 else "")
        + ". It is summed from the stored points by the trapezoidal rule, which is part of it."
    )
    parted = _parted(view)
    if abs(parted) > _SHOWN * moved:
        caption += (
            f" The residual holds the {quantity(abs(parted), 'J')} that flanks of a gear lose as they part, "
            "all at once and between two points; the run's own ledger (run.json) counts them to the shafts."
        )
    if absent:
        caption += f" Zero throughout and not drawn: {'; '.join(absent)}."
    return Drawn(drawing, caption)


def _parted(view: View) -> float:
    """Return the shafts' work [J] of the run's ledger that no power on the points accounts for."""
    total = view.run.ledger.get("work_j", {}).get("shafts")
    return float(total) - float(work(view, "p_shaft")[-1]) if view.has("p_shaft") and total else 0.0


def steps(view: View) -> Drawn | None:
    """Time steps of the solver, and points spent on every sample period. Needs ``time`` and samples."""
    step = np.diff(view.time)
    positive = step > 0.0
    if not positive.any():
        return None
    counted = view.sample_time.size > 2
    drawing, grid = figure(4.4 if counted else 2.8, 2 if counted else 1, 1, sharex=True)
    axes = grid[0, 0]
    shade(axes, view.contact_spans)
    middle = float(np.median(step[positive]))
    curve(axes, view.time[1:][positive], step[positive], color=JOINTS[0], linewidth=0.8, zorder=3)
    axes.set_yscale("log")
    axes.axhline(middle, color=JOINTS[1], linestyle="--", label=f"median {quantity(middle, 's')}", zorder=4)
    axes.set_ylabel("time step [s]")
    axes.set_title("time step")
    axes.set_xlim(view.time[0], view.end_s)
    legend(axes)
    caption = (
        f"The solver's time step: {int(positive.sum())} steps from "
        f"{quantity(float(step[positive].min()), 's')} to {quantity(float(step.max()), 's')}. "
        "It starts small after every sample, where the DACs jump."
    )
    if counted:
        below = grid[1, 0]
        # The point at a sample closes the period before it; two rows of one time are one point.
        points = np.unique(view.time)
        edges = np.searchsorted(points, view.sample_time, side="right")
        count = np.diff(np.append(edges, points.size)).astype(np.float64)
        last = view.sample_time[-1]
        if view.end_s <= last:  # the run ends with a sample: its period is missing
            count = count[:-1]
        shade(below, view.contact_spans)
        held(below, view.sample_time[: count.size], count, view.end_s, color=INK, linewidth=1.0)
        below.set_ylim(0.0, 1.1 * float(count.max()) or 1.0)
        below.set_ylabel("points")
        below.set_title("points in each sample period")
        caption += f" A sample period takes {float(np.median(count)):.0f} points (median)."
    grid[-1, 0].set_xlabel("time [s]")
    return Drawn(drawing, caption)
