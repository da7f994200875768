"""From a run to one self-contained HTML page, with its figures and their data beside it."""

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.caution import Caution, grouped
from cosim.storage.checksums import MANIFEST
from cosim.storage.owned_files import write_files
from cosim.units import pretty
from reports.compact_svg import data_uri
from reports.summary import summary, tiles
from reports.tables import Table, Trial, all_tables, command_line, compare_table
from reports.view import RunLike, View

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from reports.style import Drawn

__all__ = ["FIGURES", "Picture", "draw_all", "picture", "render", "write_page", "write_report"]

PAGE_NAME = "report.html"
FOLDER_NAME = "figures"

#: Order of the page: name, title, module and function. A name is also the name of the files.
FIGURES: tuple[tuple[str, str, str, str], ...] = (
    ("path", "Fingertip path over the wall", "path", "path"),
    ("tangent_normal", "Force and position along tangent and normal", "motion", "tangent_normal"),
    ("zoom", "Between the samples", "motion", "zoom"),
    ("currents", "Motor currents", "circuit", "currents"),
    ("gains", "VCA gains", "circuit", "gains"),
    ("headroom", "Headroom of the amplifiers", "circuit", "headroom"),
    ("nodes", "Recorded nodes", "circuit", "nodes"),
    ("energy", "Energy ledger", "energy_and_cost", "energy"),
    ("steps", "Time steps and cost", "energy_and_cost", "steps"),
)


@dataclass(frozen=True)
class Picture:
    """A figure as files: `svg` and `png` bytes, the drawn `data` as CSV text."""

    name: str
    title: str
    caption: str
    svg: bytes
    png: bytes
    data: str

    @property
    def source(self) -> str:
        """The SVG as a data URI: kept apart from the page, so that ids of two figures cannot clash."""
        return data_uri(self.svg)


def write_report(
    run: RunLike, out_dir: str | Path, trials: Sequence[Trial] = (), inputs: Table | None = None
) -> Path:
    """Write ``report.html`` and the folder ``figures`` with PNG, SVG and CSV of each figure.

    Parameters
    ----------
    run
        What to report; `cosim.results.Run` or anything with its attributes.
    out_dir
        Folder to write into; made when it is absent. A report that it holds is replaced.
    trials
        Values tried with ``--set``, the reference first: adds a section of what changed.
    inputs
        Inputs that differ, from `reports.tables.inputs_table`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder cannot be written; nothing half-written is left.
    """
    view = View(run)
    pictures, absent = draw_all(view)
    compared: list[Picture] = []
    if len(trials) > 1:
        from reports.compare import overlay
        from reports.style import look

        with look():
            drawn = overlay(trials)
            compared = [picture("compare", "What changed", drawn)] if drawn is not None else []
    html = render(
        "run.html.j2",
        title=str(view.scene_at("title", default="Co-simulation")),
        pictures=pictures,
        absent=absent,
        warnings=grouped(_doubts(run, trials)),
        summary=summary(view),
        tiles=tiles(view),
        tables=all_tables(view),
        compare=compare_table(trials) if len(trials) > 1 else None,
        compared=compared,
        inputs=inputs,
        printed=list(run.printed),
        scene=_scene_text(run),
        command=command_line(run.provenance.get("command")),
    )
    return write_page(Path(out_dir), html, [*compared, *pictures])


def _doubts(run: RunLike, trials: Sequence[Trial]) -> list[Caution]:
    """Return the cautions about the run and about every other one that is shown."""
    cautions = [*run.warnings]
    for trial in trials:
        if trial.run is not None and trial.run is not run:
            cautions += [replace(each, text=f"{trial.label}: {each.text}") for each in trial.run.warnings]
    return cautions


def draw_all(view: View, *, first: bool = False) -> tuple[list[Picture], list[str]]:
    """Return the figures that the run fills (or the `first`), and the titles of those it lacks."""
    from importlib import import_module

    from reports.style import look

    pictures, absent = [], []
    with look():
        for name, title, module, function in FIGURES:
            draw: Callable[[View], Drawn | None] = getattr(import_module(f"reports.{module}"), function)
            drawn = draw(view)
            if drawn is None:
                absent.append(title)
            else:
                pictures.append(picture(name, title, drawn))
                if first:
                    break
    return pictures, absent


def picture(name: str, title: str, drawn: "Drawn") -> Picture:
    """Turn a drawn figure into files."""
    from reports.style import pictures

    files = pictures(drawn.figure)
    return Picture(name, title, drawn.caption, files["svg"], files["png"], _data(drawn.figure))


