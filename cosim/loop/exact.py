"""Scenes that are linear between events: linkage, operator and circuit in one matrix exponential.

A slider without Coulomb friction and end stops, held by nobody, a mass, or a hand whose intended point
rests, obeys x' = A x + B i with x = (q, v, circuit), A changing with the multipliers' gains only. One matrix
for each set of gains and each length of time takes it from event to event.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cosim.circuits.linear import LinearCircuit
from cosim.loop.maps import NODES, WEIGHTS, Ints, Matrix, Vector
from cosim.loop.native import call_plain
from cosim.loop.phi import phi_functions
from cosim.loop.pins import grid_noise, volts
from cosim.loop.state import Fault
from mech.kernels import dynamics, operator_force
from mech.records import OperatorKind

Array = NDArray[np.float64]
Record = Any

#: Inputs: outer torque [N m], u, cmd [V], noise of the potentiometer [rad] and its rate [rad/s].
_INPUTS = 5
#: Sets of gains times lengths of time kept at a time.
_SLOTS = 256


class Exact(NamedTuple):
    """Memory of the exact path.

    Attributes
    ----------
    on : [1] whether the scene is linear between events
    key : [slots, 4] gains, length of time, 1 when in use; made : [1] slots used
    data : [slots, N + 10, N + 10] by column: maps of (state, inputs at the start, their change over the
        step) to the state at the end, the current there, and q, v and current at Gauss's three nodes
    asked : [3] gains and time of the matrix that is missing; address : of the function that makes it
    moving : [k, 2] times between which the hand's intended point moves
    outer : [knots + 2, 2] times and torque on the drum [N m] that does not depend on its motion
    now, then : scratch
    """

    on: Ints
    key: Matrix
    made: Ints
    data: Annotated[Array, 3]
    asked: Vector
    address: Ints
    moving: Matrix
    outer: Matrix
    now: Vector
    then: Vector


def exact(
    state: np.void, circuit: LinearCircuit, knots: Array, failures: list[Exception]
) -> tuple[Exact, Callable[[], None]]:
    """Return the memory of the exact path and the callback that must live as long as it is used.

    `knots` are the times inside the run at which the operator's force has a kink. What goes wrong in the
    callback ends the run and is left in `failures`.
    """
    p, op = state["p"], state["op"]
    size = 2 + circuit.order
    linear = (
        p["slider"] == 1 and not any(p[name] for name in ("coulomb_on", "stops_on", "shaft_on"))
        and not state["position_noise"] and op["kind"] != OperatorKind.USER and not state["component"]
    )  # fmt: skip
    path = op["path"][: op["paths"]]
    held = op["stiffness"] > 0 or op["damping"] > 0
    moving = [(a[0], b[0]) for a, b in pairwise(path) if held and (a[1:] != b[1:]).any()]
    slots = _SLOTS if linear else 1
    x = Exact(
        on=np.array([int(linear)]), key=np.zeros((slots, 4)), made=np.zeros(1, np.int64),
        data=np.zeros((slots, size + 10, size + 2 * _INPUTS)), asked=np.zeros(3),
        address=np.zeros(1, np.int64), moving=np.array(moving).reshape(-1, 2),
        outer=outer_torque(state, np.array([0.0, *knots, state["t_end"]])) if linear else np.zeros((2, 2)),
        now=np.zeros(size + 2 * _INPUTS), then=np.zeros(size + 10),
    )  # fmt: skip

    def make() -> None:
        at = x.made[0]
        try:
            nodes = bool(state["rows_capacity"])
            x.data[at] = transition(state, circuit, x.asked[:2], float(x.asked[2]), nodes=nodes).T
        except Exception as error:  # none may cross the compiled frames above
            failures.append(error)
            state["fault"] = Fault.STOPPED
        x.key[at] = *x.asked, 1.0
        x.made[:] += 1

    callback = ctypes.CFUNCTYPE(None)(make)
    x.address[0] = ctypes.cast(callback, ctypes.c_void_p).value or 0
    return x, callback


def outer_torque(state: np.void, times: Array) -> Array:
    """Return `times` and what weight and operator exert on a drum at rest at its origin [N m]; [k, 2]."""
    p, op = state["p"], state["op"]
    radius, direction = p["length"][0], np.array(p["direction"])
    weight = p["moment"][0] * p["heavy"] + op["falls"] * op["mass"] * radius
    force = np.zeros(2)
    out = np.zeros((len(times), 2))
    for row, t in zip(out, times, strict=True):
        operator_force(op, t, np.array(p["origin"]), np.zeros(2), force)
        row[:] = t, weight * (np.array(p["gravity"]) @ direction) + radius * (force @ direction)
    return out


def system(state: np.void, circuit: LinearCircuit, gains: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C and D of x' = A x + B i, current = C x + D i, for a slider with given multiplier gains.

    Inputs are those of `_INPUTS`; the circuit's own offset is left out.
    """
    p, op = state["p"], state["op"]
    before = circuit.a_pre.shape[0]
    size, m = 2 + circuit.order, len(circuit.gain)
    z, w = slice(2, 2 + before), slice(2 + before, size)
    a, b = np.zeros((size, size)), np.zeros((size, _INPUTS))
    pins, pin_inputs = np.zeros((2, size)), np.zeros((2, _INPUTS))  # pot, u
    pins[0, 0], pin_inputs[0, 3], pin_inputs[1, 1] = 1.0, 1.0, 1.0
    a[z], b[z] = circuit.b_pre @ pins, circuit.b_pre @ pin_inputs
    a[z, z] += circuit.a_pre
    x, x_inputs = circuit.d_pre @ pins, circuit.d_pre @ pin_inputs
    x[:, z] += circuit.c_pre
    x[:, 1] += circuit.e_pre[:, 0]
    x_inputs[:, 4] += circuit.e_pre[:, 0]
    held = (circuit.gain * (gains + circuit.y_offset))[:, None]
    behind, behind_inputs = np.zeros((m + 2, size)), np.zeros((m + 2, _INPUTS))
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
    a[1] = state["torque_per_amp"] * c[0] / inertia
    a[1, 0] -= op["stiffness"] * radius**2 / inertia
    a[1, 1] -= viscous / inertia
    b[1] = state["torque_per_amp"] * d[0] / inertia
    b[1, 0] += 1.0 / inertia
    return a, b, c, d


