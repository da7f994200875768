"""Exact noise: against Lyapunov's equation, closed forms, and sampled runs of the same scene."""

import math
import warnings

import numpy as np
import pytest
from held_scenes import HELD, LATE, RADIUS, SLOW, at_wall, circuit_of_kind
from linear_runs import CONSTANTS, ideal, lagging, propagate, rows, samples
from scipy.linalg import solve_continuous_lyapunov
from scipy.stats import chi2
from support import COMMAND_TRUE, SCENES, SPRING_TRUE, V_NM, at_times, merge, quick, scene_of, slider

from cosim.analysis.control_law import _by_newton, law_point
from cosim.analysis.covariance_steps import (
    exact_step,
    integral,
    repeated,
    stationary,
    summed,
    white_covariance,
)
from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact, touching
from cosim.analysis.linearise import linearise
from cosim.analysis.noise_covariance import NoiseCovariance, noise_covariance
from cosim.analysis.noise_period import noise_grid
from cosim.analysis.period_map import lift
from cosim.errors import InputError
from cosim.loop.computer import COMPUTER, SAMPLE, law, to_volts
from cosim.loop.noise import potentiometer_noise
from cosim.loop.setup import computer_record
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.scene.mechanism import mechanism


def held(folder, *more):
    tables = slider(**HELD)
    for each in more:
        tables = merge(tables, each)
    return scene_of(folder, tables)


# ---- building blocks


def test_stiff_white_covariance_is_lyapunovs():
    """Hard case 5: poles of 1e9 and 1e-1 rad/s over 0.1 s; Van Loan's block would need exp(1e8).

    The modes are independent but for the noise they share, so P_ij = (1 - e^(-(a_i + a_j) h))/(a_i + a_j).
    The turn of the states mixes values of 1e-9 and 1: each is right to rounding of the largest.
    """
    poles, b = np.array([0.1, 3.0, 1e4, 1e9]), np.ones((4, 1))
    h = 0.1
    p = white_covariance(-np.diag(poles), b, np.eye(1), h)
    pairs = poles[:, None] + poles
    assert np.allclose(p, -np.expm1(-pairs * h) / pairs, rtol=1e-11, atol=0.0)
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((4, 4)))[0]
    turned = white_covariance(-turn @ np.diag(poles) @ turn.T, turn @ b, np.eye(1), h)
    assert np.array_equal(turned, turned.T)
    assert np.linalg.eigvalsh(turned)[0] > -1e-15 * np.linalg.norm(turned)
    # a matrix of norm 1e9 states its pole of 0.1 rad/s to 1e9 x 1e-16 only: 1e-6 of it
    assert np.allclose(turn.T @ turned @ turn, p, rtol=0.0, atol=1e-6 * np.abs(p).max())


def test_van_loans_block_fails_where_ours_does_not():
    from scipy.linalg import expm

    block = np.array([[1e5, 1.0], [0.0, -1e5]]) * 0.1
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        assert not np.isfinite(expm(block)).all()
    assert white_covariance(-1e5 * np.eye(1), np.eye(1), np.eye(1), 0.1)[0, 0] == pytest.approx(
        5e-6, rel=1e-12
    )


@pytest.mark.parametrize("ohm", [1.0, 1e3, 1e6, 1e12])
@pytest.mark.parametrize("time_s", [1e4, math.inf])
def test_kt_over_c_for_any_resistor(ohm, time_s):
    """Hard case 9: 1 nF at 300 K, 2.035 uV; from 1 ns to 1000 s of time constant."""
    k, c, temperature = 1.380649e-23, 1e-9, 300.0
    p = white_covariance(
        np.array([[-1 / (ohm * c)]]), np.array([[1 / c]]), np.array([[2 * k * temperature / ohm]]), time_s
    )
    exact = k * temperature / c * -math.expm1(-2.0 * time_s / (ohm * c))
    assert p[0, 0] == pytest.approx(exact, rel=1e-11)
    assert math.sqrt(p[0, 0]) == pytest.approx(2.035e-6, rel=2e-4)


