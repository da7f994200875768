"""What ngspice calls while it integrates: sources, step control, accepted points.

ngspice owns time. Per point it asks `synchronise` for the step, polls `source` for every EXTERNAL source at
the trial time, and hands the accepted values to `accepted`, where the linkage takes its step. Sample instants
are landed on exactly: the step is cut to them, and a breakpoint set beforehand makes ngspice take the first
step behind a DAC step with backward Euler.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.loop.columns import write_row
from cosim.loop.events import announce, process_events
from cosim.loop.ngspice_data import name_hash, vector_value
from cosim.loop.spice import friction_events, runge_kutta, stop_surfaces
from cosim.loop.spice.coupling import advance, bound_by_pole, fill, present, shortened
from cosim.loop.spice.watch import watch
from cosim.loop.state import NO_VOLTAGE, STATE, Fault
from cosim.types import Record
from mech.compiled import PointerTo, call_plain, callback, carray, doubles_at, inner, inner_spliced

_NOT_FINITE, _COLLAPSED, _CRAWLS = Fault.NOT_FINITE, Fault.STEP_COLLAPSED, Fault.CRAWLS
_NEVER = 1e300
#: A source's name in ngspice has a dot behind its letter where it stands inside a subcircuit; its length.
_DOT, _LONGEST = 46, 512


@inner
def _command_noise(s: Record, place: int) -> float:
    """Component noise [V] at the source `place`: none but at the pins cmd."""
    first = s.n + 2 * s.n * s.n
    if place < s.dac.first or s.dac.channel[place - s.dac.first] < first:
        return 0.0
    return float(s.component.now[s.component.inputs + s.dac.channel[place - s.dac.first] - first])


@inner
def _probe_noise(s: Record, letters: Any) -> float:
    """Component noise [V] of a probe inside the board, as it stands in series with X."""
    wanted = name_hash(letters, _LONGEST)
    for i in range(s.probe.count):
        if s.probe.name[i] == wanted:
            return float(s.probe.sign[i] * s.component.now[s.probe.input[i]])
    return 0.0


@callback(PointerTo(np.float64), float, PointerTo(np.uint8), np.int32, PointerTo(STATE))
def source(voltage: Any, t: float, name: Any, ident: int, user: Any) -> int:
    """GetVSRCData: sources are named v00, v01, ... in the order of `STATE.out`, probes by their path."""
    s = carray(user, 1)[0]
    if t != s.t_trial:
        fill(s, t)
    digits = carray(name, 3)
    s.calls.count += 1
    if s.component.address == 0:
        voltage[0] = s.out[(digits[1] - 48) * 10 + digits[2] - 48]
    elif digits[1] == _DOT:
        voltage[0] = _probe_noise(s, carray(name, _LONGEST))
    else:
        place = (digits[1] - 48) * 10 + digits[2] - 48
        voltage[0] = s.out[place] + _command_noise(s, place)
    return 0


@inner_spliced
def _within(t: float, h: float, end: float) -> float:
    """Return the step `h` [s], cut to the end of the run where it passes it.

    ngspice (from 44 on) would cut it to 1.1 of its least step short of the end: then no last step is
    possible, or (47) the rest is halved for ever.
    """
    if t < end < t + h:
        h = end - t
        while t + h > end:  # the sum is rounded
            h *= 1.0 - 2.3e-16
    return h


@callback(float, PointerTo(np.float64), float, np.int32, np.int32, np.int32, PointerTo(STATE))
def synchronise(t: float, delta: Any, old: float, redo: int, ident: int, where: int, user: Any) -> int:
    """GetSyncData: before a step (0) set its length; after one (1) have it redone where it is wrong.

    There `redo` says whether ngspice itself has rejected it; `t` is the end of a step that it has not.
    """
    s = carray(user, 1)[0]
    if where == 1:
        if redo == 0 and s.fault == 0 and s.running != 0 and t == s.t_trial and t > s.t:
            h = shortened(s, t - s.t)
            if h < t - s.t:
                delta[0] = h
                s.rejected += 1
                return 1
        s.rejected += redo
        delta[0] = _within(t, delta[0], s.t_end)
        return 0
    h = delta[0]
    if s.announced == 0:
        s.announced = 1
        announce(s, t + s.steps.least)
    if s.t_event <= t + s.steps.least and process_events(s, t):
        h = s.steps.first
    h = min(h, s.steps.longest, s.steps.couple, s.steps.pole)
    if s.p.backlash_on:
        h = runge_kutta.edge(s, h)
    if s.p.stops_on:
        h = stop_surfaces.edge(s, h)
    if s.w.mode.located:
        h = friction_events.edge(s, h)
    rest = s.t_event - t
    if rest > 0.0:
        if h > 0.999 * rest:
            h = rest
        elif h > 0.5 * rest:
            h = 0.5 * rest
    delta[0] = _within(t, h, s.t_end)
    if s.fault != 0:
        call_plain(s.drain_address)
    return 0


@callback(PointerTo(np.int64), np.int32, np.int32, PointerTo(STATE))
def accepted(data: Any, count: int, ident: int, user: Any) -> int:
    """SendData: the point is final; the linkage takes its step and the row is written."""
    s = carray(user, 1)[0]
    if s.running == 0:
        return 0
    vectors = carray(data, (2,))[1]
    t = vector_value(vectors, s.time_index)
    for j in range(s.n):
        s.tau[j] = s.torque_per_amp[j] * vector_value(vectors, s.current_index[j])
        if not abs(s.tau[j]) < _NEVER:
            s.fault = _NOT_FINITE
    step = t - s.t
    if t > s.t:
        if t != s.t_trial:
            fill(s, t)
        advance(s, t)
    else:
        present(s, t)
        s.history = 1
        for j in range(s.n):
            s.tau_old[0, j] = s.tau[j]
        if s.speeds > 0 or s.p.shaft_on:
            bound_by_pole(s)
    s.points += 1
    if s.points - s.points_before > s.steps.most:
        s.fault = _COLLAPSED
    if s.points == 1:
        s.calls.start = s.calls.count
    else:
        most = s.calls.free + s.calls.per_s * t + s.calls.per_event * (s.discontinuities + s.knots.next)
        if s.calls.count - s.calls.start > most:
            s.fault = _CRAWLS
    row = carray(doubles_at(s.rows.address + 8 * s.columns * s.rows.used), (s.columns,))
    at = write_row(s, t, row)
    for i in range(s.nodes):
        value = vector_value(vectors, s.node.index[i])
        s.node.volts[i] = value
        if not abs(value) <= s.node.peak[i]:
            s.node.peak[i] = abs(value)
            if s.fault == 0 and not abs(value) < NO_VOLTAGE:  # a device that ran away is the cause
                s.fault = _NOT_FINITE
        if abs(value) >= s.node.limit[i]:
            s.node.clipped[i] += step
        watch(s, i, value, t)
        if i < s.nodes_recorded:
            row[at] = value
            at += 1
    s.rows.used += 1
    if s.rows.used == s.rows.capacity or s.fault != 0:
        call_plain(s.drain_address)
    return 0
