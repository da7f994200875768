"""A sweep: measures of a scene over ranges of its values, kept point by point."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NotRequired

from typing_extensions import TypedDict

import cosim
from cosim.catalogue import OF_A_RUN, UNITS, find, needing_no_run
from cosim.caution import CautionFields, caution_of, collected, warn
from cosim.comparisons.measure_values import Measurer, check_blocks, check_measures, measure, needs_a_run
from cosim.errors import InputError, SimulationError, StorageError, fail
from cosim.ngspice.child import Child
from cosim.ngspice.lines import number
from cosim.notebook_view import view
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from cosim.scene.keys import keys
from cosim.scene.load import SceneLike
from cosim.storage.checkpoint import Points
from cosim.storage.owned_files import manifest_of, refuse_foreign, write_files
from cosim.storage.staging import disk_errors
from cosim.types import Progress
from cosim.units import heading
from cosim.variants import Setting, Variant, split_values, variants

POINTS, TABLE = "points.jsonl", "sweep.csv"
#: Names the files of a sweep, so that a later one may replace them.
MANIFEST = manifest_of("sweep")
#: Version of a kept point; points of another version are computed anew.
_FORM = "measures and warnings"
#: What elements of a netlist are counted in, by the letter of a designator such as R12 or r_diff_fb.
_ELEMENTS = {"r": "Ohm", "c": "F", "l": "H"}
_ELEMENT = re.compile(r"[rcl]\d+|[rcl]_\w+")
#: A range of more points than this is taken for a typing error.
MOST_POINTS = 10_000


class _Point(TypedDict):
    """A kept point: measures and cautions about them."""

    measures: dict[str, float]
    warnings: list[CautionFields]
    errors: NotRequired[dict[str, float]]


@dataclass(frozen=True)
class Sweep:
    """Measures over values.

    Attributes
    ----------
    names : what was varied
    values : one row a point, in the order of `names`, as written in the table
    measures : name -> one value a point, ``None`` where a point has none
    failed : label of a point -> what went wrong
    errors : name -> bounds of the solver's error, one a point, of measures that have some
    """

    names: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]
    measures: dict[str, tuple[float | None, ...]]
    failed: dict[str, str]
    errors: Mapping[str, tuple[float | None, ...]] = field(default_factory=dict)

    def plot(self) -> Any:
        """Return a matplotlib figure: each measure over the first range.

        Raises
        ------
        ValueError
            Where the first range is not of numbers, or no point has a measure.
        """
        return view("sweep_figure", self)

    def _repr_html_(self) -> str:
        """Return table and picture, for notebooks."""
        text: str = view("sweep_html", self)
        return text


def parse_range(text: str) -> Setting:
    """Parse ``NAME=FROM:TO:COUNT``, ``NAME=FROM:TO:COUNT:log`` or ``NAME=V1,V2,...``.

    Ends may be written as in a netlist (8.2k). Points of a range are shortest decimals, so that a value is
    the same in the table, in the file and in a later call.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> parse_range('R12=1k:3k:3').values, parse_range('seed=1,2').values
    (('1000', '2000', '3000'), ('1', '2'))
    """
    name, _, written = text.partition("=")
    parts = [part.strip() for part in written.split(":")]
    if name.strip() and len(parts) in (3, 4):
        first, last = number(parts[0]), number(parts[1])
        spacing = parts[3] if len(parts) == 4 else "lin"
        count = int(parts[2]) if parts[2].isdigit() else 0
        logarithmic = spacing == "log" and first is not None and last is not None and first * last > 0.0
        if first is not None and last is not None and first != last and 2 <= count <= MOST_POINTS:
            if logarithmic:
                ratio = (last / first) ** (1.0 / (count - 1))
                return Setting(name.strip(), tuple(f"{first * ratio**k:.6g}" for k in range(count)))
            if spacing == "lin":
                step = (last - first) / (count - 1)
                return Setting(name.strip(), tuple(f"{first + k * step:.6g}" for k in range(count)))
    elif name.strip() and len(parts) == 1 and all(split_values(written)):
        return Setting(name.strip(), tuple(split_values(written)))
    fail(
        "is not a range",
        key="range",
        value=text,
        allowed=f"NAME=FROM:TO:COUNT, NAME=FROM:TO:COUNT:log (both ends of one sign), or NAME=V1,V2,...; "
        f"2 to {MOST_POINTS} points",
    )


def sweep(
    path: SceneLike,
    settings: Sequence[Setting],
    measures: Sequence[str],
    folder: Path,
    *,
    overrides: tuple[str, ...] = (),
    child: Child | None = None,
    trust: bool = False,
    on_progress: Progress | None = None,
    measurer: Measurer = measure,
    how: str = "",
) -> Sweep:
    """Measure a scene at every combination of the values; what is already in `folder` is not run again.

    Nothing is simulated where no measure needs it.

    Parameters
    ----------
    path, overrides, trust
        The scene, as for `load_scene` and `resolve`.
    settings
        What is varied; the last one changes fastest.
    measures
        Names of the measures of the table; of a run all are kept.
    folder
        Keeps the points; those of another scene, board or version are begun anew.
    measurer, how
        What measures a point, and what tells its points from those of another, in words.

    Raises
    ------
    InputError
        When the table would replace a file that is not ours.
        When no point can be planned, for the reasons of all of them; where only some values do not fit the
        scene or the board, these points are rows without measures, and `Sweep.failed` has their errors.
    StorageError
        When the folder cannot be written.
    """
    check_measures(measures)
    refuse_foreign(folder, [TABLE], MANIFEST)
    own = [name for name in measures if ":" in name]
    if own:
        overrides = (*overrides, f"measures.names={json.dumps(own)}")
        measures = [name.rpartition(":")[2] for name in measures]
    every = variants(settings)
    plans = _plans(path, overrides, every, trust)
    check_blocks(measures, [plan.board for plan in plans if not isinstance(plan, InputError)])
    alone = needing_no_run(
        name for name in measures if find(name) is not None
    )  # a part of its own: asked for later, it runs nothing again
    parts = [part for part in (OF_A_RUN if own or needs_a_run(measures) else (), alone) if part]
    failed: dict[str, str] = {}
    rows: list[Mapping[str, Any]] = []
    bounds: list[Mapping[str, Any]] = []
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with Points(folder / POINTS, _digest(path, overrides, trust, how), on_progress) as points:
        points.expect(len(every) * len(parts))
        for variant, plan in zip(every, plans, strict=True):
            label = " ".join(f"{name}={value}" for name, value in variant.values)
            row: dict[str, float] = {}
            bound: dict[str, float] = {}
            for part in parts:
                key = label if part is OF_A_RUN else f"{label}: {', '.join(part)}"
                try:
                    if isinstance(plan, InputError):
                        raise plan
                    with collected(label):
                        compute = partial(_measured, plan, part, child, measurer)
                        got = points.get(key, compute, _Point)
                        warn(*map(caution_of, got["warnings"]))  # of kept points, too
                        row |= got["measures"]
                        bound |= got.get("errors", {})
                except StorageError:
                    raise
                except (InputError, SimulationError) as error:  # not kept: a resumed sweep tries it again
                    failed[label] = str(error)
            rows.append(row)
            bounds.append(bound)
    result = Sweep(
        names=tuple(setting.name for setting in settings),
        values=tuple(tuple(value for _, value in variant.values) for variant in every),
        measures={name: tuple(_number(row.get(name)) for row in rows) for name in measures},
        failed=failed,
        errors={
            name: tuple(_number(bound.get(name)) for bound in bounds)
            for name in measures
            if any(name in bound for bound in bounds)
        },
    )
    _write(result, folder)
    return result


def _plans(
    path: SceneLike, overrides: tuple[str, ...], every: Sequence[Variant], trust: bool
) -> list[Plan | InputError]:
    """Plan all points before the first runs; raise when none of them can be planned."""
    plans: list[Plan | InputError] = []
    for variant in every:
        try:
            with collected(variant.label):
                plans.append(_plan(path, overrides, variant, trust))
        except StorageError:
            raise
        except InputError as error:
            plans.append(error)
    refused = [plan for plan in plans if isinstance(plan, InputError)]
    if len(refused) == len(plans):
        raise InputError({str(problem): problem for error in refused for problem in error.problems}.values())
    return plans


def _plan(path: SceneLike, overrides: tuple[str, ...], variant: Variant, trust: bool) -> Plan:
    return resolve(load_scene(path, [*overrides, *variant.overrides]), trust=trust)


def _measured(plan: Plan, names: Sequence[str], child: Child | None, measurer: Measurer) -> dict[str, Any]:
    measured = measurer(plan, names, child=child)
    measures = {name: float(row["value"]) for name, row in measured.rows.items()}
    errors = {
        name: float(row["error"]) for name, row in measured.rows.items() if row.get("error") is not None
    }
    notes = {"errors": errors} if errors else {}
    return {"measures": measures, **notes, "warnings": [caution.as_dict() for caution in measured.warnings]}


def _digest(path: SceneLike, overrides: tuple[str, ...], trust: bool, how: str = "") -> str:
    """Return what the points depend on besides their own values: scene, user's code, board and version."""
    with collected(forward=False):  # the points tell it
        plan = resolve(load_scene(path, overrides), trust=trust)
    text = f"{_FORM} {cosim.__version__} {plan.scene.digest()} {plan.scene.code_digest()} {plan.board.digest}"
    return hashlib.sha256((f"{text} {how}" if how else text).encode()).hexdigest()


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _write(result: Sweep, folder: Path) -> None:
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(
        [
            *(heading(name, unit_of(name)) for name in result.names),
            *map(_heading, result.measures),
            *(heading(f"{name}_error", UNITS.get(name, "")) for name in result.errors),
        ]
    )
    columns = [*result.measures.values(), *result.errors.values()]
    for number_, values in enumerate(result.values):
        writer.writerow([*values, *(column[number_] for column in columns)])
    write_files(folder, {TABLE: table.getvalue().encode()}, MANIFEST)


def unit_of(name: str) -> str:
    """Return the unit of what is swept: a key of the scene, or an element of the netlist by its letter."""
    units = {key.path: key.unit for key in keys()}
    last = name.rpartition(".")[2].lower()
    if name in units or not _ELEMENT.fullmatch(last):
        return units.get(name, "")
    return _ELEMENTS[last[0]]


def _heading(name: str) -> str:
    return heading(name, UNITS.get(name, ""))
