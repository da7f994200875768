"""``cosim check``: what a board does, asked of ngspice in a few seconds."""

import argparse
from typing import Any

from cosim.caution import collected
from cosim.commands.command import Command, trust_arguments

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
        from cosim.api.asking import check
        from cosim.checking.printout import describe
        from cosim.checking.subject import load_subject
        from cosim.variants import parse_settings, variants

        subjects = [
            load_subject(args.target, variant, args.level, args.driver, trust=args.trust)
            for variant in variants(parse_settings(args.set))
        ]
        checks = []
        for subject in subjects:
            with collected(subject.label):
                checks.append(check(subject, child=child))
    text = "\n\n".join(
        (f"{done.subject.label}\n" if done.subject.label else "") + describe(done) for done in checks
    )
    return {"checks": [done.as_dict() for done in checks]}, text


def _exit_code(args: argparse.Namespace, result: dict[str, Any]) -> int:
    if any(done["stability"]["refused"] for done in result["checks"]):
        return 2  # nobody needs to ask for that: such a board does not run
    return 2 if args.strict and any(done["problems"] for done in result["checks"]) else 0


COMMAND = Command(
    "check", "ports, constants, headroom, margins, delays and noise of a board", _arguments, _run, _exit_code
)
