"""The linkage's integrator in lockstep where shafts turn: classical Runge-Kutta under interpolated torque.

A shaft rings at a frequency of its own with next to no damping. The predictor and corrector of `adams.py`
would feed it, z^4/50 a step at z = frequency times step; Runge-Kutta takes z^6/144 from it instead, and of
that next to nothing at the steps allowed here (`STEP_SHARE`), each taken in two parts. The motors' torque is
what the circuit gives: extrapolated along its last slope for the prediction, interpolated (a parabola through
three points) once the point is accepted. Their difference is the coupling's error, as in `adams.py`.

`s.history` counts as there: 0 right after a discontinuity, where the torque of the step's end holds over all
of it, then 1 (a straight line), then 2. Flanks of gears change at accepted points only; `edge` tells how far
the next change is, so that the step can end there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cosim.loop.state import STATE
from cosim.types import Record
from mech.compiled import entry, inner, vector
from mech.kernels import dynamics, solve
from mech.records import NMAX
from mech.shaft import EDGE_RAD, margin

Vector = Any

#: Most of a radian of the shafts' fastest oscillation, and of their decay, that a step may take.
STEP_SHARE, DECAY_SHARE = 0.2, 0.5
#: Runge-Kutta steps to a step of the circuit: a point of the circuit costs far more than they do.
_PARTS = 2
#: A step goes this far towards an expected change of flank, then to it: the second time it is known better.
_APPROACH, _CLOSE = 0.98, 0.05


@inner
def _torque(s: Record, x: float, h: float, known: bool, tau: Vector) -> None:
    """Motor torques [N m] the part `x` of a step `h` after the last accepted point.

    `known`: the torques at the step's end are in `s.tau`.
    """
    for j in range(s.n):
        last = s.tau_old[0, j]
        slope = (last - s.tau_old[1, j]) / s.h_old if s.history > 1 else 0.0
        if not known:
            tau[j] = last + x * h * slope
        elif s.history == 0:
            tau[j] = s.tau[j]
        else:
            right = (s.tau[j] - last) / h
            bend = (right - slope) / (h + s.h_old) if s.history > 1 else 0.0
            tau[j] = last + x * h * (right - bend * h * (1.0 - x))


@entry(STATE, float, bool, vector, vector, vector)
def step(s: Record, h: float, known: bool, q_out: Vector, v_out: Vector, work: Vector) -> None:
    """Take the linkage over the step `h` [s] into `q_out`, `v_out` [rad, rad/s].

    `work` [6] J by worker is found as well where the torque is `known` (Simpson's rule at the stages).
    """
    m, motor = s.coordinates, s.motor
    a = np.zeros(NMAX)
    q = np.zeros(NMAX)
    v = np.zeros(NMAX)
    q0 = np.zeros(NMAX)
    v0 = np.zeros(NMAX)
    tau = np.zeros(NMAX)
    part = h / _PARTS
    for j in range(m):
        q_out[j], v_out[j] = s.q[j], s.v[j]
    for i in range(6):
        work[i] = 0.0
    for stage in range(4 * _PARTS):
        k = stage % 4
        if k == 0:
            for j in range(m):
                q0[j], v0[j] = q_out[j], v_out[j]
        x = 0.0 if k == 0 else (1.0 if k == 3 else 0.5)
        share = part * (1.0 if k == 0 or k == 3 else 2.0) / 6.0
        for j in range(m):
            # the speed of the stage before moves the angle, as in any first-order system
            q[j] = q0[j] + x * part * v[j]
            v[j] = v0[j] + x * part * a[j]
        x = (stage // 4 + x) / _PARTS
        _torque(s, x, h, known, tau)
        dynamics(s.p, s.op, s.t + x * h, q, v, tau, a, s.w)
        for j in range(m):
            q_out[j] += share * v[j]
            v_out[j] += share * a[j]
        if known:
            for j in range(s.n):
                work[0] += share * tau[j] * v[motor + j]
                force = s.w.jac[0, j] * s.w.f_op[0] + s.w.jac[1, j] * s.w.f_op[1]
                work[1] += share * force * v[j]
                work[2] += share * s.w.tau_visc[j] * v[j]
                work[3] += share * s.w.tau_coul[j] * v[j]
                work[4] += share * s.w.tau_stop[j] * v[j]
                work[5] -= share * s.w.tau_loss[j] * (v[motor + j] - v[j])


@inner
def advance(s: Record, h: float) -> float:
    """Take q, v and the works over the step `h` [s], the torques at its end being in `s.tau`.

    Returns the defect [rad] as `adams.correct` does.
    """
    q = np.zeros(NMAX)
    v = np.zeros(NMAX)
    work = np.zeros(6)
    step(s, h, True, q, v, work)
    defect = 0.0
    for j in range(s.coordinates):
        e = abs(q[j] - s.q_trial[j]) + h * abs(v[j] - s.v_trial[j])
        if not e <= defect:  # a NaN gets through, and is seen
            defect = e
        s.q[j], s.v[j] = q[j], v[j]
    for i in range(6):
        s.work[i] += work[i]
    for j in range(s.n):
        s.tau_old[1, j] = s.tau_old[0, j]
        s.tau_old[0, j] = s.tau[j]
    return float(defect)


@inner
def extrapolate(s: Record, h: float, q_out: Vector, v_out: Vector) -> None:
    """Angles and speeds [rad, rad/s] a time `h` after the last accepted point."""
    step(s, h, False, q_out, v_out, np.zeros(6))


@inner
def longest(s: Record) -> float:
    """Longest step [s] that resolves the shafts at the pose in `s.w`.

    Squared frequencies are the eigenvalues of K (M^-1 + R^-1) with the rotors' inertias R: positive, so that
    their sum bounds them; so for the decays.
    """
    squares = 0.0
    decays = 0.0
    for j in range(s.n):
        for i in range(s.n):
            s.column[i] = 0.0
        s.column[j] = 1.0
        solve(s.n, s.w.mass, s.column, s.w.scratch.factor)
        mobility = s.column[j] + 1.0 / s.p.rotor[j]
        squares += s.p.shaft_stiffness[j] * mobility
        decays += s.p.shaft_damping[j] * mobility
    h = STEP_SHARE / math.sqrt(squares)
    return float(min(h, DECAY_SHARE / decays) if decays > 0.0 else h)


@inner
def edge(s: Record, h: float) -> float:
    """Step [s], at most `h`, that ends at or shortly before the next change of a flank."""
    if s.p.backlash_on == 0:
        return h
    for j in range(s.n):
        i = s.n + j
        twist, rate = s.q[i] - s.q[j], s.v[i] - s.v[j]
        turn = s.a[i] - s.a[j]
        jerk = (turn - s.a_old[i] + s.a_old[j]) / s.h_old if s.history > 1 else 0.0
        # halve for the first time at which the margin is gone; a step is short against the shaft's period
        if _margin_at(s, j, twist, rate, turn, jerk, h) >= -EDGE_RAD:
            continue
        low, high = 0.0, h
        for _ in range(40):
            middle = 0.5 * (low + high)
            if _margin_at(s, j, twist, rate, turn, jerk, middle) < -EDGE_RAD:
                high = middle
            else:
                low = middle
        h = high if high < _CLOSE * h else _APPROACH * high
    return float(max(h, s.steps.least))


@inner
def _margin_at(s: Record, j: int, twist: float, rate: float, turn: float, jerk: float, t: float) -> float:
    later = twist + t * (rate + t * (turn / 2 + t * jerk / 6))
    return float(margin(s.p, j, s.t + t, later, rate + t * (turn + t * jerk / 2), s.w))
