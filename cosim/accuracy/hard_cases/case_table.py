"""The table of hard cases, and how it is run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from cosim.accuracy.hard_cases import (
    circuit_cases,
    coupled_motion,
    event_cases,
    exchange_cases,
    limit_cycles,
    logic_gates,
    loop_cases,
    mechanical,
    public_problems,
    sampled,
)
from cosim.accuracy.hard_cases.hard_case import CaseRunner, HardCase, Outcome
from cosim.analysis.covariance_steps import white_covariance
from cosim.errors import fail, nearest

__all__ = ["CASES", "chosen", "run_cases"]


def _stiff_covariance(runner: CaseRunner, model: str) -> float:
    """Error of the covariance of white noise behind two poles, the faster of T times 1e7."""
    fast, slow, period = 1e9, 10.0, 0.01
    covariance = white_covariance(np.diag([-fast, -slow]), np.ones((2, 1)), np.eye(1), period)
    rates = np.array([[2 * fast, fast + slow], [fast + slow, 2 * slow]])
    exact = -np.expm1(-rates * period) / rates
    if not (np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance).min() >= 0.0):
        return math.nan
    return float(np.abs(covariance / exact - 1.0).max())


#: Every case; the model of those that need no scene is the one whose mathematics they test.
CASES: tuple[HardCase, ...] = tuple(
    sorted(
        (
            HardCase("stiff noise covariance", 5, "largest error, relative", 0.0, {"linear": 1e-9},
                     "Gauss-Legendre of 8 points over a quarter of the fastest time constant: rounding",
                     _stiff_covariance, broken="two points of Gauss-Legendre: 1.8e-6"),
            *mechanical.CASES,
            *sampled.CASES,
            *coupled_motion.CASES,
            *public_problems.CASES,
            *logic_gates.CASES,
            *circuit_cases.CASES,
            *event_cases.CASES,
            *loop_cases.CASES,
            *exchange_cases.CASES,
            *limit_cycles.CASES,
        ),
        key=lambda case: case.row,
    )
)  # fmt: skip


def chosen(names: Iterable[str], *, slow: bool) -> list[HardCase]:
    """Return the cases whose name begins so, or that have this number; all where nothing is asked for.

    Raises
    ------
    InputError
        For a name that no case has.
    """
    asked = list(names)
    for name in asked:
        if not any(_is(case, name) for case in CASES):
            near = nearest(name, [case.name for case in CASES])
            fail(
                "there is no such case" + (f"; nearest is {near}" if near else ""), key="NAME", value=name,
                allowed=f"the beginning of a name, or a number from {CASES[0].row} to {CASES[-1].row}",
            )  # fmt: skip
    picked = [case for case in CASES if not asked or any(_is(case, name) for name in asked)]
    return [case for case in picked if slow or not case.slow or asked]


def _is(case: HardCase, name: str) -> bool:
    return bool(name) and (str(case.row) == name if name.isdigit() else case.name.startswith(name))


def run_cases(
    cases: Iterable[HardCase],
    on_progress: Callable[[int, int, str], None] | None = None,
) -> Iterator[Outcome]:
    """Run cases on every model that they apply to, one after the other."""
    every = [(case, model) for case in cases for model in case.bound]
    with CaseRunner() as runner:
        for done, (case, model) in enumerate(every):
            if on_progress is not None:
                on_progress(done, len(every), f"{case.name}, {model}")
            yield runner.outcome(case, model)
