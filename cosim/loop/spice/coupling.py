"""Samples, DACs and other events, and the step of linkage and sources in lockstep with ngspice - compiled.

Events are those of our own time loop as well; what ngspice calls is in `callbacks.py`.
"""

from __future__ import annotations

from typing import Any

from numba import carray, njit

from cosim.loop.computer import law, read_encoders, to_volts
from cosim.loop.numba_calls import call_plain, call_with_time, doubles_at
from cosim.loop.pin_voltages import component
from cosim.loop.spice import runge_kutta, stop_surfaces
from cosim.loop.spice.adams import correct, predict
from cosim.loop.state import QUEUE, Fault
from mech.kernels import dynamics, solve
from mech.shaft import engage, windup_energy

_DIVERGED, _SAMPLE_LOST, _RAN_AWAY = Fault.DIVERGED, Fault.SAMPLE_LOST, Fault.RAN_AWAY
#: A predicted angle this wrong [rad] after one step is no prediction: the coupling has diverged.
_DIVERGENCE_RAD = 0.5
#: No joint of a haptic device turns this fast [rad/s], ten times the fastest start that a scene may state.
RUNAWAY_RAD_PER_S = 1e5
#: The next step aims at this share of the tolerance, and grows at most this much.
_SAFETY, _GROWTH = 0.8, 4.0
#: A step whose defect is so many times the tolerance is taken again, at least this much shorter.
_REDONE, _SHORTER = 4.0, 0.1
#: Share of the time constant of the coupled pole that a step may be.
_POLE_SHARE = 0.5

Record = Any


@njit(cache=True, error_model="numpy")
def noise_at(s: Record, t: float, joint: int) -> float:
    """Return what the potentiometer of a joint adds to its angle [rad]: linear in time, then in angle."""
    value = 0.0
    if s.noise != 0:
        table = carray(doubles_at(s.noise), (s.noise_rows * s.n,))
        x = t / s.noise_dt - s.noise_tick
        at = s.noise_tick * s.n + joint
        value += table[at] + x * (table[at + s.n] - table[at])
    if s.position_noise != 0:
        table = carray(doubles_at(s.position_noise), (s.position_points * s.n,))
        x = (s.q_trial[joint] - s.position_lo) / s.position_step
        x = min(max(x, 0.0), s.position_points - 1.000001)
        k = int(x)
        at = k * s.n + joint
        value += table[at] + (x - k) * (table[at + s.n] - table[at])
    return value


@njit(cache=True, error_model="numpy", forceinline=True)
def instant(s: Record, tick: int) -> float:
    """Return when the computer samples [s]: an integer tick of its clock, early or late by its jitter."""
    at = tick * s.c.period
    if s.jitter != 0:
        at += carray(doubles_at(s.jitter), (s.last_tick + 1,))[tick]
    return float(at)


@njit(cache=True, error_model="numpy")
def _is_gain(s: Record, channel: int) -> bool:
    return bool(s.n <= channel < s.n + 2 * s.n * s.n)


@njit(cache=True, error_model="numpy")
def fill(s: Record, t: float) -> None:
    """Set the values of all EXTERNAL sources at the trial time `t`."""
    n = s.n
    s.t_trial = t
    if s.p.shaft_on:
        runge_kutta.extrapolate(s, t - s.t, s.q_trial, s.v_trial)
    else:
        predict(s, t - s.t, s.q_trial, s.v_trial)
    for j in range(n):
        s.out[j] = s.q_trial[j]
        if s.noise != 0 or s.position_noise != 0:
            s.out[j] += noise_at(s, t, j)
    for j in range(s.speeds):
        s.out[n + j] = s.gear * s.v_trial[s.motor + j]
    if s.component != 0:
        for i in range(s.component_inputs + n):
            s.component_now[i] = component(s, t, i)
    if s.ramping:
        for i in range(s.dacs):
            k = s.dac_channel[i]
            part = (t - s.dac_start[0 if _is_gain(s, k) else 1]) / s.settle
            part = min(max(part, 0.0), 1.0)
            s.out[s.dac_first + i] = s.dac_from[k] + part * (s.dac_to[k] - s.dac_from[k])


@njit(cache=True, error_model="numpy")
def name_hash(letters: Any, count: int) -> int:
    """Return a number for the first `count` letters of a name, or for those before its end."""
    found = 0
    for i in range(count):
        if letters[i] == 0:
            break
        found = (found * 257 + letters[i]) % 9007199254740881  # the largest prime below 2^53
    return found


