"""The linear network of a board with other admittances, from ngspice's responses of the nominal board.

An admittance y + d between two nodes adds u d v^T to the network's matrix G: the response of any node is then
that of the nominal board less a correction with one equation for each changed element (Woodbury), exact up
to rounding. ngspice is asked once: each source and each changed element's place is driven alone.

At rest the same holds of the operating point, about which the board is taken for linear: what offsets move is
right to first order in them, and exact where only the multipliers are bent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.draws.admittances import CONDUCTANCE, CURRENT, Change
from cosim.circuits.extraction.limits_and_offsets import Offsets, beyond_rounding
from cosim.circuits.extraction.path_measurement import LOW_HZ, Paths, Session
from cosim.circuits.extraction.probes import find_probes
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.ngspice.deck import Deck
from cosim.types import Array, Complex

__all__ = ["DrawnNetwork"]


#: What is moved by less than this share of the most counts as not reached.
_REACHES = 1e-13
#: What flows at rest through a board without offsets is rounding [A].
_NO_CURRENT_A = 1e-17
_ONCE = f"lin 1 {LOW_HZ[0]} {LOW_HZ[0]}"


@dataclass(frozen=True)
class _Responses:
    """The board as it is at the frequencies `hz` [F], gain pins at full scale.

    Attributes
    ----------
    nodes
        [F, N, S]: sources (pot, u, X probes, cmd, vel) -> behind the X probes, imot.
    across
        [F, K, S]: sources -> voltage that drives each changed element.
    own, out
        [F, K, K], [F, N, K]: 1 A into each changed element's place -> the same voltages, the same nodes.
    """

    hz: Array
    nodes: Complex
    across: Complex
    own: Complex
    out: Complex


@dataclass(frozen=True)
class _Rest:
    """The board as it is at rest, gain pins held.

    Attributes
    ----------
    across, nodes
        [K], [N] V, of the changed elements, and behind the X probes, of imot and behind the control probes.
    own, out
        [K, K], [N, K]: 1 A into each changed element's place -> the same voltages.
    """

    across: Array
    nodes: Array
    own: Array
    out: Array


class _Part:
    """Sources of the board and the nodes that they reach; `elements` on the way are found for each sweep."""

    def __init__(self, nodes: NDArray[np.int64], sources: NDArray[np.int64]) -> None:
        self.nodes, self.sources = nodes, sources
        self._cut: dict[str, tuple[NDArray[np.int64], Complex, Complex, Complex, Complex]] = {}

    def response(self, sweep: str, r: _Responses, size: NDArray[Any]) -> Complex:
        """Return what the sources do at the nodes [F, N, S] with changed admittances `size` [F, K]."""
        if sweep not in self._cut:
            on = self._on_the_way(r)
            self._cut[sweep] = (
                on,
                r.nodes[:, self.nodes[:, None], self.sources],
                r.across[:, on[:, None], self.sources],
                r.own[:, on[:, None], on],
                r.out[:, self.nodes[:, None], on],
            )
        on, nodes, across, own, out = self._cut[sweep]
        change = size[:, on, None]
        seen: Complex = nodes - out @ np.linalg.solve(np.eye(len(on)) + change * own, change * across)
        return seen

    def _on_the_way(self, r: _Responses) -> NDArray[np.int64]:
        """Return the elements that the sources reach and that reach the nodes, over others or not."""
        scale = np.sqrt(np.abs(np.einsum("fkk->fk", r.own)))
        scale[scale == 0.0] = 1.0

        def reached(by: Complex, linked: NDArray[np.bool_]) -> NDArray[np.bool_]:
            size = np.abs(by) / scale[:, :, None]
            places: NDArray[np.bool_] = (
                size > _REACHES * size.max(axis=(1, 2), keepdims=True, initial=0.0)
            ).any(axis=(0, 2))
            for _ in range(len(places)):
                places |= linked[:, places].any(axis=1)
            return places

        linked = (np.abs(r.own) > _REACHES * scale[:, :, None] * scale[:, None, :]).any(axis=0)
        to = reached(r.across[:, :, self.sources], linked)
        onward = reached(r.out[:, self.nodes].transpose(0, 2, 1), linked.T)
        between: NDArray[np.int64] = np.flatnonzero(to & onward)
        return between


class DrawnNetwork:
    """A board in ngspice whose elements change, outside it.

    Parameters
    ----------
    board
        The board as it is.
    elements
        What changes on it.
    values
        The components' values on that board.

    Attributes
    ----------
    session
        The board in ngspice.
    """

    def __init__(self, board: Deck, elements: Sequence[Change], values: Sequence[float]) -> None:
        self._elements = tuple(elements)
        self._into = list(dict.fromkeys(each.into for each in elements))
        self._place = [self._into.index(each.into) for each in elements]
        self._across = [each.across for each in elements]
        self._inner = list(dict.fromkeys(node for pair in self._across for node in pair))
        self._kind = np.array([each.kind for each in elements], int)
        self._base = self._admittances(values)
        lines = [f"{_pushed(k)} {b} {a} dc 0 ac 0" for k, (a, b) in enumerate(self._into)]
        self.session = Session(board, lines)
        self._inside = [part.x_node for part in self.session.multipliers]
        self._outputs = [f"imot{i + 1}" for i in range(self.session.joints)]
        self._controls = _controls(board, self.session)
        self._known: dict[str, _Responses] = {}

    def _admittances(self, values: Sequence[float]) -> Array:
        return np.array([each.admittance([values[k] for k in each.keys]) for each in self._elements])

    @cached_property
    def _before(self) -> list[_Part]:
        """Return what stands before the multipliers, of each joint alone where no joint reaches another."""
        n, m = self.session.joints, len(self._inside)
        joint = np.arange(m) % n
        if not self.session.together:
            return [_Part(np.arange(m), np.arange(2 * n))]
        return [_Part(np.flatnonzero(joint == j), np.array([j, n + j])) for j in range(n)]

    @cached_property
    def _after(self) -> list[_Part]:
        """Return what stands after the multipliers, X probes first: of each motor alone, or of all."""
        n, m = self.session.joints, len(self._inside)
        motor = np.arange(m) // n % n
        if not self.session.together:
            return [_Part(np.arange(m + n), 2 * n + np.arange(m + 2 * n))]
        return [
            _Part(
                np.array([*np.flatnonzero(motor == i), m + i]),
                2 * n + np.array([*np.flatnonzero(motor == i), m + i, m + n + i]),
            )
            for i in range(n)
        ]

    def learn(self, gain: Array, circuit: LinearCircuit) -> None:
        """Take over what the multipliers do and the board's model as it is, and look at the board at rest.

        `gain` [m], 1/V at full scale, is reached by none of the elements that change.
        """
        self._gain, self._circuit = gain, circuit
        self._none, self._full = self._still(0.0), self._still(self.session.v_fs)

    def sweep(self, sweep: str) -> None:
        """Ask ngspice for the responses over a sweep, once."""
        if sweep in self._known:
            return
        s = self.session
        s.hold(dict.fromkeys(s.channels, s.v_fs))
        sources = [*s.signals, *(part.x for part in s.multipliers), *s.commands]
        watched = [*self._inside, *self._outputs]
        nodes, across = self._driven(sources, sweep, watched)
        out, own = self._driven([_pushed(k) for k in range(len(self._into))], sweep, watched)
        s.hold(dict.fromkeys(s.channels, 0.0))
        self._known[sweep] = _Responses(s.hz, nodes, across, own[:, :, self._place], out[:, :, self._place])

    def _still(self, volts: float) -> _Rest:
        s = self.session
        s.hold(dict.fromkeys(s.channels, volts))
        watched = [*self._inside, *self._outputs, *self._controls]
        at = s.operating_point([*watched, *(node for node in self._inner if node != "0")])
        inner = dict(zip((node for node in self._inner if node != "0"), at[len(watched) :], strict=True))
        across = np.array([inner.get(a, 0.0) - inner.get(b, 0.0) for a, b in self._across])
        out, own = self._driven([_pushed(k) for k in range(len(self._into))], _ONCE, watched)
        s.hold(dict.fromkeys(s.channels, 0.0))
        return _Rest(across, at[: len(watched)], own[0].real[:, self._place], out[0].real[:, self._place])

    def _driven(self, sources: Sequence[str], sweep: str, watched: Sequence[str]) -> tuple[Complex, Complex]:
        """Drive sources one by one: what `watched` nodes do [F, N, S], and elements' voltages [F, K, S]."""
        nodes, across = [], []
        for source in sources:
            response = self.session.respond(source, sweep, [*watched, *self._inner])
            nodes.append(response[:, : len(watched)])
            inner = dict(zip(self._inner, response[:, len(watched) :].T, strict=True))
            across.append(np.array([inner[a] - inner[b] for a, b in self._across]).T)
        if not sources or not self._elements:
            return (
                np.stack(nodes, axis=2) if nodes else np.zeros((1, len(watched), 0), complex),
                np.zeros((len(nodes[0]) if nodes else 1, 0, len(sources)), complex),
            )
        return np.stack(nodes, axis=2), np.stack(across, axis=2)

    def change(self, values: Sequence[float]) -> Array:
        """Return by how much the admittances differ from those of the board as it is, for these values."""
        return self._admittances(values) - self._base

    def paths(self, sweep: str, change: Array) -> Paths:
        """Return the paths over a sweep that was asked for, with changed admittances."""
        r, s = self._known[sweep], self.session
        n, m = s.joints, len(self._inside)
        points: Complex = 2j * np.pi * r.hz.astype(complex)
        one = np.ones(len(points), np.complex128)
        by_kind = np.stack([one, points, one / points, 0.0 * one])
        size = change * by_kind[self._kind].T
        x = np.zeros((len(points), m, 2 * n), complex)
        post = np.zeros((len(points), n, m + 2 * n), complex)
        held = self._held(change) / (self._gain * s.v_fs)
        for part in self._before:
            x[:, part.nodes[:, None], part.sources] = part.response(sweep, r, size)
        for part in self._after:
            # a driven probe also moves what stands before it a little: solve for each multiplier's own share
            response = part.response(sweep, r, size).transpose(0, 2, 1)
            own, motors = part.nodes[part.nodes < m], part.nodes[part.nodes >= m] - m
            count = len(own)
            share = np.linalg.solve(response[:, :count, :count], response[:, :count, count:])
            post[:, motors[:, None], own] = share.transpose(0, 2, 1) * held[own]
            direct = response[:, count:, count:].transpose(0, 2, 1)
            post[:, motors[:, None], part.sources[count:] - 2 * n] = direct
        total = r.nodes[:, m:, : 2 * n]
        return Paths(r.hz, x, self._gain, post, total, np.eye(2 * n), False, s.v_fs)

    def _held(self, change: Array) -> Array:
        """Return the control voltages [m] at full scale, relative to those of the board as it is."""
        count = len(self._controls)
        if not self._full.out[-count:].any():  # the pins themselves
            return np.ones(count)
        before = self._full.nodes[-count:]
        after = before + self._moved(self._full, change)[-len(self._controls) :]
        return np.divide(after, before, out=np.ones(len(before)), where=before != 0.0)

    def _moved(self, rest: _Rest, change: Array) -> Array:
        """Return how far the nodes of `rest` move [V]; there a capacitor is open and an inductor a short."""
        size = np.where(self._kind == CONDUCTANCE, change, 0.0)
        drive = size * rest.across + np.where(self._kind == CURRENT, change, 0.0)
        if np.abs(drive).max(initial=0.0) < _NO_CURRENT_A:
            return np.zeros(len(rest.out))
        moved: Array = -rest.out @ np.linalg.solve(np.eye(len(size)) + size[:, None] * rest.own, drive)
        return moved

    def offsets(self, paths: Paths, steady: Array, change: Array) -> Offsets:
        """Return the offsets of the board with changed admittances.

        `steady` [n, m] is w -> imot at rest, of `paths`.
        """
        n, m = self.session.joints, len(self._inside)
        x, y = self._circuit.x_offset, self._circuit.y_offset
        moved = self._moved(self._none, change)
        dx, dy = moved[:m], moved[m + n :]
        # what passes the multipliers, linear about the board as it is
        bent = x * y + y * dx + x * dy
        through = steady @ (paths.gain * self.session.v_fs / (self.session.v_fs + y + dy) * bent)
        current = self._none.nodes[m : m + n] + moved[m : m + n] - through
        return beyond_rounding(self.session, Offsets(current, x + dx, y + dy))


def _pushed(place: int) -> str:
    return f"icosim{place}"


def _controls(board: Deck, session: Session) -> list[str]:
    """Return the node behind the control probe of each multiplier."""
    probes = find_probes(board)
    rows = []
    for part in session.multipliers:
        group = next(probe.group for probe in probes if probe.source == part.x)
        rows.append(next(p.nodes[1] for p in probes if p.group == group and p.source not in (part.x, part.z)))
    return rows
