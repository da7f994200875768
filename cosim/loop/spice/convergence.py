"""Convergence aids, in their order, where ngspice finds no operating point, its steps vanish, or it crawls.

Vendors' models are written for other simulators' tolerances: some stop at a relative tolerance of 1e-4 and
run at 1e-3. ngspice steps its own sources from zero where Newton's method fails, but not the external ones,
whose values it gets from outside; so the operating point is also tried with plain sources in their place.
Where that fails, the pins alone are stepped from zero: each step starts from the last one's solution, which
no stepping within ngspice does at full supplies.

A model whose gains are far apart leaves rounding errors of the tolerance's size in Newton's method, which
then fails at random and at any step: the run would end, in hours. An attempt's work is therefore bounded,
counted in Newton iterations and never in seconds, so that the same input goes the same way on every machine.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from cosim.caution import Caution, warn
from cosim.circuits.decks import Drive, Tolerances, testbench
from cosim.circuits.operating_point import STEPPING
from cosim.effects.prediction import EVENT_POINTS
from cosim.errors import Crawl, InputError, NoOperatingPoint, Problem, SimulationError, StepTooSmall
from cosim.loop.setup import Memory
from cosim.loop.state import PATIENCE
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator

__all__ = ["Aid", "aided", "bound_work", "plain_start"]

#: Relative tolerance at which SPICE's own programs run, and with it the vendors' models.
LOOSE_RTOL = 1e-3
#: A microampere is no more than the tolerance asks of the motors' currents, while inside some models a
#: picovolt on a microohm, which is rounding, is that large.
MICROAMPERE = ".options abstol=1e-6"

#: Newton iterations a point: two where nothing bends, the second of which confirms the first.
ITERATIONS = 2.0
#: Points allowed at once: a share of the whole, for scenes with much to do at their start, and this at least.
_SHARE, _LEAST = 0.1, 300.0
#: Below this tolerance the coupling's error sets the steps, as its third root, and no longer ngspice's.
_COUPLING_RAD = 1e-9

#: What the shipped scenes' measures differ by from those at 1e-6; at 1e-4 it is 0.04 % and 1 %.
_COST = (
    f"; at rtol {LOOSE_RTOL:g} the shipped scenes' forces, currents and stiffness move by up to 0.12 %, and "
    "the ripple of the force by 1.6 %: look at yours with `cosim run --set solver.rtol=...`"
)

_INTERNAL = re.compile(r"_int\d+$")
#: Node that scales the voltages at all pins.
_SCALE = "pinscale"

Result = TypeVar("Result")


@dataclass(frozen=True)
class Aid:
    """How ngspice is helped.

    Attributes
    ----------
    tolerances
        Its error control.
    words
        Settings that differ from the scene's, in words; empty where none does.
    plain
        Whether to start from the operating point that plain sources give.
    lines
        Further lines of the deck.
    patient
        Whether it may crawl.
    """

    tolerances: Tolerances
    words: tuple[str, ...] = ()
    plain: bool = False
    lines: tuple[str, ...] = ()
    patient: bool = False


def bound_work(memory: Memory, predicted_points: float, duration_s: float, coupling_rad: float) -> None:
    """Let an attempt end with `Fault.CRAWLS` at `PATIENCE` times the Newton iterations that are predicted.

    They are counted by ngspice's calls: in each it asks once for every external source.
    """
    probes = len(memory.component.probes) if memory.component is not None else 0
    each = PATIENCE * ITERATIONS * (len(memory.drive.sources()) + probes)
    points = predicted_points * max(1.0, _COUPLING_RAD / coupling_rad) ** (1.0 / 3.0)
    state = memory.state[0]
    state["calls"]["free"] = each * max(_SHARE * points, _LEAST)
    state["calls"]["per_s"] = each * points / duration_s
    state["calls"]["per_event"] = each * EVENT_POINTS["spice"]


def aids(asked: Tolerances) -> Iterator[Aid]:
    """Yield the attempts: first the scene's own settings, then each aid together with those before it."""
    aid = Aid(asked)
    yield aid
    aid = replace(aid, plain=True, words=("the operating point found with plain sources, stepped from zero",))
    yield aid
    aid = replace(aid, lines=(MICROAMPERE,), words=(*aid.words, "currents to 1 uA (abstol)"))
    yield aid
    if asked.rtol < LOOSE_RTOL:
        loose = replace(aid.tolerances, rtol=LOOSE_RTOL)
        aid = replace(aid, tolerances=loose, words=(*aid.words, f"solver.rtol = {LOOSE_RTOL:g}"))
        yield aid
    if asked.method != "gear":
        gear = replace(aid.tolerances, method="gear")
        aid = replace(aid, tolerances=gear, words=(*aid.words, 'solver.method = "gear"'))
        yield aid
    yield replace(
        aid, lines=(*aid.lines, STEPPING), words=(*aid.words, "gmin = 1e-10 S with gmin and source stepping")
    )


