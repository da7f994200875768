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
from typing import TYPE_CHECKING, Any, TextIO

from cosim import __version__
from cosim.errors import CosimError

if TYPE_CHECKING:
    from cosim.scene import Scene
    from cosim.settings import Variant

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


def scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that reads a scene."""
    parser.add_argument("scene", help="scene file (TOML)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=V1,V2,...",
        help="try values of a scene key (computer.period_s) or a netlist name (R12, xdiff1.r1); repeatable",
    )
    parser.add_argument(
        "--model", metavar="NAME", help="circuit model to force instead of the effects' choice"
    )


def out_argument(parser: argparse.ArgumentParser) -> None:
    """Add the folder for results."""
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for the results; appears whole or not at all"
    )


def load_variants(args: argparse.Namespace) -> "list[tuple[Variant, Scene]]":
    """Load the scene once for every combination of ``--set``: all are checked before the first runs."""
    from cosim.scene import load_scene
    from cosim.settings import parse_settings, variants

    forced = [f"solver.model={args.model}"] if args.model else []
    return [
        (variant, load_scene(args.scene, [*forced, *variant.overrides]))
        for variant in variants(parse_settings(args.set))
    ]


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
    code, text, stream = _outcome(args)
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:
        # The reader, for example `head`, went away; Python must not complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return code or EXIT_FAILURE
    return code


def _outcome(args: argparse.Namespace) -> tuple[int, str, TextIO]:
    """Run the command; return exit code, what to print and where."""
    try:
        result, text = args.run(args)
    except CosimError as error:
        if args.json:
            return error.exit_code, _json(error.as_dict()), sys.stdout
        return error.exit_code, f"cosim {args.command}: {error}", sys.stderr
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED, f"cosim {args.command}: interrupted; finished results are whole", sys.stderr
    return 0, _json(result) if args.json else text, sys.stdout


def _json(value: dict[str, Any]) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)


if __name__ == "__main__":
    sys.exit(main())
