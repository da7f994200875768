"""The cost of accuracy as a picture, a table (CSV, JSON) and a page: error over time, both logarithmic."""

from __future__ import annotations

import csv
import io
import json
import math
import statistics
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.accuracy.pareto import resolved
from cosim.scene import PotNoise
from cosim.storage.owned_files import manifest_of
from cosim.units import quantity
from reports.page import PAGE_NAME, picture, render, write_page
from reports.study_page import Section, TextTable
from reports.style import FAINT, INK, JOINTS, LIMIT, Drawn, figure, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cosim.accuracy.work_precision import Accuracy

__all__ = ["FILES", "draw", "words", "write_accuracy"]

#: What is written besides the picture.
FILES, MANIFEST = (PAGE_NAME, "accuracy.csv", "accuracy.json"), manifest_of("accuracy")
_COLORS = {"ideal": JOINTS[2], "linear": JOINTS[0], "spice": JOINTS[1], "peer": JOINTS[5]}
_MARKS = {
    "as the scene states it": "*",
    "relative tolerance": "o",
    "charge tolerance": "D",
    "all together": "P",
    "trapezoids": "X",
    "order of the circuit": "v",
    "coupling tolerance": "s",
    "longest step": "^",
    "one deck in ngspice": "x",
    "PySpice, callbacks in Python": "+",
    "ngspice alone, filesource": "1",
}
_SCATTER = JOINTS[3]
#: Effects that a scene leaves out and that are named.
_MOST_NEGLECTED = 5
#: Below this share an error is rounding.
_ROUNDING = 1e-15


def write_accuracy(study: Accuracy, folder: Path) -> Path:
    """Write page, picture, ``accuracy.csv`` and ``accuracy.json`` into the folder; return the page.

    Raises
    ------
    InputError
        The folder cannot be written, or holds something else under these names.
    """
    with look():
        shown = picture("accuracy", "Error over time", draw(study))
    section = Section(
        "accuracy", f"{study.scene.title}: what accuracy costs", [], tuple(words(study)), [shown],
        [_front(study), *_reltol(study), *_weak(study), _failures(study)], "",
    )  # fmt: skip
    html = render(
        "study.html.j2", title=f"What accuracy costs: {study.scene.title}", command="", summary=[],
        sections=[section], claims=[], warnings=[],
    )  # fmt: skip
    text = json.dumps(study.as_dict(), indent=1, allow_nan=False) + "\n"
    return write_page(folder, html, [shown], dict(zip(FILES[1:], (_csv(study), text), strict=True)), MANIFEST)


def words(study: Accuracy) -> list[str]:
    """Return the findings in sentences, the recommendation first, with its lines as the scene takes them."""
    share = f"{study.tolerance:g}"
    own = [row for row in study.rows if row.setting.model != "peer" and row.errors]
    if study.cheapest is None:
        best = min((row.worst(study.quantities) for row in own), default=math.inf)
        floor = max((study.floor.get(name, 0.0) for name in study.quantities), default=0.0)
        why = f"the references themselves disagree by {floor:.1e}" if floor > study.tolerance else (
            f"the best reaches {best:.1e}"
        )  # fmt: skip
        sentences = [f"No setting is known to be within {share}: {why}."]
    else:
        cost = quantity(study.cheapest.seconds, "s")
        lines = "\n".join(study.cheapest.setting.lines())
        worst = study.cheapest.worst(study.quantities)
        label = study.cheapest.setting.label
        sentences = [
            f"Cheapest within {share}: {label}, {cost}, worst error {worst:.1e}; put into the scene:\n{lines}"
        ]
    sentences.append(
        f"Errors are shares of the largest value, against {study.references[0]}; the floor is what "
        f"{', '.join(study.references[1:])} differ from it by, and nothing is claimed below it. Within ten "
        "times the floor an error is bounded, not known: such points are hollow."
    )
    for model, gone in study.left_out.items():
        error = max((study.model_error[model].get(n, math.inf) for n in study.quantities), default=math.inf)
        named = ", ".join(gone) or "nothing"
        if math.isfinite(error):
            sentences.append(
                f"The model {model} leaves out {named}; no setting of it gets below {error:.1e}."
            )
    if study.scene.effects.encoder:
        sentences.append(
            "The encoder counts in steps: a count that comes a sample early or late is an error of its own, "
            "the same for all settings that have it. One deck in plain ngspice is given the codes and has "
            "no such error."
        )
    effects = study.scene.effects
    if effects.pot_noise is not PotNoise.NONE or effects.component_noise:
        sentences.append(
            f"All runs see one path of the noise (seed {study.scene.seed}): these are errors on that path. "
            "From path to path a quantity scatters by itself, the purple line: digits below it are the "
            "path's."
        )
        sentences += _on_other_paths(study)
    large = [f"{name} {size:.1e}" for name, size in study.neglected.items() if size > study.tolerance]
    if large:
        sentences.append(
            "The scene itself leaves out, as shares of the peak force, a priori and from above: "
            f"{', '.join(large[:_MOST_NEGLECTED])}. Where it has no reason to (cosim plan), digits below "
            "that say nothing about the device."
        )
    return sentences


