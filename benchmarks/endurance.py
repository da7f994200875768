"""Long runs: whether time, energy or memory drifts: `python -m benchmarks.endurance [drop] [press]`.

`drop`: a million samples on `linear`. Every sample must be at k T to the last bit; what the ledger of energy
leaves is a straight line against samples, whose slope is that of rounding or none.
`press`: an hour of simulated time on `spice`. The process must not grow: memory, the ledger and the finger's
place at rest are straight lines against time, from the second tenth of the run on.

Rows and samples are looked at and thrown away as they come, so that no disk fills.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.rig import ROOT
from cosim.circuits.extraction.extract import extract
from cosim.loop.columns import columns, sample_columns
from cosim.loop.energy_ledger import torques_and_energy, works
from cosim.loop.linear.run_linear import Clock, prepare
from cosim.loop.recorder import Recorder
from cosim.loop.spice import run_spice
from cosim.plan import Plan, resolve
from cosim.runner import request_of
from cosim.scene import load_scene
from mech.energy import energy
from mech.operator import NoOperator

SAMPLES, SECONDS = 1_000_000, 3600.0
#: Bytes the process may grow by in a simulated hour: a page of memory a second would be 14 MB.
MOST_BYTES = 4e6


@dataclass
class Track:
    """What is noted along a run: names and, for each mark, their values."""

    names: tuple[str, ...]
    marks: array[float] = field(default_factory=lambda: array("d"))  # a list would grow eightfold

    def lines(self) -> dict[str, tuple[float, float, float]]:
        """Return slope, its standard error, and change from first to last, a name, against the first name.

        The first tenth is left out: what is loaded and compiled once is no drift.
        """
        table = np.array(self.marks).reshape(-1, len(self.names))
        table = table[max(len(table) // 10, 1) :]
        x = table[:, 0] - table[:, 0].mean()
        out = {}
        for name, y in zip(self.names[1:], table.T[1:], strict=True):
            slope = float(x @ y / (x @ x))
            rest = y - y.mean() - slope * x
            error = float(np.sqrt(rest @ rest / max(len(x) - 2, 1) / (x @ x)))
            out[name] = slope, error, float(y[-1] - y[0])
        return out


class Sink:
    """Stands for a file: hands each block of rows on, and keeps nothing."""

    def __init__(self, width: int, look: Callable[[Any], None]) -> None:
        self.width, self.look = width, look

    def write(self, block: Any) -> int:
        """Look at a block of rows; an empty one is nothing."""
        rows = np.frombuffer(block).reshape(-1, self.width)
        if len(rows):
            self.look(rows)
        return rows.nbytes

    def close(self) -> None:
        """Do nothing: there is no file."""


def resident() -> float:
    """Return the memory that the process has [bytes], as Linux counts it."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return float(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def plan_of(scene: str, model: str, *changes: str) -> Plan:
    """Return the plan of a shipped scene."""
    return resolve(load_scene(ROOT / "scenes" / f"{scene}.toml", (f"solver.model={model}", *changes)))


def drop(samples: int) -> tuple[Track, int]:
    """Run the drop on `linear`; returns what was noted, and how many samples were not at k T."""
    period = 0.01
    plan = plan_of("drop", "linear", f"duration_s={samples * period!r}")
    request = request_of(plan)
    scene, board = request.scene, request.board
    circuit = extract({"board": board, "model": "linear", "band_hz": scene.solver.band_hz,
                       "tolerance": scene.solver.reduction_tolerance}, lambda _: None)  # fmt: skip
    # with rows, or no account is kept of energy
    packed = prepare(scene, request.constants, circuit, record=True)
    state, total = packed.memory.state[0], packed.step.total
    nobody = NoOperator().pack()[0]
    names = sample_columns(scene.joints)
    track = Track(("samples", "ledger_j", "place_rad", "bytes"))
    wrong = seen = 0

    def stored() -> float:
        return float(sum(energy(state["p"], nobody, state["q"], state["v"])))

    start = stored()

    def look(rows: Any) -> None:
        nonlocal wrong, seen
        ticks = np.arange(seen, seen + len(rows))
        wrong += int(np.count_nonzero(rows[:, names.index("time")] != ticks * period))
        seen += len(rows)
        # the sample in hand is the present point: both sides of the ledger are of this very instant
        left = stored() - start - float(total.sum())
        track.marks.extend((float(seen), left, float(state["q"][0]), resident()))

    nothing = Sink(len(columns(packed.memory.drive, ())), lambda _: None)
    recorder = Recorder(packed.memory, Clock(state), Path(), lambda _: None,
                        streams=(nothing, Sink(len(names), look)))  # type: ignore[arg-type]  # fmt: skip
    packed.run()
    recorder.drain()
    if recorder.failure is not None:
        raise recorder.failure
    return track, wrong + abs(seen - samples)


