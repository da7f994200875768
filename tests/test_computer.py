"""The sampled computer: control law, encoder, DAC, delay, and that it believes in nominal constants only."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asked_computer import ARM, C_FS, K_DD, K_DP, KD, KP, LINKAGE, V_FS, ask, poses, record
from support import (
    COMMAND_TRUE,
    GEAR,
    K_FS,
    POT_V,
    SCENES,
    SPRING_TRUE,
    TORQUE,
    V_NM,
    V_RAD,
    Array,
    at_times,
    merge,
    paper_law,
    quick,
    simulate,
    slider,
)

from cosim.errors import InputError, SimulationError
from cosim.loop.computer import SAMPLE, Method, law, read_encoders, to_volts
from cosim.loop.computer import Path as CommandPath
from cosim.loop.dac_channels import channels
from cosim.scene import load_scene

RADIUS = 0.1333


# ---- the law of section III


def test_out_of_contact_everything_is_zero_and_u_follows_the_pose() -> None:  # (6)
    for q, v, normal, point in poses(50):
        outside = point - 2 * float(normal @ (point - ARM.tip(q))) * normal
        for method in Method:
            x = ask(record(method, normal, outside), q, v)
            assert x["contact"] == 0
            assert x["pen"] < 0
            assert not x["ksp"].any()
            assert not x["ksd"].any()
            assert not x["cmd"].any()
            assert (x["u"][:2] == q).all()


@pytest.mark.few(2)
@pytest.mark.parametrize("path", ["cmd", "u"])
@pytest.mark.parametrize("method", list(Method), ids=lambda m: m.name.lower())
def test_law_equals_the_paper_in_matrices(method: Method, path: str) -> None:  # (7)-(9), (12)
    for q, v, normal, point in poses(300):
        c = record(method, normal, point, path=CommandPath.U if path == "u" else CommandPath.CMD)
        x = ask(c, q, v)
        asked = paper_law(ARM, q, v, (point, normal), method.name.lower(), KP, KD, K_DP, K_DD, path)
        assert x["contact"] == 1
        assert x["unsolved"] == 0
        assert x["pen"] == pytest.approx(float(asked["pen"]), abs=1e-15)
        for name in ("ksp", "ksd"):
            # products of Jacobians of 0.2 m and gains of 100: rounding
            np.testing.assert_allclose(x[name][:2, :2], asked[name], atol=1e-13)
        # the law finds the contact point to 1 nm by Newton; the pose follows over the smallest singular value
        touch = ARM.inverse(ARM.tip(q) + float(asked["pen"]) * normal)
        lever = np.linalg.svd(ARM.jacobian(touch))[1][-1]
        turn = np.angle(np.exp(1j * (x["u"][:2] - asked["u"])))  # the inverse's angles come modulo 2 pi
        assert np.abs(turn).max() < 2e-9 / lever
        np.testing.assert_allclose(x["cmd"][:2], asked["cmd"], atol=1e-13)


def test_both_command_paths_ask_for_the_same_torque() -> None:
    for q, v, normal, point in poses(100):
        torques = []
        for path in CommandPath:
            x = ask(record(Method.COMBINED, normal, point, path=path, k_dd=0.0), q, v)
            torques.append(x["ksp"][:2, :2] @ (x["u"][:2] - q) + x["cmd"][:2])
        np.testing.assert_allclose(*torques, atol=1e-12)  # torques of 1 N m at most


def test_force_is_normal_and_as_stiff_as_asked() -> None:
    """A3: 10 mm of sink with J(q): normal force within 1 %, none along the wall, in every direction."""
    for q, _, normal, point in poses(100):
        deep = ARM.tip(q) + 0.01 * normal + 0 * point
        if not 0.03 < np.hypot(*deep) < 0.19:
            continue
        x = ask(record(Method.DISCRETE, normal, deep, kd=0.0), q, np.zeros(2))
        force = np.linalg.solve(ARM.jacobian(q).T, x["cmd"][:2])
        assert normal @ force == pytest.approx(KP * 0.01, rel=1e-2)
        assert abs(normal[1] * force[0] - normal[0] * force[1]) < 1e-9 * KP * 0.01 / abs(math.sin(q[1]))


def test_joint_pd_is_diagonal_with_own_gains_or_those_of_the_wall() -> None:  # Fig. 18
    q, v, normal, point = poses(1)[0]
    x = ask(record(Method.JOINT_PD, normal, point), q, v)
    full = ask(record(Method.CONTINUOUS, normal, point), q, v)
    assert (x["ksp"][:2, :2] == np.diag(np.diag(full["ksp"][:2, :2]))).all()
    assert full["ksp"][0, 1] != 0.0
    own = np.full(6, -1.0)
    own[:2] = 1.25, 0.5
    x = ask(record(Method.JOINT_PD, normal, point, joint_gain=own), q, v)
    assert (x["ksp"][:2, :2] == np.diag([1.25, 0.5])).all()


def pressed(c: Any, depths: list[float]) -> list[Any]:
    """Ask at one sample after another; normal (-1, 0) at x = 0.15, links stretched along the wall's edge."""
    x = np.zeros(1, SAMPLE)[0]
    rows = []
    for depth in depths:
        q = LINKAGE.inverse(np.array([0.12 + depth, 0.05]))
        x["q"][:2] = q
        law(c, LINKAGE.pack()[0], x)
        torque = x["ksp"][:2, :2] @ (x["u"][:2] - q) + x["cmd"][:2]
        force = np.linalg.solve(ARM.jacobian(q).T, torque)
        rows.append((-float(force[0]), float(x["ksp"][0, 0]), x["ksp"].copy(), q))
    return rows