def test_the_stationary_covariance_of_coupled_modes_is_lyapunovs():
    """A damped two-mass chain with a fast pole, against scipy's solver (Bartels and Stewart)."""
    a = np.array(
        [[0, 1, 0, 0, 0], [-4, -0.3, 4, 0, 1], [0, 0, 0, 1, 0], [4, 0, -8, -0.1, 0], [0, 0, 0, 0, -1e6]]
    )
    b = np.array([[0.0], [0.0], [0.0], [0.0], [1e6]])
    ours = white_covariance(a, b, np.eye(1), math.inf)
    assert np.allclose(ours, solve_continuous_lyapunov(a, -b @ b.T), rtol=1e-8, atol=1e-9)


def test_sums_by_doubling_are_sums():
    generator = np.random.default_rng(2)
    s, q, p = 0.5 * generator.standard_normal((3, 3)), np.diag([1.0, 2.0, 0.0]), np.eye(3)
    for count in (1, 2, 3, 7, 12):
        cover, sums, at, plain = np.zeros((3, 3)), np.zeros((3, 3)), p.copy(), np.zeros((3, 3))
        for _ in range(count):
            sums, cover = sums + cover, s @ cover @ s.T + q
            plain, at = plain + at, s @ at @ s.T
        result, ours, our_sums = repeated(s, q, count)
        assert np.allclose(result, np.linalg.matrix_power(s, count), rtol=1e-12, atol=1e-14)
        assert np.allclose(ours, cover, rtol=1e-12, atol=1e-14)
        assert np.allclose(our_sums, sums, rtol=1e-12, atol=1e-14)
        assert np.allclose(summed(s, p, count), plain, rtol=1e-12, atol=1e-14)


def test_the_integral_over_a_ramp():
    """x' = -a x + i with a ramp i = r t from rest: x = r (a t - 1 + e^(-a t))/a^2, its square integrated."""
    a, h, r = 1e3, 0.02, 3.0
    start = np.zeros((3, 3))
    start[2, 2] = r**2
    total = integral(-a * np.eye(1), np.eye(1), np.zeros((1, 1)), h, start)
    t = np.linspace(0.0, h, 200_001)
    x = r * (a * t - 1 + np.exp(-a * t)) / a**2
    # trapezoid of 1e5 points a time constant of the whole: h^2/12 of the curvature, 1e-9
    assert total[0, 0] == pytest.approx(np.trapezoid(x**2, t), rel=1e-8)
    step = exact_step(-a * np.eye(1), np.eye(1), np.zeros((1, 1)), h)
    assert step[0, 2] == pytest.approx((a * h - 1 + math.exp(-a * h)) / a**2, rel=1e-13)


def test_an_unstable_map_has_no_covariance():
    with pytest.raises(ValueError, match="not stable"):
        stationary(np.array([[1.0]]), np.eye(1))
    with pytest.raises(ValueError, match="not stable"):
        white_covariance(np.zeros((1, 1)), np.eye(1), np.eye(1), math.inf)


# ---- the law's slopes


