"""The lockstep against two solvers that share nothing with it: exact matrix exponentials, and scipy's DOP853.

Both close the loop with a control law written a second time, in matrices and with an analytic inverse.
"""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
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
    ExactSlider,
    hand_force,
    paper_law,
    quick,
    simulate,
    slider,
)

from cosim.scene import load_scene

RADIUS = 0.1333
ENCODER = 2 * math.pi / (500 * 4 * GEAR)

#: What op-amps of gain 1e9 with noise gains up to 18 leave of an ideal circuit: 3e-8 of half a radian of
#: travel, carried along by ten bounces.
IDEAL_RAD = 2e-7
#: Issue bound for agreement with a reference [m].
MICROMETRE = 1e-6


@pytest.mark.parametrize("encoder", [False, True], ids=["exact angle", "encoder"])
@pytest.mark.parametrize(
    ("method", "kp", "kd", "k_dp", "path", "period"),
    [
        ("continuous", 0.0, 0.0, 100.0, "cmd", 0.025),
        ("combined", 100.0, 0.0, 100.0, "cmd", 0.01),
        ("combined", 100.0, 0.2, 100.0, "u", 0.01),
        ("discrete", 133.0, 0.0, 0.0, "cmd", 0.025),
    ],
)
def test_mass_dropped_on_the_wall_follows_the_exact_sampled_solution(
    tmp_path: Path, method: str, kp: float, kd: float, k_dp: float, path: str, period: float, encoder: bool
) -> None:
    # 0.2 kg with 0.05 kg dropped 10 mm; viscosity only from the motor's back-EMF (EMF_TRUE: 1.15 N s/m)
    run = quick(
        tmp_path,
        slider(
            duration_s=1.0,
            device={"slider": {"origin_m": [0.0, 0.01], "rotor_inertia_kg_m2": 2e-6}},
            operator={"type": "mass", "mass_kg": 0.05},
            computer={
                "period_s": period,
                "method": method,
                "discrete_stiffness_n_per_m": kp,
                "discrete_damping_n_s_per_m": kd,
                "analog_stiffness_n_per_m": k_dp,
                "command_path": path,
            },
            effects={"motor": "emf", "gravity": True, "encoder": encoder, "rotor_inertia": True},
        ),
    )
    mass = 0.25
    exact = ExactSlider(
        inertia=mass * RADIUS**2 + 2e-6 * GEAR**2,
        radius=RADIUS,
        viscosity=EMF_TRUE,
        period=period,
        q_wall=-0.01 / RADIUS,
        kp=kp,
        kd=kd,
        k_dp=k_dp,
        path=path,
        encoder_step=ENCODER if encoder else 0.0,
    )
    t = np.asarray(run.signals["time"])
    reference = exact.solve(0.0, 0.0, round(1.0 / period), [(0.0, -9.81 * mass)], t)
    assert np.asarray(run.samples["contact"]).sum() > 20
    error = np.abs(np.asarray(run.signals["q1"]) - reference[:, 0]).max()
    estimate = run.stats["defect_sum_rad"]
    print(f"largest angle error {error:.2e} rad, printed estimate {estimate:.2e} rad, {len(t)} points")
    assert error < estimate + IDEAL_RAD  # the run knows how wrong it may be
    assert error * RADIUS < MICROMETRE


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


@pytest.mark.parametrize("encoder", [False, True], ids=["exact angle", "encoder"])
@pytest.mark.parametrize("kind", ["slope", "slope_discrete", "slope_joint_pd"])
def test_slope_follows_dop853_on_the_textbook_equations(tmp_path: Path, kind: str, encoder: bool) -> None:
    ideal = [f"effects.{name}=ideal" for name in ("opamp", "vca", "driver_level")]
    scene = load_scene(
        SCENES / f"{kind}.toml",
        [
            *ideal,
            "effects.motor=emf",
            "effects.dac=false",
            "effects.dac_settling=false",
            f"effects.encoder={str(encoder).lower()}",
        ],
    )
    run = simulate(scene, tmp_path / "out")
    times, states, forces = slope_reference(kind, encoder=encoder)
    t = np.asarray(run.signals["time"])
    at = np.searchsorted(t, times - 1e-11)
    assert np.abs(t[at] - times).max() < 1e-11
    arm = Arm(0.1, 0.1, 0, 0, 0, 0, 0, 0, 0)
    tips = np.array([arm.tip(q) for q in states[:, :2]])
    off = np.hypot(run.signals["x"][at] - tips[:, 0], run.signals["y"][at] - tips[:, 1])
    angle = max(np.abs(run.signals[f"q{j + 1}"][at] - states[:, j]).max() for j in range(2))
    miss = np.hypot(run.signals["fx"][at] - forces[:, 0], run.signals["fy"][at] - forces[:, 1])[1:]
    peak = np.hypot(*forces.T).max()
    estimate = run.stats["defect_sum_rad"]
    print(
        f"{kind}: tip {off.max():.2e} m, force {miss.max() / peak:.1e} of its peak {peak:.2f} N, "
        f"angle {angle:.1e} rad, "
        f"printed estimate {estimate:.1e} rad, {len(t)} points"
    )
    assert np.asarray(run.samples["contact"]).sum() > 40
    assert angle < estimate + IDEAL_RAD
    assert off.max() < MICROMETRE
    assert miss.max() < 1e-4 * peak