def transition(state: np.void, circuit: LinearCircuit, gains: Array, h: float, *, nodes: bool) -> Array:
    """Return the matrix of `Exact.data`, by row, for gains [V at the pins ksp, ksd] and a time `h` [s].

    Without `nodes` the rows of Gauss's nodes stay zero.
    """
    a, b, c, d = system(state, circuit, gains)
    size = len(a)
    out = np.zeros((size + 10, size + 2 * _INPUTS))

    def to(part: float) -> Array:
        t = part * h
        e, one, two = phi_functions(a, t, 2)
        # an input that changes by 1 over h changes by `part` until t
        return np.hstack([e, t * one @ b, part * t * two @ b])

    def current(states: Array, part: float) -> Array:
        row = c @ states
        row[:, size : size + _INPUTS] += d
        row[:, size + _INPUTS :] += part * d
        return np.asarray(row[0])

    out[:size] = to(1.0)
    out[size] = current(out[:size], 1.0)
    for i, x in enumerate(NODES if nodes else ()):
        states = to(float(x))
        out[size + 1 + 3 * i : size + 3 + 3 * i] = states[:2]
        out[size + 3 + 3 * i] = current(states, float(x))
    return out


@njit(cache=True, error_model="numpy", forceinline=True)
def _outer(s: Record, x: Any, t: float) -> float:
    """Torque on the drum [N m] that does not depend on its motion, between the last knot and the next."""
    at = s.knot
    part = (t - x.outer[at, 0]) / (x.outer[at + 1, 0] - x.outer[at, 0])
    return float(x.outer[at, 1] + part * (x.outer[at + 1, 1] - x.outer[at, 1]))


