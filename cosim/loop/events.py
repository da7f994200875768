"""Samples, DACs and other events of both loops - compiled."""

from __future__ import annotations

from cosim.loop.computer import law, read_encoders, to_volts
from cosim.loop.pin_voltages import is_gain
from cosim.loop.state import QUEUE, STATE, Fault
from cosim.types import Record
from mech.compiled import call_plain, call_with_time, carray, doubles_at, entry, inner, inner_inlined

_SAMPLE_LOST = Fault.SAMPLE_LOST
#: By such a share of the largest voltage beside it, angles included, the computer's rounding may move one;
#: 1e-14 was seen, and a step of 30 bits is 1e-9.
_ROUNDING = 1e-12


@inner_inlined
def instant(s: Record, tick: int) -> float:
    """Return when the computer samples [s]: an integer tick of its clock, early or late by its jitter."""
    at = tick * s.c.period
    if s.clock.jitter != 0:
        at += carray(doubles_at(s.clock.jitter), (s.clock.last_tick + 1,))[tick]
    return float(at)


@inner
def _release(s: Record, group: int) -> bool:
    """Let the oldest waiting sample reach the DACs of a group; True if a driven voltage changes."""
    slot = s.queue.taken[group] % QUEUE
    start = s.queue.time[slot] + (s.dac.skew if group == 1 else 0.0)
    s.queue.taken[group] += 1
    part = 1.0  # of the ramp before, which a settling time longer than the period leaves unfinished
    if s.dac.ramping:
        part = min(max((start - s.dac.start[group]) / s.dac.settle, 0.0), 1.0)
    s.dac.start[group] = start
    changed, largest = False, 0.0
    for j in range(s.c.n):
        largest = max(largest, s.c.v_rad * abs(s.x.q[j]))
    for i in range(s.dac.count):
        k = s.dac.channel[i]
        if is_gain(s, k) == (group == 0):
            largest = max(largest, abs(s.queue.volts[slot, k]), abs(s.dac.target[k]))
    for i in range(s.dac.count):
        k = s.dac.channel[i]
        if is_gain(s, k) != (group == 0):
            continue
        reached = (
            s.dac.target[k] if part == 1.0 else s.dac.before[k] + part * (s.dac.target[k] - s.dac.before[k])
        )
        s.dac.before[k] = reached
        # rounding of a converter without steps is no jump: each would have the integrator start afresh
        moves = abs(s.queue.volts[slot, k] - reached) > _ROUNDING * largest
        s.dac.target[k] = s.queue.volts[slot, k] if moves else reached
        changed = changed or s.dac.target[k] != s.dac.before[k]
        if s.dac.settle == 0.0:
            s.out[s.dac.first + i] = s.dac.target[k]
    if s.dac.settle > 0.0 and changed:
        s.dac.ramping = 1
    return changed


@inner
def compute_sample(s: Record) -> None:
    """Compute one sample at the present state; its voltages wait in the queue for the DACs."""
    read_encoders(s.c, s.x, s.clock.tick, s.q[s.motor :])
    if s.law_address != 0:
        call_plain(s.law_address)
    else:
        law(s.c, s.known, s.x)
    slot = s.queue.put % QUEUE
    to_volts(s.c, s.x, s.queue.volts[slot])
    s.queue.time[slot] = (s.clock.tick + s.clock.delay_ticks) * s.c.period + s.clock.delay_s
    if s.clock.jitter != 0:
        s.queue.time[slot] += instant(s, s.clock.tick) - s.clock.tick * s.c.period
    s.queue.put += 1
    if s.queue.put - min(s.queue.taken[0], s.queue.taken[1]) > QUEUE:
        s.fault = _SAMPLE_LOST
    s.clock.tick += 1
    s.points_before = s.points
    _write_sample(s)


@inner
def _write_sample(s: Record) -> None:
    n = s.n
    width = 8 + 4 * n + 2 * n * n
    row = carray(doubles_at(s.samples.address + 8 * width * s.samples.used), (width,))
    x = s.x
    row[0], row[1], row[2], row[3] = x.tick, instant(s, x.tick), x.contact, x.pen
    row[4], row[5], row[6], row[7] = x.saturated, x.unsolved, x.r[0], x.r[1]
    at = 8
    for j in range(n):
        row[at], row[at + n], row[at + 2 * n], row[at + 3 * n] = x.q[j], x.v[j], x.u[j], x.cmd[j]
        at += 1
    at += 3 * n
    for i in range(n):
        for j in range(n):
            row[at], row[at + n * n] = x.ksp[i, j], x.ksd[i, j]
            at += 1
    s.samples.used += 1
    if s.samples.used == s.samples.capacity:
        call_plain(s.drain_address)


