"""Find what grows on a board: poles in the right half plane, their loops, and a kick that proves it.

Poles are counted without any fit (`encirclements`) on the board as ngspice linearises it at rest; gains at
zero, at full scale and as commanded. Where there are some, a rational fit of an impedance finds them, a fit
of another order must agree, and a kick must grow in a transient analysis whose steps resolve the pole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.extraction.testbench import Testbench
from cosim.circuits.fitting.aaa import poles_of
from cosim.circuits.instability.encirclements import HELD_OHM, Impedances, alike, count, measure, wound
from cosim.circuits.instability.loop_ports import Port, loop_ports
from cosim.circuits.instability.stability_verdict import Instability, Latched, Question, Verdict
from cosim.errors import CosimError
from cosim.ngspice.deck import Deck
from cosim.types import Array, Complex, Report

__all__ = ["at_rest", "judge"]


#: One frequency, to see what is held.
_ONCE = "lin 1 1k 1k"
#: Sweep and band of the search for a pole; agreement of two fits of different order.
_CLOSELY, _BAND_HZ, _AGREE = "dec 20 1m 10g", (1e-3, 1e10), 0.05
#: No real part behaves as modelled beyond that band: its last elements set the response there, such as a
#: common-mode gain that keeps rising. Sweep and band [Hz] of the search for poles there.
_BEYOND, _BEYOND_HZ = "dec 20 1g 100t", (1e9, 1e14)
#: The kick: steps of this share of 1/|p|, so many times 1/Re p, the voltage that it makes at once [V].
_STEP, _FOLDS, _KICK_V = 0.1, 6.0, 1e-4
#: Tolerances of the transient, far below the kick; transistors of some vendors' models meet only the second.
_TOLERANCES = (
    ".options method=trap reltol=1e-6 vntol=1e-12 abstol=1e-15 chgtol=1e-20 trtol=1",
    ".options method=trap reltol=1e-4 vntol=1e-8 abstol=1e-11 chgtol=1e-16 trtol=1",
)
#: Steps beyond which a transient is not worth its time: a pole so near to the axis grows that slowly.
_MOST_STEPS = 400_000
#: Candidates that are kicked, one after the other.
_MOST_POLES = 4
#: Growth between the middle and the last part of the transient that tells of a pole in the right half plane,
#: and of this pole: it is exp(2.5) then, while a slower one makes the start of a ramp, t to t^2, 2 to 4.
_GROWS, _AS_FAST = 2.0, 6.0
#: Share of the supply at which an output stands at its limit, whatever its part states.
_LATCHED = 0.6


def judge(payload: Mapping[str, Any], report: Report) -> Verdict:
    """Reach a verdict in ngspice's child process; payload: 'question'."""
    question: Question = payload["question"]
    verdict = Verdict()
    try:
        for board in question.boards:
            verdict = _Court(board, report).verdict(question.commanded)
            if not verdict.stable:
                break
        if verdict.latched and not verdict.instabilities and question.plain is not None:
            plain = _Court(question.plain, report).verdict(question.commanded)
            verdict = replace(plain, latched=verdict.latched)
    except CosimError as reason:  # whoever runs the board meets the reason again and names it fully
        return replace(verdict, unjudged=str(reason).splitlines()[0])
    return verdict


def at_rest(payload: Mapping[str, Any], report: Report) -> list[float]:
    """Return the voltages [V] of 'nodes' at the operating point of 'board' with 'pins' held, in the child."""
    bench = Testbench(payload["board"], multipliers=False)
    bench.hold(payload["pins"])
    return [float(volts) for volts in bench.operating_point(payload["nodes"])]


