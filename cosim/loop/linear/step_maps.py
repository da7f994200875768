"""One-step maps of a `LinearCircuit`, exact for polynomial inputs and any step length.

Over a step the inputs are polynomials of x = t/h in [0, 1] (angles: degree four; DACs: one; speeds: three),
the angles given by their start and by the accelerations at Gauss's three nodes, and the multipliers' gains
g_c are constant. The circuit is then a cascade, and all that it does is linear in g:

    result = sum over blocks b of g_b T_b(h) f_b,      g = 1 for what passes no multiplier,

where the features f are states at the start, coefficients of the inputs and accelerations, and the results
are states at the end and the motor currents. A block holds only the states that its path touches, and one
whose gain is zero is skipped, so that a step costs some hundred multiply-adds, however fast the poles are.

The current within a step is wanted as a parabola at Gauss's three nodes. Not the current at these instants
is taken, but the parabola with the same mean and first two moments: a transient much shorter than the step
then has its exact impulse, and the step need not resolve it.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.loop.linear.divided_differences import TOP, double, single
from cosim.types import Array, Complex
from mech.compiled import entry, inner, inner_inlined, matrix, vector

Ints = Annotated[NDArray[np.int64], 1]
Vector = Annotated[Array, 1]
Matrix = Annotated[Array, 2]
Poles = Annotated[Complex, 1]
ComplexMatrix = Annotated[Complex, 2]

#: Coefficients of an angle, a DAC voltage and a speed over a step.
ANGLE, DAC, SPEED = 5, 2, 4
#: Gauss's nodes on [0, 1] and weights.
NODES = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
#: Accelerations at the nodes -> coefficients of 1, x, x^2.
COEFFICIENTS = np.linalg.inv(np.vander(NODES, 3, increasing=True))

#: Kinds of blocks: states before the multipliers, after them, through one of them, pins behind them.
PRE, POST, CHANNEL, DIRECT = range(4)
#: From the moments int (1-x)^(l-1)/(l-1)! i(x) dx, l = 1..3, to the parabola with these moments at the nodes.
_TO_NODES = np.linalg.inv(np.array([WEIGHTS, WEIGHTS * (1 - NODES), WEIGHTS * (1 - NODES) ** 2 / 2]))
_FACTORIAL = np.array([1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0, 40320.0])


class Plan(NamedTuple):
    """What compiled code needs of a circuit; nothing in it changes but `data`, `length` and `slots`."""

    n: int
    before: int  # states before the multipliers
    after: int
    features: int
    results: int
    moving: int  # columns of what changes between the sweeps of a step
    bent: int
    gear: float
    lag: float  # s, slowest time constants before and after the multipliers together
    # per block: kind, multiplier (or column of b_post), bounds of its lists and its matrix
    kind: Ints
    channel: Ints
    row_at: Ints
    node_rows: Ints
    column_at: Ints
    varying: Ints
    pre_at: Ints
    post_at: Ints
    data_at: Ints
    rows: Ints
    columns: Ints
    pre_modes: Ints
    post_modes: Ints
    # what a feature is: 0 state before, 1 state after, 2 coefficient of an input; which one; its power
    what: Ints
    which: Ints
    power: Ints
    move: Ints  # column among those that change between sweeps, -1 for a fixed feature
    # modal form
    poles1: Poles
    v1: ComplexMatrix
    w1: ComplexMatrix
    cv: ComplexMatrix
    wb: ComplexMatrix
    poles2: Poles
    v2: ComplexMatrix
    w2: ComplexMatrix
    wb2: ComplexMatrix
    cv2: ComplexMatrix
    c_pre: Matrix
    d_pre: Matrix
    e_pre: Matrix
    c_post: Matrix
    d_post: Matrix
    gain: Vector
    offset: Vector
    bias: Vector  # offsets of the multipliers' controls
    limit: Matrix
    # matrices by step length
    data: Matrix
    length: Vector
    slots: Ints  # [0] slots in use, [1] maps built


@entry(Plan, float, result=int, how=inner_inlined)
def slot_of(k: Any, h: float) -> int:
    """Where the matrices of the step length `h` [s] are; built when they are not there yet.

    Lengths that differ by the rounding of time only (1e-12, 1 fs) share a slot.
    """
    used = min(k.slots[0], len(k.length))
    for i in range(used):
        if abs(k.length[i] - h) <= 1e-12 * h + 1e-15:
            return i
    i = k.slots[0] % len(k.length)
    k.slots[0] += 1
    k.length[i] = h
    build(k, h, k.data[i])
    return int(i)


@inner
def build(k: Any, h: float, data: Any) -> None:
    """Fill `data` with the matrices of all blocks for the step length `h` [s]."""
    k.slots[1] += 1
    f1 = np.zeros((k.before + 1, TOP + 1), np.complex128)
    f2 = np.zeros((k.after + 1, TOP + 1), np.complex128)
    for j in range(k.before):
        single(k.poles1[j] * h, f1[j])
    for i in range(k.after):
        single(k.poles2[i] * h, f2[i])
    pairs = np.zeros((k.after + 1, k.before + 1, TOP + 1), np.complex128)
    for b in range(len(k.kind)):
        if k.kind[b] == CHANNEL:
            for i in k.post_modes[k.post_at[b] : k.post_at[b + 1]]:
                for j in k.pre_modes[k.pre_at[b] : k.pre_at[b + 1]]:
                    if pairs[i, j, 0] == 0.0:
                        double(k.poles2[i] * h, k.poles1[j] * h, f2[i], f1[j], pairs[i, j])
    through = np.zeros((k.after + 1, 4), np.complex128)
    past = np.zeros(4)
    current = np.zeros(4)
    for b in range(len(k.kind)):
        kind, c = k.kind[b], k.channel[b]
        pre = k.pre_modes[k.pre_at[b] : k.pre_at[b + 1]]
        post = k.post_modes[k.post_at[b] : k.post_at[b + 1]]
        first, last = k.row_at[b], k.row_at[b + 1]
        width = k.column_at[b + 1] - k.column_at[b]
        for column in range(width):
            f = k.columns[k.column_at[b] + column]
            which, power = k.which[f], k.power[f]
            if kind == PRE:
                for row in range(first, last):
                    s = k.rows[row] - 4 * k.n - k.after
                    total = 0.0
                    for j in pre:
                        if k.what[f] == 0:
                            total += (k.v1[s, j] * f1[j, 0] * k.w1[j, which]).real
                        else:
                            part = k.v1[s, j] * k.wb[j, which] * f1[j, power + 1]
                            total += h * _FACTORIAL[power] * part.real
                    data[k.data_at[b] + (row - first) * width + column] = total
                continue
            _column(k, h, kind, c, f, pre, post, f1, f2, pairs, through, past)
            at = k.data_at[b] + column
            for row in range(first, last):
                r = k.rows[row]
                total = 0.0
                if r >= 4 * k.n:
                    for i in post:
                        total += (k.v2[r - 4 * k.n, i] * through[i, 0]).real
                else:
                    o = r // 3 if r < 3 * k.n else r - 3 * k.n
                    node = r - 3 * o
                    for lap in range(4):
                        current[lap] = k.d_post[o, c] * past[lap] if c >= 0 else 0.0
                        for i in post:
                            current[lap] += (k.cv2[o, i] * through[i, lap]).real
                    if r < 3 * k.n:
                        for lap in range(3):
                            total += _TO_NODES[node, lap] * current[lap + 1]
                    else:
                        total = current[0]
                data[at + (row - first) * width] = total
    _accelerations(k, h, data)


@inner
def _accelerations(k: Any, h: float, data: Any) -> None:
    """Turn columns of higher coefficients of angles and speeds into those of accelerations at the nodes."""
    for b in range(len(k.kind)):
        start = k.column_at[b]
        width = k.column_at[b + 1] - start
        for column in range(width - k.varying[b], width):
            f = k.columns[start + column]
            if k.kind[b] == DIRECT and k.power[f] == 1:
                x, y, z = k.gear * h, k.gear * h / 2, k.gear * h / 3
            elif k.kind[b] != DIRECT and k.power[f] == 2 and k.bent == 0:
                x, y, z = h * h / 2, h * h / 6, h * h / 12
            else:
                continue
            for row in range(k.row_at[b + 1] - k.row_at[b]):
                at = k.data_at[b] + row * width + column
                c0, c1, c2 = x * data[at], y * data[at + 1], z * data[at + 2]
                for m in range(3):
                    data[at + m] = c0 * COEFFICIENTS[0, m] + c1 * COEFFICIENTS[1, m] + c2 * COEFFICIENTS[2, m]


@inner
def _column(
    k: Any, h: float, kind: int, c: int, f: int, pre: Any, post: Any,
    f1: Any, f2: Any, pairs: Any, through: Any, past: Any,
) -> None:  # fmt: skip
    """Fill what a feature does, integrated up to three times: to modes behind the multiplier, and past it."""
    which, power = k.which[f], k.power[f]
    factor = _FACTORIAL[power]
    for lap in range(4):
        past[lap] = 0.0
        for i in post:
            through[i, lap] = 0.0
        if kind == POST:
            for i in post:
                through[i, lap] = f2[i, lap] * k.w2[i, which]
        elif kind == DIRECT:
            past[lap] = factor / _FACTORIAL[power + lap]
            for i in post:
                through[i, lap] = k.wb2[i, c] * h * factor * f2[i, power + 1 + lap]
        elif k.what[f] == 0:
            for j in pre:
                share = k.cv[c, j] * k.w1[j, which]
                past[lap] += (share * f1[j, lap]).real
                for i in post:
                    through[i, lap] += k.wb2[i, c] * share * h * pairs[i, j, lap]
        else:
            for j in pre:
                share = k.cv[c, j] * k.wb[j, which] * h * factor
                past[lap] += (share * f1[j, power + 1 + lap]).real
                for i in post:
                    through[i, lap] += k.wb2[i, c] * share * h * pairs[i, j, power + 1 + lap]
            past[lap] += k.d_pre[c, which] * factor / _FACTORIAL[power + lap]
            for i in post:
                through[i, lap] += k.wb2[i, c] * k.d_pre[c, which] * h * factor * f2[i, power + 1 + lap]
            if power > 0 and which < k.n and k.e_pre[c, which] != 0.0:
                past[lap] += k.e_pre[c, which] * factor / _FACTORIAL[power + lap - 1] / h
                for i in post:
                    through[i, lap] += k.wb2[i, c] * k.e_pre[c, which] * factor * f2[i, power + lap]


@entry(Plan, int, vector, vector, vector, matrix, how=inner_inlined)
def currents(k: Any, slot: int, gains: Any, features: Any, out: Any, matrix: Any) -> None:
    """Add to the node currents `out` [3 n] what the fixed features do, to `matrix` what the moving ones do.

    `matrix` [3 n, moving]: A per rad/s^2 at a node, and per coefficient of a bent angle.
    """
    data = k.data[slot]
    for b in range(len(k.kind)):
        c = k.channel[b]
        g = gains[c] if k.kind[b] == CHANNEL else 1.0
        if g == 0.0 or k.node_rows[b] == 0:
            continue
        start = k.column_at[b]
        width = k.column_at[b + 1] - start
        fixed = width - k.varying[b]
        for row in range(k.node_rows[b]):
            r = k.rows[k.row_at[b] + row]
            at = k.data_at[b] + row * width
            total = 0.0
            for i in range(fixed):
                total += data[at + i] * features[k.columns[start + i]]
            out[r] += g * total
            for i in range(fixed, width):
                matrix[r, k.move[k.columns[start + i]]] += g * data[at + i]


@entry(Plan, int, vector, vector, vector, how=inner_inlined)
def finish(k: Any, slot: int, gains: Any, features: Any, out: Any) -> None:
    """Fill `out[3 n:]`: the currents and the states at the end of the step."""
    data = k.data[slot]
    for r in range(3 * k.n, k.results):
        out[r] = 0.0
    for b in range(len(k.kind)):
        c = k.channel[b]
        g = gains[c] if k.kind[b] == CHANNEL else 1.0
        if g == 0.0:
            continue
        start = k.column_at[b]
        width = k.column_at[b + 1] - start
        at = k.data_at[b] + k.node_rows[b] * width
        for row in range(k.row_at[b] + k.node_rows[b], k.row_at[b + 1]):
            total = 0.0
            for i in range(width):
                total += data[at + i] * features[k.columns[start + i]]
            out[k.rows[row]] += g * total
            at += width
