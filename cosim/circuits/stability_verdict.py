"""Is a board stable at its operating point? One verdict for every circuit model, kept by the deck's content.

Implicit steps of a millisecond damp a pole at +1e6 rad/s, and an ideal amplifier has no pole at all: a run
that looks calm proves nothing. So the board is judged apart from the run, with amplifiers of finite bandwidth.
Its poles in the right half plane are counted without any fit (`encirclements`); where there are some, a
rational fit of the impedance finds them, a fit of another order must agree, and a kick must grow in a
transient analysis whose steps resolve the pole.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.caution import Caution
from cosim.circuits.aaa import poles_of
from cosim.circuits.cache import load_arrays, store_arrays
from cosim.circuits.encirclements import Impedances, count, measure
from cosim.circuits.loop_ports import Port, loop_ports
from cosim.circuits.session import Bench
from cosim.errors import CosimError, InputError, Problem
from cosim.ngspice.deck import Deck

__all__ = ["Instability", "Verdict", "judge", "known"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Report = Callable[[dict[str, Any]], None]

#: To be raised with every change that may change a verdict.
_VERSION = 1
#: Band in which a pole is looked for [Hz]; agreement of two fits of different order.
_BAND_HZ, _AGREE = (1e-4, 1e11), 0.05
#: The kick: steps of this share of 1/|p|, so many times 1/Re p, the voltage that it makes at once [V].
_STEP, _FOLDS, _KICK_V = 0.1, 6.0, 1e-4
#: Steps beyond which a transient is not worth its time: a pole so near to the axis grows that slowly.
_MOST_STEPS = 400_000
#: Growth between the middle and the last part of the transient; it is exp(2.5) if the pole is right.
_GROWS = 2.0


@dataclass(frozen=True)
class Instability:
    """A loop whose disturbances grow.

    Attributes
    ----------
    real, imag
        Its fastest growing pole [rad/s]; NaN if the poles were counted but not found.
    loop
        Instance paths of the amplifiers in the loop: grounding the output of any of them calms it.
    condition
        Gains at which it was seen, in words.
    confirmed
        Whether another fit order and a growing kick agree.
    declared
        Whether all of the loop stands in blocks that the netlist declares bistable or oscillating.
    """

    real: float
    imag: float
    loop: tuple[str, ...]
    condition: str
    confirmed: bool
    declared: bool

    def __str__(self) -> str:
        where = ", ".join(self.loop)
        if not np.isfinite(self.real):
            return f"unstable: a pole in the right half plane, in the loop of {where} {self.condition}"
        shown = f"{self.real:+.4g}" + (f" +- {abs(self.imag):.4g}j" if self.imag else "")
        hz = abs(complex(self.real, self.imag)) / (2.0 * np.pi)
        return f"unstable: a pole at {shown} rad/s ({hz:.4g} Hz) in the loop of {where} {self.condition}"


@dataclass(frozen=True)
class Verdict:
    """What was found about a board; `unjudged` says why nothing was, if so."""

    found: tuple[Instability, ...] = ()
    unjudged: str = ""

    @property
    def refused(self) -> tuple[Instability, ...]:
        """Those for which a run is refused."""
        return tuple(each for each in self.found if each.confirmed and not each.declared)

    @property
    def stable(self) -> bool:
        """Whether nothing grows that the netlist does not declare."""
        return not self.unjudged and all(each.declared for each in self.found)

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as JSON-ready fields."""
        rows = []
        for each in self.found:
            row = asdict(each) | {"loop": list(each.loop), "text": str(each)}
            if not np.isfinite(each.real):
                row |= {"real": None, "imag": None}
            rows.append(row)
        return {"stable": self.stable, "found": rows, "unjudged": self.unjudged}

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Verdict:
        """Return what `as_dict` has written."""

        def number(value: float | None) -> float:
            return np.nan if value is None else float(value)

        return cls(
            tuple(
                Instability(
                    number(row["real"]), number(row["imag"]), tuple(map(str, row["loop"])),
                    str(row["condition"]), bool(row["confirmed"]), bool(row["declared"]),
                )
                for row in stored["found"]
            ),
            str(stored["unjudged"]),
        )  # fmt: skip

    def require(self, file: str) -> None:
        """Refuse a board that is certainly unstable.

        Raises
        ------
        InputError
            Naming every pole, its loop and its amplifiers.
        """
        if self.refused:
            raise InputError(
                Problem(
                    f"the board is {each}; look for positive feedback there, or declare the block "
                    "(`*@ stability=bistable` or `oscillating`); --allow-unstable runs it as it is",
                    file=file,
                    key=each.loop[0],
                )
                for each in self.refused
            )

    def cautions(self) -> list[Caution]:
        """Return what is doubtful, or was let pass by whoever allows unstable boards."""
        if self.unjudged:
            return [Caution("stability-unknown", f"nobody knows whether the board is stable: {self.unjudged}",
                            "look at the loops with `cosim check`")]  # fmt: skip
        return [
            Caution(
                "unstable-circuit",
                f"the board is {each}" + ("" if each.confirmed else " (not confirmed by a transient)"),
                "implicit steps may hide what grows there: believe nothing before the loop is mended",
            )
            for each in self.found
            if not each.declared
        ]


