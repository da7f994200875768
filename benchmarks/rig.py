"""What the benchmarks share: scenes, our lockstep as shipped, a bare ngspice run of a peer, errors."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import Tolerances, lockstep_deck
from cosim.circuits.design_constants import DesignConstants
from cosim.loop.spice.run_spice import simulate
from cosim.ngspice.lines import Line
from cosim.ngspice.simulator import Simulator
from cosim.plan import Plan, resolve
from cosim.runner import request_of
from cosim.scene import Scene, load_scene
from cosim.storage.rawfile import RAW, read_raw

ROOT = Path(__file__).resolve().parents[1]
SLOPE = ROOT / "scenes" / "slope.toml"
#: Without rounding a small error stays small: an encoder count more or less would hide what is measured.
SMOOTH = ("effects.encoder=false", "computer.dac.bits=30")
#: What errors are measured on.
CURRENTS = ("imot1", "imot2")
Signals = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Outcome:
    """A finished run: cost and signals (name -> values at the accepted points)."""

    stats: dict[str, Any]
    signals: Signals
    samples: NDArray[np.float64]
    sample_columns: tuple[str, ...]
    constants: DesignConstants | None = None

    @property
    def wall_s(self) -> float:
        """Wall time of the simulation itself [s]."""
        return float(self.stats["wall_s"])


def slope(*overrides: str) -> Plan:
    """Return the plan of the slope scene with `NAME=VALUE` changes."""
    return resolve(load_scene(SLOPE, overrides))


def smooth(duration_s: float | None = None) -> Plan:
    """Return the plan of the slope scene (or its beginning) without rounding in the computer."""
    return slope(*SMOOTH, *([] if duration_s is None else [f"duration_s={duration_s!r}"]))


def tight(plan: Plan) -> Plan:
    """Return the plan with the tolerances of a reference."""
    return retold(plan, rtol=1e-7, max_step_s=5e-5, coupling_rad=1e-12, charge_c=1e-13)


def retold(
    plan: Plan,
    *,
    rtol: float | None = None,
    max_step_s: float | None = None,
    coupling_rad: float | None = None,
    charge_c: float | None = None,
    method: str | None = None,
) -> Plan:
    """Return the plan with other tolerances."""
    solver = plan.scene.solver
    update: dict[str, Any] = {}
    if max_step_s is not None:
        update["max_step_s"] = max_step_s
    if coupling_rad is not None:
        update["coupling_tolerance_rad"] = coupling_rad
    scene: Scene = plan.scene.model_copy(update={"solver": solver.model_copy(update=update)})
    stated = plan.tolerances
    changes: dict[str, Any] = {
        key: value
        for key, value in (("rtol", rtol), ("charge_c", charge_c), ("method", method))
        if value is not None
    }
    tolerances: Tolerances = replace(stated, **changes)
    return replace(plan, scene=scene, tolerances=tolerances)


def lockstep(plan: Plan, *, keep: bool = False) -> Outcome:
    """Run our lockstep in this process, through the function that `cosim run` calls in its child."""
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        # a reference takes what it takes
        asked = replace(request_of(plan), predicted_points=math.inf, folder=Path(folder))
        answer = simulate(asked, lambda progress: None)
        signals: Signals = {}
        samples = np.empty((0, len(answer.sample_columns)))
        if keep:
            raw = read_raw(Path(folder) / RAW)
            signals = {name: np.array(raw[name]) for name in raw}
            samples = np.fromfile(Path(folder) / "samples.f64").reshape(-1, len(answer.sample_columns))
    return Outcome(dict(answer.stats), signals, samples, tuple(answer.sample_columns), asked.constants)


def equations(plan: Plan) -> int:
    """Return the number of equations of a plan's circuit, as ngspice counts them."""
    simulator = Simulator()
    simulator.load(lockstep_deck(plan.board, plan.circuit, plan.tolerances, ()))
    simulator.attach(source=lambda name, t: 0.0)
    simulator.command("op")
    return int(simulator.command("rusage equations")[0].rpartition("=")[2])


def bare_run(
    text: str,
    command: str,
    *,
    prepare: Callable[[Simulator], None] | None = None,
    trusted: bool = False,
    **callbacks: Any,
) -> tuple[float, Simulator]:
    """Load a deck in this process, attach callbacks and time one analysis; returns (wall [s], simulator).

    A deck of our own that is `trusted` may read files.
    """
    simulator = Simulator()
    simulator.load(text, [Line(text.splitlines()[0], trusted=True)] if trusted else [])
    if prepare is not None:
        prepare(simulator)
    simulator.attach(**callbacks)
    begun = time.perf_counter()
    simulator.command(command)
    return time.perf_counter() - begun, simulator


def at(signals: Mapping[str, NDArray[np.float64]], name: str, times: NDArray[np.float64]) -> Any:
    """Return a signal at given times [s], linear between its points."""
    return np.interp(times, signals["time"], signals[name])


def instants(plan: Plan) -> NDArray[np.float64]:
    """Return the instants [s] at which runs are compared: the samples, where every run has a point."""
    period = plan.scene.computer.period_s
    count = int(plan.scene.duration_s / period * (1 + 1e-12))
    return np.arange(1, count + 1, dtype=np.float64) * np.float64(period)


def error(
    run: Mapping[str, NDArray[np.float64]],
    reference: Mapping[str, NDArray[np.float64]],
    names: Iterable[str],
    times: NDArray[np.float64],
) -> float:
    """Return the largest difference of any of the signals, as a share of that signal's largest size."""
    worst = 0.0
    for name in names:
        truth = at(reference, name, times)
        worst = max(worst, float(np.abs(at(run, name, times) - truth).max() / np.abs(truth).max()))
    return worst
