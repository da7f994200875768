"""Kinematics against finite differences, closed forms and the numbers derived from the paper."""

import math

import numpy as np
import pytest

from mech import Chain, ParameterError, Slider

TWO = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1)
# Rounding of a few products of numbers near one, for quantities of order one.
ROUND = 1e-14


def joint_stiffness(linkage, q, stiffness):
    """Return J^T K J of a tip stiffness K [N/m]: N m/rad."""
    jac = linkage.jacobian(q)
    return jac.T @ np.asarray(stiffness) @ jac


def chain(n: int) -> Chain:
    return Chain(
        lengths_m=[0.1 + 0.02 * i for i in range(n)],
        masses_kg=0.1,
        origin_m=(0.03, -0.02),
        rotor_inertia_kg_m2=1e-6,
    )


def central(function, x, step=1e-6):
    """Central differences: truncation step^2/6 ~ 2e-13, rounding eps/step ~ 1e-10, per metre of reach."""
    columns = []
    for i in range(len(x)):
        shift = np.zeros(len(x))
        shift[i] = step
        columns.append((function(x + shift) - function(x - shift)) / (2 * step))
    return np.array(columns).T


@pytest.mark.parametrize("n", range(1, 7))
def test_jacobian_is_the_derivative_of_the_fingertip(n):
    # Claim A1 of the paper's equation (1).
    rng = np.random.default_rng(n)
    linkage = chain(n)
    for _ in range(20):
        q, v = rng.uniform(-3, 3, n), rng.normal(size=n)
        jac = linkage.jacobian(q)
        assert np.max(np.abs(jac - central(linkage.forward, q))) < 1e-8
        np.testing.assert_allclose(linkage.tip_velocity(q, v), jac @ v, atol=ROUND)


def test_two_link_fingertip_in_relative_angles():
    q = (0.6, 1.1)
    expected = (0.1 * math.cos(0.6) + 0.1 * math.cos(1.7), 0.1 * math.sin(0.6) + 0.1 * math.sin(1.7))
    np.testing.assert_allclose(TWO.forward(q), expected, atol=ROUND)


def test_congruence_transformation_has_the_published_numbers():
    # Chen and Kao's K_theta = J^T K J + K_g(F) with F applied TO the tip; eight printed digits.
    q, force, stiffness = (0.6, 1.1), (1.0, -2.0), np.diag((0.0, 100.0))
    half = 0.5e-8
    expected = [[-0.15563073, -0.09916648], [0.06964911, -0.01288445]]
    np.testing.assert_allclose(TWO.jacobian(q), expected, atol=half)
    joint = [[0.48509988, -0.08973905], [-0.08973905, 0.0166009]]
    np.testing.assert_allclose(joint_stiffness(TWO, q, stiffness), joint, atol=half)
    geometric = [[0.24161234, 0.21121741], [0.21121741, 0.21121741]]
    np.testing.assert_allclose(TWO.geometric_stiffness(q, force), geometric, atol=half)


@pytest.mark.parametrize("n", range(1, 7))
def test_congruence_transformation_is_the_derivative_of_the_torque(n):
    # tau = J^T(q) F(q) with F = K (r(q) - r0): its derivative is J^T K J + K_g(F).
    rng = np.random.default_rng(n)
    linkage = chain(n)
    q, rest = rng.uniform(-2, 2, n), rng.uniform(-0.1, 0.1, 2)
    stiffness = np.array([[90.0, 20.0], [20.0, 60.0]])

    def torque(angles):
        return linkage.jacobian(angles).T @ stiffness @ (linkage.forward(angles) - rest)

    total = joint_stiffness(linkage, q, stiffness)
    total += linkage.geometric_stiffness(q, stiffness @ (linkage.forward(q) - rest))
    # Central differences of torques of order 20 N m: 20 eps / 1e-6.
    np.testing.assert_allclose(total, central(torque, q), atol=1e-8)


@pytest.mark.parametrize(
    ("q_d", "through_touch", "diagonal"), [((0.6, 1.1), 0.024, 0.95), ((1.0, 1.6), -0.010, -0.13)]
)
def test_drag_along_the_wall_of_fig_18(q_d, through_touch, diagonal):
    # 45 degree wall, k = 100 N/m, 7.5 mm sink: F_t/F_n for joint gains built in three ways.
    normal = np.array((-1.0, 1.0)) / math.sqrt(2.0)
    along = np.array((normal[1], -normal[0]))
    stiffness = 100.0 * np.outer(normal, normal)
    q = TWO.inverse(TWO.forward(q_d) - 0.0075 * normal)

    def drag(gains):
        force = np.linalg.solve(TWO.jacobian(q).T, gains @ (np.asarray(q_d) - q))
        return force @ along / (force @ normal)

    coupled = joint_stiffness(TWO, q, stiffness)
    assert abs(drag(coupled)) < 1e-12  # J^-T J^T with a condition number of about 3
    # Expected values are printed with two digits, three decimals.
    assert drag(joint_stiffness(TWO, q_d, stiffness)) == pytest.approx(through_touch, abs=6e-4)
    assert drag(np.diag(np.diag(coupled))) == pytest.approx(diagonal, abs=6e-3)