def press(seconds: float) -> Track:
    """Run the press on `spice`; returns what was noted."""
    plan = plan_of("press", "spice", f"duration_s={seconds!r}", "solver.time_limit_s=86400")
    request = replace(request_of(plan), watched=())
    constants = request.constants
    n = request.scene.joints
    track = Track(("seconds", "ledger_j", "place_rad", "bytes"))
    nobody = NoOperator().pack()[0]
    before: Any = None
    total = 0.0
    start = 0.0

    def recorder(memory: Any, *rest: Any, **more: Any) -> Recorder:
        names = columns(memory.drive, ())
        first = names.index("q1")
        linkage = memory.state[0]["p"]

        def look(rows: Any) -> None:
            nonlocal before, total, start
            back = 0 if before is None else len(before)
            block = np.array(rows) if before is None else np.concatenate([before, rows])
            torques, energies = np.empty((len(block), 5, n)), np.empty((len(block), 3))
            done = np.zeros((len(block), 5))
            torques_and_energy(linkage, nobody, n, constants.torques_per_amp(n), block, first, torques,
                               energies, np.empty((len(block), 2)), -1, -1)  # fmt: skip
            works(n, block, first, torques, done)
            if before is None:
                start = float(energies[0].sum())
            total += float(done[max(back, 1) :].sum())
            before = block[-2:].copy()
            left = float(energies[-1].sum()) - start - total
            track.marks.extend((float(block[-1, 0]), left, float(block[-1, first]), resident()))

        nothing = Sink(1, lambda _: None)
        return Recorder(memory, *rest, **more, streams=(Sink(len(names), look), nothing))  # type: ignore[arg-type]

    with (
        mock.patch.object(run_spice, "Recorder", recorder),
        mock.patch.object(run_spice, "_signals", return_value={}),
    ):
        run_spice.simulate(request, lambda _: None)
    return track


def show(track: Track, hours: float) -> None:
    """Print the lines of what was noted."""
    print(f"  {len(track.marks) // len(track.names)} marks")
    for name, (slope, error, change) in track.lines().items():
        print(f"  {name}: slope {slope:.3g} +- {2 * error:.2g} a {track.names[0]}, change {change:.3g}")
    print(f"  {hours:.2f} h of wall time", flush=True)


def main() -> int:
    """Run, print, judge; 1 where something drifts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.endurance", description=__doc__)
    parser.add_argument("names", nargs="*", default=["drop", "press"], help="drop, press")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="of the drop")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the press")
    args = parser.parse_args()
    good = True
    for name in args.names:
        begun = time.perf_counter()
        print(name, flush=True)
        if name == "drop":
            track, wrong = drop(args.samples)
            print(f"  {args.samples} samples, {wrong} not at k T")
            good &= wrong == 0
        else:
            track = press(args.seconds)
            growth = track.lines()["bytes"][0] * 3600.0
            print(f"  {args.seconds:g} s, memory grows by {growth / 1e6:.3f} MB an hour")
            good &= growth <= MOST_BYTES
        show(track, (time.perf_counter() - begun) / 3600.0)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
