"""The peer without co-simulation: the linkage as elements of the deck, recorded DAC voltages as sources.

Two links and the hand, written as a designer would for speed: states are capacitors charged by linear
sources, only products and sines are B-sources (as currents into 1 Ohm, which need no branch equation), each
computed once. The DACs come as PWL sources, as XSPICE `filesource`, or as short PWL lists renewed while the
run pauses.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.callbacks import END, NO_DATA, NO_SYNC
from benchmarks.rig import Outcome, Signals, bare_run
from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.design_constants import DesignConstants
from cosim.export.mechanics import mechanics
from cosim.export.waveform import RISE_S, settling_s
from cosim.loop.dac_channels import channels
from cosim.ngspice.simulator import Simulator
from cosim.plan import Plan
from cosim.scene.mechanism import mechanism, operator, start

#: How the recorded DAC voltages enter the deck.
FEEDS = ("pwl", "filesource", "chunks")
#: Samples in one list of the feed `chunks`.
CHUNK = 4
#: Signal -> node of the deck: motor currents and joint angles, position of the tip and the operator's force.
ANGLES = {"imot1": "imot1", "imot2": "imot2", "q1": "pot1", "q2": "pot2"}
TIP = {name: name for name in ("x", "y", "fx", "fy")}


@dataclass(frozen=True)
class Steps:
    """Recorded DAC voltages: `volts[k]` is reached a settling time after `times[k]`.

    Attributes
    ----------
    names : driven channels
    times : [samples] s
    volts : [samples, channels] V
    settle_s : duration of the ramp
    period_s : sampling period
    """

    names: tuple[str, ...]
    times: NDArray[np.float64]
    volts: NDArray[np.float64]
    settle_s: float
    period_s: float

    def moving(self) -> list[int]:
        """Channels that ever change."""
        return [i for i in range(len(self.names)) if np.ptp(self.volts[:, i]) > 0.0]

    def corners(self, channel: int, first: int, last: int) -> list[tuple[float, float]]:
        """Corners of a channel's polygon through the samples first ... last-1, from their start."""
        v = self.volts[:, channel]
        points = [(float(self.times[first]), float(v[max(first - 1, 0)]))]
        points += [(float(self.times[first]) + self.settle_s, float(v[first]))]
        for k in range(first + 1, last):
            if v[k] != v[k - 1]:
                points += [(float(self.times[k]), float(v[k - 1]))]
                points += [(float(self.times[k]) + self.settle_s, float(v[k]))]
        return points


def recorded_steps(plan: Plan, run: Outcome) -> Steps:
    """Read the DAC voltages off the signals of a lockstep run, where each has settled.

    DACs without a settling time jump: the row of the instant has the voltage before, and a deck needs a ramp.
    """
    scene = plan.scene
    settle = settling_s(scene) or RISE_S
    period = scene.computer.period_s
    times = run.samples[:, run.sample_columns.index("time")]
    times = times[times < scene.duration_s - period / 2]
    late = np.searchsorted(run.signals["time"], times + 1.5 * settle)
    names = plan.circuit.channels
    volts = np.column_stack([run.signals[name][late] for name in names])
    return Steps(names, times, volts, settle, period)


