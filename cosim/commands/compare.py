"""``cosim compare``: what an edit of the board did."""

import argparse
from pathlib import Path
from typing import Any

from cosim.commands.command import Command


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "boards", nargs=2, metavar="BOARD.cir", help="the two boards; the first is the reference"
    )
    parser.add_argument("scene", metavar="SCENE.toml", help="scene under which both are run")
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for both runs and a page (default: out/compare)"
    )
    parser.add_argument("--most", type=int, default=30, metavar="N", help="figures to show (default: 30)")
    parser.add_argument(
        "--trust", action="store_true", help="let the netlists run commands and read files of their choice"
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.loop.simulate", "cosim.check.measure") as child:
        from cosim.commands.run import measure_table
        from cosim.studies.compare import changes, compare

        out = Path(args.out) if args.out else Path("out/compare")
        sides = compare(args.scene, args.boards, out, child=child, trust=args.trust)
    from reports.page import write_report
    from reports.tables import Trial

    page = write_report(
        sides[0].run, out / "report", [Trial(side.label, side.run.measures, side.run) for side in sides]
    )
    rows = changes(sides)
    lines = [measure_table([(side.label, side.run.measures) for side in sides]), ""]
    if rows:
        width = max(len(name) for name, _ in rows[: args.most])
        lines.append(
            f"{'figures of the board that changed':{width}}  {sides[0].label:>13}  {sides[1].label:>13}"
        )
        lines += [
            f"{name:{width}}  " + "  ".join(f"{'-':>13}" if v is None else f"{v:>13.5g}" for v in values)
            for name, values in rows[: args.most]
        ]
        if len(rows) > args.most:
            lines.append(f"and {len(rows) - args.most} more (--most, --json)")
    else:
        lines.append("the boards do not differ in any figure of cosim check")
    lines.append(f"wrote {page}")
    result = {
        "boards": [side.label for side in sides],
        "measures": [dict(side.run.measures) for side in sides],
        "changed": {name: values for name, values in rows},
        "page": str(page),
    }
    return result, "\n".join(lines)


COMMAND = Command("compare", "run two boards under one scene and show what differs", _arguments, _run)
