"""What `compare` and `sweep` print and write of designs by their distributions (``--mc N``)."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.scene.load import SceneLike
    from cosim.tolerance.common_draws import Side
    from cosim.tolerance.intervals import Estimate

TABLE = "distributions.csv"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--mc", type=int, metavar="N",
        help="compare distributions: N devices of each by the tolerances, the same draws for all",
    )  # fmt: skip
    parser.add_argument(
        "--spec", action="append", default=[], metavar="TEXT",
        help='with --mc: what a device must do to pass, "rendered_stiffness in 95..105"; repeatable',
    )  # fmt: skip


def by_distributions(
    args: argparse.Namespace, scene: "SceneLike", designs: Sequence[tuple[str, tuple[str, ...]]], out: Path
) -> tuple[dict[str, Any], str]:
    """Measure designs and return the result as JSON and as text; writes a table and pictures."""
    from cosim.commands.progress import progress
    from cosim.storage.owned_files import manifest_of, refuse_foreign, write_files
    from cosim.tolerance.common_draws import sides
    from cosim.tolerance.spec import parse_specs

    refuse_foreign(out, [TABLE], manifest_of("distributions"))
    with progress("devices") as show:
        results = sides(
            scene, designs, list(dict.fromkeys(args.measure)), parse_specs(args.spec), args.mc, out,
            trust=args.trust, on_progress=show,
        )  # fmt: skip
    from reports.designs import design_pictures

    drawn = design_pictures(results, parse_specs(args.spec))
    write_files(out, {TABLE: _csv(results).encode(), **drawn}, manifest_of("distributions"))
    result = {
        "devices": args.mc,
        "model": results[0].study.model,
        "sides": [_as_dict(side) for side in results],
        "table": str(out / TABLE),
        "pictures": [str(out / name) for name in drawn],
    }
    names = ", ".join(name for name in drawn if name.endswith(".png"))
    return result, "\n".join([*_text(results), f"wrote {out / TABLE}, {names}"])


def _as_dict(side: "Side") -> dict[str, Any]:
    from cosim.tolerance.missing import lacks
    from cosim.tolerance.study_results import estimate_dict, summary_dict

    return {
        "label": side.label,
        "measures": {
            name: {**summary_dict(each), "change_of_mean": estimate_dict(side.changes[name])}
            for name, each in side.summaries.items()
        },
        "yields": {
            text: {**estimate_dict(each), "change": estimate_dict(side.gains[text])}
            for text, each in side.yields.items()
        },
        "missing": {
            name: lack.samples for lack in lacks(side.study.failures, side.study.names) for name in lack.names
        },
    }


def _text(designs: "Sequence[Side]") -> list[str]:
    from cosim.catalogue import UNITS
    from cosim.tolerance.missing import lacks
    from cosim.units import quantity

    def interval(of: "Estimate", unit: str, digits: int = 5) -> str:
        low, high = (quantity(end, unit, 4) for end in (of.low, of.high))
        return f"{quantity(of.value, unit, digits)} ({low} to {high})"

    n, model = designs[0].study.sampling.n, designs[0].study.model
    lines = [f"{n} devices of each, the same draws, model {model}; in parentheses what holds with 95 %"]
    for name in designs[0].summaries:
        unit = UNITS.get(name, "")
        rows = [[name, "nominal", "mean", "standard deviation", "change of the mean"]]
        for side in designs:
            each, first = side.summaries[name], side is designs[0]
            change = "-" if first else interval(side.changes[name], unit, 4)
            rows.append(
                [
                    side.label, quantity(each.nominal, unit, 5), interval(each.mean, unit),
                    interval(each.spread, unit), change,
                ]
            )  # fmt: skip
        lines += ["", *_aligned(rows)]
    for text in designs[0].yields:
        rows = [[f"yield, {text}", "", "change"]]
        for side in designs:
            change = "-" if side is designs[0] else _percent(side.gains[text])
            rows.append([side.label, _percent(side.yields[text]), change])
        lines += ["", *_aligned(rows)]
    lacking = [
        f"{side.label}: {lack.samples} of {n} devices have no {lack.text} and pass no specification of it, "
        f"the first (sample {lack.first}): {lack.why}"
        for side in designs for lack in lacks(side.study.failures, side.study.names)
    ]  # fmt: skip
    return [*lines, *lacking]


def _percent(of: "Estimate") -> str:
    return f"{100 * of.value:.4g} % ({100 * of.low:.4g} to {100 * of.high:.4g})"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def _csv(designs: "Sequence[Side]") -> str:
    import csv
    import io

    from cosim.catalogue import UNITS
    from cosim.units import heading

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    parts = (
        "mean",
        "mean low",
        "mean high",
        "standard deviation",
        "change of mean",
        "change low",
        "change high",
    )
    names = list(designs[0].summaries)
    columns = [f"{heading(name, UNITS.get(name, ''))} {part}" for name in names for part in parts]
    texts = list(designs[0].yields)
    yields = [f"yield {text} {part}" for text in texts for part in ("", "low", "high", "change")]
    writer.writerow(["design", *columns, *(each.replace("  ", " ").strip() for each in yields)])
    for side in designs:
        row: list[Any] = [side.label]
        for name in names:
            each, change = side.summaries[name], side.changes[name]
            row += [each.mean.value, each.mean.low, each.mean.high, each.spread.value]
            row += [change.value, change.low, change.high]
        for text in texts:
            share = side.yields[text]
            row += [share.value, share.low, share.high, side.gains[text].value]
        writer.writerow(row)
    return stream.getvalue()
