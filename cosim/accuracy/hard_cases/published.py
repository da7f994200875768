"""A deck with a published solution: its error there, and whether a twin's bound holds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.accuracy.estimate import OWN_MARGIN
from cosim.accuracy.hard_cases.hard_case import CaseRunner
from cosim.types import Array

__all__ = ["Published"]


@dataclass(frozen=True)
class Published:
    """A deck of the test set for initial value problem solvers, and the set's solution at its end.

    Attributes
    ----------
    deck : in plain ngspice, with its tolerances, without an analysis
    end_s : where the solution is known [s]
    names : vectors that are compared
    exact : their values there, in the vectors' units
    keep_from_s : rows before are not kept [s]
    uic : whether the start is that of the elements (``ic=``), without an operating point
    """

    deck: str
    end_s: float
    names: tuple[str, ...]
    exact: tuple[float, ...]
    keep_from_s: float = 0.0
    uic: bool = False

    def error(self, runner: CaseRunner, step_s: float) -> float:
        """Return the error with a longest step [s], in the set's mixed norm."""
        return self._size(self._at_end(runner, step_s) - self.exact)

    def error_over_bound(self, runner: CaseRunner, step_s: float) -> float:
        """Return the error over the bound by a twin of half the step, as a run of `spice` alone has it."""
        coarse, fine = (self._at_end(runner, step) for step in (step_s, step_s / 2.0))
        return self._size(coarse - self.exact) / (OWN_MARGIN * self._size(coarse - fine))

    def _at_end(self, runner: CaseRunner, step_s: float) -> Array:
        command = f"tran {step_s!r} {self.end_s!r} {self.keep_from_s!r} {step_s!r}{' uic' * self.uic}"
        return np.array([np.real(each[-1]) for each in runner.deck(self.deck, command, *self.names)])

    def _size(self, off: Array) -> float:
        """Return |off| / (1 + |value|), the largest."""
        return float((np.abs(off) / (1.0 + np.abs(self.exact))).max())