def _on_other_paths(study: Accuracy) -> list[str]:
    """Return what the recommended setting does to means over other paths, in a sentence."""
    if study.noise is None or study.cheapest is None:
        return []
    means = study.noise.weak.get(study.cheapest.setting.label, {})
    sizes = {name: abs(means[name][0]) + means[name][1] for name in study.quantities if name in means}
    if not sizes:
        return []
    name = max(sizes, key=sizes.__getitem__)
    beyond = "beyond" if sizes[name] > study.tolerance else "within"
    mean, half = means[name]
    return [
        f"Over {study.noise.count} other paths the recommendation's weak error, that of the mean, is largest "
        f"for {name}: {mean:+.1e} ± {half:.1e}, {beyond} {study.tolerance:g}."
    ]


def draw(study: Accuracy) -> Drawn:
    """Return the figure: a row of panels a quantity, over wall time and processor time."""
    names = study.quantities
    drawing, grid = figure(1.2 + 2.5 * len(names), len(names), 2, sharex="col", sharey="row")
    for row, name in enumerate(names):
        for column, clock in enumerate(("wall_s", "cpu_s")):
            _panel(grid[row, column], study, name, clock)
        grid[row, 0].set_ylabel(f"relative error of\n{name.replace('_', ' ')}")
    grid[-1, 0].set_xlabel("wall time of the simulation [s]")
    grid[-1, 1].set_xlabel("its processor time [s]")
    handles = _key(study)
    drawing.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    drawing.suptitle(f"{study.scene.title}: what each digit costs")
    return Drawn(drawing, _caption(study))


def _caption(study: Accuracy) -> str:
    """Return how to read the figure."""
    count = max((len(row.wall_s) for row in study.rows), default=0)
    runs = f"medians of {count} runs with their spread" if count > 1 else "one run each"
    caption = (
        f"Error of each quantity over the time of the simulation alone, {runs}. The line is the Pareto front "
        "of this program's own settings; grey below is the floor, where the references disagree; hollow "
        "points lie within ten times of it. Dashed: what a model's missing effects cost; dotted: the largest "
        "effect that the scene itself leaves out, from above."
    )
    if any(row.setting.model == "peer" and row.errors for row in study.rows):
        caption += (
            " Crosses: one deck in plain ngspice, which is given the recorded voltages of the DACs and "
            "closes no loop."
        )
    if study.noise is not None:
        caption += (
            " Purple: by how much another path of the noise changes the quantity, rms of "
            f"{study.noise.count} paths, in the 95 % interval of that rms."
        )
    unseen = sum(bool(row.cpu_s) and statistics.median(row.cpu_s) <= 0.0 for row in study.rows)
    if unseen:
        caption += f" {unseen} took less processor time than its clock tells: in the left column only."
    failed = sum(bool(row.failed) for row in study.rows)
    if failed:
        caption += f" {'One setting' if failed == 1 else f'{failed} settings'} failed, named below."
    return caption


