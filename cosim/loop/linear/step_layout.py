"""From a `LinearCircuit` to the blocks and modes that `step_maps.py` works on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import fail
from cosim.loop.linear.step_maps import ANGLE, CHANNEL, DAC, DIRECT, POST, PRE, SPEED, Ints, Plan
from cosim.types import Array, Complex

#: Step lengths kept at a time.
SLOTS = 512
#: Eigenvectors are solved with; their condition number times eps is the relative error that this makes.
_WORST_CONDITION = 1e10
#: Layouts that are kept: circuits with other values have the same blocks.
_KEPT = 8


@dataclass(frozen=True)
class Modes:
    """A = V diag(poles) W with W = V^-1, split into states that are not coupled.

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


@lru_cache(maxsize=_KEPT)
def _parts(coupled: bytes, size: int) -> Ints:
    """Return for each state the number of its part: states of two parts do not reach each other.

    `coupled` are the bytes of which entries of the state matrix are not zero.
    """
    mask = np.frombuffer(coupled, bool).reshape(size, size)
    joined = mask | mask.T | np.eye(size, dtype=bool)
    for _ in range(size.bit_length()):
        joined = joined @ joined  # reached over twice as many states
    first = np.array([row.argmax() for row in joined], np.int64)
    return np.unique(first, return_inverse=True)[1].astype(np.int64)


def modes(a: Array, name: str) -> Modes:
    """Diagonalise a state matrix part by part; `InputError` when it cannot be done to 1e-6."""
    size = len(a)
    poles, v, w = np.zeros(size, complex), np.zeros((size, size), complex), np.zeros((size, size), complex)
    condition = 1.0
    part = _parts((a != 0).tobytes(), size)
    states = np.bincount(part)
    alone = np.flatnonzero(states[part] == 1)
    poles[alone], v[alone, alone], w[alone, alone] = a[alone, alone], 1.0, 1.0
    for k in np.flatnonzero(states > 1):
        at = np.flatnonzero(part == k)
        poles[at], vectors = np.linalg.eig(a[np.ix_(at, at)])
        cond = float(np.linalg.cond(vectors))
        if not cond < _WORST_CONDITION:
            fail(
                f"the circuit's poles near {poles[at][0]:.6g} rad/s coincide in one chain of states: its "
                "modes cannot be told apart",
                key=name,
                value=cond,
                allowed=f"condition number of the eigenvectors below {_WORST_CONDITION:g}",
            )
        condition = max(condition, cond)
        v[np.ix_(at, at)], w[np.ix_(at, at)] = vectors, np.linalg.inv(vectors)
    return Modes(poles, v, w, part, condition)


def _slowest(poles: Complex) -> float:
    """Return the largest time constant [s]; 0 without poles."""
    return float(1.0 / np.abs(poles).min(initial=math.inf))


class _Block(NamedTuple):
    """Modes and pins that together give some of the results.

    Attributes
    ----------
    kind : PRE, POST, CHANNEL or DIRECT
    channel : multiplier, or column of b_post; -1 without
    rows : results; the first `nodes` of them are currents at the nodes
    columns : features; the last `moving` of them change between the sweeps
    before, after : modes before and after the multiplier
    """

    kind: int
    channel: int
    rows: list[int]
    nodes: int
    columns: list[int]
    moving: int
    before: list[int]
    after: list[int]


class _Features:
    """Where the features of a circuit begin, and what each is: states, then coefficients of the pins."""

    def __init__(self, n: int, m: int, before: int, after: int, sources: int) -> None:
        self.n, self.before, self.after = n, before, after
        self.pot = before + after
        self.u, self.cmd = self.pot + ANGLE * n, self.pot + (ANGLE + DAC) * n
        self.vel = self.pot + (ANGLE + 2 * DAC) * n
        self.noisy = self.vel + SPEED * n
        self.count = self.noisy + DAC * sources
        self.what, self.which, self.power = (np.zeros(self.count, np.int64) for _ in range(3))
        self.which[:before], self.what[before : self.pot] = range(before), 1
        self.which[before : self.pot], self.what[self.pot :] = range(after), 2
        for start, width, first, count in (
            (self.pot, ANGLE, 0, n),
            (self.u, DAC, n, n),
            (self.cmd, DAC, m, n),
            (self.vel, SPEED, m + n, n),
            (self.noisy, DAC, 2 * n, sources),
        ):
            for j in range(count):
                coefficients = np.arange(start + width * j, start + width * (j + 1))
                self.which[coefficients], self.power[coefficients] = first + j, np.arange(width)

    def inputs(self, mask: NDArray[np.bool_], *, bent: bool) -> tuple[list[int], int]:
        """Return features of the pins [pot; u; noise] chosen by `mask`, moving ones last, and their count."""
        n, pot = self.n, self.pot
        fixed = [self.u + DAC * j + k for j in range(n) if mask[n + j] for k in range(DAC)]
        first = 0 if bent else 2
        moving = [pot + ANGLE * j + k for j in range(n) if mask[j] for k in range(first, ANGLE)]
        fixed += [pot + ANGLE * j + k for j in range(n) if mask[j] for k in range(first)]
        fixed += [
            self.noisy + DAC * j + k for j in np.flatnonzero(mask[2 * n :]).tolist() for k in range(DAC)
        ]
        return fixed + moving, len(moving)

    def moves(self, motor: int, moves: int, *, bent: bool) -> Ints:
        """Return the column of what moves for each feature, -1 for what does not.

        Accelerations at the nodes of each joint or motor come first, then coefficients.
        """
        move = np.full(self.count, -1, np.int64)
        for j in range(self.n):
            first = self.vel + SPEED * j
            move[first + 1 : first + SPEED] = 3 * (motor + j) + np.arange(3)
            first = self.pot + ANGLE * j
            if bent:
                move[first : first + ANGLE] = moves + ANGLE * j + np.arange(ANGLE)
            else:
                move[first + 2 : first + ANGLE] = 3 * j + np.arange(3)
        return move


