"""The effects ledger as a picture: what an effect changes against what it costs."""

import csv
import io
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from cosim.storage.owned_files import manifest_of, write_files
from cosim.units import heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cosim.comparisons.effects_ledger import EffectsLedger

#: Files that `write_effects` writes, and their manifest.
FILES, MANIFEST = ("effects.csv", "effects.svg", "effects.png"), manifest_of("effects")


def write_effects(ledger: "EffectsLedger", measure: str, folder: Path, title: str = "") -> Path:
    """Write ``effects.png``, ``effects.svg`` and ``effects.csv`` (all measures) and return the PNG.

    Raises
    ------
    InputError
        As `cosim.storage.owned_files.write_files`.
    """
    from reports.style import look, pictures

    table = io.StringIO()
    names = list(ledger.full)
    writer = csv.writer(table)
    units = {name: str(row["unit"]) for name, row in ledger.full.items()}
    heads = [heading(name, units[name]) for name in names]
    heads += [heading(f"{name}_among", units[name]) for name in names]
    writer.writerow(["effect", "value", "alone [s]", "among [s]", *heads])
    for row in ledger.rows:
        alone = [row.on.get(name) for name in names]
        among = [row.off.get(name) for name in names]
        writer.writerow([row.effect, row.value, row.on_s, row.off_s, *alone, *among])
    with look():
        drawn = pictures(draw(ledger, measure, title))
    content = (table.getvalue().encode(), drawn["svg"], drawn["png"])
    write_files(folder, dict(zip(FILES, content, strict=True)), MANIFEST)
    return folder / FILES[-1]


def draw(ledger: "EffectsLedger", measure: str, title: str = "") -> "Figure":
    """Return the figure: bars of size, alone and on top of all others, beside bars of cost.

    It stands alone, without a page: its title names the scene, and its caption says what to see.
    """
    from reports.style import Drawn, legend
    from reports.style import figure as new_figure

    rows = sorted(ledger.rows, key=lambda r: max(abs(r.on.get(measure, 0)), abs(r.off.get(measure, 0))))
    labels = [f"{row.effect} {'' if row.value == 'True' else row.value}".strip() for row in rows]
    drawing, axes = new_figure(
        2.3 + 0.28 * len(rows), columns=2, sharey=True, gridspec_kw={"width_ratios": (3, 2)}
    )
    size, cost = axes[0]
    unit = str(ledger.full[measure]["unit"])
    _bars(
        size,
        labels,
        [abs(r.on.get(measure, 0.0)) for r in rows],
        [abs(r.off.get(measure, 0.0)) for r in rows],
    )
    size.set_xscale("log")
    scale = abs(float(ledger.full[measure]["value"])) or 1.0
    most = max((abs(change.get(measure, 0.0)) for r in rows for change in (r.on, r.off)), default=0.0)
    size.set_xlim(scale * 1e-6, max(scale * 0.05, 2.0 * most))
    size.axvline(scale * 0.01, color="0.4", linewidth=1, linestyle="--")
    size.annotate(
        " 1 %", (scale * 0.01, 0.0), xycoords=("data", "axes fraction"), ha="left", va="bottom", fontsize=9
    )
    size.set_xlabel(f"change of {measure.replace('_', ' ')}" + (f" [{unit}]" if unit else ""))
    _bars(cost, labels, [1e3 * r.on_s for r in rows], [1e3 * r.off_s for r in rows])
    # linear scale: costs within the noise of the clock should look small
    cost.set_xlabel("cost, processor time [ms]")
    cost.axvline(0.0, color="0.4", linewidth=1)
    legend(size)
    words = measure.replace("_", " ")
    drawing.suptitle(
        f"{title}: what each effect does to {words}" if title else f"What each effect does to {words}"
    )
    share = f"1 % of its value with all effects, {scale:.4g} {unit}".rstrip()
    caption = (
        f"Left: how far an effect moves the {words}, put on alone over none and on top of all others; the "
        f"dashed line is {share}. An effect without a bar changes nothing here. Right: what it costs in "
        "processor time; negative is a run that takes longer without the effect, or the noise of the clock."
    )
    drawing.supxlabel("\n".join(wrap(caption, 118)), fontsize=9.0, ha="left", x=0.01)
    return Drawn(drawing, caption).figure


def _bars(axes: "Axes", labels: list[str], alone: list[float], among: list[float]) -> None:
    at = range(len(labels))
    axes.barh([y + 0.2 for y in at], alone, height=0.38, label="alone")
    axes.barh([y - 0.2 for y in at], among, height=0.38, label="on top of all others")
    axes.set_yticks(list(at), labels)
    axes.set_ylim(-0.7, len(labels) - 0.3)