@pytest.mark.parametrize(
    ("method", "path"), [("combined", "u"), ("combined", "cmd"), ("joint_pd", "cmd"), ("discrete", "cmd")]
)
def test_the_laws_slopes_are_those_of_the_compiled_law(tmp_path, method, path):
    """Differences of what the computer of a run writes, at a pose 8 mm inside a slanted wall."""
    discrete, analog = (0 if method == other else 1 for other in ("joint_pd", "discrete"))
    scene = load_scene(
        SCENES / "slope.toml",
        [
            f"computer.method={method}", f"computer.command_path={path}", "effects.dac=false",
            f"computer.discrete_stiffness_n_per_m={133 * discrete}",
            f"computer.discrete_damping_n_s_per_m={2 * discrete}",
            f"computer.analog_stiffness_n_per_m={100 * analog}",
            f"computer.analog_damping_n_s_per_m={1.5 * analog}",
        ],
    )  # fmt: skip
    linkage = mechanism(scene, CONSTANTS.gear)
    c, x = np.zeros(1, COMPUTER), np.zeros(1, SAMPLE)
    c[0] = computer_record(scene, CONSTANTS)
    p = linkage.pack()

    def volts(q, v):
        x["q"][0, :2], x["v"][0, :2] = q, v
        law(c[0], p[0], x[0])
        out = np.zeros(12)
        to_volts(c[0], x[0], out)
        assert x["contact"][0] == 1
        return out

    q = np.asarray(linkage.inverse(np.array([0.07, 0.155]) + 0.008 * np.array([1, -1]) / math.sqrt(2.0)))
    point = law_point(scene, CONSTANTS, linkage, q)
    assert np.allclose(point.volts, volts(q, np.zeros(2)), rtol=1e-9, atol=1e-12)
    h = 1e-4  # central differences: error h^2/6 of third derivatives of order one, and 1e-9 m / h of Newton's
    for j in range(2):
        step = h * np.eye(2)[j]
        slope = (volts(q + step, np.zeros(2)) - volts(q - step, np.zeros(2))) / (2 * h)
        assert np.allclose(point.by_angle[:, j], slope, rtol=1e-5, atol=1e-5)
        slope = (volts(q, step) - volts(q, -step)) / (2 * h)
        assert np.allclose(point.by_speed[:, j], slope, rtol=1e-9, atol=1e-9)


# ---- scenes


@pytest.mark.parametrize("kind", ["ideal", "linear"])
@pytest.mark.parametrize(
    "more", [{}, LATE, SLOW], ids=["plain", "delay, settling, skew", "settling > period"]
)
def test_sampled_runs_agree_within_their_interval(tmp_path, kind, more):
    """Variance of the depth at 57,000 samples in contact, seeds 1 to 3: 99.9 % interval of chi-square.

    Correlated samples count by their exact autocovariance: some 20,000 to 36,000 independent ones.
    """
    circuit = circuit_of_kind(kind)
    squares = count = 0.0
    for seed in (1, 2, 3):
        scene = held(tmp_path, more, {"seed": seed, "duration_s": 190.0})
        exact = noise_covariance(at_wall(scene, circuit))
        made = propagate(scene, circuit, rows=False)
        depth = samples(made, "pen")[200 :: exact.periods]  # the start's transient is gone after 1 s
        assert samples(made, "contact")[200:].all()
        squares += float(np.sum((depth + RADIUS * exact.q[0]) ** 2))
        count += len(depth)
    freedom = exact.freedom("penetration", int(count))
    low, high = chi2.ppf([0.0005, 0.9995], freedom) / freedom
    assert freedom > 2000
    assert low < squares / count / exact.at_samples["penetration"][0, 0] < high


def test_the_arm_agrees_with_its_sampled_run():
    """Two links, gains that change with the pose, preload: linear for angles of half a milliradian.

    What that leaves out is of second order, (0.006 rad)^2 beside 0.006 rad, 0.6 %; the interval is 99.9 %.
    """
    scene = load_scene(
        SCENES / "press.toml",
        [
            "solver.model=linear", "effects.pot_noise=white", "effects.encoder=false", "effects.dac=false",
            "duration_s=400.0", "seed=4", "computer.method=combined",
            "computer.discrete_stiffness_n_per_m=20",
        ],
    )  # fmt: skip
    circuit = lagging(ideal(2), 2e3, 3e3)
    exact = noise_covariance(at_wall(scene, circuit))
    made = propagate(scene, circuit, rows=False)
    depth = samples(made, "pen")[120:]
    freedom = exact.freedom("penetration", len(depth))
    low, high = chi2.ppf([0.0005, 0.9995], freedom - 1.0) / freedom
    assert freedom > 1000
    ratio = float(depth.var()) / exact.at_samples["penetration"][0, 0]
    assert 0.994 * low < ratio < 1.006 * high
    assert depth.mean() == pytest.approx(_depth(scene, exact.q), abs=5e-3 * depth.mean())


