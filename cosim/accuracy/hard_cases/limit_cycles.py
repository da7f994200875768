"""Hard cases of limit cycles: gears with play, and walls of counts and codes.

A cycle is predicted by harmonic balance, which leaves the third harmonic out, or found exactly by a map from
sample to sample that knows nothing of the program.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from cosim.accuracy.hard_cases.hard_case import ALL, OWN, RADIUS, CaseRunner, HardCase, slider
from cosim.types import Array

__all__ = ["CASES"]

#: Position control through the encoder of the motor, about 0, after a kick of two samples.
_LAW = """
from cosim.loop.userlaw import Command
class Held:
    def control(self, sample):
        return Command(torque_n_m=-{gain!r} * sample.q_rad + ({kick!r} if sample.tick < 2 else 0.0))
"""
_ROTOR = 2e-6  # kg m^2, behind a gear of 8
_MOTOR = _ROTOR * 64.0
_GAIN, _PERIOD = 0.5, 4e-3  # N m/rad, s
_STIFFNESS, _DAMPING, _GAP = 2.0, 2e-3, 4e-3  # of the teeth: N m/rad, N m s/rad, rad
#: On one flank [N]: 13 mN m, more than the cycle's 0.5 N m/rad and 2 N m/rad make of 4 mrad.
_PRELOAD = 0.1


def _play(preloaded: bool, duration_s: float, runner: CaseRunner, model: str) -> Array:
    """Return times, motor's angle, speed and twist of a motor that is held through a gear with play."""
    tables = slider(
        duration_s=duration_s,
        device={
            "slider": {"mass_kg": 10.0, "rotor_inertia_kg_m2": _ROTOR, "viscous_n_m_s": 0.6,
                       "shaft_stiffness_n_m_per_rad": _STIFFNESS, "shaft_damping_n_m_s": _DAMPING,
                       "backlash_rad": _GAP, "gravity_m_per_s2": [0.0, -_PRELOAD / 10.0]},
        },
        computer={"period_s": _PERIOD, "law": "law.py:Held"},
        effects={"shaft": True, "rotor_inertia": True, "backlash": True, "viscous": True,
                 "gravity": preloaded},
        solver={"coupling_tolerance_rad": 1e-9 if model != "spice" else 1e-7, "max_step_s": 5e-4},
    )  # fmt: skip
    s = runner.run(tables, model, _LAW.format(gain=_GAIN, kick=6e-3)).signals
    return np.array([s["time"], s["qm1"], s["vm1"], np.asarray(s["qm1"]) - np.asarray(s["q1"])])


def _balanced() -> float:
    """Amplitude [rad] at which the teeth's damper takes what sampling feeds the motor.

    At a joint that hardly moves: c N(A) = K sin^2(x)/(x w), the hold's first harmonic at x = w T/2, with the
    dead zone's describing function N(A) = 1 - (2/pi) (a + sin a cos a), sin a = gap/(2 A).
    """

    def left(amplitude: float) -> float:
        a = math.asin(_GAP / 2 / amplitude)
        carried = 1 - 2 / math.pi * (a + math.sin(a) * math.cos(a))
        w = 80.0
        for _ in range(50):
            x = w * _PERIOD / 2
            w = math.sqrt((_GAIN * math.sin(x) / x * math.cos(x) + _STIFFNESS * carried) / _MOTOR)
        return _DAMPING * carried - _GAIN * math.sin(x) ** 2 / x / w

    return float(brentq(left, _GAP / 2 * (1 + 1e-9), 100 * _GAP))


def _clatter(runner: CaseRunner, model: str) -> float:
    """Amplitude of the motor in its gear over that of harmonic balance."""
    t, q, *_ = _play(False, 3.2, runner, model)
    k = np.arange(600, 800)
    return float(np.abs(np.interp(k * _PERIOD, t, q)).max() / _balanced())


