"""Hard cases of the coupling: problems of the co-simulation literature, and shorter steps that mislead.

Masses that exchange held states every H, exact between, are the constant-step Jacobi scheme of zero order
(Busch, 2012; Schweizer et al., 2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from cosim.accuracy.hard_cases.coupled_motion import _DAMPER, _SPRING, _STATED, _STATED_C, _TORQUE
from cosim.accuracy.hard_cases.hard_case import RADIUS, CaseRunner, HardCase, board, slider
from cosim.types import Array

__all__ = ["CASES"]


def _jacobi(
    inertias: tuple[float, float],
    springs: tuple[float, float, float],
    dampers: tuple[float, float, float],
    start: float,
    step: float,
    end: float,
) -> tuple[Array, Array]:
    """Return times and angles [k, 2] of two masses that exchange held states every `step`, exact between.

    Springs and dampers: of the first to ground, between, of the second to ground.
    """
    (k1, k12, k2), (d1, d12, d2) = springs, dampers
    state = np.array([start, 0.0, 0.0, 0.0])  # q1, v1, q2, v2
    maps = []
    for inertia, k, d in ((inertias[0], k1, d1), (inertias[1], k2, d2)):
        own = np.array([[0.0, 1.0], [-(k + k12) / inertia, -(d + d12) / inertia]])
        block = np.zeros((4, 4))
        block[:2, :2], block[:2, 2:] = own, np.array([[0.0, 0.0], [k12 / inertia, d12 / inertia]])
        maps.append(expm(block * step)[:2])
    seen = [state.copy()]
    for _ in range(round(end / step)):
        first, second = state[:2].copy(), state[2:].copy()
        state[:2] = maps[0] @ np.concatenate([first, second])
        state[2:] = maps[1] @ np.concatenate([second, first])
        seen.append(state.copy())
    return np.asarray(step * np.arange(len(seen)), float), np.array(seen)[:, ::2]


def _against_jacobi(
    inertias: tuple[float, float], springs: tuple[float, float, float], dampers: tuple[float, float, float]
) -> Callable[[CaseRunner, str], float]:
    """Return what finds our error over that of held values exchanged as often, rejected steps counted."""
    start, end = 0.1, 2.0

    def find(runner: CaseRunner, model: str) -> float:
        (k1, k12, k2), (d1, d12, d2) = springs, dampers
        stiff = np.array([[k1 + k12, -k12], [-k12, k2 + k12]])
        damp = np.array([[d1 + d12, -d12], [-d12, d2 + d12]])
        law = (
            "from cosim.loop.userlaw import Command\nclass Car:\n    def control(self, sample):\n"
            f"        k = {(stiff * _STATED / _SPRING).tolist()!r}\n"
            f"        c = {(damp * _STATED_C / _DAMPER).tolist()!r}\n"
            "        return Command(u_rad=0 * sample.q_rad, stiffness=k, damping=c)\n"
        )
        zero = [0.0, 0.0]
        tables = slider(
            duration_s=end,
            device={
                "board": board(2), "linkage": "chain", "slider": None,
                "chain": {"lengths_m": [0.1, 0.1], "masses_kg": zero, "coms_m": zero, "inertias_kg_m2": zero,
                          "rotor_inertia_kg_m2": [each / 64 for each in inertias]},
                "start": {"q_rad": [start, 0.0]},
            },
            computer={"period_s": 1.0, "law": "law.py:Car", "analog_damping_n_s_per_m": 1.0,
                      "analog_stiffness_n_per_m": 1.0},
            effects={"rotor_inertia": True}, solver={"coupling_tolerance_rad": 1e-9},
        )  # fmt: skip
        ran = runner.run(tables, model, law)
        exchanges = int(ran.stats["points"]) + int(ran.stats["rejected"])
        a = np.zeros((4, 4))
        mass = np.diag(1.0 / np.array(inertias))
        a[:2, 2:], a[2:, :2], a[2:, 2:] = np.eye(2), -mass @ stiff, -mass @ damp
        values, vectors = np.linalg.eig(a)
        parts = np.linalg.solve(vectors, np.array([start, 0.0, 0.0, 0.0]).astype(complex))

        def exact(t: Array) -> Array:
            return np.asarray(np.real((np.exp(np.outer(t, values)) * parts) @ vectors.T)[:, :2])

        t = np.asarray(ran.signals["time"])
        q = np.stack([ran.signals["q1"], ran.signals["q2"]], axis=1)
        ours = float(np.abs(q - exact(t)).max())
        times, held = _jacobi(inertias, springs, dampers, start, end / exchanges, end)
        return ours / float(np.abs(held - exact(times)).max())

    return find


def _shorter_steps(runner: CaseRunner, model: str) -> float:
    """Return the larger error over its bound of an integral at two steps, the shorter of which is worse.

    The heat of ten swings of 10 Hz in a circuit's spring, i^2 t/2, in steps of 2.5 ms and 1.25 ms at most.
    """
    inertia, amplitude, seconds = 0.2 * RADIUS**2, 0.05, 1.0
    stiffness = (2 * math.pi * 10.0) ** 2 * inertia
    law = (
        "from cosim.loop.userlaw import Command\nclass Spring:\n    def control(self, sample):\n"
        f"        k = {stiffness * _STATED / _SPRING!r}\n"
        "        return Command(u_rad=0 * sample.q_rad, stiffness=[[k]])\n"
    )
    exact = (stiffness * amplitude / _TORQUE) ** 2 / 2 * seconds
    errors, bounds = [], []
    for step in (2.5e-3, 1.25e-3):
        tables = slider(
            duration_s=seconds, device={"start": {"q_rad": [amplitude]}},
            computer={"period_s": seconds, "law": "law.py:Spring"},
            solver={"coupling_tolerance_rad": 1e-3, "max_step_s": step, "rtol": 1e-5},
        )  # fmt: skip
        heat = runner.run(tables, model, law, estimate=True).measures["heat"]
        errors.append(abs(heat["value"] - exact))
        bounds.append(heat["error"])
    if not (errors[1] > 1.1 * errors[0] and bounds[1] > bounds[0]):
        return math.nan  # it is no such problem, or the estimate does not follow
    return float(max(np.array(errors) / bounds))


#: A quarter car over 1e5: chassis of 400 kg on 15 kN/m and 1 kN s/m, wheel of 40 kg on 150 kN/m.
_CAR = ((4e-3, 4e-4), (0.0, 0.15, 1.5), (0.0, 0.01, 0.0))
_TWO = ((0.01, 0.01), (4 * math.pi**2 * 0.01, 16 * math.pi**2 * 0.01, 4 * math.pi**2 * 0.01), (0.0, 0.0, 0.0))


CASES = (
    HardCase("integral that shorter steps make worse", 56, "larger error over its bound", 0.5, {"spice": 0.5},
             "an error is within its bound, and both grow from 2.5 ms to 1.25 ms", _shorter_steps,
             broken="bounds half as wide"),
    *(HardCase(f"{name} against held values exchanged as often", 55, "our error over theirs", 0.0,
               {"spice": 0.02}, "the list's own; 1e-9 rad a step, amplitude 0.1 rad",
               _against_jacobi(*problem),
               broken="the angle is held over a step")
      for name, problem in (("two masses", _TWO), ("quarter car", _CAR))),
)  # fmt: skip
