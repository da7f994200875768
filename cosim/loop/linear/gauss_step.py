"""One step of linkage and circuit together: Gauss collocation with the circuit solved exactly.

The accelerations at Gauss's three nodes make a parabola, the angles hence a polynomial of degree four. The
circuit takes that polynomial in and gives the motor currents at the nodes (`step_maps.py`), the equations of
motion give new accelerations: repeated until nothing moves. Order six at the end of a step; nothing has to
be resolved that is fast in the circuit only, and right behind a DAC step no order is lost, because no value
from before it is used but as a first guess.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cosim.loop.linear.step_maps import (
    ANGLE,
    COEFFICIENTS,
    DAC,
    NODES,
    SPEED,
    WEIGHTS,
    currents,
    finish,
)
from cosim.loop.linear.step_memory import StepMemory
from cosim.loop.pin_voltages import component, grid_noise, position_noise, volts
from cosim.types import Record
from mech.compiled import inner, inner_inlined
from mech.kernels import dynamics, solve, solve_held

#: Most repetitions of a step; contraction is at least 2 when it is accepted.
_SWEEPS = 12
#: A parabola is good for a guess over this many times its own step.
_REACH = 4.0
#: Repetitions end when the remaining error is this share of the tolerance.
_SHARE = 0.05
#: Largest double integral of P3, the first term that the parabola of accelerations leaves out.
_CUBIC = 1.0 / 113.0

#: A motor is near its driver's limit from this share of it on.
_WATCHED = 0.7

#: Accelerations at the nodes -> their first and second integrals at the nodes, and values at x = 1.
_ONCE = np.column_stack([NODES, NODES**2 / 2, NODES**3 / 3]) @ COEFFICIENTS
_TWICE = np.column_stack([NODES**2 / 2, NODES**3 / 6, NODES**4 / 12]) @ COEFFICIENTS
_AT_END = np.ones(3) @ COEFFICIENTS
#: Weights of the double integral to the end of the step.
_TO_END = WEIGHTS * (1.0 - NODES)
#: Values at x = 0, the nodes, 1 -> coefficients of the polynomial of degree four.
_FIVE = np.linalg.inv(np.vander(np.array([0.0, *NODES, 1.0]), 5, increasing=True))


@inner_inlined
def _fixed(s: Record, k: Any, b: StepMemory, t: float, h: float) -> None:
    """Features and gains that do not change between the sweeps."""
    n = s.n
    f = b.features
    pot = k.before + k.after
    for i in range(pot):
        f[i] = b.states[i]
    at = pot + ANGLE * n
    for j in range(n):
        f[pot + ANGLE * j] = s.q[j] + grid_noise(s, t, j)
        f[pot + ANGLE * j + 1] = h * s.v[j] + grid_noise(s, t + h, j) - grid_noise(s, t, j)
        f[at + DAC * j] = volts(s, j, t)
        f[at + DAC * j + 1] = volts(s, j, t + h) - f[at + DAC * j]
    at += DAC * n
    first = n + 2 * n * n
    for j in range(n):
        f[at + DAC * j] = volts(s, first + j, t)
        f[at + DAC * j + 1] = volts(s, first + j, t + h) - f[at + DAC * j]
    if s.component.address != 0:
        for j in range(n):
            now = component(s, t, s.component.inputs + j)
            f[at + DAC * j] += now
            f[at + DAC * j + 1] += component(s, t + h, s.component.inputs + j) - now
    at += DAC * n
    for j in range(n):
        f[at + SPEED * j] = s.gear * s.v[s.motor + j]
    if s.component.address != 0:
        at += SPEED * n
        for i in range(s.component.inputs):
            now = component(s, t, i)
            f[at + DAC * i] = now
            f[at + DAC * i + 1] = component(s, t + h, i) - now
    for c in range(2 * n * n):
        b.gains[c] = k.gain[c] * (volts(s, n + c, t + 0.5 * h) + k.bias[c])


@inner
def _bend(s: Record, k: Any, b: StepMemory, t: float, h: float) -> None:
    """Coefficients of the angles as potentiometers see them whose error belongs to the angle."""
    for j in range(s.n):
        c0 = c1 = c2 = 0.0
        for i in range(3):
            a = h * h * b.a[i, j]
            c0 += COEFFICIENTS[0, i] * a / 2
            c1 += COEFFICIENTS[1, i] * a / 6
            c2 += COEFFICIENTS[2, i] * a / 12
        at = 3 * s.coordinates + ANGLE * j
        b.moved[at] = s.q[j] + grid_noise(s, t, j)
        b.moved[at + 1] = h * s.v[j] + grid_noise(s, t + h, j) - grid_noise(s, t, j)
        b.moved[at + 2], b.moved[at + 3], b.moved[at + 4] = c0, c1, c2
        for m in range(5):
            x = 0.0 if m == 0 else (1.0 if m == 4 else NODES[m - 1])
            error = position_noise(s, s.q[j] + x * (h * s.v[j] + x * (c0 + x * (c1 + x * c2))), j)
            for power in range(5):
                b.moved[at + power] += _FIVE[power, m] * error


@inner_inlined
def _move(s: Record, k: Any, b: StepMemory, t: float, h: float) -> None:
    """Hand over what has changed since the last sweep."""
    for j in range(s.coordinates):
        for i in range(3):
            b.moved[3 * j + i] = b.a[i, j]
    if k.bent:
        _bend(s, k, b, t, h)


@inner_inlined
def guess(s: Record, b: StepMemory, h: float) -> None:
    """Guess the accelerations at the nodes: the last step's parabola, or its end where that cannot help.

    It cannot behind a jump, and far beyond the step that it was fitted on.
    """
    for j in range(s.coordinates):
        for i in range(3):
            if s.history == 0 or h > _REACH * b.scale[0]:
                b.a[i, j] = s.a[j]
            else:
                x = 1.0 + NODES[i] * h / b.scale[0]
                b.a[i, j] = b.last[0, j] + x * (b.last[1, j] + x * b.last[2, j])


@inner_inlined
def _sweep(s: Record, k: Any, b: StepMemory, t: float, h: float, weight: float) -> float:
    """Update the accelerations at the nodes; return by how much that has moved the angles [rad]."""
    n, m, motor = s.n, s.coordinates, s.motor
    _move(s, k, b, t, h)
    for i in range(3 * n):
        total = b.nodes[i]
        for column in range(k.moving):
            total += b.matrix[i, column] * b.moved[column]
        b.results[i] = total
    for i in range(6):
        b.work[i] = 0.0
    for i in range(3):
        for j in range(m):
            once = twice = 0.0
            for node in range(3):
                once += _ONCE[i, node] * b.a[node, j]
                twice += _TWICE[i, node] * b.a[node, j]
            s.q_trial[j] = s.q[j] + h * (NODES[i] * s.v[j] + h * twice)
            s.v_trial[j] = s.v[j] + h * once
        for j in range(n):
            s.tau[j] = s.torque_per_amp[j] * clamped(k, b, j, b.results[3 * j + i])
        dynamics(s.p, s.op, t + NODES[i] * h, s.q_trial, s.v_trial, s.tau, s.a_trial, s.w)
        for j in range(m):
            b.new[i, j] = s.a_trial[j]
        part = WEIGHTS[i] * h
        for j in range(n):
            v = s.v_trial[j]
            b.work[0] += part * s.tau[j] * s.v_trial[motor + j]
            b.work[1] += part * (s.w.jac[0, j] * s.w.f_op[0] + s.w.jac[1, j] * s.w.f_op[1]) * v
            b.work[2] += part * s.w.tau_visc[j] * v
            b.work[3] += part * s.w.tau_coul[j] * v
            b.work[4] += part * s.w.tau_stop[j] * v
            if s.w.contact.holding:
                b.holds[i, j] = s.w.contact.hold[j]
            if motor > 0:
                b.work[5] -= part * s.w.tau_loss[j] * (s.v_trial[motor + j] - v)
    moved = 0.0
    for i in range(3):
        for j in range(m):
            e = abs(b.new[i, j] - b.a[i, j]) * weight
            if not e <= moved:
                moved = e
            b.a[i, j] = b.new[i, j]
    return moved


@inner_inlined
def _state_at_end(s: Record, b: StepMemory, h: float) -> None:
    """Fill `s.q_trial` and `s.v_trial` at the end of the step from the accelerations at the nodes."""
    for j in range(s.coordinates):
        once = twice = 0.0
        for i in range(3):
            once += WEIGHTS[i] * b.a[i, j]
            twice += _TO_END[i] * b.a[i, j]
        s.q_trial[j] = s.q[j] + h * (s.v[j] + h * twice)
        s.v_trial[j] = s.v[j] + h * once


@inner_inlined
def _error_at_end(s: Record, k: Any, b: StepMemory, slot: int, t: float, h: float) -> float:
    """Finish the step at its end; return the error [rad] of its angles."""
    n, m, motor = s.n, s.coordinates, s.motor
    _move(s, k, b, t, h)
    for f in range(k.before + k.after, k.features):
        if k.move[f] >= 0:
            b.features[f] = b.moved[k.move[f]]
    finish(k, slot, b.gains, b.features, b.results)
    for j in range(n):
        b.results[3 * n + j] += k.offset[j]
        s.tau[j] = s.torque_per_amp[j] * clamped(k, b, j, b.results[3 * n + j])
    dynamics(s.p, s.op, t + h, s.q_trial, s.v_trial, s.tau, s.a_trial, s.w)
    # What the current does faster than the parabola is no error of the parabola: take it off. Angle and speed
    # at the end are right with it, but within the step the circuit has seen an angle without it: its states
    # at the end are off as if the angle were by (second derivative) x (time constant)^2.
    for j in range(n):
        smooth = 0.0
        for i in range(3):
            smooth += _AT_END[i] * b.results[3 * j + i]
        b.a_new[motor + j] = s.tau[j] - s.torque_per_amp[j] * clamped(k, b, j, smooth)
    if s.w.contact.holding:
        for j in range(n):
            b.holds[3, j] = s.w.contact.hold[j]
    if motor > 0:
        for j in range(n):
            b.a_new[j] = 0.0
            b.a_new[n + j] /= s.p.rotor[j]
    elif s.w.contact.holding:
        solve_held(n, s.w, b.a_new)
    else:
        solve(n, s.w.mass, b.a_new, s.w.scratch.factor)
    error = jump = 0.0
    for j in range(m):
        jump = max(jump, abs(b.a_new[j]))
        e = s.a_trial[j] - b.a_new[j]
        for i in range(3):
            e -= _AT_END[i] * b.a[i, j]
        if not abs(e) <= error:
            error = abs(e)
    slow = min(h * h * _CUBIC, k.lag * k.lag)
    return float(max(error * h * max(h, s.c.period) * _CUBIC, jump * slow))


@inner_inlined
def attempt(s: Record, k: Any, b: StepMemory, slot: int, t: float, h: float, tol: float) -> float:
    """Try a step of length `h` [s] from the accepted point at `t`; return its error [rad].

    The error of the angles within the step is that of the cubic term of the accelerations, found as the
    difference between the parabola and the equations of motion at the end; infinite when the repetitions do
    not converge to `tol` [rad]. Angles carry an error of the speed for the rest of the period, hence the
    weight. Leaves the accelerations at the nodes in `b.a`, currents and circuit states in `b.results`, work
    in `b.work`, and the state at the end in `s.q_trial`, `s.v_trial`, `s.a_trial`.
    """
    n = s.n
    _fixed(s, k, b, t, h)
    for i in range(3 * n):
        b.nodes[i] = k.offset[i // 3]
        for column in range(k.moving):
            b.matrix[i, column] = 0.0
    currents(k, slot, b.gains, b.features, b.nodes, b.matrix)
    weight = h * max(h, s.c.period) / 8.0
    before = 0.0
    converged = False
    for sweep in range(_SWEEPS):
        moved = _sweep(s, k, b, t, h, weight)
        ratio = moved / before if sweep > 0 and before > 0.0 else 0.5
        if moved * ratio < _SHARE * tol * (1.0 - ratio):
            converged = True
            break
        if sweep > 1 and not ratio < 0.5:
            break
        before = moved
    _state_at_end(s, b, h)
    if not converged:
        return math.inf
    return float(_error_at_end(s, k, b, slot, t, h))


@inner_inlined
def near(k: Any, joint: int, current: float) -> bool:
    """Whether a motor current [A] is so near the driver's limit that steps must check for it."""
    low, high = k.limit[joint, 0], k.limit[joint, 1]
    return not (_WATCHED * low < current < _WATCHED * high)


