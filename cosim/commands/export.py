"""``cosim export``: the scene as one deck for plain ngspice."""

import argparse
from typing import Any

from cosim.commands.command import Command, load_variants, scene_arguments


def _arguments(parser: argparse.ArgumentParser) -> None:
    scene_arguments(parser)
    parser.add_argument("-o", "--out", dest="file", metavar="FILE", required=True, help="deck to write")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--monolithic",
        dest="kind",
        action="store_const",
        const="monolithic",
        default="monolithic",
        help="linkage and hand as B-sources, the computer's outputs as recorded steps (default)",
    )
    kind.add_argument(
        "--replay",
        dest="kind",
        action="store_const",
        const="replay",
        help="every source recorded, no mechanics",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.errors import fail
    from cosim.export import command, export
    from cosim.plan import resolve
    from cosim.runner import run
    from cosim.storage.owned_files import own_file
    from cosim.storage.staging import scratch_folder

    every = load_variants(args)
    if len(every) > 1:
        fail("one deck holds one scene: give each name one value", key="--set", value=args.set)
    own_file(args.file)  # before the scene runs
    plan = resolve(every[0][1], trust=args.trust)
    with scratch_folder("export") as folder:
        # run the scene once: the deck needs the computer's outputs
        result = run(plan, folder / "run", formats=())
        deck = export(plan, result, args.file, kind=args.kind)
    return {
        "deck": str(deck),
        "kind": args.kind,
        "command": command(deck),
    }, f"wrote {deck} ({args.kind}); run it with: {command(deck)}"


COMMAND = Command("export", "write the scene as one deck for plain ngspice", _arguments, _run)
