"""Errors of the potentiometers that belong to the angle, and encoders: null limit, formula, all models."""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from support import POT_V, V_RAD, Array, merge, quick, slider

from cosim.loop.noise import no_noise, potentiometer_noise, with_errors
from cosim.loop.pin_voltages import position_noise
from cosim.loop.state import STATE

MODELS = ("ideal", "linear", "spice")
TURN = 2 * math.pi
SPRING = """
import numpy as np
from cosim.loop.userlaw import Command
class Spring:
    def control(self, sample):
        return Command(u_rad=[0.1], stiffness=[[2.0]])
"""


def errors(noise: Any = None, seed: int = 3, joints: int = 2, **more: float) -> Any:
    given = {"linearity_rad": 0.0, "period_rad": 1.0, "gain_error": 0.0, "zero_rad": 0.0}
    return with_errors(no_noise(joints) if noise is None else noise, seed, **{**given, **more})


def shown(noise: Any, q: Array, joint: int) -> Array:
    """What a table adds to the angle: Hermite's cubics with the slopes of the points beside each."""
    at, values = noise.lo + noise.step * np.arange(len(noise.table)), noise.table[:, joint]
    return CubicHermiteSpline(at, values, np.gradient(values, noise.step))(np.clip(q, at[0], at[-1]))


def read(table: Array, lo: float, step: float, q: Array) -> Array:
    """What the kernels make of one joint's table at the angles q."""
    state = np.zeros(1, STATE)
    table = np.ascontiguousarray(table, float)
    state["n"], state["position_noise"]["address"], state["position_noise"]["points"] = (
        1,
        table.ctypes.data,
        len(table),
    )
    state["position_noise"]["lo"], state["position_noise"]["step"] = lo, step
    return np.array([position_noise(state[0], float(angle), 0) for angle in q])


def bytes_of(run: Any) -> str:
    return hashlib.sha256(Path(run.signals.path).read_bytes()).hexdigest()


def in_free_space(model: str, **more: Any) -> dict[str, Any]:
    """A carriage that coasts through 0.4 rad at constant speed, nothing acting on it."""
    return merge(
        slider(
            seed=3, duration_s=0.4, wall=None, solver={"model": model},
            device={"start": {"q_rad": [-0.1], "v_rad_per_s": [1.0]}},
        ),
        more,
    )  # fmt: skip


# ---- the functions of the angle


def test_linearity_is_the_largest_distance_from_the_straight_line() -> None:
    result = errors(linearity_rad=0.006)
    q = np.linspace(-TURN, TURN, 20_001)
    for joint in range(2):
        # the curve turns within a spacing of 1/64 rad, which sixteen places and these 20001 angles divide by
        # 16 and by 25: (1/16)^2 / 8 of how far it bends there, which is less than 3 pi/2 / 64 of the largest
        assert np.abs(shown(result, q, joint)).max() == pytest.approx(0.006, rel=1e-4)
    assert np.abs(np.diff(result.table[:, 0])).max() < 0.006 * math.pi / 2 * 3 / 64  # varies over a radian


def test_each_joint_and_seed_has_a_curve_of_its_own_and_nothing_else_changes() -> None:
    one, again, other = (
        errors(linearity_rad=1e-3),
        errors(linearity_rad=1e-3),
        errors(None, 4, linearity_rad=1e-3),
    )
    assert (one.table == again.table).all()
    assert not np.allclose(one.table[:, 0], one.table[:, 1])
    assert not np.allclose(one.table, other.table)
    white = potentiometer_noise("white", 2, 3, 0.1, 1e-3, 100.0, 0.1, TURN)
    both = errors(white, linearity_rad=1e-3, gain_error=0.01)
    assert (both.grid == white.grid).all()
    assert both.dt == white.dt


def test_calibration_is_a_straight_line_as_far_as_joints_go() -> None:
    result = errors(gain_error=0.02, zero_rad=-0.003)
    for q in (-99.0, -1.0, 0.0, 0.3, 99.0):
        # 1e-14: rounding of 100 rad
        assert shown(result, np.array([q]), 1)[0] == pytest.approx(0.02 * q - 0.003, abs=1e-14)


def test_errors_and_position_noise_add_up_point_by_point() -> None:
    noise = potentiometer_noise("position", 2, 3, 0.1, 1e-3, 100.0, 0.1, TURN)
    line, both = errors(gain_error=0.02, zero_rad=1e-3), errors(noise, gain_error=0.02, zero_rad=1e-3)
    at = noise.lo + noise.step * np.arange(len(noise.table))
    for joint in range(2):
        np.testing.assert_allclose(
            shown(both, at, joint), noise.table[:, joint] + shown(line, at, joint), atol=1e-13
        )
    curve = errors(linearity_rad=2e-3)
    every = errors(noise, linearity_rad=2e-3)
    total = noise.table[:, 0] + shown(curve, at, 0)
    np.testing.assert_allclose(shown(every, at, 0), total, atol=1e-13)


