"""Matrices of a slider that is linear between events: one for each set of gains and each length of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.linear.matrix_phi import phi_functions_of
from cosim.loop.linear.step_maps import NODES, Ints
from cosim.types import Array

#: Inputs: outer torque [N m], u, cmd [V], noise of the potentiometer [rad] and its rate [rad/s].
INPUTS = 5
#: A, B, C and D of a linear system.
System = tuple[Array, Array, Array, Array]


class Step(NamedTuple):
    """What a matrix is asked for: gains [V at the pins ksp, ksd], length of time and ramp within it [s]."""

    ksp: float
    ksd: float
    h: float
    ramp: float


def system(state: np.void, circuit: LinearCircuit, gains: Array) -> System:
    """Return A, B, C and D of x' = A x + B i, current = C x + D i, for a slider with given multiplier gains.

    Inputs are those of `INPUTS`; the circuit's own offset is left out.
    """
    p, op = state["p"], state["op"]
    before = circuit.a_pre.shape[0]
    size, m = 2 + circuit.order, len(circuit.gain)
    z, w = slice(2, 2 + before), slice(2 + before, size)
    a, b = np.zeros((size, size)), np.zeros((size, INPUTS))
    pins, pin_inputs = np.zeros((2, size)), np.zeros((2, INPUTS))  # pot, u
    pins[0, 0], pin_inputs[0, 3], pin_inputs[1, 1] = 1.0, 1.0, 1.0
    a[z], b[z] = circuit.b_pre @ pins, circuit.b_pre @ pin_inputs
    a[z, z] += circuit.a_pre
    x, x_inputs = circuit.d_pre @ pins, circuit.d_pre @ pin_inputs
    x[:, z] += circuit.c_pre
    x[:, 1] += circuit.e_pre[:, 0]
    x_inputs[:, 4] += circuit.e_pre[:, 0]
    held = (circuit.gain * (gains + circuit.y_offset))[:, None]
    behind, behind_inputs = np.zeros((m + 2, size)), np.zeros((m + 2, INPUTS))
    behind[:m], behind_inputs[:m] = held * x, held * x_inputs
    behind[m + 1, 1], behind_inputs[m, 2] = state["gear"], 1.0
    a[w], b[w] = circuit.b_post @ behind, circuit.b_post @ behind_inputs
    a[w, w] += circuit.a_post
    c, d = circuit.d_post @ behind, circuit.d_post @ behind_inputs
    c[:, w] += circuit.c_post
    radius = p["length"][0]
    inertia = p["couple"][0, 0] + op["mass"] * radius**2 + p["armature"][0]
    viscous = (p["viscous"][0] if p["viscous_on"] else 0.0) + op["damping"] * radius**2
    a[0, 1] = 1.0
    a[1] = state["torque_per_amp"][0] * c[0] / inertia
    a[1, 0] -= op["stiffness"] * radius**2 / inertia
    a[1, 1] -= viscous / inertia
    b[1] = state["torque_per_amp"][0] * d[0] / inertia
    b[1, 0] += 1.0 / inertia
    return a, b, c, d


def transitions(systems: Sequence[System], which: Ints, steps: Sequence[Step], *, nodes: bool) -> Array:
    """Return the matrices of states and inputs of steps [K], each of one of the systems; by row.

    Columns are states, inputs at the start and changes of the inputs over the step. With a ramp [s] the pins
    u and cmd change within that time, and rest then; other changes, and all without, are even over the step.
    Rows are those of `Exact.data`; without `nodes` those of Gauss's nodes stay zero.
    """
    a, b, c, d = (np.array(each) for each in zip(*systems, strict=True))
    size, parts = a.shape[1], np.array([1.0, *NODES] if nodes else [1.0])
    given, changing = slice(size, size + INPUTS), slice(size + INPUTS, size + 2 * INPUTS)
    # all instants of all steps in one row
    of = np.repeat(which, len(parts))
    h, ramp = (np.repeat([getattr(step, name) for step in steps], len(parts)) for name in ("h", "ramp"))
    times = h * np.tile(parts, len(steps))

    def risen(at: Array, some: Ints) -> Array:
        """Return the share of each input's change that is over at some instants; [P, 1, inputs]."""
        share = np.repeat((at / h[some])[:, None], INPUTS, axis=1)
        share[:, 1:3] = np.minimum(at / np.where(ramp > 0.0, ramp, h)[some], 1.0)[:, None]
        return share[:, None]

    def taken(start: Array, begin: Array, ends: Array, some: Ints) -> Array:
        """Take states, by column, from one time to another for some instants, the inputs changing evenly."""
        e, one, two = phi_functions_of(a, of[some], ends - begin, 2)
        span, before, drive = (ends - begin)[:, None, None], risen(begin, some), b[of[some]]
        states = e @ start
        states[:, :, given] += (span * one) @ drive
        states[:, :, changing] += span * (one @ drive * before + two @ drive * (risen(ends, some) - before))
        return np.asarray(states)

    begun, late = np.eye(size, size + 2 * INPUTS), (ramp > 0.0) & (times > ramp)
    states = np.zeros((len(times), *begun.shape))
    for some in filter(len, (np.flatnonzero(~late), np.flatnonzero(late))):
        zero, turn = np.zeros(len(some)), ramp[some]
        if late[some[0]]:
            states[some] = taken(taken(begun, zero, turn, some), turn, times[some], some)
        else:
            states[some] = taken(begun, zero, times[some], some)
    currents = c[of] @ states
    currents[:, :, given] += d[of]
    currents[:, :, changing] += risen(times, np.arange(len(times))) * d[of]
    states, currents = (x.reshape(len(steps), len(parts), *x.shape[1:]) for x in (states, currents))
    out = np.zeros((len(steps), size + 10, size + 2 * INPUTS))
    out[:, :size], out[:, size] = states[:, 0], currents[:, 0, 0]
    for i in range(1, len(parts)):
        out[:, size + 3 * i - 2 : size + 3 * i] = states[:, i, :2]
        out[:, size + 3 * i] = currents[:, i, 0]
    return out