def _panel(axes: Axes, study: Accuracy, name: str, clock: str) -> None:
    floor = max(study.floor.get(name, 0.0), _ROUNDING)
    shown: list[tuple[float, float]] = []
    unseen: list[object] = []
    for row in study.rows:
        if name not in row.errors:
            continue
        times = getattr(row, clock)
        middle = statistics.median(times)
        if middle <= 0.0:
            unseen.append(row.setting)
            continue  # no place on a logarithmic axis
        error = max(row.errors[name], _ROUNDING)
        spread = [[middle - min(times)], [max(times) - middle]]
        stated = row.setting.series == "as the scene states it"
        known = resolved(row, name, study.floor)
        axes.errorbar(
            [middle], [error], xerr=spread, fmt=_MARKS[row.setting.series], color=_COLORS[row.setting.model],
            markersize=9 if stated else 4.5, markeredgecolor="white" if stated and known else None,
            markerfacecolor=None if known else "none", elinewidth=0.7, zorder=5 if stated else 3,
            label="_known" if known else "_bounded",
        )  # fmt: skip
        if row.setting.model != "peer":
            shown.append((middle, error))
    front, least = [], math.inf
    for time, error in sorted(shown):
        if error < least:
            front.append((time, error))
            least = error
    if front:
        axes.step(*zip(*front, strict=True), where="post", color=INK, linewidth=0.8, zorder=2, label="_front")
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low = min(low, floor / 3.0)
    axes.axhspan(low * 1e-3, floor, color="#E6E6E6", zorder=0, label="_floor")
    for model, errors in study.model_error.items():
        if name in errors:
            axes.axhline(errors[name], color=_COLORS[model], linestyle="--", linewidth=0.9, zorder=1)
    gone = _drawn_neglect(study)
    if gone is not None and name in ("force", "peak_force"):
        axes.axhline(gone[1], color=LIMIT, linestyle=":", linewidth=1.0, zorder=1)
        high = max(high, 2.0 * gone[1])
    axes.axhline(study.tolerance, color=FAINT, linewidth=0.7, zorder=1)
    axes.set_ylim(low, max(high, 2.0 * _scatter(axes, study, name)))
    lost = study.cheapest is not None and study.cheapest.setting in unseen
    if unseen:
        told = f"not drawn, 0 s by this clock: {len(unseen)}" + ", the recommended one too" * lost
        axes.set_title(told, loc="right", fontsize="small")
    if study.cheapest is not None and name in study.cheapest.errors and not lost:
        at = statistics.median(getattr(study.cheapest, clock)), max(study.cheapest.errors[name], _ROUNDING)
        axes.plot(*at, "o", markersize=11, markerfacecolor="none", color=LIMIT, zorder=6, label="_cheapest")


def _scatter(axes: Axes, study: Accuracy, name: str) -> float:
    """Draw by how much another path changes a quantity, with its 95 % interval; return its upper end."""
    if study.noise is None or name not in study.noise.scatter:
        return 0.0
    rms, low, high = study.noise.scatter[name]
    if rms > _ROUNDING:
        axes.axhspan(low, high, color=_SCATTER, alpha=0.18, linewidth=0, zorder=0, label="_scatter")
        axes.axhline(rms, color=_SCATTER, linewidth=0.8, zorder=1)
    return high


def _drawn_neglect(study: Accuracy) -> tuple[str, float] | None:
    """Return the largest effect that the scene leaves out, without those that outweigh all forces."""
    return next(((name, size) for name, size in study.neglected.items() if size < 1.0), None)


def _key(study: Accuracy) -> list[object]:
    from matplotlib.colors import to_rgb
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    models = dict.fromkeys(row.setting.model for row in study.rows if row.errors)
    series = dict.fromkeys(row.setting.series for row in study.rows if row.errors)
    handles: list[object] = [
        Line2D([], [], color=_COLORS[model], marker="o", linestyle="",
               label="peers" if model == "peer" else model)
        for model in models
    ]  # fmt: skip
    handles += [
        Line2D([], [], color=INK, marker=_MARKS[name], linestyle="", markersize=5, label=name)
        for name in series
    ]
    handles.append(Line2D([], [], color=INK, linewidth=0.8, label="Pareto front"))
    handles.append(Line2D([], [], color=FAINT, linewidth=0.7, label=f"tolerance {study.tolerance:g}"))
    if study.cheapest is not None:
        handles.append(Line2D([], [], color=LIMIT, marker="o", markersize=9, markerfacecolor="none",
                              linestyle="", label="recommended"))  # fmt: skip
    if any(study.model_error.values()):
        handles.append(Line2D([], [], color=INK, linestyle="--", label="effects a model leaves out"))
    gone = _drawn_neglect(study)
    if gone is not None:
        handles.append(Line2D([], [], color=LIMIT, linestyle=":", label=f"scene leaves out {gone[0]}"))
    if any(not resolved(row, name, study.floor) for row in study.rows for name in row.errors):
        handles.append(Line2D([], [], color=INK, marker="o", linestyle="", markerfacecolor="none",
                              label="bounded only: within 10x the floor"))  # fmt: skip
    if study.noise is not None:
        handles.append(Patch(facecolor=(*to_rgb(_SCATTER), 0.18), edgecolor=_SCATTER,
                             label="another path of the noise, rms"))  # fmt: skip
    handles.append(Patch(color="#E6E6E6", label="below the references' floor"))
    return handles


