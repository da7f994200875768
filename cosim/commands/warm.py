"""``cosim warm``: compile ahead what the first commands would compile."""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cosim.caution import collected
from cosim.commands.command import Command

#: What is compiled, and the settings of a short run that needs it.
_STEPS = {
    "mechanics, computer and exact propagation": ("solver.model=linear",),
    "simulation in step with ngspice": ("solver.model=spice",),
}


def _arguments(parser: argparse.ArgumentParser) -> None:
    pass


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.assets import scenes_folder
    from cosim.commands.progress import COMPILING
    from cosim.numba_cache import cache_folder, is_warm
    from cosim.plan import resolve
    from cosim.runner import run
    from cosim.scene import load_scene

    started = time.perf_counter()
    if not is_warm():
        print(COMPILING, file=sys.stderr, flush=True)
    seconds = {}
    for number, (what, settings) in enumerate(_STEPS.items(), 1):
        print(f"  {number}/{len(_STEPS)} {what}", end=" ", file=sys.stderr, flush=True)
        begun = time.perf_counter()
        # its results are nobody's, and so are doubts about them
        with collected(forward=False), tempfile.TemporaryDirectory(prefix="cosim-warm-") as folder:
            scene = load_scene(scenes_folder() / "slope.toml", ["duration_s=0.05", *settings])
            run(resolve(scene), Path(folder) / "run")
        seconds[what] = round(time.perf_counter() - begun, 3)
        print(f"{seconds[what]:.1f} s", file=sys.stderr, flush=True)
    text = f"ready after {time.perf_counter() - started:.1f} s; compiled code is kept in {cache_folder()}"
    return {"folder": cache_folder(), "seconds": seconds}, text


COMMAND = Command("warm", "compile ahead what the first run would compile", _arguments, _run)