WALL = (np.array([-1.0, 0.0]), np.array([0.12, 0.0]))


@pytest.mark.parametrize("path", list(CommandPath), ids=lambda p: p.name.lower())
def test_ramped_gains_rise_sample_by_sample_and_begin_anew(path: CommandPath) -> None:
    """Sample n of a contact has the share n/(N + 1) of everything; leaving the wall begins anew."""
    depths = [-1e-3, 1e-3, 2e-3, 3e-3, 4e-3, -1e-3, 2e-3]
    full = pressed(record(Method.COMBINED, *WALL, kd=0.0, path=path), depths)
    ramped = pressed(record(Method.COMBINED, *WALL, kd=0.0, path=path, ramp=2), depths)
    shares = [0, 1 / 3, 2 / 3, 1, 1, 0, 1 / 3]
    for (force, _, ksp, _), (weak, _, less, _), share in zip(full, ramped, shares, strict=True):
        assert weak == pytest.approx(share * force, abs=1e-12)
        np.testing.assert_allclose(less, share * ksp, atol=1e-15)
    assert full[1][0] > 0.1  # K x = 0.2 N there: something was compared


@pytest.mark.parametrize("path", list(CommandPath), ids=lambda p: p.name.lower())
def test_anchored_springs_begin_relaxed_and_are_drawn_back_with_the_tip(path: CommandPath) -> None:
    """Force (k_dp + kp) (x - anchor): anchor 1 mm at first, 0.5 mm after the tip went back that far."""
    depths = [-1e-3, 1e-3, 3e-3, 0.5e-3, 2e-3, -1e-3, 2e-3, 3e-3]
    stretch = [0.0, 0.0, 2e-3, 0.0, 1.5e-3, 0.0, 0.0, 1e-3]
    result = pressed(record(Method.COMBINED, *WALL, kd=0.0, path=path, anchored=1), depths)
    full = pressed(record(Method.COMBINED, *WALL, kd=0.0, path=path), depths)
    for (force, _, ksp, _), (_, _, each, _), x in zip(result, full, stretch, strict=True):
        # the springs' equilibrium is found at the joints: 3 mm in 0.1 m bend it by a few per cent
        assert force == pytest.approx((K_DP + KP) * x, rel=0.06, abs=1e-6)
        np.testing.assert_array_equal(ksp, each)