def _front(study: Accuracy) -> TextTable:
    rows = sorted((row for row in study.rows if row.front), key=lambda row: row.seconds)
    head = ["setting", "wall", "set-up", "points", "rejected", *study.quantities]
    cells = [
        [
            row.setting.label, quantity(row.seconds, "s"), quantity(statistics.median(row.setup_s), "s"),
            str(row.points), str(row.rejected),
            *(f"{row.errors[n]:.1e}" if n in row.errors else "-" for n in study.quantities),
        ]
        for row in rows
    ]  # fmt: skip
    numbers = set(range(1, len(head)))
    return TextTable("The Pareto front", head, cells, numbers, "All settings are in the file.", FILES[1])


def _weak(study: Accuracy) -> list[TextTable]:
    """Return the errors of means over all paths, with their intervals; nothing is claimed inside one."""
    if study.noise is None:
        return []
    cells = []
    strong = {row.setting.label: row.errors for row in study.rows}
    for label, row in study.noise.weak.items():
        for name in study.quantities:
            if name not in row:
                continue
            shown = f"{strong[label][name]:.1e}" if name in strong[label] else "-"
            mean, half = row[name]
            claim = _claim(mean, half, study.floor.get(name, 0.0))
            scatter = f"{study.noise.scatter[name][0]:.1e}"
            cells.append([label, name, shown, f"{mean:+.1e} ± {half:.1e}", claim, scatter])
    note = (
        f"All are shares of the value, against {study.references[0]}. The weak error is that of the mean "
        f"over {study.noise.count} paths that both see, with its 95 % interval (Student's t); an interval "
        "that holds zero shows no error, nor does one that reaches the references' floor. Scatter: by how "
        "much another path changes the value, rms."
    )
    head = ["setting", "measure", f"error on the path of seed {study.scene.seed}",
            "mean difference over paths", "weak error known", "scatter of paths"]  # fmt: skip
    return [TextTable("Strong and weak errors", head, cells, {2, 3, 4, 5}, note, FILES[2])]


def _claim(mean: float, half: float, floor: float) -> str:
    """Return what a mean difference with its interval says of the weak error."""
    if abs(mean) <= half:
        return f"none seen, below {max(abs(mean) + half, floor):.1e}"
    if abs(mean) - half <= floor:
        return f"none known, below {abs(mean) + half + floor:.1e}"
    return f"{mean:+.1e}"


def _reltol(study: Accuracy) -> list[TextTable]:
    """Compare the error that ngspice's own tolerance suggests with the errors that were made."""
    rows = []
    for row in study.rows:
        asked = believed(row.setting.label)
        if asked is not None and row.errors:
            worst = row.worst(study.quantities)
            rows.append([row.setting.label, f"{asked:g}", f"{worst:.1e}", f"{worst / asked:.3g}"])
    note = (
        "reltol bounds what Newton's iterations and each step's own formula leave, not what a run makes of "
        "it: the number of a deck is no error of a result."
    )
    head = ["setting", "reltol", "worst error", "times reltol"]
    return [TextTable("The number that fools", head, rows, {1, 2, 3}, note)] if rows else []


def believed(label: str) -> float | None:
    """Return the relative tolerance that a setting's label states; None where it states none.

    Examples
    --------
    >>> believed('spice, rtol 1e-06'), believed('linear as stated')
    (1e-06, None)
    """
    _, stated, value = label.partition("rtol ")
    return float(value.partition(",")[0]) if stated else None


def _failures(study: Accuracy) -> TextTable:
    rows = [[row.setting.label, row.failed] for row in study.rows if row.failed]
    return TextTable("Settings that failed", ["setting", "why"], rows, set(), "" if rows else "None.")


def _header(study: Accuracy) -> list[str]:
    names = list(dict.fromkeys(name for row in study.rows for name in row.errors))
    return [*study.quantities, *(name for name in names if name not in study.quantities)]


def _csv(study: Accuracy) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = _header(study)
    clocks = ("wall", "cpu", "setup")
    spread = [f"{clock}_{which} [s]" for clock in clocks for which in ("median", "min", "max")]
    writer.writerow(["setting", "model", "series", "overrides", "failed", "front", *spread, "points",
                     "rejected", "states", *(f"error of {name}" for name in names)])  # fmt: skip
    for row in study.rows:
        times: list[object] = []
        for clock in (row.wall_s, row.cpu_s, row.setup_s):
            times += [statistics.median(clock), min(clock), max(clock)] if clock else [None] * 3
        writer.writerow([row.setting.label, row.setting.model, row.setting.series,
                         " ".join(row.setting.overrides), row.failed, int(row.front), *times, row.points,
                         row.rejected, row.states, *(row.errors.get(name) for name in names)])  # fmt: skip
    writer.writerow(["floor", "", "", "", "", "", *[None] * 9, "", "", "", *map(study.floor.get, names)])
    return stream.getvalue()