def _depth(scene, q):
    tip = mechanism(scene, CONSTANTS.gear).forward(q)
    return float(np.array(scene.wall.normal) @ (np.array(scene.wall.point_m) - tip))


@pytest.mark.parametrize("kind", ["ideal", "linear"])
def test_time_averages_agree_with_a_recorded_run(tmp_path, kind):
    """Current of the motor over 40 s: 12,000 values of the noise, its variance known to 1.3 % (one sigma)."""
    circuit = circuit_of_kind(kind)
    scene = held(tmp_path, {"seed": 5, "duration_s": 40.0, "solver": {"max_step_s": 5e-4}})
    exact = noise_covariance(at_wall(scene, circuit))
    made = propagate(scene, circuit)
    t, current = rows(made, "time"), rows(made, "imot1")
    late = t > 1.0
    t, y = t[late], current[late]
    rest = np.trapezoid(y, t) / (t[-1] - t[0])
    y = y - rest
    # signals are all but straight between points of 0.5 ms; at a tick the ideal damper's step is a jump, and
    # the point shows its left side
    mean = np.sum(np.diff(t) * (y[1:] ** 2 + y[1:] * y[:-1] + y[:-1] ** 2) / 3.0) / (t[-1] - t[0])
    assert math.sqrt(mean) == pytest.approx(exact.rms("currents"), rel=0.03)


def test_white_noise_through_a_continuous_contact_is_lyapunovs(tmp_path):
    """Hard case 10: ticks ever closer at the same density. No computer acts; the rest is one linear system.

    Interpolated ticks of variance 1.5 s^2, 1/(2 B) apart, have the density 0.75 s^2/B at low frequencies, and
    sinc^4 above: what is lost of a band f shrinks as (f/B)^2.
    """
    still = {
        "computer": {
            "method": "continuous",
            "discrete_stiffness_n_per_m": 0.0,
            "analog_damping_n_s_per_m": 0.0,
        }
    }
    circuit = lagging(ideal(1), 2e3, 3e3)
    density, result = 1e-8, []
    for hz in (1e2, 1e3, 1e4, 1e6):
        rms = math.sqrt(density * hz / 0.75)
        scene = held(
            tmp_path, still, {"device": {"potentiometer": {"noise_rad": rms, "noise_bandwidth_hz": hz}}}
        )
        exact = noise_covariance(at_wall(scene, circuit))
        result.append(exact.mean["penetration"][0, 0])
    system = linearise(HeldContact(scene, CONSTANTS, circuit, exact.q))
    p = solve_continuous_lyapunov(system.a, -density * system.b[:, -1:] @ system.b[:, -1:].T)
    off = np.abs(np.array(result) / (RADIUS**2 * p[0, 0]) - 1.0)
    assert off[0] > off[1] > off[2]
    assert off[2] < 1e-5
    assert off[3] < 1e-8  # 20,000 ticks a period, and nothing lost in their sum


def test_poles_of_a_gigahertz_cost_no_accuracy(tmp_path):
    """A circuit whose poles lie at 1e9 rad/s is the ideal one: delays of 1 ns beside 10 ms.

    Without the damper, whose ideal form differentiates the noise's steps.
    """
    more = {"computer": {"analog_damping_n_s_per_m": 0.0}}
    scene = held(tmp_path, more)
    slow, fast = (
        noise_covariance(at_wall(scene, circuit)) for circuit in (ideal(1), lagging(ideal(1), 1e9, 1e9))
    )
    for name in ("penetration", "motor_normal", "operator_normal"):
        assert fast.rms(name) == pytest.approx(slow.rms(name), rel=1e-6)
    assert np.isfinite(fast.state).all()
    assert np.array_equal(fast.state, fast.state.T)
    assert np.linalg.eigvalsh(fast.state)[0] > -1e-12 * np.linalg.norm(fast.state)


def test_peak_to_peak_is_a_twelfth(tmp_path):
    """Uniform over w at the ticks: w^2/12, where white of rms s has 1.5 s^2."""
    circuit = circuit_of_kind("linear")
    white = noise_covariance(at_wall(held(tmp_path), circuit))
    uniform = noise_covariance(at_wall(held(tmp_path, {"effects": {"pot_noise": "peak_to_peak"}}), circuit))
    for name in white.mean:
        assert uniform.rms(name) == pytest.approx(white.rms(name) / math.sqrt(18.0), rel=1e-12)