@pytest.mark.parametrize("line", [{"onset": "anchored"}, {"gain_ramp_samples": 3}])
def test_onset_belongs_to_the_built_in_law(line: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text("class Law:\n    def control(self, sample): ...\n")
    ((key, value),) = line.items()
    with pytest.raises(InputError, match=f"computer.{key}.*begins"):
        load_scene(
            SCENES / "drop.toml", (f"computer.law={tmp_path / 'law.py'}:Law", f"computer.{key}={value}")
        )


def test_wall_gain_has_rank_one_and_is_never_inverted() -> None:
    for q, v, normal, point in poses(100):
        gain = ask(record(Method.COMBINED, normal, point, path=CommandPath.U), q, v)["ksp"][:2, :2]
        big, small = np.linalg.svd(gain)[1]
        assert small < 1e-15 * big * 10
        np.testing.assert_allclose(gain, gain.T, rtol=1e-15)
    # Full stretch: J loses rank, and a wall across the arm's direction cannot be pushed (w = J^T n = 0).
    for angle in (0.0, 0.4, 2.0):
        q, normal = np.array([angle, 0.0]), np.array([np.cos(angle), np.sin(angle)])
        for method in Method:
            for path in CommandPath:
                for turned in (0.0, 0.7, np.pi / 2):
                    across = np.array([np.cos(angle + turned), np.sin(angle + turned)])
                    x = ask(
                        record(method, across, ARM.tip(q) + 1e-3 * normal, path=path), q, np.array([0.1, 0.2])
                    )
                    for name in ("u", "ksp", "ksd", "cmd"):
                        assert np.isfinite(x[name]).all(), (method, path, turned, name)


# ---- encoders and DACs


@pytest.mark.parametrize(("decoding", "known_mrad"), [(1, 1.571), (2, 0.785), (4, 0.393)])
def test_encoder_resolution_and_decoding(tmp_path: Path, decoding: int, known_mrad: float) -> None:
    step = 2 * math.pi / (500 * decoding * GEAR)
    assert step * 1e3 == pytest.approx(known_mrad, abs=5e-4)  # the paper's figures
    run = quick(
        tmp_path,
        slider(
            duration_s=0.3,
            device={"start": {"q_rad": [0.2], "v_rad_per_s": [-0.37]}},
            wall=None,
            computer={"period_s": 0.01, "encoder": {"pulses_per_rev": 500, "decoding": decoding}},
            effects={"encoder": True},
        ),
    )
    true = 0.2 - 0.37 * np.asarray(run.samples["time"])  # free flight
    seen = np.asarray(run.samples["q_enc1"])
    counts = seen / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(seen - true).max() <= step / 2 * (1 + 1e-9)
    # the velocity is the difference of two counts: quantised to step / T
    speed = np.asarray(run.samples["v_enc1"])
    np.testing.assert_allclose(speed[1:], np.diff(seen) / 0.01, atol=1e-9)
    assert speed[0] == 0.0
    assert np.abs(speed[1:] + 0.37).max() <= step / 0.01


def test_velocity_filter_is_one_pole() -> None:
    keep = math.exp(-2 * math.pi * 20 * 0.025)
    c = record(Method.DISCRETE, np.array([0.0, 1.0]), np.zeros(2), velocity_keep=keep)
    x = np.zeros(1, SAMPLE)[0]
    expected = 0.0
    angles = np.cumsum(np.random.default_rng(3).normal(size=20)) * 1e-3
    for tick, q in enumerate(angles):
        read_encoders(c, x, tick, np.array([q, 0.0, 0, 0, 0, 0]))
        if tick:
            expected = keep * expected + (1 - keep) * (q - angles[tick - 1]) / 0.025
        assert x["v"][0] == pytest.approx(expected, abs=1e-15)


def test_dac_rounds_to_its_codes_and_flags_its_range() -> None:
    step = 20 / 2**12
    c = record(Method.CONTINUOUS, np.array([0.0, 1.0]), np.zeros(2), dac_step=step, dac_range=10.0)
    x = np.zeros(1, SAMPLE)[0]
    names = channels(2)
    volts = np.zeros(len(names))
    rng = np.random.default_rng(5)
    for _ in range(200):
        wish = rng.uniform(-12, 12, len(names))
        x["u"][:2] = wish[:2] / V_RAD
        x["ksp"][:2, :2] = wish[2:6].reshape(2, 2) * K_FS / V_FS
        x["ksd"][:2, :2] = wish[6:10].reshape(2, 2) * C_FS / V_FS
        x["cmd"][:2] = wish[10:] / V_NM
        to_volts(c, x, volts)
        free = (wish > -10) & (wish < 10 - step)
        assert np.abs(volts - wish)[free].max() <= step / 2 + 1e-12
        np.testing.assert_allclose(volts / step, np.round(volts / step), atol=1e-9)
        assert volts.max() <= 10 - step  # two's complement: the top code is one step below the range
        assert volts.min() >= -10
        clear = np.abs(np.abs(wish) - 10) > step  # at the edge rounding decides
        clipped = (wish > 10) | (wish < -10)
        if clear.all():
            assert x["saturated"] == clipped.sum()


def test_clipped_dac_is_counted_and_renders_less(tmp_path: Path) -> None:
    # 300 N/m want 5.33 N m/rad, the converters give 3.0003 at 10 V
    tables = slider(device={"start": {"q_rad": [-0.02]}}, effects={"dac": True}, duration_s=0.05)
    run = quick(tmp_path, merge(tables, {"computer": {"analog_stiffness_n_per_m": 300.0}}))
    assert run.samples["saturated"][0] == 1
    assert run.measures["dac_saturations"]["value"] >= 1
    top = 10.0 - 20 / 2**12
    assert run.signals["ksp11"][1] == pytest.approx(top, abs=1e-12)
    torque = run.signals["imot1"][0] * TORQUE
    assert torque == pytest.approx(SPRING_TRUE * top / 10 * 0.02, rel=1e-6)


def test_recorded_dac_voltages_are_codes(tmp_path: Path) -> None:
    for bits, reach in ((8, 10.0), (12, 10.0), (16, 5.0)):
        run = quick(
            tmp_path,
            slider(
                device={"start": {"q_rad": [-0.02]}},
                computer={"dac": {"bits": bits, "range_v": reach}},
                effects={"dac": True},
            ),
        )
        step = 2 * reach / 2**bits
        for name in ("u1", "ksp11"):
            codes = np.asarray(run.signals[name]) / step
            np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)


