"""The interval that a noisy run prints: closed forms of means over long times, coverage, what has none."""

import math

import numpy as np
import pytest
from held_scenes import HELD, RADIUS, at_wall, circuit_of_kind
from linear_runs import CONSTANTS, ideal
from support import COMMAND_TRUE, SCENES, SPRING_TRUE, V_NM, merge, scene_of, shared_child, slider

from cosim.accuracy.estimate import estimator
from cosim.accuracy.noise_interval import noise_of
from cosim.analysis.control_law import resting_pose
from cosim.analysis.noise_covariance import noise_covariance
from cosim.analysis.noise_of_means import noise_of_means
from cosim.caution import collected
from cosim.commands.run import _estimated
from cosim.plan import resolve
from cosim.runner import measures_of, run
from cosim.scene import load_scene
from cosim.variants import Variant

HAND = 100.0  # N/m, of `HELD`, as are 100 N/m of the circuit, 80 N/m of the computer, 3 mrad to 150 Hz
ANALOG = 100.0 * SPRING_TRUE / CONSTANTS.k_fs
DISCRETE = 80.0 * COMMAND_TRUE * V_NM
SIGMA, TICK_S = 0.003, 1.0 / 300.0
QUANTILE = 1.959963984540054
STEADY = ("steady_penetration", "steady_normal_force", "rendered_stiffness")


def variance(span_s: float, discrete: float = DISCRETE) -> float:
    """Variance [m^2] of the mean depth over a long span.

    Noise of density 1.5 s^2 dt at rest (values on a grid, linear between), through the gain of statics.
    """
    gain = RADIUS * ANALOG / (ANALOG + discrete + HAND)
    return 1.5 * SIGMA**2 * TICK_S * gain**2 / span_s


@pytest.mark.parametrize("kind", ["ideal", "linear"])
@pytest.mark.parametrize(
    ("computer", "discrete", "bound"),
    [
        # what a mean over 1e5 s lacks at its ends is some 0.1 s of it
        ({"method": "continuous", "discrete_stiffness_n_per_m": 0.0}, 0.0, 1e-5),
        # the computer folds 100 Hz to rest: the damper's 628 N/m on 0.4 kg, (628/1.6e5/0.13)^2 of the density
        ({}, DISCRETE, 3e-3),
    ],
    ids=["circuit alone", "sampled"],
)
def test_means_over_long_times_have_the_variance_of_statics(tmp_path, kind, computer, discrete, bound):
    scene = scene_of(tmp_path, merge(slider(**HELD), {"computer": computer}))
    contact = at_wall(scene, circuit_of_kind(kind))
    at_rest = contact.at(resting_pose(contact))
    made = noise_of_means(at_rest, ("penetration", "motor_normal", "operator_force"), 100.0, 1e5)
    push = np.array([1.0, -HAND, 0.0, -HAND])  # in balance with the hand, whose force is along y
    push[3] *= -1.0 if made.covariance[0, 3] > 0.0 else 1.0
    exact = variance(1e5, discrete) * np.outer(push, push)
    assert np.allclose(made.covariance, exact, rtol=bound, atol=bound * np.abs(exact).max())
    assert made.notes == ()


def test_means_over_short_times_scatter_as_their_samples_do(tmp_path):
    """One second, ten times what noise is remembered: the sum of the depth's correlations at 100 samples.

    A mean over time is not quite one of samples: the depth moves between two by a hundredth of its scatter.
    """
    contact = at_wall(scene_of(tmp_path, slider(**HELD)), circuit_of_kind("linear"))
    exact = noise_covariance(contact)
    row, seen, lags = exact.rows["penetration"][0], exact.state, []
    for _ in range(100):
        lags.append(row @ seen @ row)
        seen = exact.step @ seen
    summed = lags[0] + 2.0 * sum(lag * (1.0 - k / 100) for k, lag in enumerate(lags[1:], 1))
    made = noise_of_means(contact.at(resting_pose(contact)), ("penetration",), 100.0, 1.0)
    assert made.covariance[0, 0] == pytest.approx(summed / 100, rel=2e-3)


def test_an_offset_that_stays_moves_means_as_statics_say(tmp_path):
    scene = scene_of(tmp_path, merge(slider(**HELD), {"effects": {"pot_noise": "static"}}))
    contact = at_wall(scene, ideal(1))
    made = noise_of_means(contact.at(resting_pose(contact)), ("penetration",), 1.0, 1.0)
    gain = RADIUS * ANALOG / (ANALOG + DISCRETE + HAND)
    assert made.covariance[0, 0] == pytest.approx((SIGMA * gain) ** 2, rel=1e-8)


#: A start with speed into the wall, held by a soft hand: contact is lost once.
BOUNCES = {
    "device": {"start": {"q_rad": [0.2], "v_rad_per_s": [-6.0]}},
    "operator": {"damping_n_s_per_m": 1.5, "waypoints_s_m": [[0.0, 0.0, -0.03]]},
}


def held_run(folder, *more):
    tables = merge(slider(**HELD), {"duration_s": 30.0, "solver": {"model": "ideal"}})
    for each in more:
        tables = merge(tables, each)
    plan = resolve(scene_of(folder, tables))
    with collected(forward=False):
        child = shared_child()
        return run(plan, folder / "r", formats=(), child=child, errors=estimator(plan, child))


