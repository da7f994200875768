"""The linear model's time loop: the same events as in lockstep with ngspice, around a `LinearCircuit`.

Between two events (samples, DACs, noise grid, knots of the operator) time is counted in binary fractions of
the interval, so that a handful of step lengths serves a whole run and every event is met exactly. A step is
the largest fraction that lies on the grid and whose error, known from the step before, is within the
tolerance.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cosim.loop.equations_of_motion import evaluate
from cosim.loop.events import process_events
from cosim.loop.linear.contact_events import find, first_crossing, meet, strike
from cosim.loop.linear.exact_slider import EXACT_KIND, PLAN_KIND, STATE_KIND, STEP_KIND, Exact, rests
from cosim.loop.linear.exact_steps import leaps
from cosim.loop.linear.gauss_step import accept, attempt, guess, near, present
from cosim.loop.linear.recording import check, moved, record, row
from cosim.loop.linear.step_maps import Plan, slot_of
from cosim.loop.linear.step_memory import StepMemory
from cosim.loop.pin_voltages import gains_ramp, ramp_step
from cosim.loop.state import Fault
from cosim.types import Record
from mech.compiled import call_plain, carray, entry, inner, inner_inlined, lent, record_at
from mech.kinds import table

_COLLAPSED = Fault.STEP_COLLAPSED
#: The shortest step is the interval over 2^_LEVELS.
_LEVELS = 40
_PARTS = 1 << _LEVELS
#: The next step aims at this share of the tolerance and grows at most so much; the error is of fifth order.
_SAFETY, _GROWTH, _ORDER = 0.5, 8.0, 5.0
#: Near a driver's limit steps are at most 1/64 of the period and are checked ...
_WATCH_STEPS = 64.0
#: ... and the instants at which a motor reaches or leaves it are located to 2^-_LOCATED of an interval.
_LOCATED = 18
#: Changes of friction and stops are located to 2^-_FINEST of an interval, but not below _RESOLUTION_S.
_FINEST, _RESOLUTION_S = 36, 1e-12
#: Steps below this share of the period are no rows where they are below that of what their error allows:
#: those on the way to such an instant and from it.
_ROW_SHARE, _CUT_SHORT = 2.0**-12, 2.0**-4
_NEVER = math.inf
#: A scene that is linear this share of a period behind an event is so up to the next.
_WELL_BEHIND = 1e-9


class Tables:
    """Where compiled code finds a run: the state, and the tables of plan, step and exact path.

    Attributes
    ----------
    addresses : of the four
    linear : [1] whether the scene is linear between events
    """

    def __init__(self, state: Any, plan: Plan, step: StepMemory, exact: Exact) -> None:
        self._alive = (state, plan, step, exact, table(plan), table(step), table(exact))
        self.linear = exact.on
        self.addresses = (state.ctypes.data, *(words.ctypes.data for words in self._alive[4:]))


class _Interval(NamedTuple):
    """Time between two events, cut into binary fractions.

    Attributes
    ----------
    start, length : s
    finest : level (steps of length / 2^level) at which an instant of friction or a stop counts as located
    """

    start: float
    length: float
    finest: int


class _Trial(NamedTuple):
    """A step that can be accepted, and what later steps keep to.

    Attributes
    ----------
    level, h, error : the step is h = length / 2^level [s] long, its angles are wrong by `error` [rad]
    watch : whether a motor is near its limit
    wish : longest step [s] that errors have allowed so far
    until : time [s] by which friction or a stop changes what it does; infinite for none in sight
    """

    level: int
    h: float
    error: float
    watch: bool
    wish: float
    until: float


@inner_inlined
def _side(k: Any, joint: int, current: float) -> float:
    if current >= k.limit[joint, 1]:
        return 1.0
    if current <= k.limit[joint, 0]:
        return -1.0
    return 0.0


@inner_inlined
def _watched(s: Record, k: Any, b: Any) -> bool:
    """Whether a motor comes near its limit within the step on trial."""
    for j in range(s.n):
        if near(k, j, b.current[j]) or near(k, j, b.results[3 * s.n + j]):
            return True
        for i in range(3):
            if near(k, j, b.results[3 * j + i]):
                return True
    return False


@inner_inlined
def _crosses(s: Record, k: Any, b: Any) -> bool:
    """Whether a motor reaches or leaves its limit within the step on trial."""
    for j in range(s.n):
        if _side(k, j, b.results[3 * s.n + j]) != b.clamp[j]:
            return True
        for i in range(3):
            if b.clamp[j] == 0.0 and _side(k, j, b.results[3 * j + i]) != 0.0:
                return True
    return False


@inner
def _right_hand(s: Record, k: Any, b: Any) -> None:
    """Compute currents and accelerations at the accepted point just behind its events."""
    present(s, k, b)
    _limit(s, k, b)


@inner
def _limit(s: Record, k: Any, b: Any) -> None:
    """Clamp the currents at the accepted point, and compute the accelerations."""
    for j in range(s.n):
        b.clamp[j] = _side(k, j, b.current[j])
        current = min(max(b.current[j], k.limit[j, 0]), k.limit[j, 1])
        s.tau[j] = s.torque_per_amp[j] * current
    if s.w.mode.located:
        find(s, b)
    else:
        evaluate(s, s.t, s.q, s.v, s.a)


@inner_inlined
def _interval(s: Record) -> _Interval:
    """Return the interval from the accepted point to the next event."""
    length = s.t_event - s.t
    finest = _FINEST
    while finest > 0 and math.ldexp(length, -finest) < _RESOLUTION_S:
        finest -= 1
    return _Interval(s.t, length, finest)


@inner_inlined
def _time(s: Record, interval: _Interval, position: int) -> float:
    if position == _PARTS:
        return float(s.t_event)
    return float(interval.start + interval.length * position / _PARTS)


@inner_inlined
def _level(interval: _Interval, position: int, longest: float) -> int:
    """Return the level of the largest step that lies on the grid and is at most `longest` [s]."""
    level = 0
    while position & ((_PARTS >> level) - 1) != 0 or math.ldexp(interval.length, -level) > longest * (
        1 + 1e-9
    ):
        level += 1
    return level


@inner_inlined
def _longest(s: Record, wish: float, jump: float, first: float, watch: bool) -> float:
    """Return the longest step [s] that is allowed: behind a jump, near a limit, over a ramp of the gains."""
    longest = min(wish, s.steps.longest)
    if s.t - jump < s.steps.fresh:
        longest = min(longest, max(first, s.t - jump))
    if watch:
        longest = min(longest, s.c.period / _WATCH_STEPS)
    if gains_ramp(s):
        longest = min(longest, ramp_step(s))
    return float(longest)


@inner_inlined
def _take(
    s: Record, k: Any, b: Any, interval: _Interval, level: int, watch: bool, wish: float, until: float
) -> _Trial:
    """Shorten a step until its error, the motors' limits, friction and stops let it be accepted."""
    length = interval.length
    while True:
        if level > _LEVELS - 2:
            s.fault = _COLLAPSED
            return _Trial(level, 0.0, 0.0, watch, wish, until)
        h = math.ldexp(length, -level)
        error = attempt(s, k, b, slot_of(k, h), s.t, h, s.steps.tol)
        if not error <= s.steps.tol:
            s.rejected += 1
            level += 2 if error > 1e3 * s.steps.tol else 1
            wish = math.ldexp(length, -level)
            guess(s, b, wish)
            continue
        if not watch and _watched(s, k, b):
            watch = True
            _right_hand(s, k, b)
            while math.ldexp(length, -level) > s.c.period / _WATCH_STEPS:
                level += 1
            s.history = 0
            guess(s, b, math.ldexp(length, -level))
            continue
        if watch and level < _LOCATED and _crosses(s, k, b):
            level += 1
            guess(s, b, math.ldexp(length, -level))
            continue
        if s.w.mode.located and level < interval.finest:
            share = first_crossing(s, b, h)
            if share <= 1.0:
                s.rejected += 1
                until = s.t + share * h
                level += 1
                while level < interval.finest and math.ldexp(length, -level) > share * h:
                    level += 1
                guess(s, b, math.ldexp(length, -level))
                continue
        return _Trial(level, h, error, watch, wish, until)


