"""From a `LinearCircuit` to the blocks and modes that `step_maps.py` works on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError, Problem
from cosim.loop.linear.step_maps import (
    ANGLE,
    CHANNEL,
    DAC,
    DIRECT,
    POST,
    PRE,
    SPEED,
    Array,
    Complex,
    Ints,
    Plan,
)

#: Step lengths kept at a time.
SLOTS = 512
#: Eigenvectors are solved with; their condition number times eps is the relative error that this makes.
_WORST_CONDITION = 1e10


@dataclass(frozen=True)
class Modes:
    """A = V diag(poles) W with W = V^-1, taken apart into states that do not touch one another.

    Attributes
    ----------
    part : [N] number of the part that a state (and the mode of the same number) belongs to
    condition : largest condition number of the eigenvectors of a part
    """

    poles: Complex
    v: Complex
    w: Complex
    part: Ints
    condition: float


def _parts(a: Array) -> Ints:
    """Return for each state the number of its part: states of two parts do not reach each other."""
    joined = (a != 0) | (a.T != 0) | np.eye(len(a), dtype=bool)
    for _ in range(len(a).bit_length()):
        joined = joined @ joined  # reached over twice as many states
    first = np.array([row.argmax() for row in joined], np.int64)
    return np.unique(first, return_inverse=True)[1].astype(np.int64)


def modes(a: Array, name: str) -> Modes:
    """Diagonalise a state matrix part by part; `InputError` when it cannot be done to 1e-6."""
    size = len(a)
    poles, v, w = np.zeros(size, complex), np.zeros((size, size), complex), np.zeros((size, size), complex)
    condition = 1.0
    part = _parts(a)
    for k in range(part.max(initial=-1) + 1):
        at = np.flatnonzero(part == k)
        poles[at], vectors = np.linalg.eig(a[np.ix_(at, at)])
        cond = float(np.linalg.cond(vectors))
        if not cond < _WORST_CONDITION:
            raise InputError(
                Problem(
                    f"the circuit's poles near {poles[at][0]:.6g} rad/s coincide in one chain of states: its "
                    "modes cannot be told apart",
                    key=name,
                    value=cond,
                    allowed=f"condition number of the eigenvectors below {_WORST_CONDITION:g}",
                )
            )
        condition = max(condition, cond)
        v[np.ix_(at, at)], w[np.ix_(at, at)] = vectors, np.linalg.inv(vectors)
    return Modes(poles, v, w, part.astype(np.int64), condition)


def _slowest(poles: Complex) -> float:
    """Return the largest time constant [s]; 0 without poles."""
    return float(1.0 / np.abs(poles).min(initial=math.inf))


_Block = tuple[int, int, list[int], int, list[int], int, list[int], list[int]]
"""Kind, multiplier or column of b_post, rows (nodes first), node rows, columns (moving last), moving columns,
modes before and after the multiplier."""


def plan(
    circuit: LinearCircuit,
    driven: Iterable[int],
    *,
    gear: float,
    commands: bool,
    speeds: bool,
    bent: bool,
    noise: Ints | None = None,
    shafts: bool = False,
) -> Plan:
    """Lay out the blocks of a circuit.

    Parameters
    ----------
    driven
        Multipliers whose control is ever other than zero; those with an offset there come on their own.
    gear
        Motor turns per joint turn: the pins vel see the motors' speeds.
    commands, speeds
        Whether the pins cmd and vel are driven.
    bent
        Whether the potentiometers see more of an angle than its polynomial (noise that depends on the angle):
        then all their coefficients change between the sweeps of a step, and stand for themselves.
    noise
        [m] number of the noise voltage in series with X of each multiplier; none without component noise.
    shafts
        Whether motors move apart from their joints, as coordinates n to 2 n.
    """
    n, m = circuit.joints, len(circuit.gain)
    motor = n if shafts else 0
    moves = 3 * (n + motor)
    one, two = modes(circuit.a_pre, "a_pre"), modes(circuit.a_post, "a_post")
    before, after = len(one.poles), len(two.poles)
    pot = before + after
    u, cmd, vel = pot + ANGLE * n, pot + (ANGLE + DAC) * n, pot + (ANGLE + 2 * DAC) * n
    noisy = vel + SPEED * n
    sources = int(noise.max()) + 1 if noise is not None else 0
    features = noisy + DAC * sources
    in_series = np.zeros((m, sources))
    if noise is not None:
        in_series[np.arange(m), noise] = 1.0
    what, which, power = (np.zeros(features, np.int64) for _ in range(3))
    which[:before], what[before:pot], which[before:pot] = range(before), 1, range(after)
    what[pot:] = 2
    for start, width, first, count in (
        (pot, ANGLE, 0, n),
        (u, DAC, n, n),
        (cmd, DAC, m, n),
        (vel, SPEED, m + n, n),
        (noisy, DAC, 2 * n, sources),
    ):
        for j in range(count):
            coefficients = np.arange(start + width * j, start + width * (j + 1))
            which[coefficients], power[coefficients] = first + j, np.arange(width)
    blocks: list[_Block] = []

    def states(part: Ints, chosen: NDArray[np.bool_]) -> list[int]:
        return [int(k) for k in np.flatnonzero(np.isin(part, part[chosen]))]

    def inputs(mask: NDArray[np.bool_]) -> tuple[list[int], int]:
        """Features of the pins [pot; u] chosen by `mask`: those that vary last."""
        fixed = [u + DAC * j + k for j in range(n) if mask[n + j] for k in range(DAC)]
        first = 0 if bent else 2
        moving = [pot + ANGLE * j + k for j in range(n) if mask[j] for k in range(first, ANGLE)]
        fixed += [pot + ANGLE * j + k for j in range(n) if mask[j] for k in range(first)]
        fixed += [noisy + DAC * j + k for j in np.flatnonzero(mask[2 * n :]).tolist() for k in range(DAC)]
        return fixed + moving, len(moving)

    def outputs(post: list[int], direct: NDArray[np.bool_]) -> tuple[list[int], int]:
        touched = [o for o in range(n) if direct[o] or (circuit.c_post[o, post] != 0).any()]
        found = [3 * o + i for o in touched for i in range(3)]
        return found + [3 * n + o for o in touched] + [4 * n + s for s in post], len(found)

    def post_of(column: int) -> list[int]:
        return states(two.part, circuit.b_post[:, column] != 0)

    channels = [c for c in sorted({*driven, *np.flatnonzero(circuit.y_offset)}) if circuit.gain[c] != 0]
    used = np.zeros(before, bool)
    for c in channels:
        used[states(one.part, circuit.c_pre[c] != 0)] = True
    for k in sorted(set(one.part[used].tolist())):
        at = [int(s) for s in np.flatnonzero(one.part == k)]
        found, moving = inputs((circuit.b_pre[at] != 0).any(axis=0))
        blocks.append((PRE, -1, [4 * n + after + s for s in at], 0, at + found, moving, at, []))
    for k in sorted(set(two.part.tolist())):
        at = [int(s) for s in np.flatnonzero(two.part == k)]
        rows, nodes = outputs(at, np.zeros(n, bool))
        blocks.append((POST, -1, rows, nodes, [before + s for s in at], 0, [], at))
    for c in channels:
        pre, post = states(one.part, circuit.c_pre[c] != 0), post_of(c)
        touched = (circuit.d_pre[c] != 0) | (circuit.b_pre[pre] != 0).any(axis=0)
        touched[:n] |= circuit.e_pre[c] != 0
        found, moving = inputs(np.concatenate([touched, in_series[c] != 0]))
        rows, nodes = outputs(post, circuit.d_post[:, c] != 0)
        blocks.append((CHANNEL, c, rows, nodes, pre + found, moving, pre, post))
    for on, start, width, first, moving in (
        (commands, cmd, DAC, m, 0),
        (speeds, vel, SPEED, m + n, SPEED - 1),
    ):
        for j in range(n if on else 0):
            post = post_of(first + j)
            rows, nodes = outputs(post, circuit.d_post[:, first + j] != 0)
            pins = list(range(start + width * j, start + width * (j + 1)))
            blocks.append((DIRECT, first + j, rows, nodes, pins, moving, [], post))
    blocks = [b for b in blocks if b[2]]
    # columns of what moves: accelerations at the nodes of each joint or motor, then coefficients
    move = np.full(features, -1, np.int64)
    for j in range(n):
        move[vel + SPEED * j + 1 : vel + SPEED * (j + 1)] = 3 * (motor + j) + np.arange(3)
        if bent:
            move[pot + ANGLE * j : pot + ANGLE * (j + 1)] = moves + ANGLE * j + np.arange(ANGLE)
        else:
            move[pot + ANGLE * j + 2 : pot + ANGLE * (j + 1)] = 3 * j + np.arange(3)

    def ints(values: Iterable[int]) -> Ints:
        return np.array(list(values), np.int64)

    def bounds(item: int) -> Ints:
        return ints(np.concatenate([[0], np.cumsum([len(b[item]) for b in blocks])]))  # type: ignore[arg-type]

    def joined(item: int) -> Ints:
        return ints(k for b in blocks for k in b[item])  # type: ignore[union-attr]

    size = [len(b[2]) * len(b[4]) for b in blocks]
    return Plan(
        n=n, before=before, after=after, features=features, results=4 * n + after + before,
        moving=moves + ANGLE * n if bent else moves, bent=int(bent), gear=gear,
        lag=_slowest(one.poles) + _slowest(two.poles),
        kind=ints(b[0] for b in blocks), channel=ints(b[1] for b in blocks),
        row_at=bounds(2), node_rows=ints(b[3] for b in blocks),
        column_at=bounds(4), varying=ints(b[5] for b in blocks),
        pre_at=bounds(6), post_at=bounds(7), data_at=ints(np.concatenate([[0], np.cumsum(size)])),
        rows=joined(2), columns=joined(4), pre_modes=joined(6), post_modes=joined(7),
        what=what, which=which, power=power, move=move,
        poles1=one.poles, v1=one.v, w1=one.w, cv=circuit.c_pre @ one.v,
        wb=one.w @ np.pad(circuit.b_pre, ((0, 0), (0, sources))),
        poles2=two.poles, v2=two.v, w2=two.w, wb2=two.w @ circuit.b_post, cv2=circuit.c_post @ two.v,
        c_pre=np.ascontiguousarray(circuit.c_pre), c_post=np.ascontiguousarray(circuit.c_post),
        d_pre=np.hstack([circuit.d_pre, in_series]), e_pre=np.ascontiguousarray(circuit.e_pre),
        d_post=np.ascontiguousarray(circuit.d_post), gain=np.ascontiguousarray(circuit.gain),
        offset=np.ascontiguousarray(circuit.offset), bias=np.ascontiguousarray(circuit.y_offset),
        limit=np.ascontiguousarray(circuit.limit),
        data=np.zeros((SLOTS, max(sum(size), 1))), length=np.full(SLOTS, -1.0), slots=np.zeros(2, np.int64),
    )  # fmt: skip