class _Pattern:
    """What the blocks of a circuit depend on: which entries of its matrices are not zero, and its parts.

    Attributes
    ----------
    b_pre, c_pre, d_pre, e_pre, b_post, c_post, d_post
        Which entries are not zero.
    one, two
        Part of each state before and after the multipliers.
    in_series
        [m, sources] which noise voltages stand in series with X of each multiplier.
    """

    _MATRICES = ("b_pre", "c_pre", "d_pre", "e_pre", "b_post", "c_post", "d_post")

    def __init__(self, circuit: LinearCircuit, one: Ints, two: Ints, in_series: NDArray[np.bool_]) -> None:
        self.b_pre, self.c_pre, self.d_pre, self.e_pre, self.b_post, self.c_post, self.d_post = (
            getattr(circuit, name) != 0 for name in self._MATRICES
        )
        self.one, self.two, self.in_series = one, two, in_series
        self._key = tuple((value.shape, value.tobytes()) for value in vars(self).values())

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Pattern) and self._key == other._key


class _Blocks:
    """The blocks of a circuit of a pattern."""

    def __init__(self, pattern: _Pattern, f: _Features) -> None:
        self._pattern, self._f = pattern, f
        self.all: list[_Block] = []

    def _outputs(self, post: list[int], direct: NDArray[np.bool_]) -> tuple[list[int], int]:
        n, c_post = self._f.n, self._pattern.c_post
        touched = [o for o in range(n) if direct[o] or c_post[o, post].any()]
        nodes = [3 * o + i for o in touched for i in range(3)]
        return nodes + [3 * n + o for o in touched] + [4 * n + s for s in post], len(nodes)

    def _post_of(self, column: int) -> list[int]:
        return _states(self._pattern.two, self._pattern.b_post[:, column])

    def _pre_of(self, channel: int) -> list[int]:
        return _states(self._pattern.one, self._pattern.c_pre[channel])

    def add_states(self, channels: Sequence[int], *, bent: bool) -> None:
        """Add the parts of the network before the multipliers that `channels` use, and all behind them."""
        n, one, two = self._f.n, self._pattern.one, self._pattern.two
        used = np.zeros(self._f.before, bool)
        for c in channels:
            used[self._pre_of(c)] = True
        for k in sorted(set(one[used].tolist())):
            at = [int(s) for s in np.flatnonzero(one == k)]
            pins, moving = self._f.inputs(self._pattern.b_pre[at].any(axis=0), bent=bent)
            rows = [4 * n + self._f.after + s for s in at]
            self.all.append(_Block(PRE, -1, rows, 0, at + pins, moving, at, []))
        for k in sorted(set(two.tolist())):
            at = [int(s) for s in np.flatnonzero(two == k)]
            rows, nodes = self._outputs(at, np.zeros(n, bool))
            self.all.append(_Block(POST, -1, rows, nodes, [self._f.before + s for s in at], 0, [], at))

    def add_channels(self, channels: Sequence[int], *, bent: bool) -> None:
        """Add the multipliers, each with what leads to it and from it."""
        circuit, n = self._pattern, self._f.n
        for c in channels:
            pre, post = self._pre_of(c), self._post_of(c)
            touched = circuit.d_pre[c] | circuit.b_pre[pre].any(axis=0)
            touched[:n] |= circuit.e_pre[c]
            pins, moving = self._f.inputs(np.concatenate([touched, circuit.in_series[c]]), bent=bent)
            rows, nodes = self._outputs(post, circuit.d_post[:, c])
            self.all.append(_Block(CHANNEL, c, rows, nodes, pre + pins, moving, pre, post))

    def add_pins(self, start: int, width: int, first: int, moving: int) -> None:
        """Add pins that no multiplier stands behind; `first` is the column of the first in b_post."""
        for j in range(self._f.n):
            post = self._post_of(first + j)
            rows, nodes = self._outputs(post, self._pattern.d_post[:, first + j])
            pins = list(range(start + width * j, start + width * (j + 1)))
            self.all.append(_Block(DIRECT, first + j, rows, nodes, pins, moving, [], post))