# ---- time: samples, delay, settling, skew


def changes(run: Any, name: str) -> Array:
    """Times of the last points before a signal's value changes (left-hand limits)."""
    t, y = np.asarray(run.signals["time"]), np.asarray(run.signals[name])
    return t[:-1][np.diff(y) != 0]


FALLING = slider(
    duration_s=0.2,
    device={"start": {"q_rad": [0.0303], "v_rad_per_s": [-0.9]}},
    computer={"period_s": 0.01, "method": "combined", "discrete_stiffness_n_per_m": 50.0},
)


def behind_a_jump(t: np.ndarray) -> np.ndarray:
    """Return which rows hold limits from the right: the second ones of their instants."""
    return np.append(False, np.diff(t) == 0.0)


def test_contact_is_found_at_samples_only(tmp_path: Path) -> None:
    run = quick(tmp_path, FALLING)
    t, q = np.asarray(run.signals["time"]), np.asarray(run.signals["q1"])
    crossed = t[np.argmax(q < 0)]
    first = math.ceil(crossed / 0.01) * 0.01
    assert crossed < first - 1e-3  # between two samples: 0.0337 s
    seen = changes(run, "ksp11")
    assert seen[0] == pytest.approx(first, abs=1e-12)
    assert run.events[0]["time_s"] == pytest.approx(first, abs=1e-12)
    between = (t > crossed) & (t <= first) & ~behind_a_jump(t)
    assert between.sum() > 1
    assert np.abs(np.asarray(run.signals["imot1"])[between]).max() < 1e-9  # inside the wall, and nobody knows
    assert np.abs(seen / 0.01 - np.round(seen / 0.01)).max() < 1e-9