@njit(cache=True, error_model="numpy", forceinline=True)
def rests(x: Any, t: float) -> bool:
    """Whether the scene is linear around the time `t`."""
    if x.on[0] == 0:
        return False
    for i in range(len(x.moving)):
        if x.moving[i, 0] < t < x.moving[i, 1]:
            return False
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def leap(s: Record, k: Any, b: Any, x: Any, t: float, h: float, account: bool) -> bool:
    """Go from the accepted point at `t` over `h` [s]: new state in `s.q_trial`, `s.v_trial` and `x.then`.

    Gains that ramp count with the value of the middle. With `account` the accelerations at the end and
    the works of the step are found as well. False when the memory for matrices is full: then the exact path
    is off.
    """
    size = 2 + k.before + k.after
    g0, g1 = volts(s, 1, t + 0.5 * h), volts(s, 2, t + 0.5 * h)
    slot = -1
    for i in range(min(x.made[0], len(x.key))):
        if x.key[i, 0] == g0 and x.key[i, 1] == g1 and abs(x.key[i, 2] - h) <= 1e-12 * h + 1e-15:
            slot = i
            break
    if slot < 0:
        if x.made[0] == len(x.key):  # gains of ever new values: not worth a matrix each
            x.on[0] = 0
            return False
        x.asked[0], x.asked[1], x.asked[2] = g0, g1, h
        slot = x.made[0]
        call_plain(x.address[0])
    now, data = x.now, x.data[slot]
    now[0], now[1] = s.q[0], s.v[0]
    for i in range(size - 2):
        now[2 + i] = b.states[i]
    outer = _outer(s, x, t)
    noise = grid_noise(s, t, 0)
    rise = grid_noise(s, t + h, 0) - noise
    now[size] = outer + s.torque_per_amp * k.offset[0]
    now[size + 1], now[size + 2] = volts(s, 0, t), volts(s, 3, t)
    now[size + 3], now[size + 4] = noise, rise / h
    now[size + 5] = _outer(s, x, t + h) - outer
    now[size + 6], now[size + 7] = 0.0, 0.0
    if s.ramping:
        now[size + 6] = volts(s, 0, t + h) - now[size + 1]
        now[size + 7] = volts(s, 3, t + h) - now[size + 2]
    now[size + 8], now[size + 9] = rise, 0.0
    rows = size + 10 if account else size + 1
    then = x.then
    for r in range(rows):
        then[r] = 0.0
    for i in range(size + 10):
        value = now[i]
        if value != 0.0:
            for r in range(rows):
                then[r] += data[i, r] * value
    s.q_trial[0], s.v_trial[0] = x.then[0], x.then[1]
    b.results[3] = x.then[size] + k.offset[0]
    if not account:
        return True
    for i in range(6):
        b.work[i] = 0.0
    for node in range(3):
        at = size + 1 + 3 * node
        s.tau[0] = s.torque_per_amp * (x.then[at + 2] + k.offset[0])
        v = x.then[at + 1]
        dynamics(s.p, s.op, t + NODES[node] * h, x.then[at:], x.then[at + 1 :], s.tau, b.new[0], s.w)
        part = WEIGHTS[node] * h * v
        b.work[0] += part * s.tau[0]
        b.work[1] += part * (s.w.jac[0, 0] * s.w.f_op[0] + s.w.jac[1, 0] * s.w.f_op[1])
        b.work[2] += part * s.w.tau_visc[0]
    s.tau[0] = s.torque_per_amp * b.results[3]
    dynamics(s.p, s.op, t + h, s.q_trial, s.v_trial, s.tau, s.a_trial, s.w)
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def land(s: Record, k: Any, b: Any, x: Any, t: float) -> None:
    """Make the end of the leap the accepted point at the time `t` [s]."""
    s.q[0], s.v[0], s.a[0] = s.q_trial[0], s.v_trial[0], s.a_trial[0]
    for i in range(k.before + k.after):
        b.states[i] = x.then[2 + i]
    for i in range(6):
        b.total[i] += b.work[i]
    b.current[0] = b.results[3]
    s.t = t
    b.scale[0] = 0.0
    s.history = 0
