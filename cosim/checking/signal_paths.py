"""The signal paths of a board: delay, bandwidth, what each block adds, and the brake of the back-EMF."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from cosim.checking.probed_board import HIGHEST_HZ, ProbedBoard, Real
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.block_delays import MOTOR, SpringDelay
from cosim.circuits.extraction.block_delays import Step as Part
from cosim.types import Complex

LOW_HZ = 0.1
"""Where w -> 0 is read: below every corner of a haptic device; 1e-4 of a bandwidth where that is lower."""
_SWEEP = f"dec 20 {LOW_HZ:g} {HIGHEST_HZ:g}"
_LOW_SHARE = 1e-4
NAMES = {
    "u": "spring, u to imot",
    "pot": "spring, pot to imot",
    "rate": "damper, pot rate to imot",
    "cmd": "cmd to imot",
}


@dataclass(frozen=True)
class Path:
    """One path at joint `joint`, from its own input to its own motor.

    Attributes
    ----------
    kind : a key of `NAMES`
    gain : A per unit of input as w -> 0; for the damper A per rad/s
    delay_s : sum of time constants, the group delay as w -> 0; ``None`` where nothing comes through
    bandwidth_hz : -3 dB; ``None`` if it is above `HIGHEST_HZ`
    """

    joint: int
    kind: str
    gain: float
    delay_s: float | None
    bandwidth_hz: float | None


@dataclass(frozen=True)
class Step:
    """What one block adds to the delay of a spring path [s]; several where only their sum is known."""

    joint: int
    block: str
    delay_s: float


@dataclass(frozen=True)
class Brake:
    """Back-EMF and delay of a joint.

    Attributes
    ----------
    viscosity_n_m_s : at the joint, from the motor's back-EMF
    delay_s : of the spring, pot to imot
    eta : k_fs * delay / viscosity, the share of the viscosity that the delay eats at full scale
    stiffness_n_per_m : at the tip where that share is 1
    """

    joint: int
    viscosity_n_m_s: float
    delay_s: float
    eta: float | None
    stiffness_n_per_m: float | None


def slope(h: complex, f_hz: float) -> float | None:
    """Delay of a response at a frequency far below its poles [s]."""
    return -h.imag / (2 * math.pi * f_hz * h.real) if h.real != 0.0 else None


def low_hz(bandwidth_hz: float | None) -> float:
    """Return the frequency [Hz] at which a path of this bandwidth is read as w -> 0."""
    return LOW_HZ if bandwidth_hz is None else min(LOW_HZ, _LOW_SHARE * bandwidth_hz)


def bandwidth(f_hz: Real, h: Complex) -> float | None:
    """Return where |h| first falls 3 dB below its value at the lowest frequency [Hz]."""
    level = np.abs(h) * math.sqrt(2.0) - abs(h[0])
    below = np.flatnonzero(level < 0.0)
    if below.size == 0 or below[0] == 0:
        return None
    k = int(below[0])
    a, b = np.log(np.abs(h[k - 1 : k + 1]))
    share = (a - math.log(abs(h[0])) + 0.5 * math.log(2.0)) / (a - b)
    return float(f_hz[k - 1] * (f_hz[k] / f_hz[k - 1]) ** share)


def measure_paths(bench: ProbedBoard, constants: DesignConstants) -> list[Path]:
    """Sweep every path of every joint with its own gain at full scale and all others at zero."""
    paths = []
    for j in range(1, bench.joints + 1):
        spring, damper = {f"ksp{j}{j}": constants.v_fs}, {f"ksd{j}{j}": constants.v_fs}
        for kind, pin, held in (
            ("u", f"u{j}", spring),
            ("pot", f"pot{j}", spring),
            ("rate", f"pot{j}", damper),
            ("cmd", f"cmd{j}", {}),
        ):
            paths.append(_path(bench, j, kind, pin, held))
    return paths


def _path(bench: ProbedBoard, j: int, kind: str, pin: str, held: Mapping[str, float]) -> Path:
    f, h = _through(bench, j, kind, pin, held, _SWEEP)
    width = bandwidth(f, h)
    low = low_hz(width)
    value = complex(_through(bench, j, kind, pin, held, f"lin 1 {low!r} {low!r}")[1][0])
    return Path(j, kind, value.real, slope(value, low), width)


def _through(
    bench: ProbedBoard, j: int, kind: str, pin: str, held: Mapping[str, float], sweep: str
) -> tuple[Real, Complex]:
    """Return frequencies and what comes through the held gain alone.

    What leaks with that gain at zero is taken off: a damper multiplier's offset would else pass for a lead
    of the spring, a spring multiplier's for a drift of the damper.
    """
    bench.hold_only(held)
    on = bench.response(pin, sweep)
    f, h = np.real(on["frequency"]), on[f"imot{j}"]
    if held:
        bench.hold_only({})
        h = h - bench.response(pin, sweep)[f"imot{j}"]
    return f, _per_input(kind, f, h)


def _per_input(kind: str, f_hz: Real, h: Complex) -> Complex:
    return h / (2j * math.pi * f_hz) if kind == "rate" else h


def _at(bench: ProbedBoard, pin: str, f_hz: float) -> dict[str, complex]:
    response = bench.response(pin, f"lin 1 {f_hz!r} {f_hz!r}")
    return {name: complex(values[0]) for name, values in response.items()}


def steps_of(delays: Iterable[SpringDelay]) -> list[Step]:
    """Return what the blocks between a joint's potentiometer and its own motor add to its spring's delay."""
    return [
        Step(path.joint, step.instance if step.instance == step.block else _named(step), step.delay_s)
        for path in delays
        for step in path.steps
    ]


def _named(step: Part) -> str:
    return f"{step.instance} and {MOTOR}" if step.block.endswith(f" and {MOTOR}") else step.instance


def measure_admittance(bench: ProbedBoard) -> list[list[float]]:
    """Return what motor current i loses per rad/s of motor j as w -> 0 [A s/rad], rows i, gains at zero."""
    bench.hold_only({})
    n = range(1, bench.joints + 1)
    columns = [_at(bench, f"vel{j}", LOW_HZ) for j in n]
    return [[-column[f"imot{i}"].real for column in columns] for i in n]


def brakes(
    paths: list[Path], admittance: list[list[float]], constants: DesignConstants, k_fs: Mapping[int, float]
) -> list[Brake]:
    """Compare each joint's spring delay with the viscosity of its motor (theory: eta = k sum(tau)/b)."""
    rows = []
    for path in paths:
        if path.kind != "pot" or path.delay_s is None:
            continue
        j = path.joint
        b = admittance[j - 1][j - 1] * constants.kt * constants.gear**2
        tau = path.delay_s
        rows.append(
            Brake(
                joint=j,
                viscosity_n_m_s=b,
                delay_s=tau,
                eta=k_fs[j] * tau / b if b > 0.0 else None,
                stiffness_n_per_m=b / tau / constants.r_tip**2 if tau > 0.0 and b > 0.0 else None,
            )
        )
    return rows