@pytest.mark.few(3)
@pytest.mark.parametrize(("periods", "fraction"), [(0, 0.0), (1, 0.0), (2, 0.5), (0, 0.25), (5, 0.0)])
def test_computing_delay_in_ticks_and_fraction(tmp_path: Path, periods: int, fraction: float) -> None:
    computer = {"delay_periods": periods, "delay_fraction": fraction}
    run = quick(tmp_path, merge(FALLING, {"computer": computer, "effects": {"delay": True}}))
    lag = (periods + fraction) * 0.01
    for name, wished, scale in (
        ("ksp11", "ksp11", 10 / K_FS),
        ("cmd1", "cmd_nm1", V_NM),
        ("u1", "u_rad1", V_RAD),
    ):
        times, wishes = np.asarray(run.samples["time"]), np.asarray(run.samples[wished]) * scale
        arrive = times + lag
        t, y = np.asarray(run.signals["time"]), np.asarray(run.signals[name])
        inside = arrive < 0.2 - 0.011
        begins = behind_a_jump(t)
        for at, wish in zip(arrive[inside], wishes[inside], strict=True):
            held = np.where(begins, np.abs(t - at) < 1e-9, (t > at + 1e-9) & (t <= at + 0.01 + 1e-9))
            np.testing.assert_allclose(y[held], wish, atol=1e-12)  # from its instant on, for one period
        moved = changes(run, name)
        phase = (moved - lag) / 0.01
        assert np.abs(phase - np.round(phase)).max() < 1e-6
    # before the first sample arrives the DACs hold the pose and no gain
    t = np.asarray(run.signals["time"])
    early = t < lag
    assert (np.asarray(run.signals["ksp11"])[early] == 0).all()
    assert np.asarray(run.signals["u1"])[early] == pytest.approx(V_RAD * 0.0303)


def test_too_long_a_delay_is_refused(tmp_path: Path) -> None:  # 30
    with pytest.raises(InputError, match="delay_periods"):
        quick(tmp_path, merge(FALLING, {"computer": {"delay_periods": 900}, "effects": {"delay": True}}))


def test_delay_longer_than_a_period_loses_no_sample(tmp_path: Path) -> None:  # 30
    computer = {"period_s": 0.003, "delay_periods": 3, "delay_fraction": 0.7}
    run = quick(tmp_path, merge(FALLING, {"computer": computer, "effects": {"delay": True}}))
    wishes = np.asarray(run.samples["ksp11"]) * 10 / K_FS
    times = np.asarray(run.samples["time"]) + 3.7 * 0.003
    seen = np.asarray(run.signals["ksp11"])
    t = np.asarray(run.signals["time"])
    for at, wish in zip(times, wishes, strict=True):
        inside = (t > at + 1e-9) & (t <= at + 0.003 - 1e-9)
        if at + 0.003 < 0.2:
            assert inside.any()
            np.testing.assert_allclose(seen[inside], wish, atol=1e-12)


def test_dac_settles_on_a_ramp(tmp_path: Path) -> None:
    settling = 1e-3
    tables = merge(
        FALLING,
        {
            "computer": {"dac": {"settling_s": settling, "bits": 32}},
            "effects": {"dac": True, "dac_settling": True},
        },
    )
    run = quick(tmp_path, tables)
    t = np.asarray(run.signals["time"])
    for name, wished, scale in (
        ("ksp11", "ksp11", 10 / K_FS),
        ("u1", "u_rad1", V_RAD),
        ("cmd1", "cmd_nm1", V_NM),
    ):
        y, wishes = np.asarray(run.signals[name]), np.asarray(run.samples[wished]) * scale
        for k in range(1, 19):
            part = (t > k * 0.01 + 1e-12) & (t <= (k + 1) * 0.01)
            share = np.clip((t[part] - k * 0.01) / settling, 0, 1)
            ramp = wishes[k - 1] + share * (wishes[k] - wishes[k - 1])
            np.testing.assert_allclose(y[part], ramp, atol=2e-8)  # 32 bits on 20 V: 5 nV
            if wishes[k] != wishes[k - 1]:  # the ramp's end is an accepted point
                assert np.abs(t - (k * 0.01 + settling)).min() < 1e-12


