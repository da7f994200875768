"""A board's stated constants against its circuit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from cosim.caution import Caution
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction import certificate
from cosim.circuits.extraction.motor_response import MotorResponse
from cosim.circuits.linear_circuit import LinearCircuit, channel_names

__all__ = ["DEVIATION", "constant_missed", "of_circuit", "of_response"]

#: The circuit's and the computer's constants are equal by design; resistors of 10 % move them by less.
DEVIATION = 0.2


def of_circuit(circuit: LinearCircuit, constants: DesignConstants) -> Iterator[Caution]:
    """Yield cautions from a circuit's certificate, and of each constant missed, at the worst place."""
    yield from certificate.cautions(circuit.certificate)
    if circuit.certificate.get("large_signal_error", 0.0) > DEVIATION:
        return  # the slope at rest is not what the board is made for; the reason was reported above
    yield from _missed(_by_circuit(circuit, constants), constants)


def of_response(
    response: MotorResponse, constants: DesignConstants, bent: Callable[[], float]
) -> Iterator[Caution]:
    """Yield a caution of each constant that a board's measured answer misses, at the worst place.

    `bent` measures how far the board leaves its slope at rest up to rated current, as a share of that; it is
    asked only where a constant is missed.
    """
    missed = [*_missed(_by_response(response, constants), constants)]
    if missed and not bent() > DEVIATION:
        yield from missed


def _missed(made: Mapping[str, Mapping[str, float]], constants: DesignConstants) -> Iterator[Caution]:
    for name, rows in made.items():
        stated = getattr(constants, name)
        where, value = max(rows.items(), key=lambda row: abs(row[1] / stated - 1.0))
        if not abs(value / stated - 1.0) <= DEVIATION:
            yield constant_missed(name, stated, value, where)


def constant_missed(name: str, stated: float, made: float, where: str) -> Caution:
    """Return the caution about a design constant that the circuit does not render."""
    return Caution(
        "constant-missed",
        f"the board states {name} = {stated:.4g}, its circuit makes {made:.4g} at {where} "
        f"({100 * (made / stated - 1):+.3g} %)",
        "correct the netlist or its .csparam line: the computer believes the stated value "
        "(cosim check lists all of them)",
    )


def _by_circuit(circuit: LinearCircuit, constants: DesignConstants) -> dict[str, dict[str, float]]:
    """Return k_fs, c_fs and v_nm as the circuit renders them for w -> 0, by place."""
    n, m = circuit.joints, len(circuit.gain)
    inverse = [np.linalg.pinv(a) if len(a) else a for a in (circuit.a_pre, circuit.a_post)]
    before = circuit.d_pre - circuit.c_pre @ inverse[0] @ circuit.b_pre
    rate = circuit.e_pre - (circuit.c_pre @ inverse[0] @ inverse[0] @ circuit.b_pre)[:, :n]
    after = circuit.d_post - circuit.c_post @ inverse[1] @ circuit.b_post
    per_ampere = constants.kt * constants.gear
    made: dict[str, dict[str, float]] = {"k_fs": {}, "c_fs": {}, "v_nm": {}}
    for c, pin in enumerate(channel_names(n)):
        i, j = int(pin[3]) - 1, int(pin[4]) - 1
        name, read = ("k_fs", before[c, j]) if pin.startswith("ksp") else ("c_fs", rate[c, j])
        made[name][pin] = float(-per_ampere * after[i, c] * circuit.gain[c] * constants.v_fs * read)
    for i in range(n):
        torque = float(after[i, m + i]) * per_ampere
        made["v_nm"][f"cmd{i + 1}"] = 1.0 / torque if torque else math.inf
    return made


def _by_response(response: MotorResponse, constants: DesignConstants) -> dict[str, dict[str, float]]:
    """Return the same as a board's motors answer at the lowest frequency that was measured."""
    per_ampere = constants.kt * constants.gear
    made: dict[str, dict[str, float]] = {"k_fs": {}, "c_fs": {}, "v_nm": {}}
    for pin, matrix in zip(response.names, response.channel[0], strict=True):
        each = -per_ampere * complex(matrix[int(pin[3]) - 1, int(pin[4]) - 1])
        if pin.startswith("ksp"):
            made["k_fs"][pin] = each.real
        else:
            made["c_fs"][pin] = each.imag / (2.0 * math.pi * float(response.hz[0]))
    for i, current in enumerate(response.command.tolist(), 1):
        made["v_nm"][f"cmd{i}"] = 1.0 / (current * per_ampere) if current else math.inf
    return made
