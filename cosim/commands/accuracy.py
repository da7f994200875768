"""``cosim accuracy``: what each digit of a scene's results costs, with resume."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, measure_argument, trust_arguments

if TYPE_CHECKING:
    from cosim.accuracy.work_precision import Accuracy

#: A median of more seconds is no better, and takes days.
_MOST_REPEATS = 100
_MODELS = ("ideal", "linear", "spice")


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="scene file (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change a value; repeatable"
    )
    measure_argument(parser, "measure whose error counts, besides position and force")
    parser.add_argument(
        "--tol",
        type=float,
        default=1e-3,
        metavar="SHARE",
        help="what the recommendation meets (default 1e-3)",
    )
    parser.add_argument(
        "--model",
        action="append",
        default=[],
        choices=_MODELS,
        help="models to try (default: all); repeatable",
    )
    parser.add_argument(
        "--repeat", type=int, default=3, metavar="N", help="times of each setting (default 3)"
    )
    parser.add_argument("--no-peer", action="store_true", help="leave the peer, one deck in ngspice, out")
    trust_arguments(parser)
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER",
        help="folder for points, table and page (default: out/accuracy); finished points in it are kept",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.loop.early_imports", reads=[Path(args.scene).parent]) as child:
        from cosim.accuracy.work_precision import accuracy
        from cosim.commands.progress import progress
        from cosim.comparisons.measure_values import check_measures
        from cosim.errors import fail
        from cosim.storage.owned_files import refuse_foreign
        from cosim.variants import parse_settings
        from reports.accuracy import FILES, MANIFEST, words, write_accuracy

        check_measures(args.measure)
        if not 0.0 < args.tol <= 1.0:
            fail("is not a share", key="--tol", value=args.tol, allowed="above 0, at most 1")
        if not 1 <= args.repeat <= _MOST_REPEATS:
            fail(
                "is not a possible number of runs",
                key="--repeat",
                value=args.repeat,
                allowed=f"1 to {_MOST_REPEATS}",
            )
        fixed = parse_settings(args.set)
        if any(len(setting.values) > 1 for setting in fixed):
            fail("a study is of one scene: give each name one value", key="--set", value=args.set)
        out = Path(args.out) if args.out else Path("out/accuracy")
        refuse_foreign(out, FILES, MANIFEST)  # refuse before anything is run
        with progress("accuracy") as show:
            study = accuracy(
                args.scene, out,
                overrides=tuple(setting.override(setting.values[0]) for setting in fixed),
                measures=list(dict.fromkeys(args.measure)),
                models=[name for name in _MODELS if name in args.model] or _MODELS,
                tolerance=args.tol, repeats=args.repeat, peer=not args.no_peer, trust=args.trust,
                child=child, on_progress=show,
            )  # fmt: skip
    page = write_accuracy(study, out)
    return study.as_dict() | {"page": str(page)}, "\n".join(
        [*_table(study), "", *words(study), f"wrote {page}"]
    )


def _table(study: "Accuracy") -> list[str]:
    """Return the front, the cheapest setting first, and the scene's present settings."""
    from cosim.units import quantity

    shown = sorted(
        (row for row in study.rows if row.front or row.setting.series == "as the scene states it"),
        key=lambda row: row.seconds,
    )
    rows = [["", "setting", "wall", "cpu", *study.quantities]]
    for row in shown:
        if row.failed:
            continue
        cpu = sorted(row.cpu_s)[len(row.cpu_s) // 2]
        errors = (row.errors.get(name, math.nan) for name in study.quantities)
        cells = ["-" if math.isnan(e) else f"{e:.1e}" for e in errors]
        mark = "*" if row.front else ""
        rows.append([mark, row.setting.label, quantity(row.seconds, "s"), quantity(cpu, "s"), *cells])
    rows.append(["", "floor: the references disagree by", "", "",
                 *(f"{study.floor.get(name, math.nan):.1e}" for name in study.quantities)])  # fmt: skip
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(r, widths, strict=True)))
        for r in rows
    ]


COMMAND = Command(
    "accuracy", "show what each digit of a scene costs, and recommend a setting", _arguments, _run
)
