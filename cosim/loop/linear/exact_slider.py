"""Scenes that are linear between events: linkage, operator and circuit in one matrix exponential.

A slider without Coulomb friction and end stops, held by nobody, a mass, or a hand whose intended point
rests, obeys x' = A x + B i with x = (q, v, circuit), A changing with the multipliers' gains only. One matrix
for each set of gains and each length of time takes it from event to event.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.linear.exact_matrices import INPUTS, Step, System, system, transitions
from cosim.loop.linear.step_maps import NODES, WEIGHTS, Ints, Matrix, Plan, Vector
from cosim.loop.linear.step_memory import StepMemory
from cosim.loop.pin_voltages import grid_noise, volts
from cosim.loop.state import STATE, Fault
from cosim.types import Array, Record
from mech.addresses import address_of
from mech.compiled import call_plain, inner, inner_inlined, kind_of
from mech.kernels import dynamics, operator_force

#: Columns of a matrix behind the state: outer torque, u and cmd at the start, their changes over the step;
#: noise and its rate with theirs, which are left out where there is no noise.
_ORDER = (0, 1, 2, 5, 6, 7, 3, 4, 8, 9)
_QUIET = 6
#: Rows at a time in a matrix times a vector: what the processor's registers hold.
_LANES = 4
#: Sets of gains times lengths of time kept at a time.
_SLOTS = 256


class Exact(NamedTuple):
    """Memory of the exact path.

    Attributes
    ----------
    on : [1] whether the scene is linear between events
    key : [slots, 5] gains, length of time, ramp inside, 1 when in use; made : [2] slots used, slot in use
    data : [slots, N + 10, N + 10 and up to 3 more] by column: maps of (state, inputs) to the state at the
        end, the current there, and q, v and current at Gauss's three nodes; inputs in the order of `_ORDER`
    asked : [4] gains, time and ramp of the matrix that is missing; address : of the function that makes it
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


#: Types by which compiled code knows the memory of a run.
STATE_KIND, PLAN_KIND, STEP_KIND, EXACT_KIND = (
    kind_of(STATE), kind_of(Plan), kind_of(StepMemory), kind_of(Exact)
)  # fmt: skip


