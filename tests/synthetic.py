"""A run made of formulas: a two-link finger traces a 45 degree wall, sampled at 25 ms.

Plausible enough to draw and exact enough to check numbers against: the forces, depths and energies below
are the ones that the report must find again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.caution import Caution

Array = NDArray[np.float64]

PERIOD_S = 0.025
STIFFNESS = 233.0  # N/m, 133 of the computer and 100 of the circuit
VISCOSITY = 1.6  # N s/m at the tip
MASS_KG = 0.2
GEAR, KT = 8.0, 0.035
DRAG = 0.35  # F_t / F_n of the joint_pd variant
K_FS, V_FS = 4.0, 10.0
WALL_POINT = (0.12, 0.08)
NORMAL = (np.sqrt(0.5), np.sqrt(0.5))


@dataclass
class SyntheticRun:
    """Has the attributes that a report reads, and nothing else."""

    scene: Mapping[str, Any] = field(default_factory=dict)
    plan: Mapping[str, Any] = field(default_factory=dict)
    signals: Mapping[str, Array] = field(default_factory=dict)
    samples: Mapping[str, Array] = field(default_factory=dict)
    events: Sequence[Mapping[str, Any]] = ()
    measures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    ledger: Mapping[str, Any] = field(default_factory=dict)
    stats: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[Caution] = ()
    printed: Sequence[str] = ()


def _elbow(x: Array, y: Array) -> tuple[Array, Array]:
    cosine = (x**2 + y**2 - 0.02) / 0.02
    q2 = np.arccos(np.clip(cosine, -1, 1))
    q1 = np.arctan2(y, x) - np.arctan2(0.1 * np.sin(q2), 0.1 + 0.1 * np.cos(q2))
    return q1, q2


def _integral(time: Array, power: Array) -> Array:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(time)
    return np.concatenate(([0.0], np.cumsum(steps)))


def slope_run(
    duration_s: float = 3.0, points_per_s: int = 2000, drag: bool = False, stiffness: float = STIFFNESS
) -> SyntheticRun:
    """Approach, trace the wall with a swelling force, let go (each a fixed share of the time)."""
    ticks = np.arange(round(duration_s / PERIOD_S) + 1)
    sample_time = np.round(ticks * PERIOD_S, 9)
    grid = np.arange(round(duration_s * points_per_s) + 1) / points_per_s
    after = sample_time[1:-1, None] + np.array([2e-6, 1e-5, 6e-5])  # the solver starts small behind a sample
    time = np.unique(np.concatenate((grid, sample_time, after.ravel())))
    time = np.unique(np.round(time[time <= duration_s], 9))  # no two times closer than a nanosecond
    phase = time / duration_s
    pressed = np.clip((phase - 0.2) / 0.05, 0, 1) * np.clip((0.9 - phase) / 0.05, 0, 1)
    force_n = pressed * (0.9 + 0.35 * np.sin(2 * np.pi * 1.3 * time) + 0.08 * np.sin(2 * np.pi * 17 * time))
    free = 0.012 * np.clip((0.2 - phase) / 0.2, 0, 1) + 0.01 * np.clip((phase - 0.9) / 0.1, 0, 1)
    depth = force_n / stiffness
    along = 0.04 * np.cos(2 * np.pi * 0.4 * time)
    across = free - depth
    tangent = (NORMAL[1], -NORMAL[0])
    x = WALL_POINT[0] + along * tangent[0] + across * NORMAL[0]
    y = WALL_POINT[1] + along * tangent[1] + across * NORMAL[1]
    q1, q2 = _elbow(x, y)
    v1, v2 = np.gradient(q1, time), np.gradient(q2, time)
    force_t = (DRAG if drag else 0.01) * force_n
    fx = -(force_n * NORMAL[0] + force_t * tangent[0])  # operator on device
    fy = -(force_n * NORMAL[1] + force_t * tangent[1])
    jac = np.array(
        [
            [-0.1 * np.sin(q1) - 0.1 * np.sin(q1 + q2), -0.1 * np.sin(q1 + q2)],
            [0.1 * np.cos(q1) + 0.1 * np.cos(q1 + q2), 0.1 * np.cos(q1 + q2)],
        ]
    )
    # The computer's share of the force is held from sample to sample, the circuit's is not.
    ticks_before = np.maximum(np.searchsorted(sample_time, time, side="left") - 1, 0)
    depth_held = np.interp(sample_time, time, depth)[ticks_before]
    drawn_n = (100.0 * depth + (stiffness - 100.0) * depth_held) * (force_n > 0)
    drawn = (drawn_n * NORMAL[0] + force_t * tangent[0], drawn_n * NORMAL[1] + force_t * tangent[1])
    torque = jac[0] * drawn[0] + jac[1] * drawn[1]
    speed = np.hypot(np.gradient(x, time), np.gradient(y, time))
    kinetic = 0.5 * MASS_KG * speed**2
    p_op = fx * np.gradient(x, time) + fy * np.gradient(y, time)
    p_visc = -VISCOSITY * speed**2
    p_mot = np.gradient(kinetic, time) - p_op - p_visc
    signals = {
        "time": time, "q1": q1, "q2": q2, "v1": v1, "v2": v2, "x": x, "y": y, "fx": fx, "fy": fy,
        "imot1": torque[0] / (GEAR * KT), "imot2": torque[1] / (GEAR * KT),
        "p_mot": p_mot, "p_op": p_op, "p_visc": p_visc, "p_coul": 0 * time, "p_stop": 0 * time,
        "e_kin": kinetic, "e_grav": 0 * time, "e_spring": 0.5 * 100.0 * depth**2,
        "xboard.xsum1.out": 3.0 * torque[0] / 0.28, "xboard.xdrv1.out": 6.0 * torque[0] / 0.28,
    }  # fmt: skip
    held = np.searchsorted(time, sample_time - 1e-10)
    pen = depth[held]
    contact = (pen > 0).astype(float)
    across_n = NORMAL[0] * jac[0] + NORMAL[1] * jac[1]
    samples: dict[str, Array] = {
        "tick": ticks.astype(float),
        "time": sample_time,
        "contact": contact,
        "pen": pen,
    }
    samples["saturated"] = np.zeros(ticks.size)
    # At the instant of a sample the DACs still show what was before.
    latest = np.maximum(np.searchsorted(sample_time, time, side="left") - 1, 0)
    for i in (1, 2):
        u = (q1, q2)[i - 1][held] + across_n[i - 1][held] * pen
        samples[f"u_rad{i}"] = u
        samples[f"cmd_nm{i}"] = 0.2 * torque[i - 1][held]
        signals[f"u{i}"] = 3.37 * u[latest]
        signals[f"cmd{i}"] = samples[f"cmd_nm{i}"][latest] * 5.0
        for j in (1, 2):
            gain = 100.0 * across_n[i - 1][held] * across_n[j - 1][held] * contact
            if drag and i != j:
                gain = 0 * gain
            samples[f"ksp{i}{j}"] = gain
            samples[f"ksd{i}{j}"] = 0 * gain
            signals[f"ksp{i}{j}"] = gain[latest] * V_FS / K_FS
            signals[f"ksd{i}{j}"] = 0 * time
    work = {name: float(_integral(time, signals[name])[-1]) for name in ("p_op", "p_mot", "p_visc")}
    residual = work["p_op"] + work["p_mot"] + work["p_visc"] - float(kinetic[-1] - kinetic[0])
    return SyntheticRun(
        scene={
            "title": "Slope, continuous and discrete stiffness together", "duration_s": duration_s, "seed": 7,
            "device": {"board": "board2.cir", "linkage": "chain", "chain": {"lengths_m": [0.1, 0.1]}},
            "computer": {
                "period_s": PERIOD_S, "method": "joint_pd" if drag else "combined",
                "discrete_stiffness_n_per_m": stiffness - 100.0, "analog_stiffness_n_per_m": 100.0,
            },
            "wall": {"point_m": list(WALL_POINT), "normal": [float(part) for part in NORMAL]},
            "operator": {"type": "hand", "mass_kg": 0.554},
            "effects": {
                "opamp": "full", "vca": "gbw", "driver": "voltage", "driver_level": "ideal", "motor": "emf",
                "potentiometer": "ideal", "pot_noise": "none", "encoder": True, "dac": True, "delay": False,
                "gravity": False, "coriolis": True, "viscous": True, "coulomb": False,
            },
        },
        plan={
            "model": "spice",
            "constants": {
                "i_rated": 1.0, "i_limit": 3.0, "kt": KT, "gear": GEAR, "k_fs": K_FS, "v_fs": V_FS,
            },
            "amplifiers": [
                {"path": "xboard.xsum1.xop", "part": "tl072", "peak_v": 8.1, "swing_v": 13.5},
                {"path": "xboard.xdrv1.xop", "part": "opa548", "peak_v": 10.2, "swing_v": 11.3},
                {"path": "xboard.xdiff1.xop", "part": "tl072", "peak_v": 0.9, "swing_v": 13.5},
            ],
            "effects": [
                {"name": "opamp", "value": "full", "size": {"words": "0.1 us"}, "cost": {"text": "3 states"}}
            ],
            "left_out": [
                {"name": "gravity", "value": False, "size": {"words": "2 N"}, "cost": {"text": "nothing"}}
            ],
        },
        signals=signals, samples=samples,
        events=({"time_s": 0.2 * duration_s, "kind": "contact", "text": "the computer finds the wall"},),
        measures={
            "rendered_stiffness": {"value": 0.98 * stiffness, "unit": "N/m", "text": "force over depth"},
            "max_penetration": {"value": float(depth.max()), "unit": "m", "text": "deepest penetration"},
            "peak_current": {"value": 0.31, "unit": "A", "text": "largest motor current"},
        },
        ledger={
            "work_j": work, "residual_j": residual,
            "closure": abs(residual) / sum(abs(each) for each in work.values()),
        },
        stats={"points": int(time.size), "rejected": 123, "wall_s": 1.9, "defect_max_rad": 4.2e-7},
        provenance={"command": ["/usr/bin/cosim", "run", "slope.toml"], "versions": {"ngspice": "39"}},
    )  # fmt: skip
