"""Noise of the circuit and of the potentiometer as torque and as force at the tip."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cosim.checking.headroom import SOFT_N_PER_M
from cosim.checking.probed_board import ProbedBoard
from cosim.checking.signal_paths import LOW_HZ
from cosim.circuits.design_constants import DesignConstants

BAND_HZ = (0.1, 1e5)
"""Where `.noise` is integrated: beyond what a finger or a motor follows, on both sides."""
_TOP = 5
_NO_GAIN, _SAME_GAIN = 1e-6, 0.01


@dataclass(frozen=True)
class Contributor:
    """A part, or a component outside of parts, with its share of the noise power [%]."""

    name: str
    share_percent: float


@dataclass(frozen=True)
class Noise:
    """Circuit noise of one motor in one state of the gains.

    Attributes
    ----------
    gains : in words
    current_a, torque_n_m, force_n : rms over `BAND_HZ`; of the motor, at its joint, at the reach `r_tip`
    top : largest contributors
    complete : whether `.noise` sees the gain that `.ac` sees. ngspice leaves XSPICE devices, which POLY
        sources become, out of this analysis; what stands before them is then missing.
    """

    joint: int
    gains: str
    current_a: float
    torque_n_m: float
    force_n: float
    top: tuple[Contributor, ...]
    complete: bool


@dataclass(frozen=True)
class PotNoise:
    """The potentiometer's noise at full-scale gain.

    Attributes
    ----------
    noise_rad, bandwidth_hz : of the potentiometer, rms and one-sided bandwidth
    spring_n, damper_n : rms force at the reach `r_tip` of white noise through either
    soft_n : the same through a spring of `SOFT_N_PER_M` at the tip
    """

    joint: int
    noise_rad: float
    bandwidth_hz: float
    spring_n: float
    soft_n: float
    damper_n: float


def measure_noise(bench: ProbedBoard, constants: DesignConstants) -> list[Noise]:
    """Ask `.noise` at every motor with gains at zero, all springs on, and all gains on."""
    pairs = [f"{i}{j}" for i in range(1, bench.joints + 1) for j in range(1, bench.joints + 1)]
    springs = {f"ksp{pair}": constants.v_fs for pair in pairs}
    states = {
        "all gains zero": {},
        "springs at k_fs": springs,
        "springs at k_fs, dampers at c_fs": springs | {f"ksd{pair}": constants.v_fs for pair in pairs},
    }
    per_ampere = constants.kt * constants.gear
    noises = []
    for gains, held in states.items():
        bench.hold_only(held)
        for i in range(1, bench.joints + 1):
            low, high = BAND_HZ
            heard = bench.noise(f"imot{i}", f"pot{i}", f"dec 10 {low:g} {high:g}")
            total, gain = heard.total, heard.gain
            true = abs(bench.response(f"pot{i}", f"lin 1 {low!r} {low!r}")[f"imot{i}"][0])
            torque, top = total * per_ampere, _top(bench, heard.elements, total)
            complete = bool(true < _NO_GAIN or (gain is not None and abs(gain / true - 1.0) < _SAME_GAIN))
            noises.append(Noise(i, gains, total, torque, torque / constants.r_tip, top, complete))
    return noises


def _top(bench: ProbedBoard, elements: dict[str, float], total: float) -> tuple[Contributor, ...]:
    """Sum the elements' powers inside each part and return the largest."""
    paths = [a.path for a in bench.board.amplifiers]
    power: dict[str, float] = {}
    for name, rms in elements.items():
        owner = next((path for path in paths if name.startswith(path + ".")), name)
        label = owner.removeprefix("xboard.")
        power[label] = power.get(label, 0.0) + rms * rms
    if total == 0.0:
        return ()
    # rounded, so that equal joints keep the order of their names
    largest = sorted(power.items(), key=lambda item: (-round(item[1] / total**2, 6), item[0]))[:_TOP]
    return tuple(Contributor(label, 100.0 * p / total**2) for label, p in largest)


def measure_pot_noise(
    bench: ProbedBoard, constants: DesignConstants, noise_rad: float, bandwidth_hz: float
) -> list[PotNoise]:
    """Pass white potentiometer noise through the measured spring and damper of each joint."""
    pot_noises = []
    sweep = f"dec 20 {LOW_HZ:g} {bandwidth_hz!r}"
    to_force = constants.kt * constants.gear / constants.r_tip
    for j in range(1, bench.joints + 1):
        forces = []
        for gain in ("ksp", "ksd"):
            bench.hold_only({f"{gain}{j}{j}": constants.v_fs})
            swept = bench.response(f"pot{j}", sweep)
            f, h = np.real(swept["frequency"]), np.abs(swept[f"imot{j}"])
            # below the sweep |h| is taken as constant (spring) or falls (damper): 1e-3 of the band at most
            mean_square = (float(np.trapezoid(h**2, f)) + float(h[0] ** 2 * f[0])) / bandwidth_hz
            forces.append(noise_rad * math.sqrt(mean_square) * to_force)
        spring, damper = forces
        softer = SOFT_N_PER_M * constants.r_tip**2 / constants.k_fs
        pot_noises.append(PotNoise(j, noise_rad, bandwidth_hz, spring, spring * softer, damper))
    bench.hold_only({})
    return pot_noises
