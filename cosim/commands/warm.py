"""``cosim warm``: compile ahead what the first commands would compile."""

import argparse
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from cosim.caution import collected
from cosim.commands.command import Command
from cosim.commands.verbosity import remark

#: What is compiled, and the settings of a short run that needs it.
_STEPS = {
    "mechanics, computer and exact propagation": ("solver.model=linear",),
    "simulation in step with ngspice": ("solver.model=spice",),
}


def _arguments(parser: argparse.ArgumentParser) -> None:
    pass


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.commands.progress import COMPILING
    from cosim.numba_cache import cache_folder, is_warm

    started = time.perf_counter()
    if not is_warm():
        remark(COMPILING)
    seconds: dict[str, float] = {}
    errors: list[BaseException] = []
    works = [
        # a daemon: after Ctrl-C nobody waits for it, and its process goes with this one
        threading.Thread(target=_compile, args=(what, settings, seconds, errors), daemon=True)
        for what, settings in _STEPS.items()
    ]
    for work in works:
        work.start()
    for work in works:
        work.join()
    if errors:
        raise errors[0]
    for settings in _STEPS.values():  # where both compiled the same at once, the list of one is lost
        _short_run(settings)
    text = f"ready after {time.perf_counter() - started:.1f} s; compiled code is kept in {cache_folder()}"
    return {"folder": cache_folder(), "seconds": seconds}, text


def _compile(
    what: str, settings: tuple[str, ...], seconds: dict[str, float], errors: list[BaseException]
) -> None:
    begun = time.perf_counter()
    try:
        _short_run(settings)
    except BaseException as error:  # the command's own thread raises it
        errors.append(error)
        return
    seconds[what] = round(time.perf_counter() - begun, 3)
    remark(f"  {what}: {seconds[what]:.1f} s")


def _short_run(settings: tuple[str, ...]) -> None:
    """Run a scene whose results are nobody's, and so are doubts about them.

    Our own loop runs in this process, too, before the child's: studies need it here, where no code that a
    child has compiled is loaded; and the child loads this.
    """
    from cosim.analysis.extracted import circuit_of
    from cosim.assets import scenes_folder
    from cosim.loop.linear.run_linear import prepare
    from cosim.plan import resolve
    from cosim.runner import run
    from cosim.scene import load_scene

    with collected(forward=False), tempfile.TemporaryDirectory(prefix="cosim-warm-") as folder:
        scene = load_scene(scenes_folder() / "slope.toml", ["duration_s=0.05", *settings])
        plan = resolve(scene)
        if plan.model == "linear":
            circuit, constants = circuit_of(plan, reduced=True)
            prepare(scene, constants, circuit, record=True).run()
        run(plan, Path(folder) / "run")


COMMAND = Command("warm", "compile ahead what the first run would compile", _arguments, _run)
