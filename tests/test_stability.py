"""Exact sampled stability against closed forms, the paper's limits, and runs on their border."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from held_scenes import HELD, LATE, RADIUS, SLOW, at_wall, carriage, circuit_of_kind
from linear_runs import CONSTANTS, ideal, lagging, propagate, rows, samples
from scipy.linalg import expm
from support import COMMAND_TRUE, EMF_TRUE, SCENES, SPRING_TRUE, V_NM, Arm, merge, scene_of, slider

from cosim.analysis.control_law import law_point, resting_pose
from cosim.analysis.held_contact import HeldContact, touching, with_computer
from cosim.analysis.linearise import linearise
from cosim.analysis.period_map import lift
from cosim.analysis.stability import border, held, stability
from cosim.cli import main
from cosim.errors import InputError
from cosim.scene import load_scene
from cosim.scene.mechanism import mechanism, operator

#: What the hand-made board renders of what the computer asks: 5e-7 off one.
COMMAND = COMMAND_TRUE * V_NM
SPRING = SPRING_TRUE / CONSTANTS.k_fs


def k_max(scene, circuit=None, key="discrete_stiffness_n_per_m", low=1e-1, high=1e6):
    circuit = ideal(1, emf=False) if circuit is None else circuit
    scale = COMMAND if key.startswith("discrete") else SPRING
    result = border(lambda k: held(at_wall(with_computer(scene, **{key: k}), circuit)), low, high)
    return result.value * scale


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("mass", "viscous", "known"),
    [
        (0.05, 1.4618, (989.0, 599.3, 307.3, 133.0, 76.5, 51.2)),
        (0.20, 1.6069, (1075.6, 647.1, 325.7, 133.0, 68.9, 37.0)),
    ],
)
def test_a_sampled_wall_on_a_mass(tmp_path, mass, viscous, known):
    """k* = b (1 - E)/(tau (1 - E) - T E), to rounding; `known` are published to four digits."""
    for period, value in zip((3e-3, 5e-3, 10e-3, 25e-3, 50e-3, 100e-3), known, strict=True):
        result = k_max(carriage(tmp_path, period, mass, viscous))
        tau, e = mass / viscous, math.exp(-period * viscous / mass)
        assert result == pytest.approx(viscous * (1 - e) / (tau * (1 - e) - period * e), rel=1e-10)
        assert result == pytest.approx(value, abs=0.051)


@pytest.mark.parametrize(("damping", "known"), [(0.002, 133.2), (0.2, 154.0), (2.0, 382.0)])
def test_analog_damping_raises_the_limit(tmp_path, damping, known):
    """Base 133.0 N/m at 25 ms and 0.05 kg."""
    scene = carriage(
        tmp_path, 0.025, 0.05, 1.4618, method="combined", analog_damping_n_s_per_m=damping,
    )  # fmt: skip
    assert k_max(scene) == pytest.approx(known, abs=0.06 if damping < 1 else 0.3)


@pytest.mark.parametrize(("period", "known"), [(0.010, 312.6), (0.025, 148.5), (0.050, 123.3), (0.100, 76.9)])
def test_analog_stiffness_shifts_the_limit(tmp_path, period, known):
    scene = carriage(tmp_path, period, 0.05, 1.4618, method="combined", analog_stiffness_n_per_m=100.0)
    assert k_max(scene) == pytest.approx(known, abs=0.06)


def test_gil_and_hulins_device(tmp_path):
    """m = b = 0.1, T = 1 ms: 200.03; with a damper of 1 N s/m from the backward difference 2178."""
    assert k_max(carriage(tmp_path, 1e-3, 0.1, 0.1)) == pytest.approx(200.03, abs=0.006)
    damped = carriage(tmp_path, 1e-3, 0.1, 0.1, discrete_damping_n_s_per_m=1.0)
    assert k_max(damped) == pytest.approx(2178.0, abs=0.6)


@pytest.mark.parametrize(("period", "growth"), [(3e-3, 1.002247), (0.1, 2.449490)])
def test_hard_case_21_growth_of_an_undamped_sampled_spring(tmp_path, period, growth):
    scene = carriage(tmp_path, period, 1.0, 0.0, discrete_stiffness_n_per_m=1000.0 / COMMAND)
    result = stability(held(at_wall(scene, ideal(1, emf=False))))
    exact = math.sqrt(1.0 + 1000.0 * period**2 / 2.0)
    assert exact == pytest.approx(growth, abs=6e-7)
    assert result.critical.growth == pytest.approx(exact, rel=1e-12)
    assert not result.stable


@pytest.mark.parametrize(("period", "critical"), [(3e-3, 1.49888), (0.1, 28.7841)])
def test_hard_case_22_the_verdict_flips_at_a_millionth(tmp_path, period, critical):
    def system(viscous):
        scene = carriage(tmp_path, period, 1.0, viscous, discrete_stiffness_n_per_m=1000.0 / COMMAND)
        return held(at_wall(scene, ideal(1, emf=False)))

    result = border(lambda b: system(b), 0.1, 300.0)
    assert result.from_value == pytest.approx(critical, rel=4e-6)
    assert stability(system(result.from_value * (1 + 1e-6))).stable
    assert not stability(system(result.from_value * (1 - 1e-6))).stable


def test_hard_case_36_a_run_on_its_border_grows_as_the_eigenvalue(tmp_path):
    """1e4 periods, 0.1 % beyond the border: log growth a period from the envelope's two ends, to 1e-6."""
    base = carriage(tmp_path, 0.01, 0.2, 1.6069)
    edge = k_max(base) / COMMAND
    for share in (1.0, 1.001):
        push = -share * edge * COMMAND * 10.0 * RADIUS  # so that it rests 1.3 m deep, and swings by 1.3 mm
        scene = slider(
                duration_s=100.0,
                computer={
                    "period_s": 0.01, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
                    "discrete_stiffness_n_per_m": share * edge,
                },
                device={
                    "slider": {"mass_kg": 0.2, "viscous_n_m_s": 1.6069 * RADIUS**2},
                    "start": {"q_rad": [-10.01]},
                },
                operator={"type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0,
                          "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, push]]},
                effects={"viscous": True},
            )  # fmt: skip
        loaded = scene_of(tmp_path, scene)
        made = propagate(loaded, ideal(1, emf=False), rows=False)
        swing = samples(made, "pen") - 10.0 * RADIUS
        mode = stability(held(at_wall(loaded, ideal(1, emf=False)))).critical
        # a mode of two components: its amplitude from two samples each
        turn = np.angle(mode.z)

        def size(k, growth=mode.growth, turn=turn, swing=swing):
            a, b = swing[k], swing[k + 1] / growth
            return math.hypot(a, (b - a * math.cos(turn)) / math.sin(turn))

        grown = (math.log(size(9900)) - math.log(size(100))) / 9800
        assert grown == pytest.approx(math.log(mode.growth), abs=1e-6 * 1e-3 + 1e-9)


@pytest.mark.parametrize("kind", ["ideal", "linear"])
@pytest.mark.parametrize(
    "more", [{}, LATE, SLOW], ids=["plain", "delay, settling, skew", "settling > period"]
)
def test_a_run_obeys_the_characteristic_polynomial(tmp_path, kind, more):
    """Cayley and Hamilton: the map's own polynomial takes every sequence of samples to zero."""
    tables = merge(merge(slider(**HELD), more), {"effects": {"pot_noise": "none"}, "duration_s": 1.5})
    scene, circuit = scene_of(tmp_path, tables), circuit_of_kind(kind)
    made = propagate(scene, circuit, tol=1e-11, rows=False)
    rest = resting_pose(at_wall(scene, circuit))
    depth = samples(made, "pen")[5:] + RADIUS * rest[0]
    z = np.linalg.eigvals(lift(linearise(HeldContact(scene, CONSTANTS, circuit, rest))).period())
    z = z[np.abs(z) > 1e-7]
    # what is left out has died after two samples; the first five are gone anyway
    left = np.convolve(depth, np.poly(z).real)[len(z) : len(depth)]
    assert np.abs(left[:40]).max() < 1e-7 * np.abs(depth).max()


@pytest.mark.parametrize(("hz", "known"), [(100, 1057), (500, 5229), (1000, 10444)])
def test_a_pole_behind_the_multipliers_limits_the_analog_spring(tmp_path, hz, known):
    """m = 0.2, b = 1.66: k < b/tau + b^2/m, whatever the sampling period."""
    lag = lagging(ideal(1, emf=False), 1.0, 2 * math.pi * hz)
    plain = ideal(1, emf=False)
    circuit = replace(lag, a_pre=plain.a_pre, b_pre=plain.b_pre, c_pre=plain.c_pre, d_pre=plain.d_pre)
    scene = carriage(tmp_path, 0.01, 0.2, 1.66, method="continuous", analog_stiffness_n_per_m=1.0,
                     discrete_stiffness_n_per_m=0.0)  # fmt: skip
    result = k_max(scene, circuit, "analog_stiffness_n_per_m", 10.0, 1e6)
    assert result == pytest.approx(1.66 * 2 * math.pi * hz + 1.66**2 / 0.2, rel=1e-9)
    assert result == pytest.approx(known, abs=0.6)


def test_a_pole_before_the_multipliers_does_the_same(tmp_path):
    lag, plain = lagging(ideal(1, emf=False), 2e3 * math.pi, 1.0), ideal(1, emf=False)
    circuit = replace(lag, a_post=plain.a_post, b_post=plain.b_post, c_post=plain.c_post, d_post=plain.d_post)
    scene = carriage(tmp_path, 0.1, 0.05, 1.6625, method="continuous", analog_stiffness_n_per_m=1.0,
                     discrete_stiffness_n_per_m=0.0)  # fmt: skip
    result = k_max(scene, circuit, "analog_stiffness_n_per_m", 10.0, 1e6)
    assert result == pytest.approx(10501, abs=1)


@pytest.mark.parametrize("lag", [0.25, 1.0, 2.6])
def test_delay_against_a_dense_model(tmp_path, lag):
    """The loop written out on a grid of twentieths of the period, the held force as a shift register."""
    period, mass, viscous, k, fine = 0.01, 0.2, 1.6, 100.0, 20
    scene = carriage(
        tmp_path, period, mass, viscous, discrete_stiffness_n_per_m=k / COMMAND,
        delay_periods=int(lag), delay_fraction=lag - int(lag),
    )  # fmt: skip
    h = period / fine
    result = expm(h * np.array([[0, 1, 0], [0, -viscous / mass, 1 / mass], [0, 0, 0]]))
    registers = 4
    step = np.eye(3 + registers)  # x, v, force; then the samples, the newest first
    total = np.eye(3 + registers)
    late, phase = divmod(round(lag * fine), fine)
    for tick in range(fine):
        if tick == 0:
            shift = np.eye(3 + registers)
            shift[3:] = 0.0
            shift[3, 0] = 1.0
            shift[4:, 3:-1] = np.eye(registers - 1)
            total = shift @ total
        if tick == phase:
            release = np.eye(3 + registers)
            release[2] = 0.0
            release[2, 3 + late] = -k
            total = release @ total
        step = np.eye(3 + registers)
        step[:3, :3] = result
        total = step @ total
    theirs = np.abs(np.linalg.eigvals(total)).max()
    ours = stability(held(at_wall(scene, ideal(1, emf=False)))).modes[0].growth
    assert ours == pytest.approx(theirs, rel=1e-10)


def test_the_two_link_arm_at_a_pose(tmp_path):
    """J^T k n n^T J sampled, J^T k n n^T J continuous and back-EMF, on the textbook's mass matrix."""
    k, analog, period = 120.0, 60.0, 0.02
    scene = _arm_scene(tmp_path, period, k, analog)
    arm = Arm(0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 8.333e-5, 8.333e-5, 2e-6 * 64)
    q = arm.inverse(np.array([0.07, 0.155]))
    normal = np.array([-1.0, 1.0]) / math.sqrt(2.0)
    mass, _ = arm.mass_and_bias(q, np.zeros(2), 0.0)
    w = arm.jacobian(q).T @ normal
    inverse = np.linalg.inv(mass)
    generator = np.zeros((6, 6))
    generator[:2, 2:4] = np.eye(2)
    generator[2:4, :2] = -inverse @ (SPRING * analog * np.outer(w, w))
    generator[2:4, 2:4] = -inverse * (EMF_TRUE + 5e-4)
    generator[2:4, 4:] = inverse

    def eigenvalues(stiffness):
        held_torque = np.eye(6)
        held_torque[4:] = 0.0
        held_torque[4:, :2] = -COMMAND * stiffness * np.outer(w, w)
        return np.linalg.eigvals(expm(period * generator) @ held_torque)

    z = eigenvalues(k)
    lifted = held(at_wall(scene, ideal(2)))
    assert np.allclose(touching(scene, CONSTANTS), q, rtol=0.0, atol=1e-12)
    result = stability(lifted)
    theirs = np.sort(np.abs(z[np.abs(z) > 1e-6]))[::-1]
    ours = np.sort(np.concatenate([[m.growth] * (2 if m.z.imag else 1) for m in result.modes]))[::-1]
    # gains change with the pose, but multiply springs without force here
    assert np.allclose(ours, theirs[: len(ours)], rtol=1e-9)
    assert result.free == 1  # along the wall nothing holds the tip
    limit = border(
        lambda x: held(at_wall(with_computer(scene, discrete_stiffness_n_per_m=x), ideal(2))), 1.0, 1e5
    )
    at_limit = np.abs(eigenvalues(limit.value))
    assert np.sort(at_limit)[-3:] == pytest.approx(
        1.0, abs=1e-9
    )  # the pair on its border, the free direction


def _arm_scene(folder, period, k, analog):
    return scene_of(
        folder,
        {
            "title": "arm",
            "duration_s": 1.0,
            "device": {
                "board": str(SCENES.parent / "netlists" / "board2.cir"),
                "linkage": "chain",
                "chain": {
                    "lengths_m": [0.1, 0.1], "masses_kg": [0.1, 0.1], "coms_m": [0.05, 0.05],
                    "inertias_kg_m2": [8.333e-5, 8.333e-5], "rotor_inertia_kg_m2": [2e-6, 2e-6],
                    "viscous_n_m_s": [5e-4, 5e-4],
                },
                "start": {"tip_m": [0.02, 0.116]},
            },
            "computer": {
                "period_s": period, "method": "combined", "analog_stiffness_n_per_m": analog,
                "discrete_stiffness_n_per_m": k,
            },
            "wall": {"point_m": [0.07, 0.155], "normal": [-0.7071067811865476, 0.7071067811865476]},
            "effects": {"viscous": True, "motor": "emf", "rotor_inertia": True},
        },
    )  # fmt: skip


def test_the_arms_linearisation_is_that_of_its_equations():
    """Differences of the compiled dynamics with weight and a pressing hand, the law in force, at its rest."""
    scene = load_scene(
        SCENES / "press.toml", ["effects.gravity=true", "effects.encoder=false", "effects.dac=false"]
    )
    circuit = ideal(2)
    linkage, person = mechanism(scene, CONSTANTS.gear), operator(scene)
    near = linkage.inverse(np.array([0.07, 0.145]))
    rest = resting_pose(HeldContact(scene, CONSTANTS, circuit, near))
    system = linearise(HeldContact(scene, CONSTANTS, circuit, rest))
    law = law_point(scene, CONSTANTS, linkage, rest)
    m = 8

    def acceleration(q, v):
        x = circuit.d_pre @ np.concatenate([q, law.volts[:2]]) + circuit.e_pre @ v
        after = np.concatenate(
            [circuit.gain * law.volts[2 : 2 + m] * x, law.volts[2 + m :], CONSTANTS.gear * v]
        )
        tau = CONSTANTS.kt * CONSTANTS.gear * circuit.d_post @ after
        return linkage.acceleration(q, v, tau, person, t=scene.duration_s)

    assert np.abs(acceleration(rest, np.zeros(2))).max() < 1e-8
    h = 1e-5  # differences: 1e-10 of third derivatives, rounding 1e-16/h of torques over inertias: 1e-7
    for j in range(2):
        step = h * np.eye(2)[j]
        by_angle = (acceleration(rest + step, np.zeros(2)) - acceleration(rest - step, np.zeros(2))) / (2 * h)
        by_speed = (acceleration(rest, step) - acceleration(rest, -step)) / (2 * h)
        assert np.allclose(system.a[2:, j], by_angle, rtol=1e-6, atol=1e-5)
        assert np.allclose(system.a[2:, 2 + j], by_speed, rtol=1e-6, atol=1e-5)


def test_nothing_is_stable_without_damping(tmp_path):
    scene, circuit = carriage(tmp_path, 0.01, 1.0, 0.0), ideal(1, emf=False)
    result = border(
        lambda k: held(at_wall(with_computer(scene, discrete_stiffness_n_per_m=k), circuit)), 1.0, 1e4
    )
    assert result.value == 0.0
    assert math.isnan(result.from_value)


def test_a_scene_without_a_wall(tmp_path):
    scene = scene_of(tmp_path, slider(wall=None, computer={"method": "continuous"}))
    with pytest.raises(InputError, match="wall"):
        touching(scene, CONSTANTS)


def test_fast_poles_change_nothing(tmp_path):
    """Poles of 1e9 rad/s before and behind, over periods of 100 ms: 1e8 time constants a period."""
    scene = carriage(tmp_path, 0.1, 0.05, 1.4618)
    plain = ideal(1, emf=False)
    assert k_max(scene, lagging(plain, 1e9, 1e9)) == pytest.approx(k_max(scene), rel=1e-6)


def test_a_recorded_run_shows_the_mode(tmp_path):
    """Ringing after a start inside the wall: frequency and damping of the critical mode from its samples."""
    scene = scene_of(
        tmp_path,
        merge(
            slider(**HELD),
            {"duration_s": 2.0, "effects": {"pot_noise": "none"}, "operator": {"damping_n_s_per_m": 1.0}},
        ),
    )
    circuit = ideal(1)
    rest = resting_pose(at_wall(scene, circuit))
    mode = stability(lift(linearise(HeldContact(scene, CONSTANTS, circuit, rest)))).critical
    made = propagate(scene, circuit)
    swing = rows(made, "q1") - rest[0]
    t = rows(made, "time")
    signs = np.flatnonzero(np.diff(np.sign(swing)))
    zero = t[signs] - swing[signs] * (t[signs + 1] - t[signs]) / (swing[signs + 1] - swing[signs])
    half = np.diff(zero)[2:10].mean()
    assert 0.5 / half == pytest.approx(mode.frequency_hz, rel=0.02)


# ---- commands


BORDERS = {
    "computer": {
        "period_s": 0.01, "method": "combined", "analog_stiffness_n_per_m": 50.0,
        "discrete_stiffness_n_per_m": 100.0,
    },
    "device": {"slider": {"viscous_n_m_s": 5e-4}},
    "effects": {"viscous": True, "motor": "emf", "encoder": True},
    "solver": {"model": "ideal"},
}  # fmt: skip


def test_the_command(tmp_path, capsys, monkeypatch):
    """Border, passive stiffness and rule of thumb of a shipped board, against 2 b/T."""
    monkeypatch.setattr("reports.stability._PERIODS", np.array([0.5, 1.0]))
    monkeypatch.setattr("reports.stability._POINTS", 20)
    scene_of(tmp_path, slider(**BORDERS))
    out = tmp_path / "out"
    assert main(["stability", str(tmp_path / "scene.toml"), "--json", "-o", str(out)]) == 0
    case = json.loads(capsys.readouterr().out)["cases"][0]
    b = (EMF_TRUE + 5e-4) / RADIUS**2
    assert case["viscosity_n_s_per_m"] == pytest.approx(b, rel=1e-5)
    assert case["gil_hulin_n_per_m"] == pytest.approx(2.0 * b / 0.01, rel=1e-5)
    assert case["passive_n_per_m"] == pytest.approx(2.0 * b / 0.01, rel=1e-4)
    assert case["needed_n_s_per_m"] == pytest.approx(0.5, rel=1e-9)
    assert case["passive_n_per_m"] < case["border_n_per_m"] < 1.2 * case["passive_n_per_m"]
    assert case["stable"]
    assert "the steps of the encoders" in case["left_out"]
    for ending in ("png", "svg", "csv"):
        assert (out / f"stability.{ending}").stat().st_size > 100
    assert main(["stability", str(tmp_path / "scene.toml")]) == 0
    words = capsys.readouterr().out
    assert "exact border" in words
    assert "passive up to" in words


def test_the_noise_command(tmp_path, capsys):
    scene_of(tmp_path, slider(**HELD))
    file = str(tmp_path / "scene.toml")
    assert main(["noise", file, "--json", "--set", "effects.pot_noise=white,peak_to_peak"]) == 0
    white, uniform = json.loads(capsys.readouterr().out)["cases"]
    assert white["jitter_rms_m"] == pytest.approx(uniform["jitter_rms_m"] * math.sqrt(18.0), rel=1e-9)
    assert main(["noise", file]) == 0
    assert "jitter of the tip" in capsys.readouterr().out
    assert main(["noise", file, "--set", "effects.pot_noise=none"]) == 2
    assert "no noise" in capsys.readouterr().err
    # the board's components alone are noise enough, and the same beside the potentiometers'
    components = ["effects.pot_noise=none,white", "--set", "effects.component_noise=true"]
    assert main(["noise", file, "--json", "--set", *components]) == 0
    alone, beside = json.loads(capsys.readouterr().out)["cases"]
    assert 0.0 < alone["component_force_noise_rms_n"] == beside["component_force_noise_rms_n"]
    assert "jitter_rms_m" in beside
    assert "jitter_rms_m" not in alone
