"""ngspice alone: the recorded source signals of a lockstep run, fed back by compiled interpolation.

The same library, deck, tolerances, breakpoints and saved vectors; no linkage, no computer, no step control of
a coupling. Angles are cubic and speeds quadratic between the recorded points, DAC voltages linear (their
ramps begin and end at recorded points). Nothing here is shared with the lockstep's own callbacks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numba import carray, cfunc, njit, types
from numpy.typing import NDArray

from benchmarks.rig import Outcome, Signals, bare_run
from benchmarks.vectors import vector_value
from cosim.circuits.decks import Drive, lockstep_deck, saved
from cosim.loop.setup import FIRST_STEP_SHARE
from cosim.ngspice.simulator import Simulator
from cosim.plan import Plan
from mech.numba_calls import call_with_time, doubles_at

_MOST = 256
REPLAY = np.dtype(
    [
        ("times", "i8"),
        ("smooth", "i8"),  # [segments, smooths, 4]: value, slope, ... at the segment's start
        ("plain", "i8"),  # [segments, plains, 2]
        ("segments", "i8"),
        ("smooths", "i8"),
        ("plains", "i8"),
        ("at", "i8"),
        ("t", "f8"),
        ("out", "f8", _MOST),
        ("marks", "i8"),  # [events, 3]: time, whether the DACs begin to move there, breakpoint to set there
        ("mark_count", "i8"),
        ("mark", "i8"),
        ("breakpoint_address", "i8"),
        ("h_max", "f8"),
        ("h_first", "f8"),
        ("tiny", "f8"),
        ("time_index", "i8"),
        ("saved", "i8"),
        ("saved_index", "i8", _MOST),
        ("rows", "i8"),
        ("capacity", "i8"),
        ("points", "i8"),
        ("rejected", "i8"),
    ],
    align=True,
)
_record = numba.from_dtype(REPLAY)
_f8, _i4, _i8, _u1 = types.float64, types.int32, types.int64, types.uint8


@njit(error_model="numpy")
def _fill(s: Any, t: float) -> None:
    """Interpolate every source at `t`; times come in order but for rejected steps, so the place is near."""
    s.t = t
    times = carray(doubles_at(s.times), (s.segments + 1,))
    k = s.at
    while k + 1 < s.segments and times[k + 1] <= t:
        k += 1
    while k > 0 and times[k] > t:
        k -= 1
    s.at = k
    x = t - times[k]
    smooth = carray(doubles_at(s.smooth), (s.segments, s.smooths, 4))
    for i in range(s.smooths):
        s.out[i] = smooth[k, i, 0] + x * (smooth[k, i, 1] + x * (smooth[k, i, 2] + x * smooth[k, i, 3]))
    plain = carray(doubles_at(s.plain), (s.segments, s.plains, 2))
    for i in range(s.plains):
        s.out[s.smooths + i] = plain[k, i, 0] + x * plain[k, i, 1]


@cfunc(_i4(types.CPointer(_f8), _f8, types.CPointer(_u1), _i4, types.CPointer(_record)))
def source(voltage: Any, t: float, name: Any, ident: int, user: Any) -> int:
    """GetVSRCData."""
    s = carray(user, 1)[0]
    if t != s.t:
        _fill(s, t)
    digits = carray(name, 3)
    voltage[0] = s.out[(digits[1] - 48) * 10 + digits[2] - 48]
    return 0


@cfunc(_i4(_f8, types.CPointer(_f8), _f8, _i4, _i4, _i4, types.CPointer(_record)))
def synchronise(t: float, delta: Any, old: float, redo: int, ident: int, where: int, user: Any) -> int:
    """GetSyncData: land on the recorded events and restart behind a DAC's jump as the lockstep does."""
    s = carray(user, 1)[0]
    if where == 1:
        s.rejected += redo
        return 0
    h = min(delta[0], s.h_max)
    marks = carray(doubles_at(s.marks), (s.mark_count, 3))
    while s.mark < s.mark_count and marks[s.mark, 0] <= t + s.tiny:
        if marks[s.mark, 1] != 0.0:
            h = s.h_first
        if marks[s.mark, 2] != 0.0:
            call_with_time(s.breakpoint_address, marks[s.mark, 2])
        s.mark += 1
    if s.mark < s.mark_count:
        rest = marks[s.mark, 0] - t
        if h > 0.999 * rest:
            h = rest
        elif h > 0.5 * rest:
            h = 0.5 * rest
    delta[0] = h
    return 0


@cfunc(_i4(types.CPointer(_i8), _i4, _i4, types.CPointer(_record)))
def accepted(data: Any, count: int, ident: int, user: Any) -> int:
    """SendData: keep the saved vectors of the point."""
    s = carray(user, 1)[0]
    vectors = carray(data, (2,))[1]
    if s.points < s.capacity:
        row = carray(doubles_at(s.rows + 8 * (s.saved + 1) * s.points), (s.saved + 1,))
        row[0] = vector_value(vectors, s.time_index)
        for i in range(s.saved):
            row[1 + i] = vector_value(vectors, s.saved_index[i])
    s.points += 1
    return 0


