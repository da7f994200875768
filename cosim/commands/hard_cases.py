"""``cosim hard-cases``: scenes whose answer theory knows, on every circuit model."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command

if TYPE_CHECKING:
    from cosim.accuracy.hard_cases.hard_case import Outcome


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="beginning of a case's name, or its number (default: all)"
    )
    parser.add_argument("--slow", action="store_true", help="also those that take minutes")
    parser.add_argument("-o", "--out", metavar="FOLDER", help="folder for a page with the table")


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.accuracy.hard_cases.case_table import chosen, run_cases
    from cosim.commands.progress import progress

    cases = chosen(args.names, slow=args.slow)
    if args.out:
        from cosim.storage.owned_files import refuse_foreign
        from reports.hard_cases import FILES, MANIFEST, write_hard_cases

        refuse_foreign(Path(args.out), FILES, MANIFEST)  # refuse before the first case
    with progress("hard cases") as show:
        outcomes = list(run_cases(cases, show))
    lines = _table(outcomes)
    if args.out:
        lines.append(f"wrote {write_hard_cases(outcomes, Path(args.out))}")
    return {"cases": [_as_dict(each) for each in outcomes]}, "\n".join(lines)


def _as_dict(outcome: "Outcome") -> dict[str, Any]:
    case = outcome.case
    return {
        "case": case.name,
        "row": case.row,
        "model": outcome.model,
        "what": case.what,
        "expected": case.expected,
        "got": outcome.got if outcome.number else None,
        "bound": case.bound[outcome.model],
        "reason": case.reason,
        "broken": case.broken,
        "held": outcome.held,
        "failed": outcome.failed,
        "seconds": outcome.seconds,
    }


def _table(outcomes: "list[Outcome]") -> list[str]:
    rows = [["", "#", "case", "model", "expected", "got", "bound", "time"]]
    for each in outcomes:
        case = each.case
        rows.append(
            [
                "" if each.held else "MISS", str(case.row), case.name, each.model,
                each.written(case.expected), "-" if each.got is None else each.written(each.got),
                f"{case.bound[each.model]:.2g}", f"{each.seconds:.2g} s",
            ]
        )  # fmt: skip
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(c.rjust(w) if k in (1, 4, 5, 6, 7) else c.ljust(w)
                  for k, (c, w) in enumerate(zip(row, widths, strict=True))).rstrip()
        for row in rows
    ]  # fmt: skip
    lines += [f"failed: {each.case.name}, {each.model}: {each.failed}" for each in outcomes if each.failed]
    missed = sum(not each.held for each in outcomes)
    return [*lines, f"{len(outcomes) - missed} of {len(outcomes)} hold"]


def _exit_code(args: argparse.Namespace, result: dict[str, Any]) -> int:
    return int(not all(case["held"] for case in result["cases"]))


COMMAND = Command(
    "hard-cases", "run scenes whose answer theory knows, on every circuit model", _arguments, _run, _exit_code
)