def test_a_static_offset_moves_the_rest_as_statics_say(tmp_path):
    """The hand of 100 N/m and the computer's spring, which reads encoders, hold against the circuit's."""
    scene = held(tmp_path, {"effects": {"pot_noise": "static"}})
    exact = noise_covariance(at_wall(scene, ideal(1)))
    analog = 100.0 * SPRING_TRUE / CONSTANTS.k_fs
    discrete = 80.0 * COMMAND_TRUE * V_NM
    share = analog / (analog + discrete + 100.0)
    assert exact.rms("angles") == pytest.approx(0.003 * share, rel=1e-9)
    force = 0.003 * RADIUS * analog - 0.003 * RADIUS * share * (analog + discrete)
    assert exact.rms("motor_normal") == pytest.approx(abs(force), rel=1e-9)
    # and a run rests where its draw says
    run = propagate(held(tmp_path, {"effects": {"pot_noise": "static"}, "duration_s": 20.0}), ideal(1))
    drawn = potentiometer_noise("static", 1, 3, 1.0, 0.003, 1.0, 1.0, 1.0).table[0, 0]
    assert rows(run, "q1")[-1] - exact.q[0] == pytest.approx(-share * drawn, rel=1e-7)


def test_the_transient_grows_to_the_stationary(tmp_path):
    exact = noise_covariance(at_wall(held(tmp_path), ideal(1)))
    growing = exact.transient("penetration", 400)
    assert growing[0] < 0.5 * growing[-1]
    assert growing[-1] == pytest.approx(math.sqrt(exact.at_samples["penetration"][0, 0]), rel=1e-9)


def test_samples_and_ticks_that_never_meet_are_brought_together(tmp_path):
    scene = held(tmp_path, {"device": {"potentiometer": {"noise_bandwidth_hz": 123.4567}}})
    grid = noise_grid(scene)
    assert grid.periods <= 64
    assert 0.0 < grid.shift < 1e-3
    exact = noise_covariance(at_wall(scene, ideal(1)))
    assert any("shifted" in note for note in exact.notes)
    # a neighbour that meets after two periods: the bandwidth enters the rms with its root, at most
    near = held(tmp_path, {"device": {"potentiometer": {"noise_bandwidth_hz": 125.0}}})
    beside = noise_covariance(at_wall(near, ideal(1)))
    assert beside.periods == 2
    assert exact.rms("penetration") == pytest.approx(beside.rms("penetration"), rel=0.02)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"effects": {"pot_noise": "none"}}, "no noise"),
        ({"effects": {"pot_noise": "position"}}, "belongs to the angle"),
        ({"effects": {"coulomb": True}}, "Coulomb"),
        ({"operator": {"waypoints_s_m": [[0.0, 0.0, 0.02]]}}, "out of contact"),
        ({"computer": {"discrete_stiffness_n_per_m": 5e4}}, "no stationary noise"),
    ],
)
def test_why_not(tmp_path, more, words):
    with pytest.raises(InputError, match=words):
        noise_covariance(at_wall(held(tmp_path, more), ideal(1)))


def test_a_shallow_contact_is_reported(tmp_path):
    shallow = held(tmp_path, {"operator": {"waypoints_s_m": [[0.0, 0.0, -1e-4]]}})
    assert any("leaves the wall" in note for note in noise_covariance(at_wall(shallow, ideal(1))).notes)


# ---- the board itself


