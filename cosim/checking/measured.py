"""The check's child process: one bench with the parts' ideal levels, one with the levels in force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from cosim.checking.components import NO_BUDGET, ComponentBudget, component_budget
from cosim.checking.headroom import Headroom, measure_headroom
from cosim.checking.loops import Loop, measure_loops
from cosim.checking.measured_constants import Constant, Rest, measure_constants, measure_rest, table
from cosim.checking.noise_budget import Noise, PotNoise, measure_noise, measure_pot_noise
from cosim.checking.probed_board import ProbedBoard
from cosim.checking.signal_paths import Brake, Path, Step, brakes, measure_admittance, measure_paths, steps_of
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.block_delays import measure as spring_delays
from cosim.circuits.extraction.noise_analysis import left_out
from cosim.circuits.extraction.noise_contributions import component_noise
from cosim.circuits.extraction.swing import swings
from cosim.errors import CosimError
from cosim.ngspice.simulator import Simulator

T = TypeVar("T")


@dataclass(frozen=True)
class Measured:
    """All that ngspice was asked about a board; the fields are explained where their types are.

    `notes` say what ngspice could not tell.
    """

    stated: DesignConstants
    constants: tuple[Constant, ...]
    rest: tuple[Rest, ...]
    headroom: Headroom
    loops: tuple[Loop, ...]
    paths: tuple[Path, ...]
    steps: tuple[Step, ...]
    brakes: tuple[Brake, ...]
    admittance_a_s: tuple[tuple[float, ...], ...]
    noise: tuple[Noise, ...]
    pot_noise: tuple[PotNoise, ...]
    components: ComponentBudget
    notes: tuple[str, ...]


def measure(payload: dict[str, Any], report: Callable[[dict[str, Any]], None]) -> Measured:
    """Measure a board.

    Parameters
    ----------
    payload
        'board', 'ideal': Deck at the levels in force and with ideal parts; 'noise_rad' [rad] and
        'noise_bandwidth_hz' of the potentiometer
    report
        called now and then

    Raises
    ------
    InputError
        With ngspice's words: syntax, no operating point, floating node, missing design constant.
    """
    simulator = Simulator(on_time=lambda reached: report({}))
    bench = ProbedBoard(simulator, payload["ideal"])
    bench.operating_point()
    stated = bench.constants()
    notes: list[str] = []
    ideal = measure_constants(bench, stated, measure_paths(bench, stated), notes)
    limits = swings(simulator, payload["board"])  # in decks of their own
    bench = ProbedBoard(simulator, payload["board"])
    rest = measure_rest(bench, stated)
    paths = measure_paths(bench, stated)
    constants = table(stated, measure_constants(bench, stated, paths, notes), ideal)
    admittance = measure_admittance(bench)
    k_fs = {j: c.measured or 0.0 for c in constants for j in range(1, bench.joints + 1)
            if c.name == "k_fs" and c.where == f"{j}{j}"}  # fmt: skip
    headroom = _or_note(
        lambda: measure_headroom(bench, stated, limits), Headroom((), (), (), ()), "the headroom", notes
    )
    bench.hold_only({})
    silent: tuple[Noise, ...] = ()
    noise = _or_note(lambda: tuple(measure_noise(bench, stated)), silent, "the circuit's noise", notes)
    if bench.mute:
        notes.append(left_out(sorted(bench.mute)))
    return Measured(
        stated=stated,
        constants=tuple(constants),
        rest=tuple(rest),
        headroom=headroom,
        loops=tuple(measure_loops(bench)),
        paths=tuple(paths),
        brakes=tuple(brakes(paths, admittance, stated, k_fs)),
        admittance_a_s=tuple(map(tuple, admittance)),
        noise=noise,
        pot_noise=tuple(
            measure_pot_noise(bench, stated, payload["noise_rad"], payload["noise_bandwidth_hz"])
        ),
        # last: they load decks of their own
        steps=_or_note(
            lambda: tuple(steps_of(spring_delays({"board": payload["board"], "own": True}, report))),
            (), "what each block adds to the delay", notes,
        ),
        components=_or_note(
            lambda: component_budget(component_noise({"board": payload["board"]}, report), stated),
            NO_BUDGET, "the noise of the components", notes,
        ),
        notes=tuple(notes),
    )  # fmt: skip


def _or_note(measured: Callable[[], T], nothing: T, what: str, notes: list[str]) -> T:
    """Return what is measured; where ngspice fails at it, nothing with a note, as the rest stands without."""
    try:
        return measured()
    except CosimError as reason:
        notes.append(f"{what} is not known: {reason}")
        return nothing