@njit(cache=True, error_model="numpy")
def _release(s: Record, group: int) -> bool:
    """Let the oldest waiting sample reach the DACs of a group; True if a driven voltage changes."""
    slot = s.queue_out[group] % QUEUE
    start = s.queue_time[slot] + (s.skew if group == 1 else 0.0)
    s.queue_out[group] += 1
    part = 1.0  # of the ramp before, which a settling time longer than the period leaves unfinished
    if s.ramping:
        part = min(max((start - s.dac_start[group]) / s.settle, 0.0), 1.0)
    s.dac_start[group] = start
    changed = False
    for i in range(s.dacs):
        k = s.dac_channel[i]
        if _is_gain(s, k) != (group == 0):
            continue
        reached = s.dac_to[k] if part == 1.0 else s.dac_from[k] + part * (s.dac_to[k] - s.dac_from[k])
        s.dac_from[k] = reached
        s.dac_to[k] = s.queue[slot, k]
        changed = changed or s.dac_to[k] != s.dac_from[k]
        if s.settle == 0.0:
            s.out[s.dac_first + i] = s.dac_to[k]
    if s.settle > 0.0 and changed:
        s.ramping = 1
    return changed


@njit(cache=True, error_model="numpy")
def compute_sample(s: Record) -> None:
    """Compute one sample at the present state; its voltages wait in the queue for the DACs."""
    read_encoders(s.c, s.x, s.tick, s.q[s.motor :])
    if s.law_address != 0:
        call_plain(s.law_address)
    else:
        law(s.c, s.p, s.x)
    slot = s.queue_in % QUEUE
    to_volts(s.c, s.x, s.queue[slot])
    s.queue_time[slot] = (s.tick + s.delay_ticks) * s.c.period + s.delay_s
    if s.jitter != 0:
        s.queue_time[slot] += instant(s, s.tick) - s.tick * s.c.period
    s.queue_in += 1
    if s.queue_in - min(s.queue_out[0], s.queue_out[1]) > QUEUE:
        s.fault = _SAMPLE_LOST
    s.tick += 1
    s.points_before = s.points
    _write_sample(s)


@njit(cache=True, error_model="numpy")
def _write_sample(s: Record) -> None:
    n = s.n
    width = 8 + 4 * n + 2 * n * n
    row = carray(doubles_at(s.samples + 8 * width * s.samples_used), (width,))
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
    s.samples_used += 1
    if s.samples_used == s.samples_capacity:
        call_plain(s.drain_address)


@njit(cache=True, error_model="numpy")
def next_event(s: Record) -> float:
    """Return the time of the next instant that the step must land on."""
    at = s.t_end
    if s.tick <= s.last_tick:
        at = min(at, instant(s, s.tick))
    for group in range(2):
        if s.queue_out[group] < s.queue_in:
            slot = s.queue_out[group] % QUEUE
            at = min(at, s.queue_time[slot] + (s.skew if group == 1 else 0.0))
    if s.ramping:
        for group in range(2):
            end = s.dac_start[group] + s.settle
            if end > s.t + s.delta_min:
                at = min(at, end)
    if s.noise != 0:
        at = min(at, (s.noise_tick + 1) * s.noise_dt)
    if s.component != 0:
        at = min(at, (s.component_tick + 1) * s.component_dt)
    if s.knot < s.knots:
        at = min(at, carray(doubles_at(s.knot_times), (s.knots,))[s.knot])
    return float(at)


@njit(cache=True, error_model="numpy")
def announce(s: Record, now: float) -> None:
    """Tell ngspice where the DACs will jump next, so that it starts afresh there (order one)."""
    if s.breakpoint_address == 0:  # our own loop knows
        return
    if s.tick <= s.last_tick:
        call_with_time(s.breakpoint_address, instant(s, s.tick))
    change = s.queue_time[(s.queue_in - 1) % QUEUE]
    if change > now:
        call_with_time(s.breakpoint_address, change)
    if s.skew > 0.0:
        call_with_time(s.breakpoint_address, change + s.skew)


