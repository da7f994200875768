"""``cosim verify``: repeat a result from its folder, and compare bit for bit."""

import argparse
from typing import Any

from cosim.commands.command import Command, trust_arguments

#: Differences that are printed; --json has all.
_MOST = 12


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="result of `cosim run` or `cosim mc`")
    parser.add_argument(
        "-n", "--samples", type=int, default=8, metavar="N",
        help="of a study: samples to repeat (default: 8)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="chooses the samples (default: 0)")
    trust_arguments(parser)


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.api.verification import verify
    from cosim.commands.progress import progress
    from cosim.errors import fail

    if args.seed < 0:
        fail("chooses samples", key="--seed", value=args.seed, allowed=">= 0")
    with progress("verify") as show:
        verdict = verify(
            args.folder, samples=args.samples, seed=args.seed, trust=args.trust, on_progress=show
        )
    result = {
        "what": verdict.what,
        "repeated": list(verdict.repeated),
        "different": list(verdict.different),
        "same": not verdict.different,
    }
    if not verdict.different:
        return result, f"{verdict.what} repeated: the same, bit for bit"
    shown = list(verdict.different[:_MOST])
    if len(verdict.different) > len(shown):
        shown.append(f"and {len(verdict.different) - len(shown)} more (--json)")
    return result, "\n".join([f"{verdict.what} repeated: not the same", *(f"  {line}" for line in shown)])


def _exit_code(args: argparse.Namespace, result: dict[str, Any]) -> int:
    return int(not result["same"])


COMMAND = Command(
    "verify",
    "repeat a run, or some samples of a study, and compare bit for bit",
    _arguments,
    _run,
    _exit_code,
)