@inner_inlined
def _wish(s: Record, error: float, h: float, wish: float) -> float:
    """Return the step [s] to try next after one of length `h` with this error."""
    share = error / (_SAFETY * s.steps.tol)
    grow = _GROWTH if share * _GROWTH**_ORDER < 1.0 else share ** (-1.0 / _ORDER)
    # an event that cuts a step short is no reason against the longer ones before it
    return float(h * grow if grow < 1.0 else max(wish, h * grow))


@inner_inlined
def _pass_events(s: Record, k: Any, b: Any, first: float, watch: bool) -> bool:
    """Process the events at the accepted point, with a row behind a jump of the DACs; whether they jumped."""
    jumped = process_events(s, s.t)
    if jumped:
        s.history = 0
    shown = jumped and first > 0.0 and s.dac.ramping == 0
    if watch or s.w.mode.located or shown:
        for j in range(s.n):
            b.before[j] = s.tau[j]
        _right_hand(s, k, b)
        if shown and moved(s, b):
            row(s)
    if watch:
        s.history = 0
    return bool(jumped)


@inner_inlined
def _note_error(s: Record, error: float) -> None:
    s.defect = error
    s.defect_max = max(s.defect_max, error)
    s.defect_sum += error


@inner_inlined
def _switch_limits(s: Record, k: Any, b: Any) -> None:
    """Clamp motors that have reached their limit at the accepted point, and free those that have left it."""
    for j in range(s.n):
        if _side(k, j, b.current[j]) != b.clamp[j]:
            _limit(s, k, b)
            s.history = 0
            break


