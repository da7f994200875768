"""`python -m benchmarks [NAME ...]`: measure, print a table, compare with the committed figures."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.figure import Figure

HERE = Path(__file__).resolve().parent
COMMITTED = HERE / "latest.json"
REPETITIONS = 15


def main() -> int:
    """Measure the figures asked for; exit code 1 when one misses its target or became worse."""
    from benchmarks.anatomy import anatomy
    from benchmarks.figure import TARGETS
    from benchmarks.regression import committed, worse
    from benchmarks.suite import SUITE
    from benchmarks.table import show

    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Peers side by side.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join([*TARGETS, 'anatomy'])}")
    parser.add_argument("--repetitions", type=int, default=REPETITIONS, help="of each timed pair")
    parser.add_argument(
        "--out", type=Path, default=Path("out/bench.json"), help="file for the figures (default %(default)s)"
    )
    parser.add_argument(
        "--commit",
        action="store_true",
        help=f"write them to {COMMITTED.name}, what later ones are held against",
    )
    args = parser.parse_args()
    unknown = [name for name in args.names if name not in TARGETS and name != "anatomy"]
    if unknown:
        parser.error(f"no such benchmark: {', '.join(unknown)}")
    if args.repetitions < 1:
        parser.error("at least one repetition is needed")
    figures: list[Figure] = []
    for names, measure in SUITE.items():
        if not args.names or set(names) & set(args.names):
            for each in measure(args.repetitions):
                figures.append(each)
                print(show(each), flush=True)
    slower = worse(figures, committed(COMMITTED))
    if figures:
        out = COMMITTED if args.commit else args.out
        out.parent.mkdir(parents=True, exist_ok=True)
        write(out, figures)
    for line in slower:
        print(f"WORSE than committed: {line}")
    if not args.names or "anatomy" in args.names:
        print(anatomy(), flush=True)
    accepted = args.commit or not slower
    return 0 if accepted and all(each.met for each in figures) else 1


def write(path: Path, figures: list[Figure]) -> None:
    """Write the figures in place of those of the same name; others in the file stay."""
    fresh = {each.name: each.as_dict() for each in figures}
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    rows = [row for row in kept if row["name"] not in fresh] + list(fresh.values())
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