def _states(part: Ints, chosen: NDArray[np.bool_]) -> list[int]:
    """Return the states of every part that a chosen one belongs to."""
    return [int(k) for k in np.flatnonzero(np.isin(part, part[chosen]))]


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), np.int64)


def _bounds(lists: list[list[int]]) -> Ints:
    return _ints(np.concatenate([[0], np.cumsum([len(each) for each in lists])]))


def _joined(lists: list[list[int]]) -> Ints:
    return _ints(k for each in lists for k in each)


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
        then all their coefficients change between the sweeps of a step, and are features themselves.
    noise
        [m] number of the noise voltage in series with X of each multiplier; none without component noise.
    shafts
        Whether motors move apart from their joints, as coordinates n to 2 n.
    """
    n, m = circuit.joints, len(circuit.gain)
    one, two = modes(circuit.a_pre, "a_pre"), modes(circuit.a_post, "a_post")
    sources = int(noise.max()) + 1 if noise is not None else 0
    in_series = np.zeros((m, sources))
    if noise is not None:
        in_series[np.arange(m), noise] = 1.0
    channels = [c for c in sorted({*driven, *np.flatnonzero(circuit.y_offset)}) if circuit.gain[c] != 0]
    pattern = _Pattern(circuit, one.part, two.part, in_series != 0)
    laid = _laid_out(
        pattern, tuple(map(int, channels)), commands=commands, speeds=speeds, bent=bent,
        motor=n if shafts else 0,
    )  # fmt: skip
    return Plan(
        n=n, before=len(one.poles), after=len(two.poles), bent=int(bent), gear=gear,
        lag=_slowest(one.poles) + _slowest(two.poles), **laid,
        poles1=one.poles, v1=one.v, w1=one.w, cv=circuit.c_pre @ one.v,
        wb=one.w @ np.hstack([circuit.b_pre, np.zeros((len(one.poles), sources))]),
        poles2=two.poles, v2=two.v, w2=two.w, wb2=two.w @ circuit.b_post, cv2=circuit.c_post @ two.v,
        c_pre=np.ascontiguousarray(circuit.c_pre), c_post=np.ascontiguousarray(circuit.c_post),
        d_pre=np.hstack([circuit.d_pre, in_series]), e_pre=np.ascontiguousarray(circuit.e_pre),
        d_post=np.ascontiguousarray(circuit.d_post), gain=np.ascontiguousarray(circuit.gain),
        offset=np.ascontiguousarray(circuit.offset), bias=np.ascontiguousarray(circuit.y_offset),
        limit=np.ascontiguousarray(circuit.limit),
        data=np.zeros((SLOTS, max(int(laid["data_at"][-1]), 1))), length=np.full(SLOTS, -1.0),
        slots=np.zeros(2, np.int64),
    )  # fmt: skip


@lru_cache(maxsize=_KEPT)
def _laid_out(
    pattern: _Pattern, channels: tuple[int, ...], *, commands: bool, speeds: bool, bent: bool, motor: int
) -> dict[str, Any]:
    """Return the fields of a `Plan` that the pattern decides; `motor` as of `_Features.moves`."""
    m, n = pattern.e_pre.shape
    moves = 3 * (n + motor)
    f = _Features(n, m, len(pattern.one), len(pattern.two), pattern.in_series.shape[1])
    parts = _Blocks(pattern, f)
    parts.add_states(channels, bent=bent)
    parts.add_channels(channels, bent=bent)
    if commands:
        parts.add_pins(f.cmd, DAC, m, 0)
    if speeds:
        parts.add_pins(f.vel, SPEED, m + n, SPEED - 1)
    blocks = [b for b in parts.all if b.rows]
    size = [len(b.rows) * len(b.columns) for b in blocks]
    return dict(
        features=f.count, results=4 * n + f.after + f.before, moving=moves + ANGLE * n if bent else moves,
        kind=_ints(b.kind for b in blocks), channel=_ints(b.channel for b in blocks),
        row_at=_bounds([b.rows for b in blocks]), node_rows=_ints(b.nodes for b in blocks),
        column_at=_bounds([b.columns for b in blocks]), varying=_ints(b.moving for b in blocks),
        pre_at=_bounds([b.before for b in blocks]), post_at=_bounds([b.after for b in blocks]),
        data_at=_ints(np.concatenate([[0], np.cumsum(size)])),
        rows=_joined([b.rows for b in blocks]), columns=_joined([b.columns for b in blocks]),
        pre_modes=_joined([b.before for b in blocks]), post_modes=_joined([b.after for b in blocks]),
        what=f.what, which=f.which, power=f.power, move=f.moves(motor, moves, bent=bent),
    )  # fmt: skip