@njit(cache=True, error_model="numpy")
def begin(s: Record) -> None:
    """Compute sample 0, before ngspice finds the operating point: without delay it is there at power-up.

    A delayed one finds the DACs out of contact: gains and commands zero, equilibria at the pose.
    """
    for j in range(s.n):
        s.dac_to[j] = s.c.v_rad * s.q[s.motor + j]
    compute_sample(s)
    for group in range(2):
        if s.queue_time[0] + (s.skew if group == 1 else 0.0) <= s.delta_min:
            _release(s, group)
    s.ramping = 0
    for i in range(s.dacs):
        k = s.dac_channel[i]
        s.dac_from[k] = s.dac_to[k]
        s.out[s.dac_first + i] = s.dac_to[k]
    s.t_event = next_event(s)


@njit(cache=True, error_model="numpy")
def _watch_rest(s: Record, t: float) -> None:
    """End the run when the joints have been at rest for long enough."""
    for j in range(s.n):
        if not abs(s.v[j]) < s.rest_speed:
            s.moved = t
    if t - s.moved >= s.rest_time:
        s.rested = 1
        s.t_end = t


@njit(cache=True, error_model="numpy")
def process_events(s: Record, t: float) -> bool:
    """Do everything due at the accepted time `t`: noise grid, ramp ends, samples, DACs."""
    now = t + s.delta_min
    if s.noise != 0 and (s.noise_tick + 1) * s.noise_dt <= now:
        s.noise_tick += 1
        s.history = min(s.history, 1)
    if s.component != 0 and (s.component_tick + 1) * s.component_dt <= now:
        s.component_tick += 1
        s.history = min(s.history, 1)
    if s.knot < s.knots and carray(doubles_at(s.knot_times), (s.knots,))[s.knot] <= now:
        s.knot += 1
        s.history = min(s.history, 1)
    if s.ramping and max(s.dac_start[0], s.dac_start[1]) + s.settle <= now:
        for i in range(s.dacs):
            s.out[s.dac_first + i] = s.dac_to[s.dac_channel[i]]
        s.ramping = 0
        s.history = min(s.history, 1)
    if s.tick <= s.last_tick and instant(s, s.tick) <= now:
        compute_sample(s)
        announce(s, now)
        if s.rest_time > 0.0:
            _watch_rest(s, t)
    jumped = False
    for group in range(2):
        while s.queue_out[group] < s.queue_in:
            slot = s.queue_out[group] % QUEUE
            if s.queue_time[slot] + (s.skew if group == 1 else 0.0) > now:
                break
            jumped = _release(s, group) or jumped
    if jumped:
        s.discontinuities += 1
        s.history = 0 if s.settle == 0.0 else min(s.history, 1)
    s.t_event = next_event(s)
    return jumped


@njit(cache=True, error_model="numpy")
def evaluate(s: Record, t: float, q: Any, v: Any, a_out: Any) -> None:
    """Find the accelerations [rad/s^2] at a state, the motors' torques `s.tau` given."""
    dynamics(s.p, s.op, t, q, v, s.tau, a_out, s.w)


@njit(cache=True, error_model="numpy")
def bound_by_pole(s: Record) -> None:
    """Set the longest stable step of the explicit back-EMF coupling: 0.5 m_eff / b_eff.

    The fastest rate is an eigenvalue of M^-1 B with the mass matrix of the present pose; M and B being
    positive, their sum, the trace, bounds it. Behind shafts the mass is that of the rotors alone, and the
    shafts bound the step as well.
    """
    rates = 0.0
    if s.p.shaft_on:
        for j in range(s.n):
            rates += s.b_emf[j, j] / s.p.rotor[j]
        s.h_pole = min(s.h_max, runge_kutta.longest(s))
        if rates > 0.0:
            s.h_pole = min(s.h_pole, _POLE_SHARE / rates)
        return
    for j in range(s.n):
        for i in range(s.n):
            s.column[i] = s.b_emf[i, j]
        solve(s.n, s.w.mass, s.column, s.w.factor)
        rates += s.column[j]
    s.h_pole = min(s.h_max, _POLE_SHARE / rates) if rates > 0.0 else s.h_max


@njit(cache=True, error_model="numpy", forceinline=True)
def _weight(s: Record, h: float, inside: int) -> float:
    """Time [s] by which an error of the speed counts as one of the angle: the step, in a stop the period.

    A joint leaves its stop with the speed that the stop has given it, and nothing corrects that in flight.
    """
    return float(max(h, s.c.period)) if inside != 0 else h


