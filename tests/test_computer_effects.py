"""Effects of the computer and of the mechanism, one by one: null limit, closed form, every circuit model.

Numbers in comments are the hard cases' numbers of the project's list.
"""

import ctypes
import hashlib
import math
from itertools import accumulate
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from asked_computer import ARM, K_DP, KP, V_FS, ask, poses, record
from linear_runs import CONSTANTS, ideal
from support import BOARD1, BOARD2, GEAR, Array, merge, quick, scene_of, slider

from cosim.effects.period_jitter import lateness
from cosim.errors import InputError, SimulationError
from cosim.loop.computer import Method
from cosim.loop.computer import Path as CommandPath
from cosim.loop.linear.run_linear import prepare

MODELS = ("ideal", "linear", "spice")
RADIUS = 0.1333
MASS = 0.2


def of(model: str, **tables: Any) -> dict[str, Any]:
    return slider(solver={"model": model}, **tables)


def pressed(model: str, **more: Any) -> dict[str, Any]:
    """Inside the wall from the start to the end, so that every sample writes."""
    return merge(of(model, device={"start": {"q_rad": [-0.03]}}, effects={"motor": "emf"}), more)


def coasting(model: str, speed: float, start: float, **more: Any) -> dict[str, Any]:
    """A carriage that nothing holds, at constant speed [m/s] from a place above the wall [m]."""
    at = {"start": {"q_rad": [start / RADIUS], "v_rad_per_s": [-speed / RADIUS]}}
    return merge(of(model, device=at), more)


def bytes_of(run: Any) -> str:
    return hashlib.sha256(Path(run.signals.path).read_bytes()).hexdigest()


def pushed(newtons: float) -> dict[str, Any]:
    """A hand that pushes and does nothing else."""
    return {
        "type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0,
        "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, newtons]],
    }  # fmt: skip


# ---- null limits


@pytest.mark.few(12)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "null",
    [
        {"effects": {"dac_settling": True}},
        {"effects": {"dac_skew": True}},
        {"computer": {"dac": {"settling_s": 1e-3, "skew_s": 1e-3}}},
        {"effects": {"period_jitter": "uniform"}, "computer": {"jitter_share": 0.0}},
        {"effects": {"period_jitter": "normal"}, "computer": {"jitter_share": 0.0}},
        {"computer": {"jitter_share": 0.4}},
        {"effects": {"rotor_inertia": True}},
        {"device": {"slider": {"rotor_inertia_kg_m2": 1e-5}}},
        {"effects": {"end_stops": True}},
        {"device": {"slider": {"stops_rad": [[-0.031, -0.029]]}}},
        {"effects": {"geometric_stiffness": True}},  # a slider's links do not turn
        {"effects": {"operator_dynamics": True}},  # nobody holds it
    ],
    ids=lambda null: "-".join(f"{k}.{next(iter(v))}" for k, v in null.items()),
)
def test_an_effect_off_or_without_data_changes_no_byte(
    tmp_path: Path, model: str, null: dict[str, Any]
) -> None:
    plain, other = quick(tmp_path, pressed(model)), quick(tmp_path, pressed(model, **null))
    assert bytes_of(plain) == bytes_of(other)
    assert other.stats["random_draws"] == 0


@pytest.mark.parametrize("model", MODELS)
def test_a_hand_without_its_dynamics_is_a_hand_without_mass_and_damping(tmp_path: Path, model: str) -> None:
    hand = {"type": "hand", "stiffness_n_per_m": 50.0, "waypoints_s_m": [[0.0, 0.0, 0.0], [0.3, 0.0, -0.01]]}
    spring = {**hand, "mass_kg": 0.0, "damping_n_s_per_m": 0.0}
    plain = quick(tmp_path, pressed(model, operator=hand))
    bare = quick(tmp_path, pressed(model, operator=spring, effects={"operator_dynamics": True}))
    full = quick(tmp_path, pressed(model, operator=hand, effects={"operator_dynamics": True}))
    assert bytes_of(plain) == bytes_of(bare)
    assert bytes_of(plain) != bytes_of(full)


# ---- closed forms of the mechanism