def test_one_realisation_in_all_three_models(tmp_path):
    """What the potentiometer shows beyond the angle, at every tick, to the rounding of their sum.

    In ngspice the potentiometer shows the predicted angle, and the run knows how far off that ever was.
    """
    tables = merge(slider(**HELD), {"duration_s": 0.1})
    ticks = np.arange(1, 30) / 300.0
    drawn = potentiometer_noise("white", 1, 3, 0.1, 0.003, 150.0, 1.0, 1.0).grid[1:30, 0]
    for model in ("ideal", "linear", "spice"):
        run = quick(tmp_path, tables, f"solver.model={model}")
        seen = at_times(run, ticks, "pot1") - at_times(run, ticks, "q1")
        off = run.stats["defect_max_rad"] if model == "spice" else 1e-15
        assert off < 1e-5  # the pure differentiator makes a jump of the force of every kink of the noise
        assert np.allclose(seen, drawn, rtol=0.0, atol=off)


def test_the_shipped_board_has_the_noise_of_its_resistors(tmp_path):
    """ngspice's gains against the model made by hand from the netlist: 1e-5 of loading between them."""
    scene = held(tmp_path)
    circuit, constants = circuit_of(resolve(scene))
    ours = noise_covariance(HeldContact.at_wall(scene, constants, circuit))
    hand = noise_covariance(at_wall(scene, ideal(1)))
    assert ours.rms("penetration") == pytest.approx(hand.rms("penetration"), rel=1e-3)
    assert lift(linearise(HeldContact(scene, constants, circuit, ours.q))).states == 2


def test_the_motors_force_turns_with_the_arm():
    """F = J^-T tau under preload: to angles alone, against differences of J^-T with the torques held.

    Central differences of 1e-6 rad are right to 1e-9; currents that follow the angles come on top, as told.
    """
    scene = load_scene(SCENES / "press.toml", ["solver.model=linear"])
    q = touching(scene, CONSTANTS) - [0.05, 0.02]  # some millimetres deep
    result = linearise(HeldContact(scene, CONSTANTS, lagging(ideal(2), 2e3, 3e3), q))
    linkage = mechanism(scene, CONSTANTS.gear)
    torque = CONSTANTS.torque_per_amp * result.current_a
    force = lambda at: np.linalg.solve(linkage.jacobian(at).T, torque)  # noqa: E731
    turned = np.column_stack([(force(q + d) - force(q - d)) / 2e-6 for d in 1e-6 * np.eye(2)])
    follows = np.linalg.solve(linkage.jacobian(q).T, CONSTANTS.torque_per_amp * result.outputs["currents"].c)
    assert np.abs(turned).max() > 0.1  # N/rad, of a press of half a newton
    np.testing.assert_allclose(result.outputs["motor_force"].c[:, :2], turned + follows[:, :2], atol=1e-6)


@pytest.mark.parametrize(("keep", "count"), [(0.99, 1000), (0.5, 400), (-0.9, 300)])
def test_freedom_of_a_variance_estimated_from_correlated_values(keep, count):
    """Of values whose correlation is keep^k: 2 / Var(s^2 / sigma^2), here as the sum over all pairs.

    Broken once: with the sum ended at its eleventh term it fails.
    """
    state, step = np.array([[2.0]]), np.array([[keep]])
    one = NoiseCovariance("", np.zeros(1), {}, {}, step, state, state, {"x": np.eye(1)}, 1, ())
    pairs = keep ** (2.0 * np.abs(np.subtract.outer(np.arange(count), np.arange(count))))
    # Isserlis: Var(s^2) = 2 sigma^4 / count^2 times the sum of all squared correlations
    assert one.freedom("x", count) == pytest.approx(count**2 / pairs.sum(), rel=1e-7)


def test_a_pose_of_rest_is_reached_by_newton_or_left_to_another_method():
    """A root to rounding; no pose where it does not go straight."""
    bent = _by_newton(lambda q: np.array([q[0] * q[1] - 2.0, q[0] - q[1] + 1.0]), np.array([0.8, 1.7]))
    assert bent == pytest.approx([1.0, 2.0], abs=1e-14)
    assert _by_newton(lambda q: q**2 + 1.0, np.array([0.3])) is None
    assert _by_newton(lambda q: 0.0 * q + 1.0, np.array([0.3])) is None
    assert _by_newton(np.sin, np.array([1.9])) is None  # it would end four half turns away