@njit(cache=True, error_model="numpy")
def advance(s: Record, t: float) -> None:
    """Take the linkage to the accepted time `t`, the motors' torques there being in `s.tau`."""
    h = t - s.t
    inside = stop_surfaces.inside(s) if s.p.stops_on else 0
    if s.p.shaft_on:
        s.defect = runge_kutta.advance(s, h)
    else:
        evaluate(s, t, s.q_trial, s.v_trial, s.a_trial)
        s.defect = correct(s, h, s.a_trial, _weight(s, h, inside), True)
        for j in range(s.n):
            s.tau_old[1, j] = s.tau_old[0, j]
            s.tau_old[0, j] = s.tau[j]
    for j in range(s.coordinates):
        s.a_old[j] = s.a[j]
    s.used = s.history
    s.history = min(s.history + 1, 2)
    if s.p.backlash_on:
        changed, lost = engage(s.p, t, s.q, s.v, s.w)
        s.work[5] -= lost
        if changed:
            s.history = min(s.history, 1)
    if s.p.stops_on and stop_surfaces.inside(s) != inside:
        s.history = min(s.history, 1)  # the stop's torque has a kink there, not a jump
    evaluate(s, t, s.q, s.v, s.a)
    s.t = t
    s.h_old = h
    if not s.defect < _DIVERGENCE_RAD:
        s.fault = _DIVERGED
    for j in range(s.coordinates):
        if abs(s.v[j]) > RUNAWAY_RAD_PER_S:
            s.fault = _RAN_AWAY
    s.defect_max = max(s.defect_max, s.defect)
    s.defect_sum += s.defect
    # the predictor's local error is of third order: aim the next step at the tolerance
    share = s.defect / (_SAFETY * s.tol)
    grow = _GROWTH if share * _GROWTH**3 < 1.0 else share ** (-1.0 / 3.0)
    s.h_couple = h * grow
    if s.speeds > 0 or s.p.shaft_on:
        bound_by_pole(s)


@njit(cache=True, error_model="numpy", forceinline=True)
def shortened(s: Record, h: float) -> float:
    """Return the step [s] with which the trial step `h` should be taken again; `h` where it is good.

    What is nonlinear in the mechanics, a stop or friction, can make a step wrong that looked good from its
    start. The circuit's torque at the end is not to be had before the point is accepted: it is extrapolated
    along its last slope. Behind a jump the acceleration at the start is of no use, and the step short anyway.
    """
    if s.p.shaft_on or s.history == 0:
        return h
    for j in range(s.n):
        slope = (s.tau_old[0, j] - s.tau_old[1, j]) / s.h_old if s.history > 1 else 0.0
        s.tau[j] = s.tau_old[0, j] + h * slope
    evaluate(s, s.t_trial, s.q_trial, s.v_trial, s.a_trial)
    inside = stop_surfaces.inside(s) if s.p.stops_on else 0
    share = correct(s, h, s.a_trial, _weight(s, h, inside), False) / (_SAFETY * s.tol)
    if not share > _REDONE / _SAFETY:
        return h
    return float(max(h * max(share ** (-1.0 / 3.0), _SHORTER), s.delta_min))


@njit(cache=True, error_model="numpy")
def write_row(s: Record, t: float, row: Any) -> int:
    """Write the accepted point into `row`, in the order of `setup.columns`; return where the nodes begin."""
    n = s.n
    row[0] = t
    row[1] = s.used
    row[2], row[3], row[4], row[5] = s.w.r[0], s.w.r[1], s.w.f_op[0], s.w.f_op[1]
    at = 6
    for j in range(n):
        row[at] = s.q[j]
        row[at + n] = s.v[j]
        row[at + 2 * n] = s.a[j]
        row[at + 3 * n] = s.tau[j] / s.torque_per_amp
        row[at + 4 * n] = s.w.tau_visc[j]
        row[at + 5 * n] = s.w.tau_coul[j]
        row[at + 6 * n] = s.w.tau_stop[j]
        row[at + 7 * n] = s.out[j]
        at += 1
    at += 7 * n
    if s.p.shaft_on:
        row[at + 3 * n], row[at + 3 * n + 1] = 0.0, windup_energy(s.p, s.q, s.w)
        for j in range(n):
            rate = s.v[n + j] - s.v[j]
            row[at + j], row[at + n + j], row[at + 2 * n + j] = s.q[n + j], s.v[n + j], s.w.tau_shaft[j]
            row[at + 3 * n] -= s.w.tau_loss[j] * rate
        at += 3 * n + 2
    for i in range(s.dacs):
        row[at] = s.out[s.dac_first + i]
        at += 1
    return int(at)
