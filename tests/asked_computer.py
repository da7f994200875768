"""A computer asked directly, without a loop around it."""

from typing import Any

import numpy as np
from support import (
    K_FS,
    V_NM,
    V_RAD,
    Arm,
    Array,
)

from cosim.loop.computer import COMPUTER, SAMPLE, Method, law
from cosim.loop.computer import Path as CommandPath
from mech import Chain

ARM = Arm(0.1, 0.1, 0, 0, 0, 0, 0, 0, 0)


LINKAGE = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05), inertias_kg_m2=(1e-4, 1e-4))


KP, KD, K_DP, K_DD = 133.0, 0.7, 100.0, 1.3


V_FS, C_FS = 10.0, 0.06969


def record(method: Method, normal: Array, point: Array, **more: Any) -> Any:
    c = np.zeros((), COMPUTER)
    c["n"], c["method"], c["period"] = 2, method, 0.025
    c["kp"], c["kd"], c["k_dp"], c["k_dd"] = KP, KD, K_DP, K_DD
    c["normal"], c["point"], c["joint_gain"], c["joint_damper"] = normal, point, -1.0, -1.0
    c["path"] = CommandPath.CMD
    c["v_rad"], c["volts_per_stiffness"], c["volts_per_damping"], c["v_nm"] = (
        V_RAD,
        V_FS / K_FS,
        V_FS / C_FS,
        V_NM,
    )
    c["dac_range"] = np.inf
    for name, value in more.items():
        c[name] = value
    return c[()]


def ask(c: Any, q: Array, v: Array) -> Any:
    x = np.zeros(1, SAMPLE)[0]
    x["q"][:2], x["v"][:2] = q, v
    law(c, LINKAGE.pack()[0], x)
    return x


def poses(count: int, seed: int = 7) -> list[tuple[Array, Array, Array, Array]]:
    """Random poses of either elbow with walls of any direction a few millimetres beyond or before the tip."""
    rng = np.random.default_rng(seed)
    out = []
    while len(out) < count:
        q = np.array([rng.uniform(-np.pi, np.pi), rng.choice([-1, 1]) * rng.uniform(0.3, 2.6)])
        angle = rng.uniform(-np.pi, np.pi)
        normal = np.array([np.cos(angle), np.sin(angle)])
        point = (
            ARM.tip(q)
            + rng.uniform(1e-4, 8e-3) * normal
            + rng.uniform(-0.05, 0.05) * np.array([normal[1], -normal[0]])
        )
        touch = ARM.tip(q) + float(normal @ (point - ARM.tip(q))) * normal
        if 0.03 < np.hypot(*touch) < 0.19:  # the contact point must be in reach
            out.append((q, rng.normal(size=2), normal, point))
    return out
