"""Studies whose models are formulas of six resistors: closed forms for what is said of them."""

import math
import time
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from cosim.tolerance.distributions import Shape
from cosim.tolerance.engine import Processes
from cosim.tolerance.preparation import Asked, Prepared
from cosim.tolerance.random_variables import Component, Tolerances
from cosim.tolerance.scene_study import monte_carlo
from cosim.tolerance.spec import Spec
from cosim.tolerance.value_expression import Recipe, Term

D = 6
SLOPE = np.array([1.0, -2.0, 0.5, 0.25, 1.5, -0.75])
SLOPE /= np.linalg.norm(SLOPE)
LIMIT = 2.0


@dataclass(frozen=True)
class Formulas(Prepared):
    """A prepared scene whose models are formulas of six resistors."""

    dear_fails_at: float = math.inf
    shift: float = 0.0

    def digest(self) -> str:
        return f"formulas {self.dear_fails_at} {self.asked.n} {self.seed}"

    def batch(self, names, model):
        return Formula(model, self.dear_fails_at, self.shift)


class Formula:
    """Measures by a formula; a sample on `spice` takes its time."""

    def __init__(self, model, fails_at, shift):
        self.model, self.fails_at, self.shift = model, fails_at, shift
        self.failures = {}

    def measures(self, values):
        z = (values - 1.0) / SIGMA
        if self.model == "spice":
            time.sleep(2e-4 * len(values))
        y = z @ SLOPE + self.shift
        if self.model == "spice":
            y = np.where(z[:, 1] > self.fails_at, 9.0, y + 0.02 * (z[:, 0] ** 2 - 1.0))
        return y[:, None]


SIGMA = 0.01


def formulas(n, *, kind="gauss", limit=LIMIT, seed=1, shift=0.0, **asked):
    size = 3 * SIGMA
    recipes = [Recipe(1.0, terms=(Term(k, Shape(kind, -size, size)),)) for k in range(D)]
    parts = tuple(Component(f"r{k}", 1.0, "Ohm", "", recipe=recipe) for k, recipe in enumerate(recipes))
    tolerances = Tolerances(parts, tuple(f"r{k}" for k in range(D)))
    specs = (Spec("peak_force", high=limit),)
    plan = SimpleNamespace(model="spice", scene=None)
    return Formulas(
        Asked("", specs=specs, n=n, **asked), plan, tolerances, ("peak_force",), seed, shift=shift
    )


def measured(prepared, folder=None):
    """Return the study, in this process alone or kept in a folder."""
    return monte_carlo(prepared, None, Processes(folder, workers=1) if folder else None)
