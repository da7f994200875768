"""The step of linkage and sources in lockstep with ngspice - compiled.

What ngspice calls is in `callbacks.py`.
"""

from __future__ import annotations

from cosim.loop.equations_of_motion import RUNAWAY_RAD_PER_S, evaluate
from cosim.loop.pin_voltages import component, is_gain, noise_at
from cosim.loop.spice import friction_events, runge_kutta, stop_surfaces
from cosim.loop.spice.adams import correct, predict
from cosim.loop.state import STATE, Fault
from cosim.types import Record
from mech.compiled import entry, inner, inner_inlined
from mech.kernels import solve
from mech.shaft import engage

_DIVERGED, _RAN_AWAY = Fault.DIVERGED, Fault.RAN_AWAY
#: A predicted angle this wrong [rad] after one step is no prediction: the coupling has diverged.
_DIVERGENCE_RAD = 0.5
#: The next step aims at this share of the tolerance, and grows at most this much.
_SAFETY, _GROWTH = 0.8, 4.0
#: A step whose defect is so many times the tolerance is taken again, at least this much shorter.
_REDONE, _SHORTER = 4.0, 0.1
#: Share of the time constant of the coupled pole that a step may be.
_POLE_SHARE = 0.5


@entry(STATE, float)
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
        if s.noise.address != 0 or s.position_noise.address != 0:
            s.out[j] += noise_at(s, t, j)
    for j in range(s.speeds):
        s.out[n + j] = s.gear * s.v_trial[s.motor + j]
    if s.component.address != 0:
        for i in range(s.component.inputs + n):
            s.component.now[i] = component(s, t, i)
    if s.dac.ramping:
        for i in range(s.dac.count):
            k = s.dac.channel[i]
            part = (t - s.dac.start[0 if is_gain(s, k) else 1]) / s.dac.settle
            part = min(max(part, 0.0), 1.0)
            s.out[s.dac.first + i] = s.dac.before[k] + part * (s.dac.target[k] - s.dac.before[k])


@inner
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
        s.steps.pole = min(s.steps.longest, runge_kutta.longest(s))
        if rates > 0.0:
            s.steps.pole = min(s.steps.pole, _POLE_SHARE / rates)
        return
    for j in range(s.n):
        for i in range(s.n):
            s.column[i] = s.b_emf[i, j]
        solve(s.n, s.w.mass, s.column, s.w.scratch.factor)
        rates += s.column[j]
    s.steps.pole = min(s.steps.longest, _POLE_SHARE / rates) if rates > 0.0 else s.steps.longest


@inner_inlined
def _weight(s: Record, h: float, inside: int) -> float:
    """Time [s] by which an error of the speed counts as one of the angle: the step, in a stop the period.

    A joint leaves its stop with the speed that the stop has given it, and nothing corrects that in flight.
    """
    return float(max(h, s.c.period)) if inside != 0 else h


@inner_inlined
def _at_trial(s: Record, t: float) -> None:
    """Find the accelerations at the trial point `t`, the motors' torques there being in `s.tau`."""
    if s.w.mode.located:
        friction_events.trial(s, t)
    else:
        evaluate(s, t, s.q_trial, s.v_trial, s.a_trial)


@inner
def present(s: Record, t: float) -> None:
    """Compute the accelerations at the accepted point `t`, with friction just behind it."""
    if not s.w.mode.located:
        evaluate(s, t, s.q, s.v, s.a)
    elif friction_events.meet(s, t):
        s.history = min(s.history, 1)


@inner
def advance(s: Record, t: float) -> None:
    """Take the linkage to the accepted time `t`, the motors' torques there being in `s.tau`."""
    h = t - s.t
    inside = stop_surfaces.inside(s) if s.p.stops_on else 0
    if s.p.shaft_on:
        s.defect = runge_kutta.advance(s, h)
    else:
        _at_trial(s, t)
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
    present(s, t)
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
    share = s.defect / (_SAFETY * s.steps.tol)
    grow = _GROWTH if share * _GROWTH**3 < 1.0 else share ** (-1.0 / 3.0)
    s.steps.couple = h * grow
    if s.speeds > 0 or s.p.shaft_on:
        bound_by_pole(s)


@inner_inlined
def shortened(s: Record, h: float) -> float:
    """Return the step [s] with which the trial step `h` should be taken again; `h` where it is good.

    A nonlinearity of the mechanics, a stop or friction, can spoil a step that looked good from its start. The
    circuit's torque at the end is not available before the point is accepted: it is extrapolated along its
    last slope. Behind a jump the acceleration at the start does not help, and the step is short anyway.
    """
    if s.p.shaft_on or s.history == 0:
        return h
    for j in range(s.n):
        slope = (s.tau_old[0, j] - s.tau_old[1, j]) / s.h_old if s.history > 1 else 0.0
        s.tau[j] = s.tau_old[0, j] + h * slope
    _at_trial(s, s.t_trial)
    inside = stop_surfaces.inside(s) if s.p.stops_on else 0
    share = correct(s, h, s.a_trial, _weight(s, h, inside), False) / (_SAFETY * s.steps.tol)
    if not share > _REDONE / _SAFETY:
        return h
    return float(max(h * max(share ** (-1.0 / 3.0), _SHORTER), s.steps.least))
