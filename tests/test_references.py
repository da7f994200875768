"""The lockstep against two solvers that share nothing with it: exact matrix exponentials, and scipy's DOP853.

Both close the loop with a control law written a second time, in matrices and with an analytic inverse.
"""

from pathlib import Path

import numpy as np
import pytest
from slope import ENCODER, RADIUS, slope_reference
from support import (
    EMF_TRUE,
    GEAR,
    SCENES,
    Arm,
    ExactSlider,
    quick,
    simulate,
    slider,
)

from cosim.scene import load_scene

#: What op-amps of gain 1e9 with noise gains up to 18 leave of an ideal circuit: 3e-8 of half a radian of
#: travel, carried along by ten bounces.
IDEAL_RAD = 2e-7
#: Issue bound for agreement with a reference [m].
MICROMETRE = 1e-6


@pytest.mark.few(4)
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


@pytest.mark.few(2)
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
