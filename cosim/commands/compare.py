"""``cosim compare``: what an edit of the board changes."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, measure_argument, trust_arguments
from cosim.commands.distributions import arguments, by_distributions

if TYPE_CHECKING:
    from cosim.comparisons.compare_boards import Row, Side
    from cosim.ngspice.child import Child
    from cosim.variants import Variant

#: Results of `cosim run SCENE` without a folder of their own.
_USUAL = Path("out")
#: Figures that are printed where nothing else is asked for.
_MOST_SHOWN = 40


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "boards",
        nargs="*",
        metavar="BOARD.cir",
        help="none (the scene's board), one or two; the first is the reference",
    )
    parser.add_argument("scene", metavar="SCENE.toml", help="scene under which all are run")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=V1,V2,...",
        help="compare with values of a netlist name (R12, xdiff1.r1) or a scene key; repeatable",
    )
    parser.add_argument(
        "--last",
        nargs="?",
        const="",
        metavar="FOLDER",
        help="compare with a stored run, which becomes the reference (default: the last in out/SCENE)",
    )
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for the runs and a page (default: out/compare)"
    )
    measure_argument(parser, "measure to compare, and nothing else: no check, no page")
    parser.add_argument("--most", type=int, metavar="N", help=f"figures to show (default: {_MOST_SHOWN})")
    arguments(parser)
    trust_arguments(parser)


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early(
        "cosim.loop.early_imports", "cosim.checking.measured", reads=[Path(args.scene).parent]
    ) as child:
        from cosim.api.simulation import compare
        from cosim.commands.progress import progress
        from cosim.comparisons.measure_values import check_measures
        from cosim.errors import fail
        from cosim.storage.owned_files import refuse_foreign
        from cosim.variants import parse_settings, variants
        from reports.boards import MANIFEST
        from reports.page import PAGE_NAME

        check_measures(args.measure)
        if args.spec and args.mc is None:
            fail("is of devices that vary: give their number with --mc", key="--spec", value=args.spec[0])
        last = _USUAL / Path(args.scene).stem if args.last == "" else Path(args.last) if args.last else None
        values = [variant for variant in variants(parse_settings(args.set)) if variant.values]
        if args.mc is not None:
            return _distributions(args, values, last)
        if args.measure:
            return _measures(args, values, last, child)
        out = Path(args.out) if args.out else _USUAL / "compare"
        refuse_foreign(out / "report", [PAGE_NAME], MANIFEST)
        with progress("comparing") as show:
            comparison = compare(
                args.scene, args.boards, values, last, out,
                child=child, trust=args.trust, on_progress=show,
            )  # fmt: skip
    from reports.boards import write_comparison

    sides, rows = comparison.sides, comparison.changes
    page = write_comparison(sides, rows, out / "report")
    text = "\n".join(
        [
            *_table(sides, rows, _MOST_SHOWN if args.most is None else args.most),
            *_descriptions(sides),
            f"wrote {page}",
        ]
    )
    result = {
        "boards": [side.label for side in sides],
        "measures": [dict(side.run.measures) for side in sides],
        "findings": [dict(side.findings) for side in sides],
        "changed": [vars(row) for row in rows],
        "page": str(page),
    }
    return result, text


def _distributions(
    args: argparse.Namespace, values: "list[Variant]", last: Path | None
) -> tuple[dict[str, Any], str]:
    """Compare designs by their distributions."""
    from cosim.comparisons.compare_boards import sides_of
    from cosim.errors import fail

    if last is not None:
        fail("a stored run is one device: give boards or values", key="--last", value=str(last))
    if args.most is not None:
        fail("counts figures of single devices: it has no meaning beside --mc", key="--most", value=args.most)
    designs = [(each.label, each.overrides) for each in sides_of(args.boards, values, None)]
    out = Path(args.out) if args.out else _USUAL / "compare-mc"
    return by_distributions(args, args.scene, designs, out)


def _measures(
    args: argparse.Namespace, values: "list[Variant]", last: Path | None, child: "Child"
) -> tuple[dict[str, Any], str]:
    """Compare the measures that are asked for."""
    from cosim.commands.progress import progress
    from cosim.commands.run import measure_table
    from cosim.comparisons.compare_boards import compare_measures, sides_of

    names, asked = list(dict.fromkeys(args.measure)), sides_of(args.boards, values, last)
    with progress("comparing") as show:
        sides = compare_measures(args.scene, asked, names, child=child, trust=args.trust, on_progress=show)
    rows = [(label, {n: measured.rows[n] for n in names if n in measured.rows}) for label, measured in sides]
    why = [
        f"{label}, no {name}: {why}" for label, measured in sides for name, why in measured.lacking.items()
    ]
    result = {"boards": [label for label, _ in rows], "measures": [dict(row) for _, row in rows]}
    return result, "\n".join([*([measure_table(rows)] if any(r for _, r in rows) else []), *why])


def _table(sides: "Sequence[Side]", rows: "Sequence[Row]", most: int) -> list[str]:
    """Return the largest changes, by section."""
    from cosim.comparisons.board_figures import SECTIONS
    from reports.boards import cells, felt

    if not rows:
        return ["no figure differs"]
    shown = rows[: max(most, 0)]
    table = [["", "", *(side.label for side in sides)]]
    lines: list[str | None] = [None]
    for section in SECTIONS:
        inside = [row for row in shown if row.section == section]
        if inside:
            lines.append(section)
        for row in inside:
            table.append([f"  {row.quantity}", row.where, *cells(row)])
            lines.append(None)
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    formed = iter(
        "  ".join(
            c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in table
    )
    text = [*felt(rows), "", *(next(formed).rstrip() if line is None else line for line in lines)]
    if len(rows) > len(shown):
        text.append(f"and {len(rows) - len(shown)} smaller changes (--most, --json)")
    return text


def _descriptions(sides: "Sequence[Side]") -> list[str]:
    """Return the results in words, once where all sides agree."""
    lines = [""]
    for name in dict.fromkeys(name for side in sides for name, _ in side.findings):
        words = [dict(side.findings).get(name, "not known") for side in sides]
        if len(set(words)) == 1:
            lines.append(f"{name}: {words[0]} (all)")
        else:
            lines += [f"{name}, {side.label}: {word}" for side, word in zip(sides, words, strict=True)]
    return lines


COMMAND = Command(
    "compare", "show what an edit did: boards, values or an earlier run under one scene", _arguments, _run
)
