"""Subcommands, and the arguments that several of them share."""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cosim.caution import MOST_ALIKE, Caution, grouped
from cosim.commands.verbosity import verbose

if TYPE_CHECKING:
    from cosim.scene import Scene
    from cosim.variants import Variant


def _success(args: argparse.Namespace, result: dict[str, Any]) -> int:
    return 0


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
        Does the work; returns the data that ``--json`` prints and the text for people.
    exit_code
        Returns the exit code for the arguments and that result; 0 by default.
    """

    name: str
    help: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], tuple[dict[str, Any], str]]
    exit_code: Callable[[argparse.Namespace, dict[str, Any]], int] = _success


def scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that every command with a scene takes."""
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
    parser.add_argument(
        "--allow-unstable", action="store_true", help="run a circuit that is unstable as it is, to look at it"
    )
    trust_arguments(parser)


def trust_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the permissions that a user grants to netlists."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="let the netlists hold commands and name files; the sandbox stays (SECURITY.md)",
    )
    parser.add_argument(
        "--include",
        action="append",
        default=[],
        metavar="DIR",
        help="let netlists include files of this folder outside the project; repeatable",
    )


def measure_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--measure``; `what` says what it does there."""
    parser.add_argument(
        "--measure",
        action="append",
        default=[],
        metavar="NAME",
        help=f"{what}; repeatable; nothing is simulated where no measure needs it",
    )


def tolerance_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--tol``; `what` says what it does there."""
    parser.add_argument(
        "--tol",
        action="append",
        default=[],
        metavar="SHARE or NAME=AMOUNT",
        help=f"{what}: 1e-3 for all, or rendered_stiffness=0.1%%; repeatable",
    )


def out_argument(parser: argparse.ArgumentParser) -> None:
    """Add the folder for results."""
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for the results; appears whole or not at all"
    )


def load_variants(args: argparse.Namespace) -> "list[tuple[Variant, Scene]]":
    """Load the scene once for every combination of ``--set``: all are checked before the first runs."""
    from cosim.scene import load_scene
    from cosim.variants import parse_settings, variants

    forced = [f"solver.model={args.model}"] if args.model else []
    if getattr(args, "measure", None):
        forced.append(f"measures.names={json.dumps(list(dict.fromkeys(args.measure)))}")
    if args.allow_unstable:
        forced.append("solver.allow_unstable=true")
    return [
        (variant, load_scene(args.scene, [*forced, *variant.overrides]))
        for variant in variants(parse_settings(args.set))
    ]


def caution_lines(cautions: Sequence[Caution]) -> list[str]:
    """Return cautions as lines for people, those of one kind together."""
    lines = []
    for caution, more in grouped(cautions, most=None if verbose() else MOST_ALIKE):
        lines += [f"warning: {caution} [{caution.code}]" for caution in caution]
        if more:
            lines.append(f"warning: and {more} more [{caution[0].code}] (all with --verbose or --json)")
    return lines


def about(variant: "Variant", every: "Sequence[object]") -> str:
    """Return the prefix of a caution about one of several variants; empty where there is only one."""
    return variant.label if len(every) > 1 else ""
