"""``cosim new``: lay out a project to edit."""

import argparse
import os
from typing import Any

from cosim.commands.command import Command


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="folder to make; it must not hold anything yet")
    parser.add_argument(
        "--joints", type=int, default=2, metavar="N", help="joints of the board, 1 to 6 (default 2)"
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.newproject import new_project

    files = [str(path) for path in new_project(args.folder, args.joints)]
    joints = f"{args.joints} joint{'s' if args.joints > 1 else ''}"
    text = "\n".join([f"{args.folder}: a project with {joints}", *(f"  {name}" for name in files)])
    return {"folder": os.path.abspath(args.folder), "joints": args.joints, "files": files}, text


COMMAND = Command("new", "lay out a project folder to edit: board, blocks, parts, scenes", _arguments, _run)
