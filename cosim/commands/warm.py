"""``cosim warm``: compile and measure ahead what the first command that simulates would."""

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
#: Shipped scenes that use both boards; a project of `cosim new` has the same.
_SCENES = ("drop", "press", "slope")


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
    _measure()
    text = f"ready after {time.perf_counter() - started:.1f} s; compiled code is kept in {folder()}"
    return {"folder": str(folder()), "seconds": seconds}, text


def _measure() -> None:
    """Run shipped scenes once: what is measured of a board, its stability and its circuit, is kept."""
    from cosim.api.simulation import run
    from cosim.assets import scenes_folder
    from cosim.caution import collected
    from cosim.errors import CosimError
    from cosim.ngspice.child import Child
    from cosim.storage.staging import scratch_folder

    try:
        with collected(forward=False), scratch_folder("warm") as folder, Child() as child:
            for name in _SCENES:
                run(scenes_folder() / f"{name}.toml", folder / name, formats=(), child=child)
    except CosimError as reason:  # a run says it again, and more
        remark(f"the shipped boards are not measured ahead: {str(reason).splitlines()[0]}")


COMMAND = Command("warm", "compile and measure ahead what the first run would", _arguments, _run)