@dataclass(frozen=True)
class Question:
    """What a verdict depends on: decks to judge, and gains [V] that are commanded, by gain pin."""

    boards: tuple[Deck, ...]
    commanded: Mapping[str, float] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Name of the verdict in the cache."""
        gains = sorted((pin, repr(volts)) for pin, volts in self.commanded.items())
        texts = [(board.text, board.declared) for board in self.boards]
        return "verdict-" + hashlib.sha256(repr((_VERSION, gains, texts)).encode()).hexdigest()


def known(question: Question) -> Verdict | None:
    """Return the verdict on the same decks at the same gains, if it was reached before."""
    stored = load_arrays(question.digest)
    try:
        return Verdict.of(stored[0]) if stored else None
    except (KeyError, TypeError, ValueError):  # damaged: the board itself is at hand
        return None


def judge(payload: Mapping[str, Any], report: Report) -> Verdict:
    """Reach a verdict in ngspice's child process, or take it from the cache; payload: 'question'."""
    question: Question = payload["question"]
    verdict = known(question)
    if verdict is None:
        found: list[Instability] = []
        for board in question.boards:
            try:
                found += _Court(board, report).found(question.commanded)
            except CosimError as reason:
                return Verdict(tuple(found), unjudged=str(reason).splitlines()[0])
            if found:
                break
        verdict = Verdict(tuple(found))
        store_arrays(question.digest, verdict.as_dict(), {})
    return verdict


