"""``cosim warm``: compile ahead what the first command that simulates would compile."""

import argparse
import time
from typing import Any

from cosim.commands.command import Command
from cosim.commands.verbosity import remark

#: What each library holds, as a user knows it.
_HOLDS = {
    "mech": "mechanics",
    "cosim.loop": "computer and ledger",
    "cosim.loop.linear": "linear stepper",
    "cosim.loop.linear.exact_steps": "exact steps of a slider",
    "cosim.loop.spice": "simulation in step with ngspice",
}


def _arguments(parser: argparse.ArgumentParser) -> None:
    pass


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.commands.progress import COMPILING
    from mech.library_files import folder, is_built, ready

    started = time.perf_counter()
    if not is_built():
        remark(COMPILING)
    seconds: dict[str, float] = {}

    def show(package: str, seconds_since: float) -> None:
        seconds[_HOLDS[package]] = round(seconds_since, 3)
        remark(f"  {_HOLDS[package]}: {seconds_since:.1f} s")

    ready(show)
    text = f"ready after {time.perf_counter() - started:.1f} s; compiled code is kept in {folder()}"
    return {"folder": str(folder()), "seconds": seconds}, text


COMMAND = Command("warm", "compile ahead what the first run would compile", _arguments, _run)
