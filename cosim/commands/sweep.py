"""``cosim sweep``: measures of a scene over ranges of its values, with resume."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, tolerance_argument, trust_arguments
from cosim.commands.distributions import arguments, by_distributions

if TYPE_CHECKING:
    from cosim.comparisons.sweep import Sweep


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="scene file (TOML)")
    parser.add_argument(
        "ranges",
        nargs="+",
        metavar="NAME=RANGE",
        help="scene key or netlist name, with FROM:TO:COUNT, FROM:TO:COUNT:log or V1,V2,...; several: a grid",
    )
    parser.add_argument(
        "--measure", action="append", default=[], metavar="NAME", help="measure of the table; repeatable"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change a value for all; repeatable"
    )
    tolerance_argument(parser, "choose each point's solver settings so that measures are this right")
    arguments(parser)
    trust_arguments(parser)
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER",
        help="folder for points, table and picture (default: out/sweep); finished points in it are kept",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.loop.early_imports", reads=[Path(args.scene).parent]) as child:
        from cosim.api.simulation import sweep
        from cosim.commands.progress import progress
        from cosim.comparisons.sweep import TABLE, parse_range
        from cosim.errors import fail
        from cosim.scene import load_scene
        from cosim.storage.owned_files import refuse_foreign
        from cosim.variants import parse_settings, variants
        from reports.sweep import FILES, MANIFEST, write_sweep

        fixed = parse_settings(args.set, several=False)
        if any(len(setting.values) > 1 for setting in fixed):
            fail("is for all points: give the values to sweep as NAME=RANGE", key="--set", value=args.set)
        overrides = tuple(setting.override(setting.values[0]) for setting in fixed)
        settings = [parse_range(text) for text in args.ranges]
        doubled = {s.name for s in settings if sum(s.name == other.name for other in settings) > 1}
        if doubled:
            fail("is swept twice", key="range", value=", ".join(sorted(doubled)))
        if args.spec and args.mc is None:
            fail("is of devices that vary: give their number with --mc", key="--spec", value=args.spec[0])
        if args.mc is not None:
            if args.tol:
                fail("chooses settings of single runs: it has no meaning beside --mc", key="--tol",
                     value=" ".join(args.tol))  # fmt: skip
            designs = [(each.label, (*overrides, *each.overrides)) for each in variants(settings)]
            where = Path(args.out) if args.out else Path("out/sweep-mc")
            return by_distributions(args, args.scene, designs, where)
        out = Path(args.out) if args.out else Path("out/sweep")
        refuse_foreign(out, FILES, MANIFEST)
        measures = list(dict.fromkeys(args.measure)) or ["peak_force", "max_penetration"]
        with progress("sweep") as show:
            swept = sweep(
                load_scene(args.scene, overrides), settings, measures, out,
                tolerances=args.tol, child=child, trust=args.trust, on_progress=show,
            )  # fmt: skip
    picture = write_sweep(swept, out)
    result = {
        "names": list(swept.names),
        "values": [list(row) for row in swept.values],
        "measures": {name: list(column) for name, column in swept.measures.items()},
        **({"errors": {name: list(column) for name, column in swept.errors.items()}} if swept.errors else {}),
        "failed": swept.failed,
        "table": str(out / TABLE),
        "picture": str(picture) if picture else None,
    }
    return result, _text(swept, out / TABLE, picture)


def _text(result: "Sweep", table: Path, picture: Path | None) -> str:
    from cosim.catalogue import UNITS
    from cosim.units import measured, quantity

    def cell(name: str, number: int) -> str:
        value, unit = result.measures[name][number], UNITS.get(name, "")
        error = result.errors[name][number] if name in result.errors else None
        if value is None:
            return "-"
        return measured(value, error, unit) if error else quantity(value, unit, 5)

    rows = [[*result.names, *result.measures]]
    for number, values in enumerate(result.values):
        rows.append([*values, *(cell(name, number) for name in result.measures)])
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]
    lines += [f"failed: {label}: {reason}" for label, reason in result.failed.items()]
    return "\n".join([*lines, f"wrote {table}" + (f" and {picture}" if picture else "")])


def _exit_code(args: argparse.Namespace, result: dict[str, Any]) -> int:
    return int(bool(result.get("failed")))


COMMAND = Command(
    "sweep",
    "measures of a scene over ranges of its values; goes on where it was stopped",
    _arguments,
    _run,
    _exit_code,
)
