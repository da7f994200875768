"""What `coupling_tolerance_rad` promises: errors of all signals follow it, whatever the circuit's poles.

Collocation is held against the matrix exponential of the same scene. Tolerances are angles; speeds and
currents are judged as shares of their largest value against the tolerance as a share of the largest angle.
"""

import ctypes
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_runs import CONSTANTS, ideal, lagging, propagate, rows
from scipy.linalg import expm
from support import scene_of, slider

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.linear.exact_matrices import Step, system, transitions
from cosim.loop.linear.run_linear import prepare
from cosim.scene import Scene

Array = Any
PERIOD = 0.01
#: Each step may be off by the tolerance, and a bounce repeats what fifty steps leave.
MULTIPLE = 20.0


def bounce(tmp_path: Path, before: float, after: float) -> tuple[Scene, LinearCircuit]:
    """A carriage that falls on a wall of analog spring and damper, the circuit's poles as given [rad/s]."""
    tables = slider(
        device={"slider": {"origin_m": [0.0, 0.01]}, "start": {"v_rad_per_s": [-0.5]}},
        computer={"period_s": PERIOD, "analog_damping_n_s_per_m": 1.0},
        effects={"motor": "emf", "gravity": True},
    )
    flat = ideal(1)
    return scene_of(tmp_path, tables), lagging(replace(flat, e_pre=0 * flat.e_pre), before, after)


def signals(scene: Scene, circuit: LinearCircuit, tol: float, *, exact: bool) -> tuple[Array, int]:
    """Angle, speed and current at the samples, and the points that it took; no step but by tolerance."""
    made = prepare(
        scene, CONSTANTS, circuit, record=True, dense=False, row_capacity=20_000, sample_capacity=100
    )
    state = made.memory.state[0]
    state["steps"]["tol"] = tol
    made.exact.on[0] = int(exact)
    drain = ctypes.CFUNCTYPE(None)(lambda: None)
    state["drain_address"] = ctypes.cast(drain, ctypes.c_void_p).value
    made.run()
    assert state["fault"] == 0
    at = np.abs(rows(made, "time")[:, None] - PERIOD * np.arange(1, 51)).argmin(axis=0)
    return np.column_stack([rows(made, name)[at] for name in ("q1", "v1", "imot1")]), int(state["points"])


@pytest.mark.parametrize(
    ("before", "after"), [(100.0, 100.0), (300.0, 1e3), (3e3, 6.4e3)], ids=["slow", "middle", "quick"]
)
def test_errors_of_angle_speed_and_current_follow_the_tolerance(
    tmp_path: Path, before: float, after: float
) -> None:
    scene, circuit = bounce(tmp_path, before, after)
    truth, _ = signals(scene, circuit, 1e-9, exact=True)
    largest = np.abs(truth).max(axis=0)
    tolerances = 10.0 ** -np.arange(6, 12)
    errors = []
    for tol in tolerances:
        result, points = signals(scene, circuit, tol, exact=False)
        errors.append(np.abs(result - truth).max(axis=0) / largest * largest[0])
        assert (errors[-1] < MULTIPLE * tol).all(), tol
        assert points < 400
    # proportional to the tolerance: slope 1 in double logarithmic scale, but for steps halved or not
    slopes = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slopes == pytest.approx([1.0, 1.0, 1.0], abs=0.25)


def test_bandwidth_changes_neither_error_nor_steps(tmp_path: Path) -> None:  # 1
    # amplifiers of 1e5 and 1e8 Hz at a gain of 17.9
    points = []
    for gbw in (1e5, 1e8):
        pole = 2 * np.pi * gbw / 17.9
        scene, circuit = bounce(tmp_path, pole, pole)
        truth, _ = signals(scene, circuit, 1e-9, exact=True)
        result, count = signals(scene, circuit, 1e-8, exact=False)
        largest = np.abs(truth).max(axis=0)
        assert (np.abs(result - truth).max(axis=0) / largest * largest[0] < MULTIPLE * 1e-8).all()
        points.append(count)
    assert max(points) <= 1.2 * min(points)