@pytest.mark.parametrize("model", MODELS)
def test_a_rotor_is_its_inertia_behind_the_gear(tmp_path: Path, model: str) -> None:
    rotor, force = 2e-5, 0.3
    tables = of(
        model, wall=None, duration_s=0.2, operator=pushed(force),
        device={"slider": {"rotor_inertia_kg_m2": rotor}}, effects={"rotor_inertia": True},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    inertia = MASS * RADIUS**2 + rotor * GEAR**2
    # constant acceleration: exact for every rule of the integration
    assert run.signals["v1"][-1] == pytest.approx(force * RADIUS / inertia * 0.2, rel=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_a_stop_takes_the_energy_of_the_blow(tmp_path: Path, model: str) -> None:
    stiffness, speed, stop = 20.0, 1.0, 0.05
    table = {"stops_rad": [[-1.0, stop]], "stop_stiffness_n_m_per_rad": stiffness, "stop_damping_n_m_s": 0.0}
    start = {"q_rad": [0.0], "v_rad_per_s": [speed]}
    tables = of(
        model, wall=None, duration_s=0.12, device={"slider": table, "start": start},
        effects={"end_stops": True},
    )  # fmt: skip
    run = quick(tmp_path, merge(tables, {"solver": {"max_step_s": 1e-4}}))
    inertia = MASS * RADIUS**2
    deepest = speed * math.sqrt(inertia / stiffness)
    # a half swing of 0.04 s: rows every 0.1 ms miss its top by (w h / 2)^2 / 2 = 7e-6 of it, and where it is
    # met within a step of ngspice the blow comes by up to h late
    assert np.asarray(run.signals["q1"]).max() - stop == pytest.approx(deepest, rel=1e-2)
    assert run.signals["v1"][-1] == pytest.approx(-speed, rel=1e-2)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dynamic", [False, True])
def test_a_hand_swings_with_its_mass_only_where_it_has_one(tmp_path: Path, model: str, dynamic: bool) -> None:
    mass, stiffness = 0.554, 135.0
    hand = {
        "type": "hand", "mass_kg": mass, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": stiffness,
        "waypoints_s_m": [[0.0, 0.0, 0.01]],
    }  # fmt: skip
    tables = of(model, wall=None, duration_s=0.5, operator=hand, effects={"operator_dynamics": dynamic})
    run = quick(tmp_path, merge(tables, {"solver": {"max_step_s": 2e-4}}))
    w = math.sqrt(stiffness / (MASS + (mass if dynamic else 0.0)))
    t, y = np.asarray(run.signals["time"]), np.asarray(run.signals["y"])
    # third-order steps of w h = 5e-3 for 13 rad: 1e-6 of the swing of 10 mm
    assert np.abs(y - 0.01 * (1 - np.cos(w * t))).max() < 1e-7


# ---- jitter


@pytest.mark.parametrize("kind", ["uniform", "normal"])
def test_jitter_is_drawn_as_stated(kind: str) -> None:
    late = lateness(kind, 11, 200_001, 0.1)
    assert late[0] == 0.0
    rms = 0.1 / math.sqrt(3) if kind == "uniform" else 0.1
    # mean and rms of 2e5 values: five standard errors
    assert abs(late[1:].mean()) < 5 * rms / math.sqrt(2e5)
    assert late[1:].std() == pytest.approx(rms, rel=5 / math.sqrt(2 * 2e5))
    assert np.abs(late).max() <= (0.1 if kind == "uniform" else 0.45)
    assert (late == lateness(kind, 11, 200_001, 0.1)).all()
    assert not np.allclose(late[1:], lateness(kind, 12, 200_001, 0.1)[1:])


def test_a_wide_normal_jitter_keeps_samples_in_order() -> None:
    assert np.abs(lateness("normal", 1, 10_000, 0.45)).max() <= 0.45


@pytest.mark.parametrize("kind", ["uniform", "normal"])
@pytest.mark.parametrize("model", MODELS)
def test_samples_come_at_their_instants_and_the_computer_does_not_know(
    tmp_path: Path, model: str, kind: str
) -> None:
    period, speed, share = 0.01, 0.05, 0.2
    tables = coasting(
        model, speed, 1.0, seed=5, duration_s=0.5, computer={"period_s": period, "jitter_share": share},
        effects={"period_jitter": kind},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    ticks = np.arange(51)
    late = lateness(kind, 5, 51, share)
    at = ticks * period + period * late
    seen = np.asarray(run.samples["time"])
    assert (seen == at[: len(seen)]).all()
    assert len(seen) >= 50  # the last may come after the end
    assert run.stats["random_draws"] == 50
    # the backward difference is over the period that it takes for granted
    expected = -speed / RADIUS * (1 + np.diff(late[: len(seen)]))
    assert np.abs(np.asarray(run.samples["v_enc1"])[1:] - expected).max() < 1e-9 * speed / RADIUS / period


def test_jitter_leaves_the_noise_alone(tmp_path: Path) -> None:
    noisy = {"effects": {"pot_noise": "white"}, "device": {"potentiometer": {"noise_rad": 1e-3}}}
    base = merge(of("ideal", wall=None, seed=9, duration_s=0.2), noisy)
    runs = [quick(tmp_path, merge(base, {"effects": {"period_jitter": kind}})) for kind in ("none", "normal")]
    t = np.arange(1, 40) * 5e-3
    one, other = (
        np.interp(t, run.signals["time"], np.asarray(run.signals["pot1"]) - run.signals["q1"]) for run in runs
    )
    assert np.abs(one - other).max() < 1e-15
    assert np.abs(one).max() > 1e-4


@pytest.mark.parametrize("model", MODELS)
def test_a_delayed_command_follows_its_jittered_sample(tmp_path: Path, model: str) -> None:
    tables = pressed(
        model, seed=2, computer={"delay_fraction": 0.25, "jitter_share": 0.1, "period_s": 0.02},
        effects={"delay": True, "period_jitter": "uniform"},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    t, u = np.asarray(run.signals["time"]), np.asarray(run.signals["ksp11"])
    change = t[np.flatnonzero(np.diff(u)) + 1]
    due = np.asarray(run.samples["time"]) + 0.25 * 0.02
    first = due[0]
    assert change[0] > first - 1e-12
    assert change[0] - first < 2e-3  # the row behind the jump is at most a longest step later


# ---- the wall seen at samples


@pytest.mark.few(1)
@pytest.mark.parametrize("model", MODELS)
def test_first_penetration_is_between_nothing_and_a_period(tmp_path: Path, model: str) -> None:  # 24
    """On average over the phases of the impact it is half the way of a period."""
    speed, period, phases = 0.2, 0.025, 8
    seen = []
    for k in range(phases):
        phase = (k + 0.5) / phases
        tables = coasting(model, speed, speed * period * (1 + phase), duration_s=2.9 * period)
        run = quick(tmp_path, tables)
        first = np.flatnonzero(run.samples["contact"])[0]
        assert first == 2
        seen.append(float(run.samples["pen"][first]))
        assert seen[-1] == pytest.approx(speed * period * (1 - phase), abs=1e-12)
    assert 0.0 <= min(seen) <= max(seen) <= speed * period
    assert np.mean(seen) == pytest.approx(speed * period / 2, rel=1e-9)


RELAY = """
import numpy as np
from cosim.loop.userlaw import Command
class Relay:
    def control(self, sample):
        return Command(torque_n_m=-{torque!r} * np.sign(sample.q_rad))
"""


@pytest.mark.few(1)
@pytest.mark.parametrize("model", MODELS)
def test_a_sampled_relay_swings_by_m_t_with_period_2_t(tmp_path: Path, model: str) -> None:  # 23
    """x' = -M sgn(x_k), M = 2 rad/s, T = 100 ms: 0.2 rad peak to peak, less what the mass rounds off.

    The carriage follows the torque over its viscosity with tau = I / b. Its speed turns at tau ln 2 after a
    sample, so that each half swing is M (T - 2 tau ln 2) long, but for exp(-T / tau).
    """
    period, speed, tau, b = 0.1, 2.0, 1e-3, 0.01
    (tmp_path / "law.py").write_text(RELAY.format(torque=b * speed))
    tables = of(
        model, wall=None, duration_s=2.0,
        computer={"period_s": period, "law": "law.py:Relay"},
        device={"slider": {"mass_kg": tau * b / RADIUS**2, "viscous_n_m_s": b}, "start": {"q_rad": [0.05]}},
        effects={"viscous": True},
    )  # fmt: skip
    run = quick(tmp_path, merge(tables, {"solver": {"max_step_s": 2e-4}}))
    t, q = np.asarray(run.signals["time"]), np.asarray(run.signals["q1"])
    settled = t > 0.5
    wanted = speed * (period - 2 * tau * math.log(2))
    # the turn is rounded over tau: rows 0.2 ms apart miss its top by M h^2 / (8 tau), 5e-5 of the swing
    assert np.ptp(q[settled]) == pytest.approx(wanted, rel=1e-4)
    sign = np.sign(np.asarray(run.samples["q_enc1"]))
    assert (sign[1:] == -sign[:-1]).all()  # turns at every sample: period 2 T


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_quantised_wall_rests_or_cycles(tmp_path: Path, model: str, share: float) -> None:  # 31
    """Abbott and Okamura 2005: K <= 2 f_c / D. A push half way between two of the wall's steps of K D.

    No step balances it: K D / 2 is left, one way or the other. Dry friction holds that up to f_c; beyond,
    there is no equilibrium, and the computer's force goes on changing for ever. K < 2 b / T holds throughout.
    """
    step = RADIUS * 2 * math.pi / (500 * GEAR)  # D at the tip, decoding 1
    friction, b, period = 0.02, 0.2, 1e-3
    wall = share * 2 * friction / step
    assert wall < 2 * b / period
    level = 20
    tables = of(
        model, duration_s=0.6,
        device={
            "slider": {"viscous_n_m_s": b * RADIUS**2, "coulomb_n_m": friction * RADIUS,
                       "coulomb_speed_rad_per_s": 1e-4},
            "start": {"q_rad": [-level * step / RADIUS]},
        },
        computer={
            "period_s": period, "method": "discrete", "discrete_stiffness_n_per_m": wall,
            "analog_stiffness_n_per_m": 0.0, "encoder": {"pulses_per_rev": 500, "decoding": 1},
        },
        operator=pushed(-wall * step * (level + 0.5)),
        effects={"viscous": True, "coulomb": True, "encoder": True},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    late = np.asarray(run.samples["time"]) > 0.3
    changes = np.count_nonzero(np.diff(np.asarray(run.samples["pen"])[late]))
    print(f"{model} {share}: {changes} changes in the last 0.3 s")
    if share < 1:
        assert changes == 0
    else:
        assert changes > 10


# ---- clock


def test_a_million_periods_without_drift(tmp_path: Path) -> None:  # 29
    """Integer ticks: 1e6 periods of 0.1 s end at 1e5 s to the last bit, where a running sum is off."""
    tables = slider(
        duration_s=1e5,
        wall=None,
        computer={"period_s": 0.1},
        device={"start": {"q_rad": [0.0], "v_rad_per_s": [1e-5]}},
    )
    scene = scene_of(tmp_path, tables)
    made = prepare(scene, CONSTANTS, ideal(1), record=False, sample_capacity=1 << 16)
    state = made.memory.state[0]
    last: list[tuple[float, float]] = []

    def drain() -> None:
        used = int(state["samples"]["used"])
        if used:
            last[:] = [tuple(made.memory.samples[used - 1, :2])]
        state["samples"]["used"] = 0

    callback = ctypes.CFUNCTYPE(None)(drain)
    state["drain_address"] = ctypes.cast(callback, ctypes.c_void_p).value
    made.run()
    drain()
    assert last == [(999_999, 999_999 * 0.1)]  # the end itself is no sample: nothing comes of it
    assert float(state["t"]) == 1e5
    assert float(list(accumulate([0.1] * 1_000_000))[-1]) != 1e5  # what a running sum would say


@pytest.mark.parametrize("model", MODELS)
def test_samples_are_multiples_of_the_period_to_the_last_bit(tmp_path: Path, model: str) -> None:  # 29
    run = quick(tmp_path, coasting(model, 1e-3, 1.0, duration_s=100.0, computer={"period_s": 0.1}))
    assert (np.asarray(run.samples["time"]) == np.arange(1000) * 0.1).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("periods", "fraction"), [(1, 0.0), (2, 0.5), (14, 0.9)])
def test_a_delay_longer_than_a_period_loses_no_sample(
    tmp_path: Path, model: str, periods: int, fraction: float
) -> None:  # 30
    period = 3e-3
    tables = pressed(
        model, duration_s=0.15,
        computer={"period_s": period, "method": "combined", "discrete_stiffness_n_per_m": 50.0,
                  "delay_periods": periods, "delay_fraction": fraction},
        effects={"delay": True},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    t, command = np.asarray(run.signals["time"]), np.asarray(run.signals["cmd1"])
    asked = np.asarray(run.samples["cmd_nm1"])
    for tick in range(50 - periods - 2):
        held = (tick + periods + fraction) * period
        within = (t > held + 1e-9) & (t < held + period - 1e-9)
        assert within.any()
        assert np.ptp(command[within]) == 0.0
        assert command[within][0] == pytest.approx(15.625 * asked[tick], rel=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_more_samples_under_way_than_fit_are_refused(tmp_path: Path, model: str) -> None:  # 30
    tables = pressed(model, computer={"delay_periods": 15}, effects={"delay": True})
    with pytest.raises((InputError, SimulationError)) as caught:
        quick(tmp_path, tables)
    assert "sample would be lost" in str(caught.value)


# ---- geometric stiffness (footnote 2)


def test_geometric_stiffness_has_the_check_numbers() -> None:
    """l = 0.1 m twice, q = (0.6, 1.1), F = (1, -2) N on the device: K_g of the theory's worked example."""
    force = np.array([1.0, -2.0])
    push = math.hypot(*force)
    normal = -force / push  # the wall pushes against the force on the device
    q = np.array([0.6, 1.1])
    point = ARM.tip(q) + 5e-3 * normal
    plain, stiff = (
        ask(record(Method.CONTINUOUS, normal, point, geometric=on), q, np.zeros(2)) for on in (0, 1)
    )
    w = ARM.jacobian(q).T @ normal
    preload = K_DP * w @ (plain["u"][:2] - q)
    added = (stiff["ksp"] - plain["ksp"])[:2, :2] * push / preload
    wanted = np.array([[0.24161234, 0.21121741], [0.21121741, 0.21121741]])
    np.testing.assert_allclose(added, wanted, atol=1e-8)


@pytest.mark.parametrize("path", ["cmd", "u"])
@pytest.mark.parametrize("method", [Method.CONTINUOUS, Method.COMBINED], ids=lambda m: m.name.lower())
def test_apparent_stiffness_under_preload_is_the_commanded_one(method: Method, path: str) -> None:
    """Finite differences of the force that holds the device still, about the sampled pose."""
    worst = 0.0
    for q, _, normal, point in poses(60):
        c = dict(path=CommandPath.U if path == "u" else CommandPath.CMD)
        apparent = {}
        for on in (0, 1):
            x = ask(record(method, normal, point, geometric=on, **c), q, np.zeros(2))
            gains, u, cmd = x["ksp"][:2, :2].copy(), x["u"][:2].copy(), x["cmd"][:2].copy()

            def force(pose: Array) -> Array:
                """Force of the hand on the device that balances the motors."""
                torque = gains @ (u - pose) + cmd  # noqa: B023
                return -np.linalg.solve(ARM.jacobian(pose).T, torque)

            h = 1e-6
            slope = np.column_stack([(force(q + h * e) - force(q - h * e)) / (2 * h) for e in np.eye(2)])
            apparent[on] = slope @ np.linalg.inv(ARM.jacobian(q))
            if on == 0:
                held = force(q)
            else:
                # the torque at the sample is what it was: rounding of gains of a few N m/rad
                np.testing.assert_allclose(force(q), held, atol=1e-9 * (1 + np.abs(held).max()))
        wanted = K_DP * np.outer(normal, normal)
        lever = np.linalg.svd(ARM.jacobian(q))[1][-1]
        # second differences of forces of a newton over 1e-6 rad, through the smallest lever of the arm
        np.testing.assert_allclose(apparent[1], wanted, atol=1e-6 * np.abs(held).max() / lever**2 + 1e-6)
        worst = max(worst, float(np.abs(apparent[0] - wanted).max()))
    assert worst > 10.0  # and without the term it is not


def test_geometric_stiffness_goes_with_the_preload() -> None:
    """Null limit: at the surface there is no force, and nothing is added."""
    for q, _, normal, point in poses(20):
        pen = float(normal @ (point - ARM.tip(q)))
        for share in (1e-3, 1e-6):
            near = point - (1 - share) * pen * normal
            a, b = (ask(record(Method.COMBINED, normal, near, geometric=on), q, np.zeros(2)) for on in (0, 1))
            # |K_g| <= F (l1 + l2), F = (kp + k_dp) x depth, the spring's force up to second order
            room = 1.1 * (KP + K_DP) * share * pen * 0.2
            assert np.abs((a["ksp"] - b["ksp"])[:2, :2]).max() <= room
            assert np.abs((a["cmd"] - b["cmd"])[:2]).max() <= room * np.abs(a["u"][:2] - q).max() + 1e-15


@pytest.mark.parametrize("model", MODELS)
def test_every_model_gets_the_stiffer_gains(tmp_path: Path, model: str) -> None:
    zero = [0.0, 0.0]
    tables = {
        "title": "held in the wall", "duration_s": 0.02,
        "device": {
            "board": str(BOARD2), "linkage": "chain",
            "chain": {"lengths_m": [0.1, 0.1], "masses_kg": [0.1, 0.1], "coms_m": [0.05, 0.05],
                      "inertias_kg_m2": [1e-4, 1e-4]},
            "start": {"q_rad": [0.6, 1.1], "v_rad_per_s": zero},
        },
        "computer": {"period_s": 0.02, "method": "continuous", "analog_stiffness_n_per_m": 100.0},
        "wall": {"point_m": [float(a) for a in ARM.tip(np.array([0.6, 1.1])) + np.array([0.0, 5e-3])],
                 "normal": [0.0, 1.0]},
        "effects": {"geometric_stiffness": True},
        "solver": {"model": model},
    }  # fmt: skip
    run = quick(tmp_path, tables)
    q, normal = np.array([0.6, 1.1]), np.array([0.0, 1.0])
    x = ask(record(Method.CONTINUOUS, normal, ARM.tip(q) + 5e-3 * normal, kp=0.0, kd=0.0, k_dp=100.0,
                   k_dd=0.0, geometric=1), q, np.zeros(2))  # fmt: skip
    for i in range(2):
        assert run.signals[f"cmd{i + 1}"][1] == pytest.approx(15.625 * x["cmd"][i], rel=1e-9)
        for j in range(2):
            wanted = V_FS / 3.0003 * x["ksp"][i, j]
            assert run.signals[f"ksp{i + 1}{j + 1}"][1] == pytest.approx(wanted, rel=1e-9)


# ---- the start


@pytest.mark.parametrize("model", MODELS)
def test_an_inconsistent_initial_state_is_reported_and_the_consistent_one_used(
    tmp_path: Path, model: str
) -> None:  # 43
    """3 V on a capacitor and 5 V at a node contradict the circuit at rest, where both are at 0 V."""
    copytree(BOARD1.parent, tmp_path / "netlists")
    tables = merge(pressed(model, effects={"opamp": "gbw"} if model != "ideal" else {}),
                   {"device": {"board": str(tmp_path / "netlists" / "board1.cir")}})  # fmt: skip
    block = tmp_path / "netlists" / "blocks" / "diffamp.cir"
    text = block.read_text().replace("R14 inp 0 ", "C77 out 0 10p\nR14 inp 0 ")
    block.write_text(text)
    plain = quick(tmp_path, tables)
    block.write_text(text.replace("C77 out 0 10p", "C77 out 0 10p ic=3") + ".ic v(xboard.drv1)=5\n")
    run = quick(tmp_path, tables)
    rows = [note for note in run.plan["notes"] if "operating point" in note]
    assert any(".ic" in note for note in rows)
    assert any("C77" in note and "ic = 3" in note for note in rows)
    assert not any("operating point" in note for note in plain.plan["notes"])
    assert bytes_of(run) == bytes_of(plain)