def test_a_noisy_run_says_how_far_other_paths_lie(tmp_path):
    """The last fifth is 6 s: its ends, of some 0.1 s, change the variance by some hundredths."""
    result = held_run(tmp_path)
    rows = result.measures
    half = QUANTILE * math.sqrt(variance(6.0))
    assert rows["steady_penetration"]["noise"] == pytest.approx(half, rel=0.05)
    assert rows["steady_normal_force"]["noise"] == pytest.approx(HAND * half, rel=0.05)
    depth = rows["steady_penetration"]["value"]
    slope = (HAND + rows["rendered_stiffness"]["value"]) / depth  # of force over depth, both moved by noise
    assert rows["rendered_stiffness"]["noise"] == pytest.approx(slope * half, rel=0.05)
    for name in ("peak_force", "max_penetration", "heat", "force_ripple", "peak_current"):
        assert 0.0 < rows[name]["noise"] < rows[name]["value"], name
    assert rows["contact_share"]["noise"] == 0.0
    assert rows["dac_saturations"]["noise"] is None
    assert "no output" in rows["dac_saturations"]["no_noise"]
    printed = "\n".join(_estimated([(Variant((), (), ""), tmp_path, result)]))
    assert "95 % of all paths" in printed
    assert "dac_saturations" in printed


def test_the_size_of_a_force_about_zero_has_no_interval(tmp_path):
    """The wall of press pushes along its normal: the tangential force is less than what noise makes of it."""
    plan = resolve(load_scene(SCENES / "press.toml", ["solver.model=linear", "effects.pot_noise=white"]))
    with collected(forward=False):
        child = shared_child()
        rows = run(plan, tmp_path / "r", formats=(), child=child, errors=estimator(plan, child)).measures
    assert abs(rows["steady_tangential_force"]["value"]) < 2.0 * rows["steady_tangential_force"]["noise"]
    assert rows["rendered_stiffness"]["noise"] > 0.0
    assert rows["tangential_ratio"]["noise"] is None
    assert "corner" in rows["tangential_ratio"]["no_noise"]


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"effects": {"coulomb": True}, "device": {"slider": {"coulomb_n_m": 1e-3}}}, "Coulomb friction"),
        ({"operator": {"waypoints_s_m": [[0.0, 0.0, -0.02], [14.0, 0.0, -0.06]]}}, "does not rest"),
        ({"operator": {"waypoints_s_m": [[0.0, 0.0, -0.0005]]},
          "device": {"start": {"q_rad": [-0.01]}, "potentiometer": {"noise_rad": 0.004}}}, "leaves the wall"),
    ],
    ids=["friction", "moving", "shallow"],
)  # fmt: skip
def test_where_it_is_not_linear_there_is_no_interval(tmp_path, more, why):
    rows = held_run(tmp_path, {"duration_s": 10.0}, more).measures
    steady = [rows[name] for name in STEADY if name in rows]
    assert all(row["noise"] is None and row["no_noise"] for row in steady)
    assert not steady or why in steady[0]["no_noise"]
    assert rows["peak_force"]["noise"] is None
    assert rows["peak_force"]["no_noise"]


def test_a_run_without_noise_speaks_of_none(tmp_path):
    rows = held_run(tmp_path, {"effects": {"pot_noise": "none"}, "duration_s": 2.0}).measures
    assert not any("noise" in row or "no_noise" in row for row in rows.values())


def test_a_contact_lost_and_made_again_is_not_drawn(tmp_path):
    """The carriage bounces off the wall once and comes to rest: only the last fifth is linear."""
    rows = held_run(tmp_path, {"duration_s": 10.0}, BOUNCES).measures
    assert 0.0 < rows["contact_share"]["value"] < 1.0
    assert rows["force_ripple"]["noise"] > 0.0
    for name in ("peak_force", "heat", "contact_share"):
        assert rows[name]["noise"] is None
        assert "made again" in rows[name]["no_noise"]


#: Of what is drawn, besides the means: each has a distribution of its own.
DRAWN = ("peak_force", "peak_normal_force", "peak_current", "max_penetration", "heat", "mean_normal_force",
         "force_ripple")  # fmt: skip


@pytest.mark.slow
def test_in_95_of_100_runs_the_interval_holds_the_mean_over_paths():
    """A thousand paths of press; their own mean stands for the true one, and widens the scatter by 1/2000.

    The intervals are those of every 25th path, for the 25 from there on: from path to path they differ by
    what the slopes of the means do.
    """
    scene = load_scene(SCENES / "press.toml", ["solver.model=linear", "effects.pot_noise=white"])
    plan = resolve(scene)
    values: dict[str, list[float]] = {}
    halves: dict[str, list[float]] = {}
    for seed in range(1000):
        seeded = resolve(scene.model_copy(update={"seed": seed}), board=plan.board)
        with collected(forward=False):
            measures, contacts = measures_of(seeded, shared_child())
        if seed % 25 == 0:
            intervals = noise_of(measures, seeded, None, contacts, shared_child())
        for key in (*STEADY, *DRAWN):
            values.setdefault(key, []).append(measures[key]["value"])
            halves.setdefault(key, []).append(intervals[key]["noise"])
    shares = {
        key: float(np.mean(np.abs(np.array(each) - np.mean(each)) <= np.array(halves[key])))
        for key, each in values.items()
    }
    assert all(0.93 <= share <= 0.97 for share in shares.values()), shares