@dataclass
class Replay:
    """The peer's memory for one recorded run; `run` may be called again and again."""

    plan: Plan
    state: NDArray[np.void]
    rows: NDArray[np.float64]
    kept: tuple[NDArray[np.float64], ...]
    names: tuple[str, ...]

    def run(self) -> Outcome:
        """Run ngspice alone once."""
        s = self.state[0]
        for field in ("at", "mark", "points", "rejected"):
            s[field] = 0
        s["t"] = np.nan
        plan, solver = self.plan, self.plan.scene.solver

        def prepare(simulator: Simulator) -> None:
            s["breakpoint_address"] = simulator.set_breakpoint_address()

        def init(names: list[str]) -> None:
            s["time_index"] = names.index("time")
            s["saved_index"][: len(self.names)] = [names.index(name) for name in self.names]

        wall, _ = bare_run(
            lockstep_deck(plan.board, plan.circuit, plan.tolerances, _nodes(plan)),
            f"tran {solver.max_step_s!r} {plan.scene.duration_s!r} 0 {solver.max_step_s!r}",
            prepare=prepare,
            data=accepted.address,
            init=init,
            source=source.address,
            sync=synchronise.address,
            user=self.state.ctypes.data,
        )
        points = int(s["points"])
        if points > len(self.rows):
            raise RuntimeError(f"the replay took {points} points; room was made for {len(self.rows)}")
        signals: Signals = {"time": self.rows[:points, 0]}
        signals |= {name: self.rows[:points, 1 + i] for i, name in enumerate(self.names)}
        stats = {"wall_s": wall, "points": points, "rejected": int(s["rejected"])}
        return Outcome(stats, signals, np.empty((0, 0)), ())


def _nodes(plan: Plan) -> tuple[str, ...]:
    return plan.recorded + tuple(node for node in plan.watched if node not in plan.recorded)


def replay(plan: Plan, recorded: Outcome, gear: float, room: int = 10_000) -> Replay:
    """Prepare the replay of a recorded lockstep run; `room`: time points it may take."""
    circuit, signals = plan.circuit, recorded.signals
    times = np.ascontiguousarray(signals["time"])
    smooth = _smooth(circuit, signals, gear)
    plain = _plain(circuit, signals)
    marks = _marks(plan, recorded)
    state = np.zeros(1, REPLAY)
    s = state[0]
    s["times"], s["smooth"], s["plain"] = times.ctypes.data, smooth.ctypes.data, plain.ctypes.data
    s["segments"], s["smooths"], s["plains"] = len(times) - 1, smooth.shape[1], plain.shape[1]
    s["marks"], s["mark_count"] = marks.ctypes.data, len(marks)
    s["h_max"] = min(plan.scene.solver.max_step_s, plan.scene.computer.period_s)
    s["h_first"] = min(FIRST_STEP_SHARE * float(s["h_max"]), plan.scene.computer.dac.settling_s / 3)
    s["tiny"] = 1e-12
    names = tuple(name.lower() for name in saved(circuit, _nodes(plan)))
    rows = np.zeros((room, len(names) + 1))
    s["saved"], s["rows"], s["capacity"] = len(names), rows.ctypes.data, len(rows)
    return Replay(plan, state, rows, (times, smooth, plain, marks), names)


def _smooth(circuit: Drive, signals: Signals, gear: float) -> NDArray[np.float64]:
    """Polynomials of the angles and speeds in each segment [segments, sources, 4]."""
    h = np.diff(signals["time"])
    n = circuit.joints
    table = np.zeros((len(h), n * (2 if circuit.speeds else 1), 4))
    for j in range(n):
        q, v = signals[f"q{j + 1}"], signals[f"v{j + 1}"]
        mean = np.diff(q) / h
        second = (3 * mean - 2 * v[:-1] - v[1:]) / h
        third = (v[:-1] + v[1:] - 2 * mean) / h**2
        table[:, j] = np.column_stack([q[:-1], v[:-1], second, third])
        if circuit.speeds:
            table[:, n + j] = gear * np.column_stack([v[:-1], 2 * second, 3 * third, np.zeros(len(h))])
    return table


def _plain(circuit: Drive, signals: Signals) -> NDArray[np.float64]:
    """Straight lines of the DAC voltages in each segment [segments, channels, 2]."""
    h = np.diff(signals["time"])
    lines = [np.column_stack([signals[c][:-1], np.diff(signals[c]) / h]) for c in circuit.channels]
    return np.ascontiguousarray(np.stack(lines, axis=1))


def _marks(plan: Plan, recorded: Outcome) -> NDArray[np.float64]:
    """Return what the lockstep landed on [events, 3]: samples, ends of ramps, kinks of the hand's intention.

    As there, each sample makes the next one a breakpoint of ngspice; the first one is set at time 0.
    """
    scene = plan.scene
    settle = scene.computer.dac.settling_s if scene.effects.dac_settling else 0.0
    if settle == 0.0 or scene.effects.delay:
        raise ValueError("the replay knows DACs that settle and no delay")
    columns = recorded.sample_columns
    ticks = recorded.samples[:, columns.index("time")]
    wanted = [i for i, c in enumerate(columns) if c.startswith(("u_rad", "cmd_nm", "ksp", "ksd"))]
    moved = np.any(np.diff(recorded.samples[:, wanted], axis=0) != 0.0, axis=1)
    marks = np.zeros((len(ticks), 3))
    marks[:, 0] = ticks
    marks[1:, 1] = moved
    marks[:-1, 2] = ticks[1:]
    ends = ticks[1:][moved] + settle
    tables = (getattr(scene.operator, name, ()) for name in ("waypoints_s_m", "force_s_n"))
    knots = [row[0] for table in tables for row in table if 0.0 < row[0]]
    landings = np.array([*ends, *knots, scene.duration_s])
    fresh = np.abs(landings[:, None] - ticks[None, :]).min(axis=1) > 1e-9
    others = np.unique(landings[fresh & (landings <= scene.duration_s)])
    table = np.vstack([marks, np.column_stack([others, np.zeros((len(others), 2))])])
    return np.ascontiguousarray(table[np.argsort(table[:, 0])])