@inner_inlined
def clamped(k: Any, b: StepMemory, joint: int, current: float) -> float:
    """Motor current [A] that flows: the driver's limit while the motor is at it."""
    side = b.clamp[joint]
    if side == 0.0:
        return current
    return float(k.limit[joint, 1] if side > 0.0 else k.limit[joint, 0])


@inner
def _keep_rounding(s: Record, b: StepMemory, h: float) -> None:
    """Add the steps of the angles with what rounding has left out of them so far (Knuth's two-sum)."""
    for j in range(s.coordinates):
        twice = 0.0
        for i in range(3):
            twice += _TO_END[i] * b.a[i, j]
        step = h * (s.v[j] + h * twice) + b.low[j]
        q = s.q[j] + step
        part = q - s.q[j]
        b.low[j] = (s.q[j] - (q - part)) + (step - part)
        s.q_trial[j] = q


@inner_inlined
def accept(s: Record, k: Any, b: StepMemory, t: float, h: float) -> None:
    """Make the step on trial, of length `h` [s], the present point at `t` [s]."""
    n = s.n
    for j in range(n):
        b.current[j] = b.results[3 * n + j]
    if s.w.mode.located:
        _keep_rounding(s, b, h)
    for j in range(s.coordinates):
        s.q[j], s.v[j], s.a[j] = s.q_trial[j], s.v_trial[j], s.a_trial[j]
        for i in range(3):
            total = 0.0
            for m in range(3):
                total += COEFFICIENTS[i, m] * b.a[m, j]
            b.last[i, j] = total
    for i in range(k.before):
        b.states[i] = b.results[4 * n + k.after + i]
    for i in range(k.after):
        b.states[k.before + i] = b.results[4 * n + i]
    for i in range(6):
        b.total[i] += b.work[i]
    s.t = t
    b.scale[0] = h
    s.history = 1