@inner_inlined
def _switch_contacts(s: Record, k: Any, b: Any) -> bool:
    """Change what friction, stops and flanks do at an instant that is located; whether anything did."""
    if not strike(s, b):
        return False
    _limit(s, k, b)
    s.history = 0
    return True


@entry(int, int, int, int, float, result=bool)
def _steps(state: int, plan: int, step: int, exact: int, first: float) -> bool:
    """Go on by collocation; whether the run is over. Otherwise all is linear from the event now due on."""
    s = carray(record_at(state, STATE_KIND), 1)[0]
    k, b, x = lent(plan, PLAN_KIND), lent(step, STEP_KIND), lent(exact, EXACT_KIND)
    if s.points == 0 and s.w.mode.located:
        meet(s)
    _right_hand(s, k, b)
    s.history = 0
    if s.points == 0:
        record(s)
    interval, position = _interval(s), 0
    wish, jump, until = s.steps.longest, -_NEVER, _NEVER
    watch = behind = bool(0)  # as literals they would have `_take` and `_longest` compiled twice
    while s.fault == 0:
        if s.t_event <= s.t + s.steps.least:
            if s.t >= s.t_end - s.steps.least:
                return True
            if behind and not watch and rests(x, s.t + _WELL_BEHIND * s.c.period):
                return False
            if _pass_events(s, k, b, first, watch) and first > 0.0:
                wish, jump = min(wish, first), s.t
            interval, position = _interval(s), 0
            until = _NEVER
            behind = True
        longest = _longest(s, wish, jump, first, watch)
        if until - s.t > math.ldexp(interval.length, -interval.finest):
            longest = min(longest, until - s.t)
        else:
            until = _NEVER
        level = _level(interval, position, longest)
        guess(s, b, math.ldexp(interval.length, -level))
        trial = _take(s, k, b, interval, level, watch, wish, until)
        if s.fault != 0:
            break
        position += _PARTS >> trial.level
        accept(s, k, b, _time(s, interval, position), trial.h)
        _note_error(s, trial.error)
        shown = trial.h > _ROW_SHARE * s.c.period or trial.h > _CUT_SHORT * min(trial.wish, s.steps.longest)
        wish = _wish(s, trial.error, trial.h, trial.wish)
        watch, until = trial.watch, trial.until
        check(s)
        if watch:
            watch = _watched(s, k, b)
            _switch_limits(s, k, b)
        struck = False
        if s.w.mode.located and trial.level >= interval.finest and _switch_contacts(s, k, b):
            struck, until = True, _NEVER
        if struck or position == _PARTS or shown:
            record(s)
        else:
            s.points += 1
    if s.drain_address != 0:
        call_plain(s.drain_address)
    return True


def run(tables: Tables, first: float) -> None:
    """Write the start as a row and integrate to `t_end` of the state, or until a fault.

    Parameters
    ----------
    first
        Longest step [s] behind a jump of the DACs, for rows that show it; 0 for none.
    """
    # separate calls, so that neither compiles because of the other
    over = False
    while not over:
        over = bool(tables.linear[0]) and leaps(*tables.addresses, first)
        over = over or _steps(*tables.addresses, first)