class _Court:
    """One board on a bench with a current source at every port."""

    def __init__(self, board: Deck, report: Report) -> None:
        self.board, self.report = board, report
        self.ports = loop_ports(board)
        self._bench: Testbench | None = None
        held = self._held() if self.ports else []
        if held:
            self.ports, self._bench = loop_ports(board, held), None

    @property
    def bench(self) -> Testbench:
        """The bench, loaded anew after a transient has had the simulator."""
        if self._bench is None:
            lines = [f"{_source(k)} 0 {port.node} dc 0 ac 0" for k, port in enumerate(self.ports)]
            self._bench = Testbench(self.board, lines, multipliers=False)
        return self._bench

    def verdict(self, commanded: Mapping[str, float]) -> Verdict:
        """Look for instabilities at every gain that matters; the first gains that show one are enough."""
        if not self.ports:
            return Verdict()
        none = dict.fromkeys(self.bench.channels, 0.0)
        full = dict.fromkeys(self.bench.channels, self.bench.v_fs)
        latched = tuple(self._latched())
        at_rest, chosen, notes = self._poles(none, None, "with all gains at zero")
        if notes:
            return Verdict(notes, latched)
        at_full, _, notes = self._poles(full, chosen, "with all gains at full scale")
        matter = bool(chosen) and not alike(at_rest.of(chosen), at_full.of(chosen))
        if not notes and matter and any(commanded.values()):
            _, _, notes = self._poles(none | dict(commanded), chosen, "at the commanded gains")
        return Verdict(notes, latched, matter)

    def _poles(
        self, volts: Mapping[str, float], ports: list[int] | None, condition: str
    ) -> tuple[Impedances, list[int], tuple[Instability, ...]]:
        self.report({"stage": f"stability {condition}"})
        self.bench.hold(volts)
        seen, chosen = measure(self._ask, ports)
        unstable = count(seen.of(chosen)) > 0
        return seen, chosen, tuple(self._loops(seen, chosen, condition, volts)) if unstable else ()

    def _latched(self) -> list[Latched]:
        """Return the amplifiers that are at their limit with all pins at zero."""
        amplifiers = [a for a in self.board.amplifiers if not self._is_declared(a.path) and a.out_node != "0"]
        volts = self.bench.operating_point([a.out_node for a in amplifiers])
        stuck = np.flatnonzero(np.abs(volts) > _LATCHED * SUPPLY_V)
        return [Latched(amplifiers[k].path, float(volts[k])) for k in stuck]

    def _is_declared(self, owner: str) -> bool:
        return any(owner == path or owner.startswith(path + ".") for path in self.board.declared)

    def _held(self) -> list[str]:
        """Return the amplifiers whose output a voltage source holds."""
        own = {a.path for a in self.board.amplifiers}
        z = np.abs(np.diagonal(self._ask(_ONCE)[1][0]))
        return [port.owner for port, ohms in zip(self.ports, z, strict=True)
                if ohms <= HELD_OHM and port.owner in own]  # fmt: skip

    def _ask(self, sweep: str) -> tuple[Array, Complex]:
        nodes = [port.node for port in self.ports]
        z = np.stack([self.bench.respond(_source(k), sweep, nodes) for k in range(len(nodes))], axis=2)
        self.report({})
        return self.bench.hz, z

    def _loops(
        self, seen: Impedances, chosen: list[int], condition: str, volts: Mapping[str, float]
    ) -> list[Instability]:
        """Separate the loops: each is a set of ports any of which, grounded, stabilises the others."""
        winding = {port: count(seen.of([port])) for port in chosen}
        left = [port for port in chosen if winding[port] > 0]
        left = [port for port in left if self.ports[port].active] or left
        close = seen.joined(Impedances(*self._ask(_CLOSELY)))
        loops: list[list[int]] = []
        while left:
            first = left[0]
            loop = [p for p in left if p == first or count(seen.of([first, p])) < winding[first] + winding[p]]
            left = [port for port in left if port not in loop]
            loops.append(loop)
        loops = loops or [chosen]  # nothing but several ports together calms it
        near = [loop for loop in loops if not self._is_beyond(seen, loop)]
        out = [self._instability(close, loop, condition, volts) for loop in near]
        return sorted(out, key=lambda each: -each.real if np.isfinite(each.real) else np.inf)

    def _is_beyond(self, seen: Impedances, loop: list[int]) -> bool:
        """Whether all poles of a loop in the right half plane lie beyond the band of any part."""
        every = count(seen.of(loop))
        if wound(seen.of(loop).up_to(_BAND_HZ[1])) > every - 0.5:  # far fits find poles in rounding as well
            return False
        far = Impedances(*self._ask(_BEYOND)).of(loop)
        fast = 2.0 * np.pi * _BAND_HZ[1]
        counts = (_right(far.hz, far.z[:, k, k], _BEYOND_HZ) for k in range(len(loop)))
        most = max(sum(2 if p.imag else 1 for p in poles if abs(p) > fast) for poles in counts)
        return most >= every > 0

    def _instability(
        self, seen: Impedances, loop: list[int], condition: str, volts: Mapping[str, float]
    ) -> Instability:
        owners = tuple(dict.fromkeys(self.ports[port].owner for port in loop))
        declared = all(map(self._is_declared, owners))
        unknown = Instability(np.nan, np.nan, owners, condition, confirmed=False, declared=declared)
        told = [
            (replace(unknown, real=float(pole.real), imag=float(pole.imag)), at, pole)
            for at, pole in _poles(seen, loop)
        ]
        if declared and told:
            return replace(told[0][0], confirmed=True)
        # two fits may agree on what is no pole, at the end of the band: one grows as fast when it is kicked
        growing: list[tuple[float, Instability]] = []
        for instability, at, pole in told:
            growth = self._growth(self.ports[at], pole, _level(seen, at, pole), volts)
            if growth > _GROWS:
                growing.append((growth, replace(instability, confirmed=True)))
            if growth > _AS_FAST:
                break
        if growing:
            return max(growing, key=lambda each: each[0])[1]
        return told[0][0] if told else unknown

    def _growth(self, port: Port, pole: complex, ohms: float, volts: Mapping[str, float]) -> float:
        """Kick a port and return by how much what is left of it grows, with steps that resolve the pole.

        0 where no transient tells.
        """
        length = _FOLDS / pole.real
        step = min(_STEP / abs(pole), length / 100.0)
        if length / step > _MOST_STEPS:
            return 0.0
        amps = _KICK_V / ohms
        kick = f"ikick 0 {port.node} dc 0 pulse(0 {amps!r} 0 {step!r} {step!r} {step!r})"
        for tolerances in _TOLERANCES:
            bench, self._bench = Testbench(self.board, [kick, tolerances], multipliers=False), None
            bench.hold(volts)
            try:
                t, v = bench.transient(step, length, port.node)
                break
            except CosimError:  # ngspice comes to no end
                continue
        else:
            return 0.0
        moved = np.abs(v - v[0])
        middle, last = moved[(t > 0.3 * length) & (t < 0.5 * length)], moved[t > 0.8 * length]
        before = float(middle.max(initial=0.0))
        return float(last.max(initial=0.0)) / before if before > 0.0 else 0.0