@inner
def present(s: Record, k: Any, b: StepMemory) -> None:
    """Fill `b.current` [A] with the right-hand limit of the motor currents at the accepted point."""
    n, m = s.n, 2 * s.n * s.n
    for o in range(n):
        total = k.offset[o]
        for i in range(k.after):
            total += k.c_post[o, i] * b.states[k.before + i]
        for j in range(n):
            held = volts(s, n + m + j, s.t) + component(s, s.t, s.component.inputs + j)
            total += k.d_post[o, m + j] * held
            total += k.d_post[o, m + n + j] * s.gear * s.v[s.motor + j]
        for c in range(m):
            g = k.gain[c] * (volts(s, n + c, s.t) + k.bias[c]) * k.d_post[o, c]
            if g == 0.0:
                continue
            x = 0.0
            for i in range(k.before):
                x += k.c_pre[c, i] * b.states[i]
            for j in range(n):
                pot = s.q[j] + grid_noise(s, s.t, j) + position_noise(s, s.q[j], j)
                x += k.d_pre[c, j] * pot + k.d_pre[c, n + j] * volts(s, j, s.t) + k.e_pre[c, j] * s.v[j]
            for i in range(s.component.inputs):
                x += k.d_pre[c, 2 * n + i] * component(s, s.t, i)
            total += g * x
        b.current[o] = total