def test_a_ramp_longer_than_the_period_goes_on_from_where_it_is(tmp_path: Path) -> None:
    # u follows a joint at 1 rad/s; each sample turns the ramp to its wish, half-way of the one before
    period, settling = 0.01, 0.02
    run = quick(
        tmp_path,
        slider(
            duration_s=0.1,
            device={"start": {"q_rad": [0.3], "v_rad_per_s": [1.0]}},
            wall=None,
            computer={"period_s": period, "dac": {"settling_s": settling, "bits": 32}},
            effects={"dac": True, "dac_settling": True},
        ),
    )
    t, y = np.asarray(run.signals["time"]), np.asarray(run.signals["u1"]) / V_RAD
    held = target = 0.3
    for k in range(10):
        wish = 0.3 + k * period  # what the encoder sees in free flight
        held += period / settling * (target - held) if k else 0.0
        target = wish
        part = (t > k * period + 1e-12) & (t <= (k + 1) * period + 1e-12)
        ramp = held + (t[part] - k * period) / settling * (target - held)
        np.testing.assert_allclose(y[part], ramp, atol=1e-8)


def test_equilibria_and_commands_follow_the_gains_by_the_skew(tmp_path: Path) -> None:
    skew = 5e-4
    tables = merge(
        FALLING,
        {"computer": {"dac": {"skew_s": skew, "bits": 32}}, "effects": {"dac": True, "dac_skew": True}},
    )
    run = quick(tmp_path, tables)
    for name, lag in (("ksp11", 0.0), ("u1", skew), ("cmd1", skew)):
        phase = (changes(run, name) - lag) / 0.01
        assert len(phase) >= 2
        assert np.abs(phase - np.round(phase)).max() < 1e-7


# ---- whole runs


def press(*overrides: str) -> list[str]:
    """Overrides that leave press.toml an ideal circuit with an exact computer."""
    ideal = [f"effects.{name}=ideal" for name in ("opamp", "vca", "driver_level", "motor")]
    return [*ideal, "effects.encoder=false", "effects.dac=false", "effects.dac_settling=false", *overrides]


def test_u_equals_cmd_on_an_ideal_circuit(tmp_path: Path) -> None:
    runs = {}
    for path in ("u", "cmd"):
        overrides = press('computer.method="combined"', "computer.discrete_stiffness_n_per_m=60.0",
                          "effects.motor=emf", f'computer.command_path="{path}"')  # fmt: skip
        runs[path] = simulate(load_scene(SCENES / "press.toml", overrides), tmp_path / path)
    times = np.arange(80) * 0.025
    for name in ("x", "y"):
        off = at_times(runs["u"], times, name) - at_times(runs["cmd"], times, name)
        # the board's spring gain is SPRING_TRUE / K_FS of what the computer believes, its command gain 1:
        # the two renderings of 60 N/m differ by that ratio, so does the sink of 6 mm at most
        print(name, np.abs(off).max())
        assert np.abs(off).max() < 6e-3 * abs(SPRING_TRUE / K_FS - 1) + 1e-7
    force = runs["cmd"].measures["steady_normal_force"]["value"]
    assert runs["u"].measures["steady_normal_force"]["value"] == pytest.approx(force, rel=2e-4)


@pytest.mark.parametrize("method", ["discrete", "combined"])
def test_without_an_analog_spring_u_can_carry_no_force(tmp_path: Path, method: str) -> None:
    computer = {"method": method, "discrete_stiffness_n_per_m": 50.0, "analog_stiffness_n_per_m": 0.0,
                "analog_damping_n_s_per_m": 2.0 * (method == "combined"), "command_path": "u"}  # fmt: skip
    with pytest.raises(InputError, match="command_path"):
        quick(tmp_path, slider(computer=computer))