class _Court:
    """One board on a bench with a current source at every port."""

    def __init__(self, board: Deck, report: Report) -> None:
        self.board, self.report = board, report
        self.ports = loop_ports(board)
        self._bench: Bench | None = None

    @property
    def bench(self) -> Bench:
        """The bench, loaded anew after a transient has had the simulator."""
        if self._bench is None:
            lines = [f"{_source(k)} 0 {port.node} dc 0 ac 0" for k, port in enumerate(self.ports)]
            self._bench = Bench(self.board, lines, multipliers=False)
        return self._bench

    def found(self, commanded: Mapping[str, float]) -> list[Instability]:
        """Look for instabilities at every gain that matters; the first gains that show one are enough."""
        if not self.ports:
            return []
        v_fs, channels = self.bench.v_fs, self.bench.channels
        conditions = {
            "with all gains at zero": dict.fromkeys(channels, 0.0),
            "with all gains at full scale": dict.fromkeys(channels, v_fs),
        }
        if any(commanded.values()):
            conditions["at the commanded gains"] = dict.fromkeys(channels, 0.0) | dict(commanded)
        chosen: list[int] | None = None
        for condition, volts in conditions.items():
            self.report({"stage": f"stability {condition}"})
            self.bench.hold(volts)
            seen, chosen = measure(self._ask, chosen)
            if count(seen.of(chosen)) > 0:
                return self._loops(seen, chosen, condition, volts)
        return []

    def _ask(self, sweep: str) -> tuple[Array, Complex]:
        nodes = [port.node for port in self.ports]
        z = np.stack([self.bench.respond(_source(k), sweep, nodes) for k in range(len(nodes))], axis=2)
        self.report({})
        return self.bench.hz, z

    def _loops(
        self, seen: Impedances, chosen: list[int], condition: str, volts: Mapping[str, float]
    ) -> list[Instability]:
        """Tell the loops apart: each is the set of ports any of which, grounded, calms what the others do."""
        winding = {port: count(seen.of([port])) for port in chosen}
        left = [port for port in chosen if winding[port] > 0]
        out = []
        while left:
            first = left[0]
            loop = [p for p in left if p == first or count(seen.of([first, p])) < winding[first] + winding[p]]
            left = [port for port in left if port not in loop]
            out.append(self._instability(seen, loop, condition, volts))
        if not out:  # nothing but several ports together calms it
            out.append(self._instability(seen, chosen, condition, volts))
        return sorted(out, key=lambda each: -each.real if np.isfinite(each.real) else np.inf)

    def _instability(
        self, seen: Impedances, loop: list[int], condition: str, volts: Mapping[str, float]
    ) -> Instability:
        owners = tuple(dict.fromkeys(self.ports[port].owner for port in loop))
        declared = all(any(o.startswith(d + ".") or o == d for d in self.board.declared) for o in owners)
        at, pole = _pole(seen, loop)
        none = Instability(np.nan, np.nan, owners, condition, confirmed=False, declared=declared)
        if pole is None:
            return none
        grows = declared or self._grows(self.ports[at], pole, _level(seen, at, pole), volts)
        return replace(none, real=float(pole.real), imag=float(pole.imag), confirmed=grows)

    def _grows(self, port: Port, pole: complex, ohms: float, volts: Mapping[str, float]) -> bool:
        """Kick a port and see whether what is left of it grows, with steps that resolve the pole."""
        length = _FOLDS / pole.real
        step = min(_STEP / abs(pole), length / 100.0)
        if length / step > _MOST_STEPS:
            return False
        amps = _KICK_V / ohms
        lines = [
            f"ikick 0 {port.node} dc 0 pulse(0 {amps!r} 0 {step!r} {step!r} {step!r})",
            ".options method=trap reltol=1e-6 vntol=1e-12 abstol=1e-15 chgtol=1e-20 trtol=1",
        ]
        bench, self._bench = Bench(self.board, lines, multipliers=False), None
        bench.hold(volts)
        t, v = bench.transient(step, length, port.node)
        moved = np.abs(v - v[0])
        middle, last = moved[(t > 0.3 * length) & (t < 0.5 * length)], moved[t > 0.8 * length]
        return bool(last.max(initial=0.0) > _GROWS * middle.max(initial=0.0) > 0.0)


def _source(port: int) -> str:
    return f"ip{port:03d}"


def _level(seen: Impedances, port: int, pole: complex) -> float:
    """Return how many ohms a port shows near a pole."""
    near = int(np.argmin(np.abs(seen.hz - abs(pole) / (2.0 * np.pi))))
    return float(np.abs(seen.z[near, port, port]))


def _pole(seen: Impedances, loop: Sequence[int]) -> tuple[int, complex | None]:
    """Return the fastest growing pole that two fits of different order agree on, and a port that shows it."""
    inside = (seen.hz > _BAND_HZ[0]) & (seen.hz < _BAND_HZ[1])
    s = 2j * np.pi * seen.hz[inside].astype(complex)
    best: tuple[int, complex | None] = (loop[0], None)
    for port in loop:
        h = seen.z[inside, port, port]
        f = (h / np.abs(h).max())[:, None]
        first, second = (
            found[(found.real > 0.0) & (np.abs(found) < np.abs(s[-1]))]
            for found in (poles_of(s, f, 1e-4, True), poles_of(s[::2], f[::2], 1e-9, False))
        )
        for pole in first.tolist():
            apart = np.abs(second - pole)
            if apart.size and apart.min() <= _AGREE * abs(pole):
                if best[1] is None or pole.real > best[1].real:
                    best = (port, pole)
    return best