def _polygon(corners: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{t!r} {v!r}" for t, v in corners)


def _sources(steps: Steps, feed: str, folder: Path) -> list[str]:
    """Write one source a channel; what never moves is plain DC."""
    lines, moving = [], steps.moving()
    for i, name in enumerate(steps.names):
        if i not in moving or feed == "none":
            lines.append(f"Vd{name} {name} 0 {float(steps.volts[0, i])!r}")
        elif feed != "filesource":
            last = CHUNK + 1 if feed == "chunks" else len(steps.times)
            lines.append(f"Vd{name} {name} 0 pwl({_polygon(steps.corners(i, 0, last))})")
    if feed == "filesource" and moving:
        every = [steps.corners(i, 0, len(steps.times)) for i in moving]
        instants = sorted({t for corners in every for t, _ in corners} | {0.0})
        table = [instants]
        instants += [steps.times[-1] + 1e6]  # behind its last row a filesource is 0
        for corners in every:
            knots = np.array(corners)
            table.append(np.interp(instants, knots[:, 0], knots[:, 1]).tolist())
        file = folder / "dacs.txt"
        np.savetxt(file, np.array(table).T, fmt="%.17g")
        nodes = " ".join(f"%vd({steps.names[i]},0)" for i in moving)
        ones, zeros = " ".join(["1"] * len(moving)), " ".join(["0"] * len(moving))
        lines += [
            f"Adacs [{nodes}] dacs",
            f'.model dacs filesource(file="{file}" amploffset=[{zeros}] amplscale=[{ones}] timeoffset=0 '
            "timescale=1 timerelative=false amplstep=false)",
        ]
    if feed in ("filesource", "chunks"):
        # neither lands on its corners: this does
        landings = {t for i in moving for t, _ in steps.corners(i, 0, len(steps.times))}
        teeth = [(t, float(k % 2)) for k, t in enumerate(sorted(landings))]
        lines.append(f"Vtick tick 0 pwl({_polygon(teeth)})")
    return lines


def _linkage(plan: Plan, constants: DesignConstants) -> list[str]:
    """Linkage and hand as `cosim export` writes them.

    The accelerations are solved for by the circuit itself. Written out instead, with the inverse of the mass
    matrix in two B-sources, a point costs 6 % less, but more points are needed for the same error.
    """
    linkage = mechanism(plan.scene, constants.gear)
    q, v = start(plan.scene, linkage)
    p, op = linkage.pack()[0], operator(plan.scene).pack()[0]
    return mechanics(p, op, q, v, constants.gear, constants.kt, plan.circuit.speeds)


def deck(
    plan: Plan,
    constants: DesignConstants,
    steps: Steps,
    feed: str,
    folder: Path,
    saved: Mapping[str, str] = ANGLES,
) -> str:
    """Return the whole deck; `feed` 'none' holds the DACs at their first voltages."""
    undriven = [c for c in channels(plan.scene.joints) if c not in plan.circuit.channels]
    lines = [
        "monolithic",
        *plan.board.text.splitlines()[1:],
        f"Vcc vcc 0 {SUPPLY_V}",
        f"Vee vee 0 {-SUPPLY_V}",
        f"Xboard {' '.join(plan.board.pins)} {plan.board.board}",
        *(f"Vz{name} {name} 0 0" for name in undriven),
        *_sources(steps, feed, folder),
        *_linkage(plan, constants),
        plan.tolerances.line(),
        ".save " + " ".join(f"v({node})" for node in saved.values()),
        ".end",
    ]
    return "\n".join(lines) + "\n"


def run(
    plan: Plan,
    constants: DesignConstants,
    steps: Steps,
    feed: str,
    folder: Path,
    saved: Mapping[str, str] = ANGLES,
) -> Outcome:
    """Run the deck once; `saved` says which node is which signal."""
    text = deck(plan, constants, steps, feed, folder, saved)
    longest, end = plan.scene.solver.max_step_s, plan.scene.duration_s
    command = f"tran {longest!r} {end!r} 0 {longest!r}"
    simulator: Simulator
    END[0] = end
    if feed == "chunks":
        wall, simulator = _in_chunks(text, command, steps)
    else:
        wall, simulator = bare_run(text, command, trusted=feed == "filesource", data=NO_DATA, sync=NO_SYNC)
    names = {"time": "time", **saved}
    signals: Signals = {name: np.real(simulator.vector(vector)) for name, vector in names.items()}
    return Outcome({"wall_s": wall, "points": len(signals["time"])}, signals, np.empty((0, 0)), ())


def _in_chunks(text: str, command: str, steps: Steps) -> tuple[float, Simulator]:
    """Pause in the middle of a period now and then, and renew the lists of all sources."""
    simulator = Simulator()
    simulator.load(text)
    simulator.attach(data=NO_DATA, sync=NO_SYNC)
    # a paused run counts as a failed command to the simulator's own face
    order = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_char_p)(simulator.command_address())
    orders = []
    for k in range(CHUNK, len(steps.times), CHUNK):
        orders.append(f"stop when time > {float(steps.times[k]) + 0.5 * steps.period_s!r}")
        orders.append("resume" if k > CHUNK else command)
        for i in steps.moving():
            corners = steps.corners(i, k, min(k + CHUNK + 1, len(steps.times)))
            flat = _polygon([(0.0, corners[1][1]), *corners[1:]])
            orders.append(f"alter @vd{steps.names[i]}[pwl] = [ {flat} ]")
        orders.append("delete all")
    begun = time.perf_counter()
    for words in [*orders, "resume"]:
        order(words.encode())
    return time.perf_counter() - begun, simulator
