"""How late a spring acts, block by block: the delay of every path from a potentiometer to a motor.

The delay of a path as frequency goes to zero, -d phase/d omega, is the sum of those of its blocks. A late
spring of stiffness k takes k times its delay from the viscosity of its device, whatever the shape of the lag
(footnote 1 of the paper says that the circuit has none).

A path is cut at an amplifier's output if all of it passes there: the response up to it times what moving that
output alone does to the motor is then the response of the whole. Between two cuts the delays add up whatever
stands there, leads included; amplifiers in parallel, or in one loop, have no separate delays and are reported
together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from cosim.catalogue import AND
from cosim.circuits.extraction.testbench import Testbench
from cosim.errors import InputError, fail
from cosim.ngspice.child import TIME_LIMIT_S, Child, call
from cosim.ngspice.deck import Amplifier, Deck
from cosim.ngspice.netlist import parse
from cosim.ngspice.overrides import shared_name

__all__ = ["MOTOR", "SpringDelay", "Step", "groups_of", "measure", "slowest", "spring_delays"]

#: What stands behind the driver's amplifier.
MOTOR = "motor"
#: Where w -> 0 is read: so low that every phase is this small [rad], its cube then is 1e-6 of it.
_FIRST_HZ, _PHASE, _LEAST_HZ = 0.1, 1e-3, 1e-9
#: Products of responses and sums of delays agree to this share where all of a path passes an output: what
#: leaks past it matters no more. Weaker shares of a path, and weaker loops, are leaks themselves.
_COMPLETE, _LEAK = 1e-2, 1e-3


@dataclass(frozen=True)
class Step:
    """What one block adds.

    Attributes
    ----------
    block : name of its subcircuit on the board, such as ``diffamp``; several where only their sum is known
    instance : ``xdiff1``
    delay_s : negative for a block that leads
    """

    block: str
    instance: str
    delay_s: float

    @property
    def group(self) -> str:
        """Its blocks as one word: ``driver_and_motor``."""
        return _group(self.block)


def _group(block: str) -> str:
    return re.sub(r"\W", "_", block)


@dataclass(frozen=True)
class SpringDelay:
    """The spring path from the potentiometer of `joint` to `motor`.

    Attributes
    ----------
    joint, motor : j and i, from 1
    steps : in the order of the signal
    gain : A/V from the pin pot to imot with the gain pin at full scale
    """

    joint: int
    motor: int
    steps: tuple[Step, ...]
    gain: float

    @property
    def total_s(self) -> float:
        """Delay of the whole path."""
        return math.fsum(step.delay_s for step in self.steps)

    def of(self, block: str) -> float:
        """Return what all blocks of a name add [s]."""
        return math.fsum(step.delay_s for step in self.steps if step.block == block)

    def of_group(self, group: str) -> float | None:
        """Return what the blocks ``a_and_b`` add [s]; None where they are known with others only."""
        wanted = set(group.split(AND))
        inside = [step for step in self.steps if wanted.issuperset(step.group.split(AND))]
        if wanted != {block for step in inside for block in step.group.split(AND)}:
            return None
        return math.fsum(step.delay_s for step in inside)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of its steps, in the order of the signal: their delays add up to the total."""
        return tuple(dict.fromkeys(step.group for step in self.steps))


def slowest(paths: list[SpringDelay]) -> SpringDelay:
    """Return the slowest path: it eats most of the damping that it acts on."""
    return max(paths, key=lambda path: path.total_s)


def groups_of(board: Deck) -> tuple[str, ...]:
    """Return the names under which a board's blocks can be asked for, in or out of a spring's path."""
    return tuple(dict.fromkeys((*map(_group, _blocks(board).values()), MOTOR)))


def spring_delays(
    board: Deck, child: Child | None = None, *, time_limit_s: float | None = TIME_LIMIT_S
) -> list[SpringDelay]:
    """Return the delays of all n * n spring paths, measured by ngspice in a child process.

    Raises
    ------
    InputError
        For a board on which nothing comes through a spring.
    """
    paths: list[SpringDelay] = call(
        "cosim.circuits.extraction.block_delays:measure",
        {"board": board},
        time_limit_s=time_limit_s,
        deck=str(board.path),
        child=child,
    )
    return paths