def test_the_angle_that_is_shown_has_no_kinks() -> None:
    """A differentiator makes a jump of a kink: 2e-5 of a current stayed hidden in steps of a quarter period.

    Broken once: with the straight line of before, the slope jumps by a third of its largest.
    """
    noise = potentiometer_noise("position", 1, 3, 0.1, 1e-3, 100.0, 0.1, TURN)
    points = noise.lo + noise.step * np.arange(2000)  # of the whole turn's
    got = read(noise.table, noise.lo, noise.step, points)
    np.testing.assert_allclose(got, noise.table[:2000, 0], atol=1e-15)
    apart = 1e-6 * noise.step  # slopes beside a point, of differences over a millionth of the spacing
    inside = points[2:-2]
    before, at, behind = (
        read(noise.table, noise.lo, noise.step, inside + shift) for shift in (-apart, 0.0, apart)
    )
    left, right = (at - before) / apart, (behind - at) / apart
    # curvature: at most 4 x (largest second difference)/step^2 times the distance; and rounding of q
    bend = 4.0 * np.abs(np.diff(noise.table[:, 0], 2)).max() / noise.step**2 * apart
    rounding = 4e-16 * TURN * np.abs(left).max() / apart + 4e-16 * np.abs(at).max() / apart
    assert np.abs(right - left).max() < bend + rounding
    assert bend + rounding < 1e-3 * np.abs(left).max()


def test_a_parabola_and_a_line_to_the_last_point_are_kept() -> None:
    """Catmull and Rom's cubic is exact for a parabola within, and for a line up to either end."""
    at = 0.1 * np.arange(12)
    q = np.linspace(0.1, 0.99, 57)
    np.testing.assert_allclose(read((at * at)[:, None], 0.0, 0.1, q), q * q, atol=1e-15)
    q = np.linspace(-1.0, 1.0, 57)
    np.testing.assert_allclose(read(np.array([[-2.0], [2.0]]), -1.0, 2.0, q)[:-1], 2.0 * q[:-1], atol=1e-15)


@pytest.mark.parametrize("zero", [{}, {"linearity_rad": 0.0}, {"gain_error": 0.0, "zero_rad": 0.0}])
def test_no_error_is_no_table(zero: dict[str, float]) -> None:
    white = potentiometer_noise("white", 2, 3, 0.1, 1e-3, 100.0, 0.1, TURN)
    assert errors(white, **zero) is white


# ---- runs


@pytest.mark.few(4)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "null",
    [
        {"effects": {"pot_linearity": True}, "device": {"potentiometer": {"linearity_rad": 0.0}}},
        {"effects": {"pot_calibration": True},
         "device": {"potentiometer": {"gain_error": 0.0, "zero_rad": 0.0}}},
        {"device": {"potentiometer": {"linearity_rad": 0.1, "gain_error": 0.1, "zero_rad": 0.1}}},
    ],
    ids=["linearity 0", "calibration 0", "data without the effect"],
)  # fmt: skip
def test_null_limit(tmp_path: Path, model: str, null: dict[str, Any]) -> None:
    base = slider(solver={"model": model}, device={"start": {"q_rad": [-0.03]}}, effects={"motor": "emf"})
    plain, other = quick(tmp_path, base), quick(tmp_path, merge(base, null))
    assert bytes_of(plain) == bytes_of(other)
    assert other.stats["random_draws"] == 0


@pytest.mark.parametrize("model", MODELS)
def test_every_model_shows_the_same_curve(tmp_path: Path, model: str) -> None:
    pot = {"linearity_rad": 4e-3, "linearity_period_rad": 0.2, "gain_error": -0.03, "zero_rad": 2e-3}
    run = quick(
        tmp_path,
        in_free_space(
            model, device={"potentiometer": pot}, effects={"pot_linearity": True, "pot_calibration": True}
        ),
    )
    q, seen = np.asarray(run.signals["q1"]), np.asarray(run.signals["pot1"])
    assert np.ptp(q) == pytest.approx(0.4, rel=1e-9)
    curve = errors(joints=1, linearity_rad=4e-3, period_rad=0.2)
    # in `spice` the potentiometer sees the predicted angle, wrong by the defect at most
    room = 1e-12 + run.stats["defect_max_rad"]
    assert np.abs(seen - q - (shown(curve, q, 0) - 0.03 * q + 2e-3)).max() < room


@pytest.mark.parametrize("model", MODELS)
def test_a_spring_comes_to_rest_where_the_potentiometer_shows_its_equilibrium(
    tmp_path: Path, model: str
) -> None:
    (tmp_path / "law.py").write_text(SPRING)
    run = quick(
        tmp_path,
        slider(
            duration_s=3.0, wall=None, solver={"model": model}, computer={"law": "law.py:Spring"},
            device={"slider": {"viscous_n_m_s": 0.1},
                    "potentiometer": {"gain_error": 0.05, "zero_rad": 0.02}},
            effects={"viscous": True, "pot_calibration": True},
        ),
    )  # fmt: skip
    wanted = (0.1 * V_RAD / POT_V - 0.02) / 1.05
    # 2 N m/rad over 0.1 N m s/rad: exp(-45) is left after 3 s; the driver's and op-amps' gain of 1e9 is exact
    assert run.signals["q1"][-1] == pytest.approx(wanted, abs=1e-6)
