"""The runs of a ``--set`` sweep drawn over one another."""

from collections.abc import Sequence
from typing import Any

from reports.style import FAINT, JOINTS, Drawn, curve, figure, legend
from reports.tables import Trial
from reports.view import View

__all__ = ["overlay"]

_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))


def overlay(trials: Sequence[Trial], most: int = 6) -> Drawn | None:
    """Depth and normal force (with a wall), else the motor currents, of every trial with a run."""
    shown = [(trial.label, View(trial.run)) for trial in trials if trial.run is not None]
    views = [(label, view) for label, view in shown if view.time.size > 1][:most]
    if len(views) < 2:
        return None
    walled = all(view.place is not None and view.force is not None for _, view in views)
    drawing, grid = figure(4.6, 2, 1, sharex=True)
    above, below = grid[:, 0]
    for number, (label, view) in enumerate(views):
        line: dict[str, Any] = {"color": JOINTS[number], "linestyle": _DASHES[number], "label": label}
        if view.place is not None and view.force is not None and walled:
            curve(above, view.time, view.force[1], **line)
            curve(below, view.time, 1e3 * view.place[1], **line)
        else:
            curve(above, view.time, view.signal("imot1"), **line)
            curve(below, view.time, view.signal("imot2" if view.joints > 1 else "q1"), **line)
    if walled:
        above.set_ylabel("normal force [N]")
        below.set_ylabel("position along\nthe normal [mm]")
    else:
        above.set_ylabel("current of motor 1 [A]")
        below.set_ylabel("current of motor 2 [A]" if views[0][1].joints > 1 else "joint angle [rad]")
    for axes in (above, below):
        axes.axhline(0.0, color=FAINT, linewidth=0.7)
        axes.set_xlim(views[0][1].time[0], max(view.end_s for _, view in views))
    legend(above)
    below.set_xlabel("time [s]")
    caption = "The tried values over one another; where only one line is seen, the value changes nothing."
    if len(shown) > len(views):
        caption += f" The first {len(views)} of {len(shown)} are drawn."
    return Drawn(drawing, caption)
