"""Jobs for the tests of the engine: numbers by a formula, and samples that end their process."""

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.tolerance.engine import Job, run

NAMES = ("first", "second")


@dataclass(frozen=True)
class Formula:
    """Makes what measures: two numbers of each sample, which notes in `log` what it did."""

    log: str
    deadly: tuple[int, ...] = ()
    failing: tuple[int, ...] = ()
    slow_s: float = 0.0

    def __call__(self):
        return self.measured

    def measured(self, first, count):
        table = np.empty((count, 2))
        for k in range(count):
            if first + k in self.deadly:
                os.kill(os.getpid(), signal.SIGKILL)
            table[k] = np.random.Generator(np.random.Philox(key=7).advance(first + k)).random(2)
            time.sleep(self.slow_s)
        with open(self.log, "a", encoding="utf-8") as log:
            log.write(f"{first} {count}\n")
        failed = {
            k - first: dict.fromkeys(NAMES, "no circuit") for k in self.failing if first <= k < first + count
        }
        table[list(failed)] = np.nan
        return table, failed


def job(folder, n, **more):
    Path(folder).mkdir(parents=True, exist_ok=True)
    return Job(f"study of {n}", NAMES, n, Formula(str(Path(folder) / "log"), **more))


def main():
    """Run a job that is to be interrupted: folder, samples, slowness, workers."""
    folder, n, slow_s, workers = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    run(job(folder, n, slow_s=slow_s), Path(folder) / "mc", workers=workers, chunk=5)


if __name__ == "__main__":
    main()
