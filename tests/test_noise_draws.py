"""Paths of noise that are drawn, against the exact moments of the linear contact, and measures of them."""

import math

import numpy as np
import pytest
from held_scenes import HELD, at_wall, circuit_of_kind
from support import merge, scene_of, slider

from cosim.accuracy.noise_by_drawing import drawn_halves
from cosim.analysis.control_law import resting_pose
from cosim.analysis.noise_covariance import noise_covariance
from cosim.analysis.noise_draws import WEIGHTS, drawn
from cosim.analysis.noise_of_means import noise_of_means
from cosim.errors import InputError

PATHS, BEGIN_S, END_S, LEVEL_A = 2000, 1.0, 8.0, 10.0
OUTPUTS = ("penetration", "operator_normal", "motor_normal", "currents")


def resting(folder, kind="linear", **more):
    contact = at_wall(scene_of(folder, merge(slider(**HELD), more)), circuit_of_kind(kind))
    return contact.at(resting_pose(contact))


def squares(at_rest, end_s=END_S, settled_s=1.0):
    """Time means of the squares of `OUTPUTS` from `settled_s` after contact on, [outputs, paths]."""
    total, length = 0.0, 0.0
    for each in drawn(at_rest, OUTPUTS, BEGIN_S, end_s, PATHS, 7):
        if each.begin_s >= BEGIN_S + settled_s - 1e-9:
            total = total + each.length_s * np.einsum("p,pok->ok", WEIGHTS, each.values**2)
            length += each.length_s
    assert length == pytest.approx(end_s - BEGIN_S - settled_s, abs=1e-9)
    return total / length


@pytest.mark.parametrize("kind", ["ideal", "linear"])
@pytest.mark.parametrize("noise", ["white", "peak_to_peak", "static"])
def test_mean_squares_are_those_of_the_exact_covariance(tmp_path, kind, noise):
    """Mean over 2,000 paths: within four standard errors of the trace that Isserlis gives a square's mean.

    Four nodes know the square of what dies within a tenth of a tick to 2 %.
    """
    at_rest = resting(tmp_path, kind, effects={"pot_noise": noise})
    exact = noise_covariance(at_rest)
    made = squares(at_rest, end_s=3.0)
    for name, row in zip(OUTPUTS, made, strict=True):
        error = 4.0 * row.std() / math.sqrt(PATHS) + 0.02 * exact.mean[name][0, 0]
        assert abs(row.mean() - exact.mean[name][0, 0]) < error, name


def test_mean_squares_scatter_as_isserlis_says(tmp_path):
    """Var of the depth's mean square: 2/T^2 of the integral of the covariance's square over both times.

    The covariance lives for 0.1 s, as long as ten samples: the integral is a sum over samples to a percent.
    """
    at_rest = resting(tmp_path)
    exact = noise_covariance(at_rest)
    row, seen, count = exact.rows["penetration"][0], exact.state, 600
    total = 0.0
    for lag in range(count):
        gamma = float(row @ seen @ row)
        total += (1.0 if lag == 0 else 2.0 * (1.0 - lag / count)) * gamma**2
        seen = exact.step @ seen
    spread = math.sqrt(2.0 * total / count)
    # a standard deviation of 2,000 paths is known to sqrt(1/4000), 1.6 %; thrice that, and the sum's percent
    assert squares(at_rest)[0].std() == pytest.approx(spread, rel=0.06)


def test_noise_moves_nothing_before_contact_and_all_of_its_size_after(tmp_path):
    exact = noise_covariance(at_rest := resting(tmp_path))
    depths = [(each.begin_s, each.values[0, 0]) for each in drawn(at_rest, OUTPUTS, BEGIN_S, 2.0, PATHS, 7)]
    assert depths[0][0] == pytest.approx(BEGIN_S, abs=1e-12)
    assert np.all(depths[0][1] == 0.0)
    assert depths[-1][1].std() == pytest.approx(math.sqrt(exact.at_samples["penetration"][0, 0]), rel=0.1)


