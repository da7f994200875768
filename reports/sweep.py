"""A sweep as a picture: each measure over the first range, one curve for each combination of the others."""

from pathlib import Path
from typing import TYPE_CHECKING

from cosim.catalogue import UNITS
from cosim.comparisons.sweep import unit_of
from cosim.ngspice.lines import number
from cosim.storage.owned_files import manifest_of, write_files
from cosim.units import heading, scale
from reports.style import JOINTS, Drawn, figure, legend, look, pictures

if TYPE_CHECKING:
    from cosim.comparisons.sweep import Sweep

#: Files that `write_sweep` writes, and their manifest.
FILES, MANIFEST = ("sweep.svg", "sweep.png"), manifest_of("sweep-picture")
_DASHES = ("-", (0, (5, 2)), (0, (2, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1)), (0, (8, 2)))
#: Steps of equal ratio, this far apart at least, ask for a logarithmic axis.
_LOGARITHMIC = 8.0


def write_sweep(sweep: "Sweep", folder: Path) -> Path | None:
    """Write ``sweep.png`` and ``sweep.svg``; ``None`` where the first range is not of numbers.

    Raises
    ------
    InputError
        As `cosim.storage.owned_files.write_files`.
    """
    with look():
        drawn = draw(sweep)
        files = pictures(drawn.figure) if drawn is not None else {}
    write_files(folder, {f"sweep.{ending}": data for ending, data in files.items()}, MANIFEST)
    return folder / FILES[-1] if files else None


def draw(sweep: "Sweep") -> Drawn | None:
    """Return the figure."""
    axis = [number(values[0]) for values in sweep.values]
    known = [value for value in axis if value is not None]
    seen = any(value is not None for column in sweep.measures.values() for value in column)
    if len(known) < len(axis) or len(set(known)) < 2 or not seen:
        return None
    names = list(sweep.measures)
    drawing, grid = figure(1.0 + 2.3 * len(names), rows=len(names), sharex=True)
    groups = list(dict.fromkeys(values[1:] for values in sweep.values))
    for row, name in enumerate(names):
        axes, column = grid[row, 0], sweep.measures[name]
        unit = UNITS.get(name, "")
        largest = max((abs(value) for value in column if value is not None), default=0.0)
        factor, shown = scale(largest, unit) if unit in ("N", "m", "A", "s") else (1.0, unit)
        for place, group in enumerate(groups):
            line = sorted(
                (x, value * factor)
                for x, values, value in zip(known, sweep.values, column, strict=True)
                if values[1:] == group and value is not None
            )
            pairs = zip(sweep.names[1:], group, strict=True)
            label = ", ".join(
                f"{key.rpartition('.')[2]} = {value} {unit_of(key)}".rstrip() for key, value in pairs
            )
            axes.plot(
                [x for x, _ in line],
                [y for _, y in line],
                color=JOINTS[place % len(JOINTS)],
                linestyle=_DASHES[place % len(_DASHES)],
                marker="o",
                markersize=3.5,
                label=label or None,
            )
        axes.set_ylabel(name.replace("_", " ") + (f" [{shown}]" if shown else ""))
        if min(known) > 0.0 and max(known) / min(known) >= _LOGARITHMIC:
            axes.set_xscale("log")
    legend(grid[0, 0], columns=3)
    grid[-1, 0].set_xlabel(heading(sweep.names[0], unit_of(sweep.names[0])))
    drawing.suptitle(f"{', '.join(name.replace('_', ' ') for name in names)} over {sweep.names[0]}")
    return Drawn(drawing, "")
