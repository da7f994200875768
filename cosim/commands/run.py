"""``cosim run``: simulate a scene, or one for each value of ``--set``."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, load_variants, out_argument, scene_arguments

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cosim.results import Run
    from cosim.settings import Variant


def _arguments(parser: argparse.ArgumentParser) -> None:
    scene_arguments(parser)
    out_argument(parser)
    parser.add_argument(
        "--format",
        action="append",
        default=[],
        choices=("parquet", "csv"),
        help="also write the signals in this form; repeatable",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.loop.simulate") as child:  # it imports while the scene is read
        from cosim.plan import resolve
        from cosim.run import run

        found = load_variants(args)
        plans = [(variant, resolve(scene, trust=args.trust)) for variant, scene in found]
        base = Path(args.out) if args.out else Path("out") / Path(args.scene).stem
        finished: list[tuple[Variant, Path, Run]] = []
        names = folder_names([variant.label for variant, _ in plans])
        for (variant, plan), name in zip(plans, names, strict=True):
            out = base if len(plans) == 1 else base / name
            with progress(plan.scene.duration_s, variant.label or plan.scene.title) as show:
                result = run(plan, out, formats=tuple(args.format), on_progress=show, child=child)
            finished.append((variant, out, result))
    return _json(finished), _text(finished)


def folder_name(label: str) -> str:
    """Return a folder's name for one combination of values."""
    return "".join(c if c.isalnum() or c in "._=-+" else "_" for c in label)


def folder_names(labels: list[str]) -> list[str]:
    """Return the folders' names of a series; values that differ in odd characters only are told apart."""
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
    import sys

    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.3g} of {task.total:.3g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=duration_s)
        yield lambda state: bar.update(task, completed=float(state.get("time_s", 0.0)))


def _json(finished: "list[tuple[Variant, Path, Run]]") -> dict[str, Any]:
    return {
        "runs": [
            {
                "set": dict(variant.values),
                "folder": str(out),
                "measures": dict(run.measures),
                "ledger": dict(run.ledger),
                "stats": dict(run.stats),
            }
            for variant, out, run in finished
        ]
    }


def _text(finished: "list[tuple[Variant, Path, Run]]") -> str:
    lines = []
    for variant, out, run in finished:
        head = f"{variant.label}: " if variant.label else ""
        stats = run.stats
        lines.append(
            f"{head}{run.scene.duration_s:g} s simulated in {stats['wall_s']:.3g} s, "
            f"{stats['points']} points, {1e6 * stats['wall_s'] / stats['points']:.3g} us each -> {out}"
        )
        certificate = run.plan.get("certificate", {})
        said = certificate.get("sentence") or certificate.get("footnote_1", {}).get("sentence")
        lines += [f"  model {run.plan['model']}: {said}"] if said else []
        lines += [f"  note: {note}" for note in run.plan["notes"]]
        if not run.ledger["closes"]:
            lines.append(
                f"  warning: the energy ledger leaves {run.ledger['closure']:.2g} of the energy unexplained "
                f"(tolerance {run.ledger['tolerance']:g}): shorten solver.max_step_s"
            )
    return "\n".join([*lines, "", measure_table([(v.label, r.measures) for v, _, r in finished])])


def measure_table(columns: "list[tuple[str, Mapping[str, Mapping[str, Any]]]]") -> str:
    """Return measures side by side: the first column in full, the others with their change."""
    reference = columns[0][1]
    names = list(dict.fromkeys(name for _, measures in columns for name in measures))
    table = [["measure", "unit", *(label or "value" for label, _ in columns)]]
    for name in names:
        unit = next(str(measures[name]["unit"]) for _, measures in columns if name in measures)
        row = [name, unit]
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
            cell.ljust(width) if i in (0, 1) or (len(columns) == 1 and i == 3) else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    )


def _cell(row: "Mapping[str, Any] | None", before: "Mapping[str, Any] | None") -> str:
    if row is None:
        return "-"
    text = f"{row['value']:.4g}"
    if before is None:
        return text
    if before["value"] == row["value"]:
        return f"{text} (same)"
    if before["value"] == 0:
        return text
    return f"{text} ({100 * (row['value'] / before['value'] - 1):+.3g} %)"


COMMAND = Command("run", "simulate a scene; with --set one run a value", _arguments, _run)
