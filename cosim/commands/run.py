"""``cosim run``: simulate a scene, or one for each value of ``--set``."""

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.caution import collected
from cosim.commands.command import (
    Command,
    about,
    load_variants,
    measure_argument,
    out_argument,
    scene_arguments,
    tolerance_argument,
)
from cosim.commands.progress import COMPILING, announce_compilation
from cosim.commands.verbosity import bars, remark

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cosim.ngspice.child import Child
    from cosim.plan import Plan
    from cosim.results import Run
    from cosim.variants import Variant


def _arguments(parser: argparse.ArgumentParser) -> None:
    scene_arguments(parser)
    measure_argument(parser, "measure to show, instead of the scene's [measures]")
    out_argument(parser)
    parser.add_argument(
        "--format",
        action="append",
        default=[],
        choices=("parquet", "csv"),
        help="also write the signals in this form; repeatable",
    )
    tolerance_argument(parser, "choose solver settings so that measures are this right")
    parser.add_argument(
        "--no-estimate", action="store_true", help="do not estimate the errors of measures: saves a twin run"
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    ours = args.model in ("linear", "ideal")  # extraction of a circuit opens the library itself
    early = "cosim.loop.early_linear" if ours else "cosim.loop.early_imports"
    with start_early(
        early,
        reads=[Path(args.scene).parent],
        library=not ours,
        shared=("numpy", "cosim.scene") if ours else (),
    ) as child:  # it imports while the scene is read
        from cosim.api.simulation import run
        from cosim.commands.chosen_effects import plan_of
        from cosim.comparisons.measure_values import check_measures, needs_a_run
        from cosim.results import written_files
        from cosim.storage.staging import require_ours

        check_measures(args.measure)
        _check_tolerances(args)
        every = load_variants(args)
        if args.measure and not needs_a_run(args.measure):
            return _without_run(args, [(v, plan_of(args, scene, child)) for v, scene in every], child)
        base = Path(args.out) if args.out else Path("out") / Path(args.scene).stem
        _keep_apart(base, series=len(every) > 1)
        names = folder_names([variant.label for variant, _ in every])
        places = [base / name for name in names] if len(every) > 1 else [base]
        for out in places:
            require_ours(out, written_files)  # refuse before anything is computed
        announce_compilation()
        plans = []
        for variant, scene in every:
            with collected(about(variant, every)):
                plans.append((variant, plan_of(args, scene, child)))
        finished: list[tuple[Variant, Path, Run]] = []
        for (variant, plan), out in zip(plans, places, strict=True):
            title = variant.label or plan.scene.title
            with collected(about(variant, every)), progress(plan.scene.duration_s, title) as show:
                result = run(
                    plan, out, formats=tuple(args.format), tolerances=args.tol, free=not args.model,
                    estimate=not args.no_estimate, on_progress=show, child=child,
                )  # fmt: skip
            finished.append((variant, out, result))
    return _json(finished), _text(finished)


def _check_tolerances(args: argparse.Namespace) -> None:
    """Refuse tolerances that no run can meet, before anything long is done."""
    if not args.tol:
        return
    from cosim.accuracy.tolerance_control import parse_tolerances
    from cosim.errors import fail

    parse_tolerances(args.tol)
    if args.no_estimate:
        fail("a tolerance is held by the estimates: leave one of the two out", key="--no-estimate")


def _without_run(
    args: argparse.Namespace, plans: "list[tuple[Variant, Plan]]", child: "Child"
) -> tuple[dict[str, Any], str]:
    """Measure what needs no run: nothing is simulated, nothing is stored."""
    from cosim.comparisons.board_measures import board_measures
    from cosim.comparisons.measure_values import check_blocks

    check_blocks(args.measure, [plan.board for _, plan in plans])
    rows: list[tuple[str, Mapping[str, Mapping[str, Any]]]] = []
    results, lines = [], ["no run is needed for these measures: nothing was simulated or stored"]
    for variant, plan in plans:
        measured, lacking = board_measures(plan, args.measure, child=child)
        rows.append((variant.label, measured))
        results.append(
            {"set": dict(variant.values), "folder": None, "measures": measured, "lacking": lacking}
        )
        head = f"{variant.label}: " if variant.label else ""
        lines += [f"  {head}no {name}: {why}" for name, why in lacking.items()]
    shown = [row for row in rows if row[1]]
    return {"runs": results}, "\n".join([*lines, *(["", measure_table(shown)] if shown else [])])


def _keep_apart(base: Path, *, series: bool) -> None:
    """Refuse a series inside a single result, and a result in place of a series: one would be lost."""
    from cosim.errors import fail

    if series and os.path.isfile(base / "run.json"):
        fail("holds the result of a single run; give the series a folder of its own (--out)", file=str(base))
    inside = sorted(path.parent.name for path in base.glob("*/run.json"))
    if not series and inside:
        fail(
            f"holds the results of a series ({', '.join(inside[:3])}{', ...' if len(inside) > 3 else ''}); "
            "choose another folder (--out)",
            file=str(base),
        )


def folder_name(label: str) -> str:
    """Return a folder's name for one combination of values."""
    return "".join(c if c.isalnum() or c in "._=-+" else "_" for c in label)


def folder_names(labels: list[str]) -> list[str]:
    """Return the folders' names of a series; values that differ only in special characters get numbers."""
    names: list[str] = []
    for label in labels:
        name = plain = folder_name(label)
        count = 1
        while name in names:
            count += 1
            name = f"{plain}_{count}"
        names.append(name)
    return names


@contextmanager
def progress(duration_s: float, title: str) -> "Iterator[Callable[[Mapping[str, Any]], None] | None]":
    """Show a bar on a terminal, nothing elsewhere."""
    if not bars():
        remark(f"{title}: {duration_s:.3g} s are simulated", detail=True)
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from cosim.commands.progress import shown
    from mech.library_files import is_built

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[reached]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        # no total: the bar pulses until simulated time advances
        task = bar.add_task(shown(title) if is_built() else COMPILING, total=None, reached="")

        def show(state: "Mapping[str, Any]") -> None:
            time_s = float(state.get("time_s", 0.0))
            if time_s > 0.0:
                reached = f"{time_s:.3g} of {duration_s:.3g} s"
                bar.update(
                    task, description=shown(title), total=duration_s, completed=time_s, reached=reached
                )

        yield show


def _json(finished: "list[tuple[Variant, Path, Run]]") -> dict[str, Any]:
    return {
        "runs": [
            {
                "set": dict(variant.values),
                "folder": str(out),
                **({"choice": run.plan["choice"]} if "choice" in run.plan else {}),
                "measures": dict(run.measures),
                "ledger": dict(run.ledger),
                "stats": dict(run.stats),
                "printed": list(run.printed),
                "warnings": [caution.as_dict() for caution in run.warnings],
            }
            for variant, out, run in finished
        ]
    }


def _text(finished: "list[tuple[Variant, Path, Run]]") -> str:
    from cosim.commands.chosen_effects import choice_lines
    from cosim.units import quantity

    lines = []
    for variant, out, run in finished:
        head = f"{variant.label}: " if variant.label else ""
        stats = run.stats
        lines.append(
            f"{head}{quantity(run.scene.duration_s, 's', 4)} simulated in {quantity(stats['wall_s'], 's')}, "
            f"{stats['points']} points, {1e6 * stats['wall_s'] / stats['points']:.3g} µs each -> {out}"
        )
        if "choice" in run.plan:
            lines += choice_lines(run.plan["choice"])
        lines += _certified(run)
        lines += [f"  note: {note}" for note in run.plan["notes"]]
        lines += [f"  printed: {line}" for line in run.printed]
    table = measure_table([(v.label, r.measures) for v, _, r in finished])
    return "\n".join([*lines, "", table, *_estimated(finished)])


def _estimated(finished: "list[tuple[Variant, Path, Run]]") -> list[str]:
    """State the error bounds, or why there are none."""
    rows = [row for _, _, run in finished for row in run.measures.values()]
    lines = []
    if any(row.get("error") is not None for row in rows):
        lines.append(
            "±: bound of the solver's error (95 %), from a closer run; what the scene leaves out is not in it"
        )
        lines += [f"no bound, {names}: {why}" for names, why in _why_not(finished, "no_error")]
    elif why := next((str(row["no_error"]) for row in rows if "no_error" in row), ""):
        lines.append(f"errors are not estimated: {why}")
    if any(row.get("noise") for row in rows):
        lines.append(
            "noise ±: 95 % of all paths of the noise lie so close to their mean, by the linear model"
        )
    lines += [f"no interval of the noise, {name}: {why}" for name, why in _why_not(finished, "no_noise")]
    return lines


def _why_not(finished: "list[tuple[Variant, Path, Run]]", key: str) -> list[tuple[str, str]]:
    """Return the measures whose rows say by a key why something is missing, the first of many, by reason."""
    by_reason: dict[str, dict[str, None]] = {}
    for _, _, run in finished:
        for name, row in run.measures.items():
            if key in row:
                by_reason.setdefault(str(row[key]), {})[name] = None
    return [
        (", ".join([*names][:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else ""), why)
        for why, names in by_reason.items()
    ]


def _certified(run: "Run") -> list[str]:
    """State what the model `ideal` or `linear` neglects; dampers only where the scene uses them."""
    from cosim.units import quantity

    certificate = run.plan.get("certificate", {})
    neglect = certificate.get("footnote_1", {})
    if "sentence" in certificate:
        return [f"  model {run.plan['model']}: {certificate['sentence']}"]
    if "error" not in neglect:
        return []
    damped = run.scene.computer.analog_damping_n_s_per_m > 0
    parts = [
        f"{path} {100 * share:.3g} %"
        for path, share in neglect["error"].items()
        if path != "damper" or damped
    ]
    left_out = (
        f"up to {quantity(neglect['band_hz'], 'Hz', 4)} the dynamics left out are at most "
        f"{', '.join(parts)} of each path"
    )
    return [f"  model {run.plan['model']}: {left_out}"]


def measure_table(columns: "Sequence[tuple[str, Mapping[str, Mapping[str, Any]]]]") -> str:
    """Return measures side by side with units: the first column in full, the others with their change."""
    reference = columns[0][1]
    names = list(dict.fromkeys(name for _, measures in columns for name in measures))
    table = [["measure", *(label or "value" for label, _ in columns)]]
    for name in names:
        row = [name]
        for k, (_, measures) in enumerate(columns):
            row.append(_cell(measures.get(name), None if k == 0 else reference.get(name)))
        table.append(row)
    if len(columns) == 1:
        for row, name in zip(table[1:], names, strict=True):
            row.append(str(reference[name]["text"]))
        table[0].append("")
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 or (len(columns) == 1 and i == 2) else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    )


#: Changes below this share are the rounding of sums.
_SAME = 1e-12


def _cell(row: "Mapping[str, Any] | None", before: "Mapping[str, Any] | None") -> str:
    if row is None:
        return "-"
    from cosim.units import of_measure

    text = of_measure(row)
    if before is None:
        return text
    if abs(row["value"] - before["value"]) <= _SAME * abs(before["value"]):
        return f"{text} (same)"
    if before["value"] == 0:
        return text
    ratio = row["value"] / before["value"]
    return f"{text} ({100 * (ratio - 1):+.3g} %)" if abs(ratio - 1) < 10 else f"{text} (x {ratio:.3g})"


COMMAND = Command("run", "simulate a scene; with --set one run a value", _arguments, _run)
