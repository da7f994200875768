"""What friction holds a joint at rest against: motor, weight and the hand, by the balance of torques."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import merge, quick, slider

from mech.operator import Hand
from mech.records import NMAX, WORK
from mech.slider import Slider
from mech.stiction import settle

RADIUS, MASS, FRICTION = 0.1333, 0.2, 0.016


@pytest.mark.parametrize("tau", [0.0, 0.01, -0.01])
@pytest.mark.parametrize("force", [0.0, 0.04, -0.04, 0.15, -0.3])
def test_a_joint_at_rest_is_held_against_motor_and_hand_together(tau: float, force: float) -> None:
    slider = Slider(radius_m=RADIUS, mass_kg=MASS, direction=(0.0, 1.0), coulomb_n_m=(FRICTION,))
    hand = Hand(waypoints_s_m=[(0.0, 0.0, 0.0)], force_s_n=[(0.0, 0.0, force)], mass_kg=0.0,
                stiffness_n_per_m=0.0, damping_n_s_per_m=0.0)  # fmt: skip
    work = np.zeros(1, WORK)
    work["mode"]["located"] = 1
    p, op = slider.pack(), hand.pack()
    p["coulomb_on"] = 1
    q, v, torque, a = np.zeros(NMAX), np.zeros(NMAX), np.array([tau] + [0.0] * (NMAX - 1)), np.zeros(NMAX)
    settle(p[0], op[0], 0.0, q, v, torque, a, work[0])
    load = tau + RADIUS * force
    beyond = np.sign(load) * max(abs(load) - FRICTION, 0.0)
    assert a[0] == pytest.approx(beyond / (MASS * RADIUS**2), abs=1e-12)
    assert bool(work[0]["contact"]["held"][0]) == (beyond == 0.0)
    if beyond == 0.0:
        assert work[0]["contact"]["hold"][0] == pytest.approx(-load, abs=1e-15)


def pushed(force: float, friction: bool) -> dict[str, Any]:
    return merge(
        slider(
            duration_s=0.2,
            operator={
                "type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0,
                "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, force]],
            },
            device={"slider": {"coulomb_n_m": FRICTION}},
            effects={"coulomb": friction},
            solver={"model": "linear"},
        ),
        {"wall": {"point_m": [0.0, -1.0]}},
    )  # fmt: skip


def test_a_hand_moves_the_carriage_by_what_friction_leaves(tmp_path: Path) -> None:
    """In a process of its own: x = (F - f_c/r) t^2/(2 m), and nothing below f_c/r = 0.12 N."""
    for force in (0.1, -0.1):
        assert not np.any(quick(tmp_path, pushed(force, True)).signals["y"])
    for force in (0.2, -0.2):
        y = float(np.asarray(quick(tmp_path, pushed(force, True)).signals["y"])[-1])
        left = np.sign(force) * (abs(force) - FRICTION / RADIUS)
        assert y == pytest.approx(left * 0.2**2 / (2 * MASS), rel=1e-6)
