"""How late a spring acts, block by block: the delay of every path from a potentiometer to a motor.

The delay of a path as frequency goes to zero, -d phase/d omega, is the sum of those of its blocks. A late
spring of stiffness k takes k times its delay from the viscosity of its device, whatever the shape of the lag
(footnote 1 of the paper says that the circuit has none).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.circuits.session import Bench
from cosim.errors import fail
from cosim.ngspice.child import Child, call
from cosim.ngspice.deck import Amplifier, Deck
from cosim.ngspice.netlist import parse

__all__ = ["MOTOR", "SpringDelay", "Step", "measure", "spring_delays"]

#: What stands behind the driver's amplifier.
MOTOR = "motor"
#: Where w -> 0 is read: so low that the phase is this small [rad], its cube then is 1e-6 of it.
_FIRST_HZ, _PHASE = 0.1, 1e-3
#: An amplifier is in the path if it moves in phase by this share of the one that moves most, before or after
#: the multiplier: what reaches others through the offset of a multiplier at zero gain, or through a summing
#: node that is not quite at ground, is far below.
_RESPONDS = 0.01
_ORDER = {"vca": 1, "driver": 3}


@dataclass(frozen=True)
class Step:
    """What one block adds.

    Attributes
    ----------
    block : name of its subcircuit on the board, such as ``diffamp``
    instance : ``xdiff1``
    delay_s : negative for a block that leads
    """

    block: str
    instance: str
    delay_s: float


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


def spring_delays(board: Deck, child: Child | None = None) -> list[SpringDelay]:
    """Return the delays of all n * n spring paths, measured by ngspice in a child process.

    Raises
    ------
    InputError
        For a board on which nothing comes through a spring.
    """
    found: list[SpringDelay] = call(
        "cosim.circuits.delay:measure", {"board": board}, deck=str(board.path), child=child
    )
    return found


def measure(payload: Mapping[str, Any], report: Callable[[dict[str, Any]], None]) -> list[SpringDelay]:
    """Measure all spring paths of ``payload['board']``; runs in ngspice's child process."""
    board: Deck = payload["board"]
    bench, name = Bench(board), _blocks(board)
    found = []
    for j in range(1, bench.joints + 1):
        for i in range(1, bench.joints + 1):
            found.append(_path(bench, name, i, j))
            report({"stage": f"delay of ksp{i}{j}"})
    return found


def _path(bench: Bench, name: Mapping[str, str], i: int, j: int) -> SpringDelay:
    amplifiers, motor = bench.board.amplifiers, f"imot{i}"
    nodes = [*dict.fromkeys(a.out_node for a in amplifiers), motor]
    hz = _FIRST_HZ
    while True:
        on, off = _driven(bench, i, j, hz, nodes)
        through = on[motor] - off[motor]
        if through.real == 0.0:
            fail(f"nothing comes from pot{j} to {motor}", file=str(bench.board.path), key=f"ksp{i}{j}")
        phase = abs(math.atan(through.imag / through.real))
        if phase <= _PHASE:
            break
        hz *= 0.5 * _PHASE / phase
    changes = {a.out_node: on[a.out_node] - off[a.out_node] for a in amplifiers}
    most_before = max((abs(off[a.out_node].real) for a in amplifiers if a.role != "vca"), default=0.0)
    most_after = max((abs(change.real) for change in changes.values()), default=0.0)
    path: list[tuple[int, float, Amplifier, complex]] = []
    for a in amplifiers:
        here, change = off[a.out_node], changes[a.out_node]
        if abs(change.real) > _RESPONDS * most_after:
            path.append((_ORDER.get(a.role or "", 2), _late(change, hz), a, change))
        elif a.role != "vca" and abs(here.real) > max(_RESPONDS * most_before, abs(here.imag)):
            path.append((0, _late(here, hz), a, here))
    last, steps = complex(1.0), []
    for _, _, a, value in sorted(path, key=lambda item: item[:2]):
        instance = a.path.split(".")[1]
        steps.append(Step(name.get(instance, instance), instance, _late(value / last, hz)))
        last = value
    rest = _late(through / last, hz)
    if steps and steps[-1].delay_s < 0.0:  # in a current drive the output leads the winding's lag: one loop
        before_it = steps.pop()
        steps.append(Step(f"{before_it.block} and {MOTOR}", before_it.instance, before_it.delay_s + rest))
    else:
        steps.append(Step(MOTOR, MOTOR, rest))
    return SpringDelay(j, i, _joined(steps), through.real)


def _driven(
    bench: Bench, i: int, j: int, hz: float, nodes: list[str]
) -> tuple[dict[str, complex], dict[str, complex]]:
    """Return what a volt at pot j makes of the nodes, with the spring's gain at full scale and at zero."""
    found = []
    for volts in (bench.v_fs, 0.0):
        bench.hold({f"ksp{i}{j}": volts})
        answer = bench.respond(f"pot{j}", f"lin 1 {hz!r} {hz!r}", nodes)[0]
        found.append(dict(zip(nodes, np.asarray(answer).tolist(), strict=True)))
    return found[0], found[1]


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
    return {instance.name: instance.block for instance in net.blocks[board.board].instances()}