@pytest.mark.few(1)
@pytest.mark.parametrize("turn", [1.1, 2.9, -2.0])
def test_walls_of_any_normal_render_alike(tmp_path: Path, turn: float) -> None:
    """The press scene turned about the base: same sink and force, in the turned frame."""
    cos, sin = math.cos(turn), math.sin(turn)

    def rotated(x: float, y: float) -> list[float]:
        return [cos * x - sin * y, sin * x + cos * y]

    turned = [
        f"device.start.tip_m={rotated(0.07, 0.157)}",
        f"wall.point_m={rotated(0.07, 0.155)}",
        f"wall.normal={rotated(0.0, 1.0)}",
        f"operator.waypoints_s_m={[[0.0, *rotated(0.07, 0.157)], [0.2, *rotated(0.07, 0.155)]]}",
        f"operator.force_s_n={[[0.2, 0.0, 0.0], [0.7, *rotated(0.0, -2.35)]]}",
    ]
    plain = simulate(load_scene(SCENES / "press.toml", press()), tmp_path / "plain")
    other = simulate(load_scene(SCENES / "press.toml", press(*turned)), tmp_path / "turned")
    times = np.arange(80) * 0.025
    x, y = (at_times(plain, times, name) for name in ("x", "y"))
    for name, expected in (("x", cos * x - sin * y), ("y", sin * x + cos * y)):
        # both runs are as good as their own estimate of the coupling's error; a lever of 0.2 m
        room = 0.2 * (plain.stats["defect_sum_rad"] + other.stats["defect_sum_rad"])
        assert np.abs(at_times(other, times, name) - expected).max() < room
    for name in ("steady_penetration", "steady_normal_force"):
        assert other.measures[name]["value"] == pytest.approx(plain.measures[name]["value"], rel=1e-5)


def static_force(run: Any, share: dict[str, float]) -> tuple[float, float]:
    """Normal force at the end of a press: as measured, and by hand from the resistors of the board.

    `share`: relative gain of 'sum' (all springs), 'motor1', 'pot1', 'u1' (joint 1's difference amplifier).
    """
    s, last = run.signals, -1
    q = np.array([s["q1"][last], s["q2"][last]])
    u = np.array([s["u1"][last], s["u2"][last]]) / POT_V
    gain = np.array([[s[f"ksp{i}{j}"][last] for j in (1, 2)] for i in (1, 2)]) / 10 * SPRING_TRUE
    scale_u, scale_pot = np.array([share.get("u1", 1.0), 1.0]), np.array([share.get("pot1", 1.0), 1.0])
    scale_motor = share.get("sum", 1.0) * np.array([share.get("motor1", 1.0), 1.0])
    torque = scale_motor * (gain @ (scale_u * u - scale_pot * q))
    force = np.linalg.solve(ARM.jacobian(q).T, torque)
    return -float(s["fy"][last]), float(force[1])


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("name", "value", "share"),
    [
        (None, "", {}),
        ("r_sum_spring", "24.543k", {"sum": 1 / 1.01}),
        ("xboard.xsum1.r31", "10.1k", {"motor1": 1.01}),
        # R12: out = -(R12/R11) pot + (1 + R12/R11) R14/(R13 + R14) u
        ("xboard.xdiff1.r12", "170.69k", {"pot1": 1.01, "u1": (1 + 16.9 * 1.01) / 17.9}),
    ],
)
def test_volts_come_from_nominal_constants_only(
    tmp_path: Path, name: str | None, value: str, share: dict[str, float]
) -> None:
    """One resistor by 1 %: the computer asks for the same, the board renders its computed share."""
    overrides = press("duration_s=3.0", "effects.motor=emf")
    nominal = simulate(load_scene(SCENES / "press.toml", overrides), tmp_path / "nominal")
    if name is not None:
        overrides.append(f'device.values={{"{name}" = "{value}"}}')
    run = simulate(load_scene(SCENES / "press.toml", overrides), tmp_path / "edited")
    # the same wish for the same pose: volts over physical units are those of the board as stated
    ratio = run.signals["ksp22"][-1] * K_FS / 10 / run.samples["ksp22"][-1]
    assert ratio == pytest.approx(1.0, rel=1e-12)
    measured, computed = static_force(run, share)
    # in rest after 3 s (time constant of the ringing 0.1 s); the hand's force balances the motors'
    assert measured == pytest.approx(computed, rel=1e-5)
    if "sum" in share:
        stiffness = [r.measures["rendered_stiffness"]["value"] for r in (nominal, run)]
        # the sink changes too, and with it the pose: second order of the 1 %
        assert stiffness[1] / stiffness[0] == pytest.approx(share["sum"], abs=1e-3)


# ---- a law of the user's own

