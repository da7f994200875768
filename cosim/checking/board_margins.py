"""The part of a check that measures of a board need: what is left out of contact, and the loops' margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cosim.checking.loops import Loop, measure_loops
from cosim.checking.measured_constants import Rest, measure_rest
from cosim.checking.probed_board import ProbedBoard
from cosim.ngspice.child import Child, call
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator

__all__ = ["Standing", "standing"]


@dataclass(frozen=True)
class Standing:
    """A board with all its pins at zero: forces out of contact, and its loops."""

    rest: tuple[Rest, ...]
    loops: tuple[Loop, ...]


def standing(board: Deck, time_limit_s: float, child: Child | None = None) -> Standing:
    """Return what ngspice says of a board that does nothing; as `measured.measure` does for a whole check.

    Raises
    ------
    InputError
        When ngspice does not accept the board.
    """
    answer: Standing = call(
        "cosim.checking.board_margins:ask", {"board": board},
        time_limit_s=time_limit_s, deck=str(board.path), child=child,
    )  # fmt: skip
    return answer


def ask(payload: dict[str, Any], report: Callable[[dict[str, Any]], None]) -> Standing:
    """Measure ``payload['board']``; runs in the child."""
    bench = ProbedBoard(Simulator(on_time=lambda reached: report({})), payload["board"])
    return Standing(tuple(measure_rest(bench, bench.constants())), tuple(measure_loops(bench)))
