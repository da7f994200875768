"""What is tried, in this order, where ngspice finds no operating point or its steps vanish.

Vendors' models are written for other simulators' tolerances: some stop at a relative tolerance of 1e-4 and
run at 1e-3. ngspice steps its own sources from zero where Newton's method fails, but not the external ones,
which it only asks for; so the operating point is also looked for with plain sources in their place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from cosim.caution import Caution, warn
from cosim.circuits.rest import STEPPING
from cosim.circuits.spice import Drive, Tolerances, testbench
from cosim.errors import InputError, NoOperatingPoint, Problem, SimulationError, StepTooSmall
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator

__all__ = ["Aid", "aided", "plain_start"]

#: Relative tolerance at which SPICE's own programs run, and with it the vendors' models.
LOOSE_RTOL = 1e-3

Result = TypeVar("Result")


@dataclass(frozen=True)
class Aid:
    """How ngspice is helped.

    Attributes
    ----------
    tolerances
        Its error control.
    words
        What is unlike what the scene asks for; empty where nothing is.
    plain
        Whether to start from the operating point that plain sources give.
    lines
        Further lines of the deck.
    """

    tolerances: Tolerances
    words: tuple[str, ...] = ()
    plain: bool = False
    lines: tuple[str, ...] = ()


def aids(asked: Tolerances) -> Iterator[Aid]:
    """Yield what is tried: first what the scene asks for, then each step together with those before it."""
    aid = Aid(asked)
    yield aid
    aid = replace(aid, plain=True, words=("the operating point found with plain sources, stepped from zero",))
    yield aid
    if asked.rtol < LOOSE_RTOL:
        loose = replace(aid.tolerances, rtol=LOOSE_RTOL)
        aid = replace(aid, tolerances=loose, words=(*aid.words, f"solver.rtol = {LOOSE_RTOL:g}"))
        yield aid
    if asked.method != "gear":
        gear = replace(aid.tolerances, method="gear")
        aid = replace(aid, tolerances=gear, words=(*aid.words, 'solver.method = "gear"'))
        yield aid
    yield replace(aid, lines=(STEPPING,), words=(*aid.words, "gmin = 1e-10 S with gmin and source stepping"))


def aided(asked: Tolerances, attempt: Callable[[Aid], Result]) -> Result:
    """Return what `attempt` does with the first aid that lets ngspice come to its end; the step is told.

    Raises
    ------
    NoOperatingPoint, StepTooSmall
        The first of them, with all that was tried, when no aid helps.
    """
    first: NoOperatingPoint | StepTooSmall | None = None
    tried: tuple[str, ...] = ()
    for aid in aids(asked):
        if aid.plain and isinstance(first, StepTooSmall) and len(aid.words) == 1:
            continue  # its operating point was found
        try:
            result = attempt(aid)
        except (NoOperatingPoint, StepTooSmall) as error:
            first = first or error
            tried = aid.words
            continue
        if first is not None:
            warn(_told(first, aid))
        return result
    assert first is not None
    raise _in_vain(first, tried)


def _told(error: InputError | SimulationError, aid: Aid) -> Caution:
    reason = error.message if isinstance(error, SimulationError) else error.problems[0].message
    return Caution(
        "convergence-aided",
        f"ngspice came to no end as the scene asks ({reason}), and does with {' and '.join(aid.words)}",
        "state it in [solver] to save the vain attempt; a looser tolerance moves the results",
    )


def _in_vain(error: NoOperatingPoint | StepTooSmall, tried: tuple[str, ...]) -> InputError | SimulationError:
    words = f"; tried in vain: {', '.join(tried)}"
    if isinstance(error, StepTooSmall):
        return StepTooSmall(
            error.message + words, deck=error.deck, time_s=error.time_s, last_words=error.last_words
        )
    problem = error.problems[0]
    return NoOperatingPoint(Problem(problem.message + words, file=problem.file))


def plain_start(
    simulator: Simulator, board: Deck, circuit: Drive, volts: Mapping[str, float], aid: Aid
) -> list[str]:
    """Return `.nodeset` lines of the operating point with plain sources of `volts` at the board's pins.

    Raises
    ------
    NoOperatingPoint
        If ngspice finds none so either.
    """
    sources = {pin: f"dc {volts[f'v{k:02d}']!r}" for k, pin in enumerate(circuit.sources())}
    rows = ["cosim start", *(line.text for line in board.lines[1:]), *testbench(board, circuit, sources)]
    rows += [aid.tolerances.line(), *aid.lines, ".end"]
    simulator.load("\n".join(rows) + "\n", lines=board.lines, name=str(board.path))
    simulator.command("op")
    nodes = [name for name in simulator.vector_names() if "#" not in name]
    found = {name: float(np.real(simulator.vector(name)[0])) for name in nodes}
    return [f".nodeset v({name})={value!r}" for name, value in found.items()]