def at_depth(at_rest, *, force_n=2.0, depth_m=0.01):
    """A path that has rested since its contact: signals at begin and end are enough."""
    (angle,), n = at_rest.q, 200
    t = np.linspace(0.0, END_S, n)
    level = {"y": -depth_m, "fy": -force_n, "q1": angle, "imot1": LEVEL_A, "time": t}
    return {name: np.zeros(n) + level.get(name, 0.0) for name in ("x", "fx", "fmx", "fmy", *level)}


def test_squares_about_a_level_move_as_isserlis_says(tmp_path):
    """Heat of i0 + i, i0 far above its noise: 2 i0 times the integral of i, whose covariance is exact."""
    at_rest = resting(tmp_path)
    halves = drawn_halves(at_depth(at_rest), at_rest, BEGIN_S)
    mean = noise_of_means(at_rest, ("currents",), 0.0, END_S - BEGIN_S).covariance[0, 0]
    spread = 2.0 * LEVEL_A * (END_S - BEGIN_S) * math.sqrt(mean)
    # a quantile of 95 % of a thousand paths is known to 3 %: twice that
    assert halves["heat"] == pytest.approx(1.96 * spread, rel=0.06)
    assert halves["contact_share"] == 0.0


def test_a_peak_over_rivals_moves_less_than_one_at_its_place(tmp_path):
    """The largest of many rivals scatters less than each: Gumbel's law, s pi/sqrt(12 ln N) of N of them."""
    at_rest = resting(tmp_path)
    exact = noise_covariance(at_rest)
    halves = drawn_halves(at_depth(at_rest), at_rest, BEGIN_S)
    one = math.sqrt(exact.mean["penetration"][0, 0])
    rivals = (END_S - BEGIN_S) / 0.1  # remembered for 0.1 s; N enters by the root of its logarithm
    assert halves["max_penetration"] / 1.96 == pytest.approx(one * math.pi / math.sqrt(12 * math.log(rivals)),
                                                             rel=0.25)  # fmt: skip
    sharp = at_depth(at_rest)
    sharp["y"][100] *= 2.0  # the noise reorders nothing: first order at that instant
    assert drawn_halves(sharp, at_rest, BEGIN_S)["max_penetration"] == pytest.approx(1.96 * one, rel=0.1)


@pytest.mark.parametrize("share", [(1e-4, 0.9), (0.95, 1.0 - 1e-7)], ids=["within", "end"])
def test_a_peak_within_a_stretch_is_seen(tmp_path, share):
    """A pulse between two events, which lie 1/300 s apart: nothing rivals it.

    It scatters as one instant does, the largest of all others by less than half of that. Over the period the
    scatter of forces and currents changes by a quarter, that of the depth hardly.
    """
    at_rest = resting(tmp_path)
    exact = noise_covariance(at_rest)
    level = at_depth(at_rest)
    begin, end = 4.0 + np.array(share) / 300.0
    path = {"time": np.array([0.0, begin, begin + 1e-9, end, end + 1e-9, END_S])}
    path |= {name: level[name][0] * np.array([1, 1, 2, 2, 1, 1]) for name in level.keys() - path.keys()}
    halves = drawn_halves(path, at_rest, BEGIN_S)
    for measure, output, apart in (
        ("max_penetration", "penetration", 0.1), ("peak_normal_force", "operator_normal", 0.3),
        ("peak_force", "operator_normal", 0.3), ("peak_current", "currents", 0.3),
    ):  # fmt: skip
        one = math.sqrt(exact.mean[output][0, 0])
        assert halves[measure] == pytest.approx(1.96 * one, rel=apart), measure


def test_where_paths_leave_the_wall_nothing_is_drawn(tmp_path):
    at_rest = resting(tmp_path)
    depth = 2.0 * math.sqrt(noise_covariance(at_rest).mean["penetration"][0, 0])
    with pytest.raises(InputError, match="leaves the wall"):
        drawn_halves(at_depth(at_rest, depth_m=depth), at_rest, BEGIN_S)