@inner
def next_event(s: Record) -> float:
    """Return the time of the next instant that the step must land on."""
    at = s.t_end
    if s.clock.tick <= s.clock.last_tick:
        at = min(at, instant(s, s.clock.tick))
    for group in range(2):
        if s.queue.taken[group] < s.queue.put:
            slot = s.queue.taken[group] % QUEUE
            at = min(at, s.queue.time[slot] + (s.dac.skew if group == 1 else 0.0))
    if s.dac.ramping:
        for group in range(2):
            end = s.dac.start[group] + s.dac.settle
            if end > s.t + s.steps.least:
                at = min(at, end)
    if s.noise.address != 0:
        at = min(at, (s.noise.tick + 1) * s.noise.dt)
    if s.component.address != 0:
        at = min(at, (s.component.tick + 1) * s.component.dt)
    if s.knots.next < s.knots.count:
        at = min(at, carray(doubles_at(s.knots.address), (s.knots.count,))[s.knots.next])
    return float(at)


@inner
def announce(s: Record, now: float) -> None:
    """Tell ngspice where the DACs will jump next, so that it starts afresh there (order one)."""
    if s.breakpoint_address == 0:  # the linear loop knows
        return
    if s.clock.tick <= s.clock.last_tick:
        call_with_time(s.breakpoint_address, instant(s, s.clock.tick))
    change = s.queue.time[(s.queue.put - 1) % QUEUE]
    if change > now:
        call_with_time(s.breakpoint_address, change)
    if s.dac.skew > 0.0:
        call_with_time(s.breakpoint_address, change + s.dac.skew)


@entry(STATE)
def begin(s: Record) -> None:
    """Compute sample 0, before ngspice finds the operating point: without delay it is there at power-up.

    A delayed one finds the DACs out of contact: gains and commands zero, equilibria at the pose.
    """
    for j in range(s.n):
        s.dac.target[j] = s.c.v_rad * s.q[s.motor + j]
    compute_sample(s)
    for group in range(2):
        if s.queue.time[0] + (s.dac.skew if group == 1 else 0.0) <= s.steps.least:
            _release(s, group)
    s.dac.ramping = 0
    for i in range(s.dac.count):
        k = s.dac.channel[i]
        s.dac.before[k] = s.dac.target[k]
        s.out[s.dac.first + i] = s.dac.target[k]
    s.t_event = next_event(s)


@inner
def _watch_rest(s: Record, t: float) -> None:
    """End the run when the joints have been at rest for long enough."""
    for j in range(s.n):
        if not abs(s.v[j]) < s.rest.speed:
            s.rest.moved = t
    if t - s.rest.moved >= s.rest.time:
        s.rest.rested = 1
        s.t_end = t


@inner
def process_events(s: Record, t: float) -> bool:
    """Do everything due at the accepted time `t`: noise grid, ramp ends, samples, DACs."""
    now = t + s.steps.least
    if s.noise.address != 0 and (s.noise.tick + 1) * s.noise.dt <= now:
        s.noise.tick += 1
        s.history = min(s.history, 1)
    if s.component.address != 0 and (s.component.tick + 1) * s.component.dt <= now:
        s.component.tick += 1
        s.history = min(s.history, 1)
    if (
        s.knots.next < s.knots.count
        and carray(doubles_at(s.knots.address), (s.knots.count,))[s.knots.next] <= now
    ):
        s.knots.next += 1
        s.history = min(s.history, 1)
    if s.dac.ramping and max(s.dac.start[0], s.dac.start[1]) + s.dac.settle <= now:
        for i in range(s.dac.count):
            s.out[s.dac.first + i] = s.dac.target[s.dac.channel[i]]
        s.dac.ramping = 0
        s.history = min(s.history, 1)
    if s.clock.tick <= s.clock.last_tick and instant(s, s.clock.tick) <= now:
        compute_sample(s)
        announce(s, now)
        if s.rest.time > 0.0:
            _watch_rest(s, t)
    jumped = False
    for group in range(2):
        while s.queue.taken[group] < s.queue.put:
            slot = s.queue.taken[group] % QUEUE
            if s.queue.time[slot] + (s.dac.skew if group == 1 else 0.0) > now:
                break
            jumped = _release(s, group) or jumped
    if jumped:
        s.discontinuities += 1
        s.history = 0 if s.dac.settle == 0.0 else min(s.history, 1)
    s.t_event = next_event(s)
    return jumped