def measure(payload: Mapping[str, Any], report: Callable[[dict[str, Any]], None]) -> list[SpringDelay]:
    """Measure all spring paths of ``payload['board']``; runs in ngspice's child process.

    With ``payload['own']`` only those from a joint to its own motor, as far as something comes through.
    """
    board: Deck = payload["board"]
    name = _blocks(board)
    amplifiers = list({a.out_node: a for a in board.amplifiers if a.out_node != "0"}.values())
    lines = [f"{_pushed(k)} 0 {a.out_node} dc 0 ac 0" for k, a in enumerate(amplifiers)]
    bench = Testbench(board, lines, multipliers=False)
    paths = []
    own = bool(payload.get("own"))
    for j in range(1, bench.joints + 1):
        for i in [j] if own else range(1, bench.joints + 1):
            try:
                paths.append(_Path(bench, amplifiers, i, j).spring_delay(name))
            except InputError:  # nothing comes through: other figures of the check report that
                if not own:
                    raise
            report({"stage": f"delay of ksp{i}{j}"})
    return paths


def _pushed(amplifier: int) -> str:
    return f"ipush{amplifier}"


@dataclass(frozen=True)
class _Passed:
    """An amplifier in a path.

    Attributes
    ----------
    place : among the amplifiers
    behind : whether it stands behind the multiplier
    h : response of its output to the potentiometer, through the spring alone
    onward : response of the motor to its output, through the spring alone
    moved : response of every amplifier's output to its output
    complete : whether all of the path passes there
    """

    place: int
    behind: bool
    h: complex
    onward: complex
    moved: tuple[complex, ...]
    complete: bool