def _rests(runner: CaseRunner, model: str) -> float:
    """Return the twist at rest of a preloaded gear over half the gap and what the weight twists.

    Carriage and hold settle as exp(-0.916 t): the slow root of 0.178 s^2 + 0.6 s + 0.4, teeth and hold in
    series. Of the twist that is 6e-7 after 16 s and 4e-10 after 24 s.
    """
    t, _, v, twist = _play(True, 24.0, runner, model)
    late = t > 23.9
    if np.abs(v[late]).max() > (1e-6 if model != "spice" else 1e-3):
        return math.nan
    return float(twist[-1] / (_GAP / 2 + _PRELOAD * RADIUS / _STIFFNESS))


_COUNT = 2 * math.pi / (500 * 8.0)  # rad at the joint: 500 pulses a turn of the motor, decoding 1
_CODE = 20.0 / 4096 / 15.625  # N m: 12 bits over +-10 V, 15.625 V per N m
_MASS, _VISCOSITY, _SAMPLE = 0.2, 0.5, 1e-3  # kg, N s/m, s


def _coded(q: float) -> float:
    """Torque [N m] of a wall at 0 whose one count is one code of the DAC."""
    depth = -math.floor(q / _COUNT + 0.5)
    return _CODE * max(depth, 0)


def _orbit(start: float, push: float, samples: int) -> Array:
    """Return the angles at the samples, from the exact map of a mass with viscosity under held torque."""
    inertia, b = _MASS * RADIUS**2, _VISCOSITY * RADIUS**2
    tau = inertia / b
    decay = math.exp(-_SAMPLE / tau)
    q, v, out = start, 0.0, []
    for _ in range(samples):
        out.append(q)
        rest = (_coded(q) - push) / b  # the speed that this torque ends at
        q += rest * _SAMPLE + (v - rest) * tau * (1 - decay)
        v = rest + (v - rest) * decay
    return np.array(out)


def _counts_and_codes(runner: CaseRunner, model: str) -> float:
    """Return the largest distance of the angles at the samples from the exact orbit, over its swing."""
    push, start, seconds = 1.5 * _CODE, -1.45 * _COUNT, 0.25
    tables = slider(
        duration_s=seconds,
        device={"slider": {"mass_kg": _MASS, "viscous_n_m_s": _VISCOSITY * RADIUS**2},
                "start": {"q_rad": [start]}},
        computer={
            "period_s": _SAMPLE, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
            "discrete_stiffness_n_per_m": _CODE / _COUNT / RADIUS**2,
            "encoder": {"pulses_per_rev": 500, "decoding": 1},
        },
        wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        operator={
            "type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 0.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, -push / RADIUS]],
        },
        effects={"viscous": True, "encoder": True, "dac": True, "operator_dynamics": True},
        solver={"coupling_tolerance_rad": 1e-12},
    )  # fmt: skip
    s = runner.run(tables, model).signals
    count = round(seconds / _SAMPLE)
    at = np.searchsorted(np.asarray(s["time"]), np.arange(count) * _SAMPLE - 1e-11)
    exact = _orbit(start, push, count)
    return float(np.abs(np.asarray(s["q1"])[at] - exact).max() / np.ptp(exact[count // 5 :]))


CASES = (
    HardCase("gear with play, limit cycle", 46, "amplitude over harmonic balance's", 1.0,
             dict.fromkeys(ALL, 0.05), "the third harmonic is left out: a few per cent", _clatter,
             broken="a gap wider by a tenth"),
    HardCase("gear with play, preloaded", 46, "twist at rest over its closed form", 1.0,
             {**dict.fromkeys(OWN, 1e-8), "spice": 1e-3},
             "exp(-0.916 24) of the way; it rests, or this is no number; spice: speeds below 1e-3 rad/s",
             _rests, slow=True,
             broken="a gap wider by a tenth"),
    HardCase("wall of one count and one code", 59, "distance from the exact orbit over its swing", 0.0,
             {**dict.fromkeys(OWN, 1e-6), "spice": 1e-3},
             "the list's own: op-amps of 1e9 leave 1e-8 of a torque, which five swings add up; spice: 1e-3",
             _counts_and_codes, broken="counts that change at 0.51 of a step"),
)  # fmt: skip