def aided(asked: Tolerances, attempt: Callable[[Aid], Result]) -> Result:
    """Return what `attempt` does with the first aid that lets ngspice finish; a warning names the aid.

    Raises
    ------
    NoOperatingPoint, StepTooSmall
        The first of them, with all that was tried, when no aid helps; what crawls is then let crawl.
    """
    first: NoOperatingPoint | StepTooSmall | Crawl | None = None
    crawling: Aid | None = None
    tried: tuple[str, ...] = ()
    for aid in aids(asked):
        if aid.plain and isinstance(first, StepTooSmall | Crawl) and len(aid.words) == 1:
            continue  # its operating point was found
        try:
            result = attempt(aid)
        except (NoOperatingPoint, StepTooSmall, Crawl) as error:
            first = first or error
            if isinstance(error, Crawl):
                crawling = crawling or aid
            tried = aid.words
            continue
        if first is not None:
            warn(_caution(first, aid, asked))
        return result
    assert first is not None
    if crawling is None:
        assert not isinstance(first, Crawl)
        raise _in_vain(first, tried)
    result = attempt(replace(crawling, patient=True))  # nothing helps, but it gets on
    if crawling.words:
        warn(_caution(first, crawling, asked))
    return result


def _caution(error: InputError | SimulationError, aid: Aid, asked: Tolerances) -> Caution:
    reason = error.message if isinstance(error, SimulationError) else error.problems[0].message
    return Caution(
        "convergence-aided",
        f"ngspice came to no end as the scene asks ({reason}), and does with {' and '.join(aid.words)}",
        _advice(aid, asked),
    )


def _advice(aid: Aid, asked: Tolerances) -> str:
    if (aid.tolerances.rtol, aid.tolerances.method) == (asked.rtol, asked.method):
        return "nothing is to be done: the run keeps the scene's tolerance and method"
    cost = _COST if aid.tolerances.rtol > asked.rtol else ""
    return f"state it in [solver] to save the vain attempt{cost}"


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
    """Return `.nodeset` lines of the operating point with plain sources of `volts` [V] at the board's pins.

    Raises
    ------
    NoOperatingPoint
        If ngspice finds none so either.
    """
    rows = ["cosim start", *(line.text for line in board.lines[1:]), *testbench(board, circuit, {})]
    rows += [f"e{k:02d} {pin} 0 {_SCALE} 0 {volts[f'v{k:02d}']!r}" for k, pin in enumerate(circuit.sources())]
    rows += [f"v{_SCALE} {_SCALE} 0 1", aid.tolerances.line(), *aid.lines, ".end"]
    simulator.load("\n".join(rows) + "\n", lines=board.lines, name=str(board.path))
    # the board's probes may be external, for noise that begins at zero: ngspice 47 reads them here as well
    simulator.attach(source=lambda name, t: 0.0)
    try:
        simulator.command("op")
    except NoOperatingPoint:  # Newton's method starts from zero volts, far away; so the pins go there, too
        simulator.command(f"dc v{_SCALE} 0 1 0.1")
    # nodes that ngspice itself adds have no name in a deck
    names = [name for name in simulator.vector_names() if "#" not in name and not _INTERNAL.search(name)]
    nodes = [name for name in names if name not in (_SCALE, "v-sweep")]
    by_node = {name: float(np.real(simulator.vector(name)[-1])) for name in nodes}
    return [f".nodeset v({name})={value!r}" for name, value in by_node.items()]