@pytest.mark.parametrize("elbow", [1, -1])
def test_inverse_returns_to_the_pose_with_either_elbow(elbow):
    rng = np.random.default_rng(7)
    linkage = chain(2)
    for _ in range(200):
        q = np.array((rng.uniform(-math.pi, math.pi), elbow * rng.uniform(0.02, 3.1)))
        # Angles lose eps/sin(q2) near full stretch and fold, at most 1/0.02.
        result = linkage.inverse(linkage.forward(q), elbow, seed=q)
        np.testing.assert_allclose(result, q, atol=1e-12)
        other = linkage.inverse(linkage.forward(q), -elbow)
        assert np.sign(other[1]) == -elbow
        np.testing.assert_allclose(linkage.forward(other), linkage.forward(q), atol=1e-15)


@pytest.mark.parametrize("n", range(3, 7))
@pytest.mark.parametrize("elbow", [1, -1])
def test_inverse_of_longer_chains_by_search(n, elbow):
    rng = np.random.default_rng(n)
    linkage = chain(n)
    least, most = linkage.reach_m
    for share in (*rng.uniform(0.05, 0.98, 40), 0.999):
        angle = rng.uniform(-math.pi, math.pi)
        target = np.array((0.03, -0.02)) + (least + share * (most - least)) * np.array(
            (math.cos(angle), math.sin(angle))
        )
        result = linkage.inverse(target, elbow)
        np.testing.assert_allclose(linkage.forward(result), target, atol=1e-12)
    pose = rng.uniform(0.2, 0.8, n)
    near = linkage.inverse(linkage.forward(pose), seed=pose + 0.01)
    assert np.max(np.abs(near - pose)) < 0.1  # a search from a pose stays with it


def test_inverse_keeps_whole_turns_of_the_seed():
    seed = np.array((0.6 + 4 * math.pi, 1.1 - 2 * math.pi))
    np.testing.assert_allclose(TWO.inverse(TWO.forward((0.6, 1.1)), seed=seed), seed, atol=1e-13)


def test_full_stretch_is_reached_and_has_infinite_mass_along_itself():
    # Hard case 12: det J = 0.
    direction = np.array((math.cos(0.4), math.sin(0.4)))
    np.testing.assert_allclose(TWO.inverse(0.2 * direction), (0.4, 0.0), atol=1e-7)  # sqrt(eps): a fold
    assert TWO.tip_mass((0.4, 0.0), direction) == math.inf
    across = TWO.tip_mass((0.4, 0.0), (-direction[1], direction[0]))
    lever = TWO.jacobian((0.4, 0.0)).T @ (-direction[1], direction[0])
    assert across == pytest.approx(1 / (lever @ np.linalg.solve(TWO.mass_matrix((0.4, 0.0)), lever)))
    assert 0 < TWO.tip_mass((0.4, 0.01), direction) < math.inf


@pytest.mark.parametrize(
    ("linkage", "target", "says"),
    [
        (TWO, (0.3, 0.0), "0 to 0.2 m from the origin"),
        (Chain(lengths_m=(0.2, 0.1), masses_kg=0.1), (0.05, 0.0), "0.1 to 0.3 m"),
        (Chain(lengths_m=(0.1,), masses_kg=0.1), (0.2, 0.0), "0.1 m from the origin"),
        (Chain(lengths_m=(0.1,) * 4, masses_kg=0.1), (0.5, 0.0), "0 to 0.4 m"),
        (Slider(radius_m=0.01, mass_kg=0.05), (0.1, 0.02), "on the slider's line"),
        (TWO, (math.nan, 0.0), "2 finite numbers"),
        (TWO, (0.1,), "2 finite numbers"),
    ],
)
def test_out_of_reach_is_reported_with_the_reach(linkage, target, says):
    with pytest.raises(ParameterError, match=says) as caught:
        linkage.inverse(target)
    assert caught.value.problems[0].name == "r"


def test_elbow_is_a_sign():
    with pytest.raises(ParameterError, match="elbow = 0"):
        TWO.inverse((0.1, 0.1), elbow=0)


def test_slider_moves_along_its_line():
    linkage = Slider(radius_m=0.02, mass_kg=0.05, direction=(3.0, 4.0), origin_m=(0.1, 0.0))
    np.testing.assert_allclose(linkage.forward((0.5,)), (0.106, 0.008), atol=ROUND)
    np.testing.assert_allclose(linkage.jacobian((0.5,)), [[0.012], [0.016]], atol=ROUND)
    np.testing.assert_allclose(linkage.tip_velocity((0.5,), (2.0,)), (0.024, 0.032), atol=ROUND)
    np.testing.assert_allclose(linkage.inverse((0.106, 0.008)), [0.5], atol=ROUND)
    assert linkage.geometric_stiffness((0.5,), (1.0, 1.0)) == 0.0
    assert linkage.tip_mass((0.5,), (3.0, 4.0)) == pytest.approx(0.05, rel=ROUND)
    assert linkage.tip_mass((0.5,), (-4.0, 3.0)) == math.inf