class _Path:
    """The spring path from potentiometer j to motor i at a frequency so low that phases are delays."""

    def __init__(self, bench: Testbench, amplifiers: list[Amplifier], i: int, j: int) -> None:
        self.bench, self.amplifiers, self.i, self.j = bench, amplifiers, i, j
        self.nodes = [*(a.out_node for a in amplifiers), f"imot{i}"]
        self.hz = _FIRST_HZ
        while True:
            on, off = self._driven(f"pot{j}")
            change = on - off
            self.through = complex(change[-1])
            if self.through.real == 0.0:
                fail(f"nothing comes from pot{j} to imot{i}", file=str(bench.board.path), key=f"ksp{i}{j}")
            # what the potentiometer reaches through a capacitor alone (a differentiator) has no delay
            phases = [abs(math.atan(h.imag / h.real)) for h in (*off.tolist(), *change.tolist())
                      if abs(h.real) > max(abs(h.imag), 1e-9)]  # fmt: skip
            most = max(phases, default=0.0)
            if most <= _PHASE or self.hz < _LEAST_HZ:
                break
            self.hz *= 0.5 * _PHASE / most
        self.passed = self._passed(off, change)

    def _driven(self, source: str) -> tuple[Any, Any]:
        """Return what a source makes of the nodes, with the spring's gain at full scale and at zero."""
        gains = []
        for volts in (self.bench.v_fs, 0.0):
            self.bench.hold({f"ksp{self.i}{self.j}": volts})
            gains.append(self.bench.respond(source, f"lin 1 {self.hz!r} {self.hz!r}", self.nodes)[0])
        return gains[0], gains[1]

    def _passed(self, off: Any, change: Any) -> list[_Passed]:
        """Return the amplifiers through which the signal goes, by moving the output of each alone."""
        out = []
        reach = abs(off[:-1].real).max(initial=0.0), abs(change[:-1].real).max(initial=0.0)
        for place in range(len(self.amplifiers)):
            if abs(off[place]) <= 1e-9 * reach[0] and abs(change[place]) <= 1e-9 * reach[1]:
                continue
            pushed_on, pushed_off = self._driven(_pushed(place))
            if pushed_off[place] == 0.0:
                continue  # a voltage source holds it: it cannot be moved alone
            on, none = pushed_on / pushed_on[place], pushed_off / pushed_off[place]
            for behind, h, onward, moved in (
                (False, complex(off[place]), complex(on[-1] - none[-1]), none),
                (True, complex(change[place]), complex(on[-1]), on),
            ):
                share = h * onward / self.through
                if abs(share) > _LEAK:
                    complete = abs(share - 1.0) < _COMPLETE and self._adds_up(h, onward)
                    out.append(_Passed(place, behind, h, onward, tuple(moved[:-1].tolist()), complete))
        inner = [a for a in out if a.complete and any(self._looped(a, b) for b in out if b.complete)]
        return [replace(p, complete=False) if p in inner else p for p in out]

    def _looped(self, a: _Passed, b: _Passed) -> bool:
        """Whether `a` stands in a loop that `b` closes further down the path."""
        back = abs(a.moved[b.place] * b.moved[a.place]) if a.behind == b.behind else 0.0
        return back > _LEAK and self._before(a, b)

    def _adds_up(self, h: complex, onward: complex) -> bool:
        parts = _late(h, self.hz), _late(onward, self.hz)
        total = _late(self.through, self.hz)
        return abs(sum(parts) - total) <= _COMPLETE * max(*map(abs, parts), abs(total))

    def _before(self, a: _Passed, b: _Passed) -> bool:
        """Whether all that comes from `a` passes `b`, which is whole."""
        if a.behind != b.behind:
            return b.behind
        return a.place != b.place and abs(a.moved[b.place] * b.onward / a.onward - 1.0) < _COMPLETE

    def spring_delay(self, name: Mapping[str, str]) -> SpringDelay:
        """Return the delays between cuts; amplifiers side by side or in one loop make one step."""
        complete = [p for p in self.passed if p.complete]
        rank = {id(p): sum(self._before(p, q) for q in complete) for p in self.passed}  # cuts still to come
        last, steps = complex(1.0), []
        for level in sorted({rank[id(p)] for p in complete}, reverse=True):
            group = [p for p in complete if rank[id(p)] == level]
            end = max(group, key=lambda p: _late(p.h, self.hz))
            beside = [p for p in self.passed if not p.complete and rank[id(p)] == level + 1]
            steps.append(self._step(name, [*beside, *group], _late(end.h / last, self.hz)))
            last = end.h
        rest = _late(self.through / last, self.hz)
        beside = [p for p in self.passed if not p.complete and rank[id(p)] == 0]
        if beside:
            alone = self._step(name, beside, rest)
            steps.append(Step(f"{alone.block} and {MOTOR}", alone.instance, rest))
        elif steps and steps[-1].delay_s < 0.0 and self._is_driver(complete, rank):
            lead = steps.pop()  # in a current drive the output leads the winding's lag: one loop
            steps.append(Step(f"{lead.block} and {MOTOR}", lead.instance, lead.delay_s + rest))
        else:
            steps.append(Step(MOTOR, MOTOR, rest))
        return SpringDelay(self.j, self.i, _joined(steps), self.through.real)

    def _is_driver(self, complete: list[_Passed], rank: Mapping[int, int]) -> bool:
        return any(rank[id(p)] == 0 and self.amplifiers[p.place].role == "driver" for p in complete)

    def _step(self, name: Mapping[str, str], group: list[_Passed], delay_s: float) -> Step:
        instances = dict.fromkeys(self.amplifiers[p.place].path.split(".")[1] for p in group)
        blocks = " and ".join(dict.fromkeys(name.get(each, each) for each in instances))
        return Step(blocks, " and ".join(instances), delay_s)


def _late(h: complex, hz: float) -> float:
    """Return the delay of a response whose phase is small, or half a turn more [s]."""
    return -math.atan(h.imag / h.real) / (2.0 * math.pi * hz) if h.real != 0.0 else 0.0


def _joined(steps: list[Step]) -> tuple[Step, ...]:
    """Put what stands in one instance together."""
    out: dict[str, Step] = {}
    for step in steps:
        seen = out.get(step.instance)
        delay = step.delay_s + (seen.delay_s if seen else 0.0)
        out[step.instance] = Step(step.block, step.instance, delay)
    return tuple(out.values())


def _blocks(board: Deck) -> dict[str, str]:
    """Return the subcircuit of every instance on the board; parts that stand there alone keep their name."""
    net = parse(board.lines[1:])
    placed = net.blocks[board.board]
    return {instance.name: shared_name(placed, instance) for instance in placed.instances()}
