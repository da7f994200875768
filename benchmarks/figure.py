"""One figure of the benchmarks: a ratio (or a plain number) with its spread, its errors and its target."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

#: Name -> (target, unit, what it says). A figure meets its target when it is not above it.
TARGETS: dict[str, tuple[float, str, str]] = {
    "lockstep_vs_replay": (1.10, "", "wall: lockstep / ngspice alone fed with the recorded sources"),
    "lockstep_vs_replay_points": (1.2, "", "time points: the same two"),
    "callback_share": (0.05, "", "compiled callbacks / wall of the lockstep"),
    "lockstep_vs_monolithic": (0.7, "", "wall: lockstep / linkage as B-sources, at equal accuracy"),
    "lockstep_vs_pyspice": (0.3, "", "wall: compiled callbacks / PySpice's Python callbacks"),
    "growth_exponent": (1.3, "", "wall per simulated second against number of equations, 1 to 6 joints"),
    "memory_100s_mb": (500.0, "MB", "peak resident memory of the simulation's process, 100 s scene"),
    "help_vs_numpy": (3.0, "", "wall: cosim --help / python -c 'import numpy'"),
    "warm_run_outside_s": (1.0, "s", "wall of a warm `cosim run` outside the simulation"),
    "warm_linear_outside_s": (0.5, "s", "the same on `linear`"),
    "stability_s": (1.0, "s", "wall of a warm `cosim stability`"),
    "linear_vs_monolithic_slope": (1 / 50, "", "wall: our loop on `linear` / linkage as B-sources, slope"),
    "ideal_vs_monolithic_slope": (1 / 150, "", "wall: our loop on `ideal` / the same, ideal parts, slope"),
    "linear_vs_monolithic_drop": (1 / 1000, "", "wall: our loop on `linear` / linkage as elements, drop"),
    "linear_vs_stiff_solvers": (1 / 20, "", "wall: our loop / the fastest stiff solver, same linear system"),
    "extraction_vs_ac": (20.0, "", "wall: extraction of board2 / one `ngspice -b`, 181 points of .ac"),
    "reextraction_vs_ac": (
        0.5,
        "",
        "wall: extraction of board2 after changed values / one `ngspice -b` as above",
    ),
    "auto_vs_all_effects": (0.25, "", "processor time: effects chosen for 2 % / all effects on, worst scene"),
    "fig13_vs_monolithic": (1 / 400, "", "wall: the whole Fig. 13 on `linear` / with the monolithic deck"),
    "border_map": (1000.0, "", "wall: 100 x 100 exact borders, one process / one border"),
    "mc_extraction_vs_ac": (
        0.3,
        "",
        "wall: model of a draw of all R, C of board2 / one `ngspice -b` as above",
    ),
    "batch_vs_single": (1 / 20, "", "wall: a `linear` drop sample of a batch / one `cosim run` of it"),
    "two_level_vs_plain_press": (
        1 / 30,
        "",
        "seconds: spice corrected by linear / plain, same interval",
    ),
    "two_level_vs_plain_drop": (1 / 30, "", "the same, a mass dropped"),
    "two_level_vs_plain_slope": (1 / 30, "", "the same, a hand along a slope"),
    "yield_vs_plain": (1 / 30, "", "seconds: yield by strata at 1 % failing / plain spice, same interval"),
    "engine_overhead": (0.10, "", "wall that the engine adds to spice samples, over theirs"),
    "two_cores": (1 / 1.8, "", "wall: samples on two workers / on one"),
    "extraction_cached_ms": (50.0, "ms", "wall: extraction of an unchanged board2"),
}


@dataclass(frozen=True)
class Figure:
    """One row of `latest.json`.

    Attributes
    ----------
    name : key of `TARGETS`
    ratio : median over the repetitions (the number itself where it is no ratio); min, max : their spread
    error_ours, error_peer : errors against a tight reference, as `error_unit` says; None where there is none
    target : not to be exceeded
    command : how to measure it again
    details : further numbers, printed and kept
    """

    name: str
    ratio: float
    min: float
    max: float
    error_ours: float | None
    error_peer: float | None
    target: float
    command: str
    error_unit: str
    details: dict[str, Any]

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        return self.ratio <= self.target

    def as_dict(self) -> dict[str, Any]:
        """Return the figure, ready for JSON."""
        return asdict(self)


def figure(
    name: str,
    values: Sequence[float],
    *,
    ratio: float | None = None,
    error_ours: float | None = None,
    error_peer: float | None = None,
    error_unit: str = "",
    details: dict[str, Any] | None = None,
) -> Figure:
    """Make a figure from the values of its repetitions.

    `ratio` replaces the median of `values` where the better estimate is a ratio of medians.
    """
    if not values or not all(math.isfinite(v) for v in values):
        raise ValueError(f"{name}: no finite values: {list(values)}")
    return Figure(
        name=name,
        ratio=statistics.median(values) if ratio is None else ratio,
        min=min(values),
        max=max(values),
        error_ours=error_ours,
        error_peer=error_peer,
        target=TARGETS[name][0],
        command=f"python -m benchmarks {name}",
        error_unit=error_unit,
        details=details or {},
    )


def interleaved(repetitions: int, *runs: Callable[[], float]) -> list[list[float]]:
    """Call the runs in turn, A B A B ..., and return the times of each; a first round warms up."""
    times: list[list[float]] = [[] for _ in runs]
    for repetition in range(repetitions + 1):
        for run, kept in zip(runs, times, strict=True):
            value = run()
            if repetition:
                kept.append(value)
    return times
