"""``cosim check``: what a board does, measured in ngspice in a few seconds."""

import argparse
from typing import TYPE_CHECKING, Any

from cosim.caution import collected
from cosim.commands.command import Command, trust_arguments

if TYPE_CHECKING:
    from cosim.checking.check_target import Subject

_LEVELS = ("ideal", "gbw", "full")
_DRIVERS = ("voltage", "current")


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("target", metavar="SCENE|BOARD", help="scene (.toml) or board netlist (.cir)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=V1,V2,...",
        help="try values of a netlist name (R12, xdiff1.r1), with a scene also of its keys; repeatable",
    )
    parser.add_argument(
        "--level",
        choices=_LEVELS,
        help="level of all parts (default: the scene's effects; for a board: full)",
    )
    parser.add_argument(
        "--driver", choices=_DRIVERS, help="kind of drive (default: the scene's; for a board: voltage)"
    )
    trust_arguments(parser)


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.checking.measured") as child:  # it imports while the netlists are read
        from cosim.api.queries import check
        from cosim.checking.check_target import load_subject
        from cosim.checking.printout import describe
        from cosim.variants import parse_settings, variants

        subjects = [
            load_subject(args.target, variant, args.level, args.driver, trust=args.trust)
            for variant in variants(parse_settings(args.set))
        ]
        checks = []
        for subject in subjects:
            with collected(subject.label):
                checks.append(check(subject, child=child))
    varies = [_varies(subject, args.trust) for subject in subjects]
    texts = []
    for done, (_, lines) in zip(checks, varies, strict=True):
        sections, _, counts = describe(done).rpartition("\n")
        label = [done.subject.label] if done.subject.label else []
        texts.append("\n".join([*label, sections, lines, counts]))
    text = "\n\n".join(texts)
    records = [done.as_dict() | rows for done, (rows, _) in zip(checks, varies, strict=True)]
    return {"checks": records}, text


def _varies(subject: "Subject", trust: bool) -> tuple[dict[str, Any], str]:
    """Return what varies of a built device, or what is wrong with its tolerances."""
    from cosim.errors import InputError
    from cosim.tolerance.listing import CONVENTION, component_rows, table
    from cosim.tolerance.scene_variables import tolerances

    try:
        varied = tolerances(subject.scene, board=subject.board, trust=trust)
    except InputError as error:
        wrong = [problem.as_dict() for problem in error.problems]
        lines = [f"  problem: {problem}" for problem in error.problems]
        return {"tolerances": [], "tolerance_problems": wrong}, "\n".join(["tolerances", *lines])
    rows = {"tolerances": component_rows(varied), "tolerance_problems": []}
    if not varied.components:
        return rows, "tolerances\n  none stated"
    return rows, "\n".join(["tolerances", *(f"  {line}" for line in (*table(varied), CONVENTION))])


def _exit_code(args: argparse.Namespace, result: dict[str, Any]) -> int:
    if any(done["stability"]["refused"] or done["tolerance_problems"] for done in result["checks"]):
        return 2  # also without --strict: such a board does not run, such parts do not exist
    return 2 if args.strict and any(done["problems"] for done in result["checks"]) else 0


COMMAND = Command(
    "check", "ports, constants, headroom, margins, delays and noise of a board", _arguments, _run, _exit_code
)
