"""The paper's slope, integrated once more without the program: what a scene must show on it."""

import math
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from support import (
    COMMAND_TRUE,
    EMF_TRUE,
    GEAR,
    K_FS,
    POT_V,
    SCENES,
    SPRING_TRUE,
    V_NM,
    V_RAD,
    Arm,
    hand_force,
    paper_law,
)

RADIUS = 0.1333


ENCODER = 2 * math.pi / (500 * 4 * GEAR)


def slope_reference(
    kind: str, *, encoder: bool, emf: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample times, states (q, v) there and force of the hand [N] just before, of scenes/`kind`.toml."""
    import tomllib  # the file is read as a user reads it, not through the loader

    with open(SCENES / "slope.toml", "rb") as file:
        tables = tomllib.load(file)
    if kind != "slope":
        with open(SCENES / f"{kind}.toml", "rb") as file:
            tables["computer"] |= tomllib.load(file)["computer"]
    chain, computer, hand = tables["device"]["chain"], tables["computer"], tables["operator"]
    arm = Arm(*chain["lengths_m"], *chain["masses_kg"], *chain["coms_m"], *chain["inertias_kg_m2"],
              chain["rotor_inertia_kg_m2"][0] * GEAR**2)  # fmt: skip
    viscosity = chain["viscous_n_m_s"][0] + (EMF_TRUE if emf else 0.0)
    normal = np.array(tables["wall"]["normal"])
    wall = np.array(tables["wall"]["point_m"]), normal / np.hypot(*normal)
    period, duration = computer["period_s"], tables["duration_s"]
    knots = sorted({row[0] for row in (*hand["waypoints_s_m"], *hand["force_s_n"])})
    q = arm.inverse(np.array(tables["device"]["start"]["tip_m"]))
    state, before = np.concatenate([q, [0.0, 0.0]]), None
    times, states, forces = [0.0], [state], [hand_force(hand, 0.0, arm.tip(q), np.zeros(2))]
    for k in range(round(duration / period)):
        start, end = k * period, (k + 1) * period
        q = state[:2]
        seen = np.floor(q / ENCODER + 0.5) * ENCODER if encoder else q
        rate = np.zeros(2) if before is None else (seen - before) / period
        before = seen
        asked = paper_law(
            arm, seen, rate, wall, computer["method"],
            computer.get("discrete_stiffness_n_per_m", 0.0), computer.get("discrete_damping_n_s_per_m", 0.0),
            computer.get("analog_stiffness_n_per_m", 0.0), 0.0, computer["command_path"],
        )  # fmt: skip
        spring, u = asked["ksp"] * SPRING_TRUE / K_FS, asked["u"] * V_RAD / POT_V
        command = asked["cmd"] * COMMAND_TRUE * V_NM

        def rates(t: float, y: np.ndarray, spring=spring, u=u, command=command) -> np.ndarray:
            q, v = y[:2], y[2:]
            jac = arm.jacobian(q)
            push = hand_force(hand, t, arm.tip(q), jac @ v)
            mass, bias = arm.mass_and_bias(q, v, hand["mass_kg"])
            torque = spring @ (u - q) + command - viscosity * v + jac.T @ push - bias
            return np.concatenate([v, np.linalg.solve(mass, torque)])

        edges = [start, *[t for t in knots if start + 1e-9 < t < end - 1e-9], end]
        for a, b in pairwise(edges):
            # a knot's slope belongs to the interval in front of it: stay half a nanosecond inside
            part = solve_ivp(rates, (a, b), state, method="DOP853", rtol=1e-11, atol=1e-13)
            state = part.y[:, -1]
        jac, v = arm.jacobian(state[:2]), state[2:]
        acceleration = rates(end - 1e-12, state)[2:]
        absolute = np.array([v[0], v[0] + v[1]])
        angles = np.cumsum(state[:2])
        pull = np.array(chain["lengths_m"]) * absolute**2
        turning = -np.array([pull @ np.cos(angles), pull @ np.sin(angles)])
        inertial = hand["mass_kg"] * (jac @ acceleration + turning)
        times.append(end)
        states.append(state)
        forces.append(hand_force(hand, end - 1e-12, arm.tip(state[:2]), jac @ v) - inertial)
    return np.array(times), np.array(states), np.array(forces)
