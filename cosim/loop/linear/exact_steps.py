"""From event to event by one matrix each, while a scene is linear between its events (`exact_slider.py`).

Without rows a step goes over the ramp of the DACs as well, which is a part of its matrix; where a
multiplier's gain ramps too, X times the gain is no linear system with constant coefficients, and the ramp is
stepped over. With rows the interval is cut into binary fractions, so that a handful of matrices serves a run.
"""

from __future__ import annotations

import math
from typing import Any

from cosim.loop.equations_of_motion import evaluate
from cosim.loop.events import next_event, process_events
from cosim.loop.linear.exact_slider import EXACT_KIND, PLAN_KIND, STATE_KIND, STEP_KIND, land, leap, rests
from cosim.loop.linear.gauss_step import near, present
from cosim.loop.linear.recording import check, moved, record, row
from cosim.loop.pin_voltages import gains_ramp, ramp_step
from cosim.types import Record
from mech.compiled import carray, entry, inner_inlined, lent, record_at

#: An interval is cut into 2^_LEVELS parts at most.
_LEVELS = 40
_PARTS = 1 << _LEVELS
#: Steps grow at most so much from one to the next.
_GROWTH = 8.0


@inner_inlined
def _behind(s: Record) -> float:
    """Return the next event behind the end of the ramp that begins now; 0 when the step must not go there."""
    if s.dac.skew != 0.0 or abs(s.t - s.dac.start[1]) > s.steps.least:
        return 0.0
    s.dac.ramping = 0
    at = next_event(s)
    s.dac.ramping = 1
    if at - s.t <= s.dac.settle or at - s.t > s.steps.longest * (1 + 1e-9):
        return 0.0
    return float(at)


@inner_inlined
def _right_hand(s: Record, k: Any, b: Any, wanted: bool) -> None:
    """Find the current, and for a row the acceleration, at the accepted point just behind its events."""
    present(s, k, b)
    if wanted:
        current = min(max(b.current[0], k.limit[0, 0]), k.limit[0, 1])
        s.tau[0] = s.torque_per_amp[0] * current
        evaluate(s, s.t, s.q, s.v, s.a)


@entry(int, int, int, int, float, result=bool)
def leaps(state: int, plan: int, step: int, exact: int, first: float) -> bool:
    """Go on while each step is one matrix; whether the run is over, by its end or a fault.

    Otherwise the scene stops being linear at the accepted point, or a motor comes near its limit: collocation
    must go on from there. State and tables come by their addresses; `first` [s] is the longest step
    behind a jump of the DACs, 0 for none.
    """
    s = carray(record_at(state, STATE_KIND), 1)[0]
    k, b, x = lent(plan, PLAN_KIND), lent(step, STEP_KIND), lent(exact, EXACT_KIND)
    wanted = s.rows.capacity > 0
    if s.points == 0:
        _right_hand(s, k, b, wanted)
        record(s)
    if near(k, 0, b.current[0]):
        return False
    s.history = 0
    b.scale[0] = 0.0
    t0, length, position = s.t, s.t_event - s.t, 0
    wish, jump = s.steps.longest, -math.inf
    while s.fault == 0:
        if s.t_event <= s.t + s.steps.least:
            if s.t >= s.t_end - s.steps.least:
                return True
            if process_events(s, s.t) and first > 0.0:
                wish, jump = min(wish, first), s.t
                if s.dac.ramping == 0:
                    b.before[0] = s.tau[0]
                    _right_hand(s, k, b, wanted)
                    if moved(s, b):
                        row(s)
            t0, length, position = s.t, s.t_event - s.t, 0
            if s.t_event <= s.t + s.steps.least:  # the run has come to rest
                continue
        longest, ramp = min(wish, s.steps.longest), 0.0
        if s.t - jump < s.steps.fresh:
            longest = min(longest, max(first, s.t - jump))
        if s.dac.ramping:
            if gains_ramp(s):
                longest = min(longest, ramp_step(s))
            elif not wanted and position == 0:
                behind = _behind(s)
                if behind > 0.0:
                    length, ramp = behind - s.t, s.dac.settle
        level, h = 0, length
        if position != 0 or h > longest * (1 + 1e-9):
            while position & ((_PARTS >> level) - 1) != 0 or h > longest * (1 + 1e-9):
                level += 1
                h = math.ldexp(length, -level)
        if not rests(x, s.t + 0.5 * h) or not leap(s, k, b, x, s.t, h, ramp) or near(k, 0, b.results[3]):
            return False
        position += _PARTS >> level
        if ramp > 0.0:  # over, and no event any more
            s.dac.ramping = 0
            s.t_event = next_event(s)
        land(s, k, b, x, float(s.t_event) if position == _PARTS else t0 + length * position / _PARTS)
        wish = max(wish, _GROWTH * h)
        check(s)
        record(s)
    return True