def _padded(rows: int) -> int:
    return -(-rows // _LANES) * _LANES


def exact(
    state: np.void, circuit: LinearCircuit, knots: Array, failures: list[Exception], asked: list[Step],
    *, linear: bool, expected: Sequence[Step] = (),
) -> tuple[Exact, Callable[[], None]]:  # fmt: skip
    """Return the memory of the exact path and the callback that must live as long as it is used.

    `knots` are the times inside the run at which the operator's force has a kink. An exception in
    the callback ends the run and is kept in `failures`. `linear`: see `is_linear_between_events`.
    Steps go to `asked` as they are asked for; those that are `expected` are made together with the first.
    """
    op = state["op"]
    size = 2 + circuit.order
    path = op["path"][: op["paths"]]
    held = op["stiffness"] > 0 or op["damping"] > 0
    moving = [(a[0], b[0]) for a, b in pairwise(path) if held and (a[1:] != b[1:]).any()]
    slots = _SLOTS if linear else 1
    x = Exact(
        on=np.array([int(linear)]), key=np.zeros((slots, 5)), made=np.zeros(2, np.int64),
        data=np.zeros((slots, size + 2 * INPUTS, _padded(size + 10))), asked=np.zeros(4),
        address=np.zeros(1, np.int64), moving=np.array(moving).reshape(-1, 2),
        outer=outer_torque(state, np.array([0.0, *knots, state["t_end"]])) if linear else np.zeros((2, 2)),
        now=np.zeros(size + 2 * INPUTS), then=np.zeros(_padded(size + 10)),
    )  # fmt: skip

    order = [*range(size), *(size + i for i in _ORDER)]
    systems: dict[tuple[float, float], System] = {}
    known: dict[Step, Array] = {}
    nodes = bool(state["rows"]["capacity"])

    def make() -> None:
        at = x.made[0]
        try:
            step = Step(*x.asked.tolist())
            if step not in known:
                steps = list(dict.fromkeys((step, *(() if asked else expected))))
                gains = list(dict.fromkeys((each.ksp, each.ksd) for each in steps))
                for each in gains:
                    if each not in systems:
                        systems[each] = system(state, circuit, np.array(each))
                which = np.array([gains.index((each.ksp, each.ksd)) for each in steps])
                made = transitions([systems[each] for each in gains], which, steps, nodes=nodes)
                known.update(zip(steps, made[:, :, order].transpose(0, 2, 1), strict=True))
            x.data[at, :, : size + 10] = known.pop(step)
            asked.append(step)
        except Exception as error:  # none may cross the compiled frames above
            failures.append(error)
            state["fault"] = Fault.STOPPED
        x.key[at] = *x.asked, 1.0
        x.made[0] += 1

    callback = ctypes.CFUNCTYPE(None)(make)
    x.address[0] = address_of(callback)
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


@inner_inlined
def _outer(s: Record, x: Any, t: float) -> float:
    """Torque on the drum [N m] that does not depend on its motion, between the last knot and the next."""
    at = s.knots.next
    part = (t - x.outer[at, 0]) / (x.outer[at + 1, 0] - x.outer[at, 0])
    return float(x.outer[at, 1] + part * (x.outer[at + 1, 1] - x.outer[at, 1]))


@inner_inlined
def rests(x: Any, t: float) -> bool:
    """Whether the scene is linear around the time `t`."""
    if x.on[0] == 0:
        return False
    for i in range(len(x.moving)):
        if x.moving[i, 0] < t < x.moving[i, 1]:
            return False
    return True


@inner_inlined
def _fits(x: Any, i: int, g0: float, g1: float, h: float, ramp: float) -> bool:
    return bool(
        x.key[i, 0] == g0
        and x.key[i, 1] == g1
        and abs(x.key[i, 2] - h) <= 1e-12 * h + 1e-15
        and x.key[i, 3] == ramp
    )


@inner
def _find(s: Record, x: Any, g0: float, g1: float, h: float, ramp: float) -> int:
    """Return the slot of a matrix, made when it is not there yet; -1 when the memory is full."""
    used = x.made[0]
    for i in range(used):
        if _fits(x, i, g0, g1, h, ramp):
            return i
    if used == len(x.key):
        return -1
    x.asked[0], x.asked[1], x.asked[2], x.asked[3] = g0, g1, h, ramp
    call_plain(x.address[0])
    return int(used)


@inner_inlined
def _times(data: Any, now: Any, then: Any, width: int, rows: int) -> None:
    """Fill `then` with at least `rows` rows of a matrix, held by column, times the first `width` of `now`."""
    for block in range((rows + _LANES - 1) // _LANES):
        r = _LANES * block
        y0 = y1 = y2 = y3 = 0.0
        for i in range(width):
            value = now[i]
            y0 += data[i, r] * value
            y1 += data[i, r + 1] * value
            y2 += data[i, r + 2] * value
            y3 += data[i, r + 3] * value
        then[r], then[r + 1], then[r + 2], then[r + 3] = y0, y1, y2, y3


@inner_inlined
def leap(s: Record, k: Any, b: Any, x: Any, t: float, h: float, ramp: float) -> bool:
    """Go from the accepted point at `t` over `h` [s]: new state in `s.q_trial`, `s.v_trial` and `x.then`.

    Gains that ramp count with the value of the middle; u and cmd may have a ramp of length `ramp` [s] at the
    beginning, 0 when the whole step is one. Where rows are wanted the accelerations at the end and the works
    of the step are found as well. False when the memory for matrices is full: then the exact path is off.
    """
    size = 2 + k.before + k.after
    g0, g1 = volts(s, 1, t + 0.5 * h), volts(s, 2, t + 0.5 * h)
    slot = x.made[1]
    if not _fits(x, slot, g0, g1, h, ramp):
        slot = _find(s, x, g0, g1, h, ramp)
        if slot < 0:  # gains of ever new values: not worth a matrix each
            x.on[0] = 0
            return False
        x.made[1] = slot
    now, then = x.now, x.then
    now[0], now[1] = s.q[0], s.v[0]
    for i in range(size - 2):
        now[2 + i] = b.states[i]
    outer = _outer(s, x, t)
    now[size] = outer + s.torque_per_amp[0] * k.offset[0]
    now[size + 1], now[size + 2] = volts(s, 0, t), volts(s, 3, t)
    now[size + 3] = _outer(s, x, t + h) - outer
    now[size + 4] = now[size + 5] = 0.0
    if s.dac.ramping:
        now[size + 4] = volts(s, 0, t + h) - now[size + 1]
        now[size + 5] = volts(s, 3, t + h) - now[size + 2]
    width = size + _QUIET
    if s.noise.address != 0:
        noise = grid_noise(s, t, 0)
        rise = grid_noise(s, t + h, 0) - noise
        now[width], now[width + 1], now[width + 2], now[width + 3] = noise, rise / h, rise, 0.0
        width += 4
    account = s.rows.capacity > 0
    _times(x.data[slot], now, then, width, size + 10 if account else size + 1)
    s.q_trial[0], s.v_trial[0] = then[0], then[1]
    b.results[3] = then[size] + k.offset[0]
    if not account:
        return True
    for i in range(6):
        b.work[i] = 0.0
    # Speeds at the nodes add up to the distance up to rounding, which at rest would do work for ever.
    late = (then[0] - s.q[0]) / h
    for node in range(3):
        late -= WEIGHTS[node] * then[size + 2 + 3 * node]
    for node in range(3):
        at = size + 1 + 3 * node
        s.tau[0] = s.torque_per_amp[0] * (then[at + 2] + k.offset[0])
        s.q_trial[0] = then[at]
        v = s.v_trial[0] = then[at + 1] + late
        dynamics(s.p, s.op, t + NODES[node] * h, s.q_trial, s.v_trial, s.tau, s.a_trial, s.w)
        part = WEIGHTS[node] * h * v
        b.work[0] += part * s.tau[0]
        b.work[1] += part * (s.w.jac[0, 0] * s.w.f_op[0] + s.w.jac[1, 0] * s.w.f_op[1])
        b.work[2] += part * s.w.tau_visc[0]
    s.q_trial[0], s.v_trial[0] = then[0], then[1]
    s.tau[0] = s.torque_per_amp[0] * b.results[3]
    dynamics(s.p, s.op, t + h, s.q_trial, s.v_trial, s.tau, s.a_trial, s.w)
    return True


@inner_inlined
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
