"""Designs by their distributions on one axis, and the change of each mean with its interval."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cosim.catalogue import UNITS
from cosim.units import heading
from reports.style import FAINT, INK, JOINTS, LIMIT, Drawn, figure, legend, look, pictures

if TYPE_CHECKING:
    from cosim.tolerance.common_draws import Side
    from cosim.tolerance.spec import Spec

__all__ = ["design_pictures", "distributions"]

#: Designs that are drawn, at most: more lines cannot be told apart.
_MOST = len(JOINTS)
_BINS = 50


def design_pictures(designs: "Sequence[Side]", specs: "Sequence[Spec]" = ()) -> dict[str, bytes]:
    """Return the pictures of all measures by their file names."""
    files = {}
    with look():
        for name in designs[0].summaries:
            for kind, data in pictures(distributions(designs, name, specs).figure).items():
                files[f"distributions_{name}.{kind}"] = data
    return files


def distributions(designs: "Sequence[Side]", name: str, specs: "Sequence[Spec]" = ()) -> Drawn:
    """Draw one measure of the devices of several designs, of which the first is the reference.

    Parameters
    ----------
    designs
        Samples of each, all with the same draws.
    name
        The measure.
    specs
        Limits that are drawn where they are of this measure.
    """
    shown = designs[:_MOST]
    drawing, grid = figure(3.2 + 0.35 * len(shown), 2, 1, height_ratios=[3.0, 0.5 + 0.5 * len(shown)])
    above, below = grid[:, 0]
    columns = [side.study.column(name) for side in shown]
    known = [column[np.isfinite(column)] for column in columns]
    edges = np.histogram_bin_edges(np.concatenate(known), min(_BINS, max(10, int(2 * len(known[0]) ** 0.5))))
    for number, (side, values) in enumerate(zip(shown, known, strict=True)):
        color, mean = JOINTS[number], side.summaries[name].mean.value
        above.hist(values, edges, histtype="stepfilled", alpha=0.18, color=color)
        above.hist(values, edges, histtype="step", color=color, linewidth=1.4, label=side.label)
        above.axvline(mean, color=color, linestyle="--", linewidth=1.0)
    for spec in specs:
        for limit in (spec.low, spec.high):
            if spec.measure == name and np.isfinite(limit):
                above.axvline(limit, color=LIMIT, linewidth=1.2)
    above.set_ylabel("devices")
    above.set_xlabel(heading(name.replace("_", " "), UNITS.get(name, "")))
    legend(above, columns=3)
    below.axvline(0.0, color=INK, linewidth=0.8)
    for number, side in enumerate(shown[1:], 1):
        change = side.changes[name]
        below.plot([change.low, change.high], [number, number], color=JOINTS[number], linewidth=2.0)
        below.plot(change.value, number, "o", color=JOINTS[number], markersize=5.0)
    below.set_yticks(range(1, len(shown)), [side.label for side in shown[1:]])
    below.set_ylim(len(shown) - 0.5, 0.5)
    below.grid(visible=False, axis="y")
    below.set_xlabel(f"change of the mean against {shown[0].label}" + heading("", UNITS.get(name, "")))
    below.tick_params(axis="y", colors=FAINT)
    caption = (
        "Above: how often, dashed the mean of each. Below: the change of the mean, of the same draws, with "
        "what holds with 95 %; it leaves 0 out where designs differ for sure."
    )
    if len(designs) > len(shown):
        caption += f" The first {len(shown)} of {len(designs)} are drawn."
    return Drawn(drawing, caption)