def _source(port: int) -> str:
    return f"ip{port:03d}"


def _level(seen: Impedances, port: int, pole: complex) -> float:
    """Return how many ohms a port shows near a pole."""
    near = int(np.argmin(np.abs(seen.hz - abs(pole) / (2.0 * np.pi))))
    return float(np.abs(seen.z[near, port, port]))


def _poles(seen: Impedances, loop: Sequence[int]) -> list[tuple[int, complex]]:
    """Return the growing poles that two fits of different order agree on, fastest first, each with a port.

    A pole that several ports show is of the first.
    """
    every = [(port, pole) for port in loop for pole in _right(seen.hz, seen.z[:, port, port], _BAND_HZ)]
    apart: list[tuple[int, complex]] = []
    for port, pole in sorted(every, key=lambda each: -each[1].real):
        alone = all(min(abs(pole - p), abs(pole.conjugate() - p)) > _AGREE * abs(p) for _, p in apart)
        if alone and len(apart) < _MOST_POLES:
            apart.append((port, pole))
    return apart


def _right(hz: Array, h: Complex, band_hz: tuple[float, float]) -> list[complex]:
    """Return the poles in the right half plane, within a band, that two fits of different order agree on."""
    inside = (hz > band_hz[0]) & (hz < band_hz[1])
    s = 2j * np.pi * hz[inside].astype(complex)
    f = (h[inside] / np.abs(h[inside]).max())[:, None]
    first, second = (
        poles[(poles.real > 0.0) & (np.abs(poles) < np.abs(s[-1]))]
        for poles in (poles_of(s, f, 1e-4, True), poles_of(s[::2], f[::2], 1e-9, False))
    )
    return [p for p in first.tolist() if second.size and np.abs(second - p).min() <= _AGREE * abs(p)]
