"""``cosim keys``: every key of a scene file, with unit, range, default and meaning."""

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command

if TYPE_CHECKING:
    from cosim.scene.keys import Key


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "section",
        nargs="?",
        default="",
        metavar="WORD",
        help="table of a scene (computer, device.chain), one key, or a word in names or meanings "
        "(default: all)",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.effects import EFFECTS
    from cosim.scene.keys import section

    used = {key: effect.name for effect in EFFECTS for key in effect.keys}
    keys = section(args.section)
    rows = [{**asdict(key), "effect": used.get(key.path)} for key in keys]
    return {"keys": rows}, "\n".join(_text(key, used.get(key.path)) for key in keys)


def _text(key: "Key", effect: str | None) -> str:
    unit = f" [{key.unit}]" if key.unit else ""
    allowed = f" ({key.allowed})" if key.allowed else ""
    default = key.default if key.default == "required" else f"default {key.default}"
    used = f"; used with effects.{effect}" if effect else ""
    return f"{key.path}{unit}: {key.kind}{allowed}, {default}\n    {key.meaning}{used}"


COMMAND = Command("keys", "list the keys of a scene: unit, range, default, meaning", _arguments, _run)
