"""The command line: ``cosim COMMAND ...``.

Exit codes: 0 on success, 1 when a simulation failed, 2 for the user's mistake, 130 after Ctrl-C.
Nothing heavy is imported before a command runs, so that ``cosim --help`` answers at once.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from cosim import __version__
from cosim.errors import CosimError

EXIT_FAILURE = 1
EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class Command:
    """A subcommand.

    Attributes
    ----------
    name, help
        As shown by ``cosim --help``.
    arguments
        Adds the command's own arguments to its parser.
    run
        Does the work; returns what ``--json`` prints and the text for people.
    """

    name: str
    help: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], tuple[dict[str, Any], str]]


def _new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="folder to make; it must not hold anything yet")
    parser.add_argument(
        "--joints", type=int, default=2, metavar="N", help="joints of the board, 1 to 6 (default 2)"
    )


def _new(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.newproject import new_project

    files = [str(path) for path in new_project(args.folder, args.joints)]
    text = "\n".join(
        [f"{args.folder}: a project with {args.joints} joints", *(f"  {name}" for name in files)]
    )
    return {"folder": os.path.abspath(args.folder), "joints": args.joints, "files": files}, text


COMMANDS: tuple[Command, ...] = (
    Command("new", "lay out a project folder to edit: board, blocks, parts, scenes", _new_arguments, _new),
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all commands."""
    parser = argparse.ArgumentParser(
        prog="cosim",
        description="Circuit-level co-simulation of haptic devices: ngspice in lockstep with a linkage.",
    )
    parser.add_argument("--version", action="version", version=f"cosim {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        sub = commands.add_parser(command.name, help=command.help, description=command.help)
        command.arguments(sub)
        sub.add_argument("--json", action="store_true", help="print the result as JSON")
        sub.set_defaults(run=command.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    args = build_parser().parse_args(argv)
    try:
        result, text = args.run(args)
        print(json.dumps(result, indent=2, ensure_ascii=False) if args.json else text, flush=True)
    except CosimError as error:
        if args.json:
            print(json.dumps(error.as_dict(), indent=2, ensure_ascii=False), flush=True)
        else:
            print(f"cosim {args.command}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"cosim {args.command}: interrupted; finished results are whole", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader, for example `head`, went away; Python must not complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILURE
    return 0


if __name__ == "__main__":
    sys.exit(main())