def ramped(tmp_path: Path, duration_s: float) -> tuple[Scene, LinearCircuit]:
    """A carriage pushed out of a wall of 50 + 100 N/m by DACs that take a tenth of the period to settle."""
    tables = slider(
        duration_s=duration_s, device={"start": {"q_rad": [-0.05]}},
        computer={
            "period_s": 0.01, "method": "combined", "discrete_stiffness_n_per_m": 50.0,
            "dac": {"settling_s": 1e-3},
        },
        effects={"dac_settling": True, "motor": "emf"},
    )  # fmt: skip
    return scene_of(tmp_path, tables), lagging(ideal(1), 3e3, 6e3)


def test_a_leap_over_a_ramp_is_the_ramp_stepped_over(tmp_path: Path) -> None:
    # with rows the loop lands on the end of each ramp, without it takes one matrix for both; both are exact,
    # but where the gains ramp: out of contact from 0.07 s on
    scene, circuit = ramped(tmp_path, 0.06)
    ends, points = [], []
    for record in (True, False):
        made = prepare(
            scene, CONSTANTS, circuit, record=record, dense=False, row_capacity=100, sample_capacity=20
        )
        made.run()
        state = made.memory.state[0]
        ends.append(np.array([state["q"][0], state["v"][0], made.step.current[0]]))
        points.append(int(state["points"]))
        assert (made.memory.samples[: int(state["samples"]["used"]), 2] == 1).all()
    assert points == [1 + 1 + 5 * 2, 1 + 6]  # no ramp at power-up
    assert ends[1] == pytest.approx(ends[0], rel=1e-12)


def test_the_matrix_of_a_ramp_is_that_of_its_two_pieces(tmp_path: Path) -> None:
    # x' = A x + B i with i even over each piece, as one exponential of (x, i, i')
    scene, circuit = ramped(tmp_path, 0.06)
    made = prepare(scene, CONSTANTS, circuit, record=False)
    state, gains, h, ramp = made.memory.state[0], np.array([5.9, 0.3]), 0.01, 1e-3
    a, b, c, d = system(state, circuit, gains)
    n = len(a)
    values = np.zeros((n + 10, n + 10))
    values[:n, :n], values[:n, n : n + 5], values[n : n + 5, n + 5 :] = a, b, np.eye(5)
    rng = np.random.default_rng(3)
    start, change = rng.normal(size=n + 5), rng.normal(size=5)
    late = np.array([1.0, 0.0, 0.0, 1.0, 1.0]) / h  # torque, u, cmd, pot and its rate
    early = late + np.array([0.0, 1.0, 1.0, 0.0, 0.0]) / ramp
    there = expm(values * ramp) @ np.concatenate([start, early * change])
    end = expm(values * (h - ramp)) @ np.concatenate([there[: n + 5], late * change])
    (made,) = transitions([(a, b, c, d)], np.zeros(1, int), [Step(*gains, h, ramp)], nodes=False)
    value = made @ np.concatenate([start, change])
    assert value[:n] == pytest.approx(end[:n], rel=1e-10)
    assert value[n] == pytest.approx(float(c[0] @ end[:n] + d[0] @ end[n : n + 5]), rel=1e-10)


@pytest.mark.parametrize("exact", [True, False], ids=["exponential", "collocation"])
def test_subnormal_signals_give_the_same_answer_in_as_many_steps(tmp_path: Path, exact: bool) -> None:  # 7
    # linear, held by a hand, steps of a period (a tolerance is absolute): the answer scales with the start,
    # down to where most products are subnormal
    ends, points = [], []
    for size in (1e-3, 1e-307):
        hand = {"type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 50.0, "damping_n_s_per_m": 0.0,
                "waypoints_s_m": [[0.0, 0.0, 0.0]]}  # fmt: skip
        tables = slider(
            duration_s=0.04, device={"start": {"q_rad": [size]}}, computer={"period_s": 0.01}, operator=hand,
            effects={"motor": "emf", "operator_dynamics": True},
        )  # fmt: skip
        pole = 3e3
        made = propagate(
            scene_of(tmp_path, tables), lagging(ideal(1), pole, pole), tol=1.0, rows=False, exact=exact
        )
        state = made.memory.state[0]
        ends.append(np.array([state["q"][0], state["v"][0], made.step.current[0]]) / size)
        points.append(int(state["points"]))
    assert ends[1] == pytest.approx(ends[0], rel=1e-8)
    assert points[1] == points[0]
