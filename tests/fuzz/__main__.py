"""``python -m tests.fuzz``: the fuzzers at length; exit code 1 for the first defect of each."""

import argparse
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene

from . import commands, mc_kills
from .targets import Project, exercise, readers

#: How the cases are shared out: what is quick and small needs fewer.
SHARES = {"scenes": 6, "netlists": 6, "settings": 6, "studies": 3, "results": 3}


def main() -> int:
    """Run what is asked for and print a row a fuzzer."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=20_000, help="inputs within this process")
    parser.add_argument("--commands", type=int, default=500, help="whole commands")
    parser.add_argument("--kills", type=int, default=50, help="kills at random instants")
    parser.add_argument("--mc-kills", type=int, default=50, help="kills of Monte Carlo studies")
    args = parser.parse_args()
    os.environ.setdefault("SOURCE_DATE_EPOCH", "0")  # else two runs differ in their dates
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's `&` leaves it ignored, here and below
    failed = 0
    with tempfile.TemporaryDirectory(prefix="cosim fuzz ") as name:
        folder = Path(name)
        result = folder / "result"
        scene = load_scene(Project(folder / "first").scenes[0], ["duration_s=0.05", "solver.model=linear"])
        run(resolve(scene), result)
        targets = readers(folder, result)
        parts = sum(SHARES.get(target.name, 1) for target in targets)
        for target in targets:
            count = args.cases * SHARES.get(target.name, 1) // parts
            if count:
                asked = lambda target=target, count=count: exercise(target, args.seed, count, folder / "home")  # noqa: E731
                failed += _row(target.name, count, asked)
        for title, count, task in (
            ("commands", args.commands, commands.exercise),
            ("kills", args.kills, commands.kill_and_resume),
            ("mc kills", args.mc_kills, mc_kills.kill_studies),
        ):
            if count:
                place = folder / title
                place.mkdir()
                os.chdir(place)
                project = Project(place / "project")
                given = (project, result, place) if title == "commands" else (project, place)
                failed += _row(title, count, lambda: task(*given, args.seed, count))  # noqa: B023
    return int(failed > 0)


def _row(name: str, count: int, task: Callable[[], object]) -> int:
    """Run one fuzzer; print what came out of it."""
    begun = time.monotonic()
    try:
        result: object = task()
    except Exception:
        result = "DEFECT\n" + traceback.format_exc(limit=-6)
    print(f"{name:10} {count:6} cases {time.monotonic() - begun:7.1f} s  {result}", flush=True)
    return int(str(result).startswith("DEFECT"))


if __name__ == "__main__":
    sys.exit(main())