PAPER_LAW = """
import numpy as np
from cosim.loop.userlaw import Command

class Combined:
    '''Section III with both paths, in numpy.'''
    def control(self, s):
        pen = float(s.wall_normal @ (s.wall_point_m - s.tip_m))
        if not pen > 0:
            return Command()
        target = s.tip_m + pen * s.wall_normal
        cosine = (target @ target - 0.02) / 0.02
        q2 = np.arccos(cosine)
        q1 = np.arctan2(target[1], target[0]) - np.arctan2(0.1 * np.sin(q2), 0.1 + 0.1 * np.cos(q2))
        w = s.jacobian.T @ s.wall_normal
        force = 60.0 * pen - 0.5 * w @ s.v_rad_per_s
        return Command(u_rad=[q1, q2], stiffness=100.0 * np.outer(w, w), torque_n_m=w * force)

class Raises:
    def control(self, s):
        if s.tick == {tick}:
            raise KeyError("no such gain")
        return Command()

class Nan:
    def control(self, s):
        return Command(torque_n_m=[float("nan") if s.tick == {tick} else 0.0] * len(s.q_rad))

class Shape:
    def control(self, s):
        return Command(stiffness=[1.0, 2.0, 3.0])

class NoMethod:
    pass
"""


def test_users_law_replaces_the_built_in_and_reproduces_it(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(PAPER_LAW.replace("{tick}", "0"))
    common = press('computer.method="combined"', "computer.discrete_stiffness_n_per_m=60.0",
                   "computer.discrete_damping_n_s_per_m=0.5", "effects.encoder=true")  # fmt: skip
    built_in = simulate(load_scene(SCENES / "press.toml", common), tmp_path / "built_in")
    law_file = tmp_path / "law.py"
    users = simulate(
        load_scene(SCENES / "press.toml", [*common, f'computer.law="{law_file}:Combined"']), tmp_path / "u"
    )
    assert any("Python" in note for note in users.plan["notes"])
    times = np.arange(80) * 0.025
    for name in ("q1", "q2", "imot1", "imot2"):
        a, b = at_times(built_in, times, name), at_times(users, times, name)
        # Newton's contact point is good to 1 nm, which is 0.1 uN; steps are the same
        np.testing.assert_allclose(a, b, atol=1e-6)
    for name in ("contact", "q_enc1", "pen"):
        np.testing.assert_allclose(built_in.samples[name], users.samples[name], atol=1e-7)


@pytest.mark.few(2)
@pytest.mark.parametrize("tick", [0, 7])
@pytest.mark.parametrize(
    ("name", "words"), [("Raises", "no such gain"), ("Nan", r"torque_n_m is not finite at sample {tick}")]
)
def test_errors_of_a_users_law_end_the_run(tmp_path: Path, name: str, words: str, tick: int) -> None:
    (tmp_path / "law.py").write_text(PAPER_LAW.replace("{tick}", str(tick)))
    with pytest.raises(SimulationError) as caught:
        quick(tmp_path, slider(computer={"law": f"law.py:{name}"}, duration_s=5.0))
    text = str(caught.value) + (caught.value.last_words or "")
    assert words.format(tick=tick) in text
    assert not (tmp_path / "run0").exists()  # nothing half-written


def test_a_law_of_the_wrong_shape_or_without_method_is_reported(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(PAPER_LAW.replace("{tick}", "0"))
    with pytest.raises(SimulationError, match="stiffness"):
        quick(tmp_path, slider(computer={"law": "law.py:Shape"}))
    for law_name, words in (
        ("law.py:NoMethod", "control"),
        ("law.py:Absent", "computer.law"),
        ("gone.py:Law", "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            quick(tmp_path, slider(computer={"law": law_name}))


def test_command_gain_is_one_newton_metre_a_newton_metre(tmp_path: Path) -> None:
    # Fig. 16's path: cmd alone; v_nm is exact for the nominal resistors
    assert pytest.approx(1.0, rel=1e-12) == COMMAND_TRUE * V_NM
    tables = slider(
        duration_s=0.05,
        device={"start": {"q_rad": [-0.02]}},
        computer={"method": "discrete", "discrete_stiffness_n_per_m": 133.0, "analog_stiffness_n_per_m": 0.0},
    )
    run = quick(tmp_path, tables)
    assert run.signals["imot1"][0] * TORQUE == pytest.approx(133.0 * RADIUS**2 * 0.02, rel=1e-6)