def _data(figure: "Figure") -> str:
    """Return what the figure shows, one row a point: panel, series, x, y and, of a map, value."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("panel", "series", "x", "y", "x_axis", "y_axis", "value"))
    for number, axes in enumerate(figure.axes):
        panel = axes.get_title(loc="left") or f"panel {number + 1}"
        axis = (axes.get_xlabel() or figure.axes[-1].get_xlabel(), axes.get_ylabel())
        for line in axes.get_lines():
            label = str(line.get_label())
            if label.startswith("_"):
                label = axes.get_ylabel() or panel
            x, y = (np.asarray(part, dtype=np.float64) for part in line.get_data(orig=True))
            rows.writerows(
                (panel, label, f"{a:.9g}", f"{b:.9g}", *axis, "")
                for a, b in zip(x.tolist(), y.tolist(), strict=True)
            )
        names = [tick.get_text() for tick in axes.get_yticklabels()]
        for bar, label in zip(axes.patches, names, strict=False):
            if hasattr(bar, "get_width") and axes.containers:
                rows.writerow((panel, label, f"{bar.get_width():.9g}", "", *axis, ""))
        for drawn in axes.collections:
            label = str(drawn.get_label())
            if label.startswith("_"):
                label = axes.get_ylabel() or panel
            rows.writerows(
                (panel, label, f"{x:.9g}", f"{y:.9g}", *axis, "" if v is None else f"{v:.9g}")
                for x, y, v in _points(drawn)
            )
    return text.getvalue()


def _points(drawn: Any) -> Iterator[tuple[float, float, float | None]]:
    """Yield (x, y, value) of what is no line: middles of a map's cells, dots, contours at their levels."""
    values = drawn.get_array()
    flat = None if values is None else np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan).ravel()
    if hasattr(drawn, "get_coordinates"):  # a mesh: middles of its cells, or points
        at = np.asarray(drawn.get_coordinates(), dtype=np.float64)
        if flat is not None and at.shape[0] * at.shape[1] != len(flat):
            at = (at[1:, 1:] + at[1:, :-1] + at[:-1, 1:] + at[:-1, :-1]) / 4.0
        at = at.reshape(-1, 2)
    elif hasattr(drawn, "levels"):
        for level, path in zip(drawn.levels, drawn.get_paths(), strict=False):
            yield from ((float(x), float(y), float(level)) for x, y in path.vertices)
        return
    elif len(offsets := np.asarray(drawn.get_offsets(), dtype=np.float64).reshape(-1, 2)) > 1:
        at = offsets
    else:
        for path in drawn.get_paths():
            yield from ((float(x), float(y), None) for x, y in path.vertices)
        return
    for number, (x, y) in enumerate(at.tolist()):
        yield x, y, float(flat[number]) if flat is not None and number < len(flat) else None


def _scene_text(run: RunLike) -> str:
    writer = getattr(run.scene, "to_toml", None)
    return str(writer()) if writer is not None else ""


def render(template: str, **fields: Any) -> str:
    """Fill one of the templates beside this module."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("reports", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["glue"] = glue
    environment.filters["pretty"] = pretty
    return environment.get_template(template).render(**fields)


def glue(text: str) -> str:
    """Return `text` with pretty units, glued to their numbers, so that no line ends between them."""
    return re.sub(r"(?<=\d) (?=[%A-Za-zµ]{1,3}\b|%)", "\u00a0", pretty(text))


def write_page(
    folder: Path,
    html: str,
    pictures: Sequence[Picture],
    tables: Mapping[str, str] | None = None,
    manifest: str = MANIFEST,
) -> Path:
    """Write the page, its pictures and `tables` (path in the folder -> CSV text), the page last.

    Each command has its own manifest: with a common one, a second command into a folder would take the first
    one's tables for leftovers of its own, and delete them.

    Raises
    ------
    InputError
        As `cosim.storage.owned_files.write_files`.
    """
    content: dict[str, bytes] = {path: text.encode() for path, text in (tables or {}).items()}
    for each in pictures:
        for ending, data in (("svg", each.svg), ("png", each.png), ("csv", each.data.encode())):
            content[f"{FOLDER_NAME}/{each.name}.{ending}"] = data
    content[PAGE_NAME] = html.encode()
    write_files(folder, content, manifest)
    return folder / PAGE_NAME
