"""A long study of 36 components by a formula, with its page: ``python million_samples.py FOLDER N``.

Prints the largest resident memory [MB] of this process, and the seconds of samples and of the rest.
"""

import resource
import sys
import time
from pathlib import Path

import formula_studies
import numpy as np

from cosim.tolerance.engine import Processes
from cosim.tolerance.scene_study import monte_carlo
from reports.monte_carlo import write_monte_carlo

COMPONENTS = 36
SIZES = 0.9 ** np.arange(COMPONENTS)


class Formula:
    """One measure by a formula with a bend, and a device in ten thousand that has none."""

    def __init__(self):
        self.failures = {}

    def measures(self, values):
        z = (values - 1.0) / formula_studies.SIGMA
        y = z @ SIZES + 0.1 * z[:, 0] ** 2
        y[np.abs(z[:, 5]) > 3.89] = np.nan
        return y[:, None]


class Formulas(formula_studies.Formulas):
    def batch(self, names, model):
        return Formula()


def main():
    folder, n = Path(sys.argv[1]), int(sys.argv[2])
    formula_studies.D = COMPONENTS
    study = formula_studies.formulas(n, limit=4.0)
    prepared = Formulas(study.asked, study.plan, study.tolerances, study.names, study.seed)
    begun = time.monotonic()
    result = monte_carlo(prepared, None, Processes(folder, workers=1))
    drawn = time.monotonic()
    write_monte_carlo(result, folder, "cosim mc --sample", "x")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(
        f"{peak:.0f} MB, samples and estimates {drawn - begun:.1f} s, page {time.monotonic() - drawn:.1f} s"
    )


if __name__ == "__main__":
    main()
