"""Limits of the analog wall: maps of exact borders, delay, the onset of a contact and what softens it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from held_scenes import at_wall
from linear_runs import CONSTANTS, ideal, lagging
from support import COMMAND_TRUE, SCENES, SPRING_TRUE, V_NM, merge, scene_of, slider

from cosim.analysis.held_contact import HeldContact, touching, with_computer
from cosim.analysis.impedance import full_scale
from cosim.analysis.stability import border, held
from cosim.analysis.stiffness_map import Axis, border_map, changed, pencil
from cosim.loop.columns import sample_columns
from cosim.scene import load_scene
from cosim.storage.checkpoint import Points
from cosim.studies.analog_limit import delay
from cosim.studies.drop_test import Falls, Job, Rest
from cosim.studies.onset import Fall, _Work, first_contact, sweep

RADIUS = 0.1333
COMMAND, SPRING = COMMAND_TRUE * V_NM, SPRING_TRUE / CONSTANTS.k_fs


def carriage(folder, period=0.025, mass=0.05, viscous=1.4618, **computer):
    """A carriage against a wall, all damping in its bearings; the circuit has no back-EMF."""
    return scene_of(
        folder,
        slider(
            computer={
                "period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
                "discrete_stiffness_n_per_m": 1.0, **computer,
            },
            device={"slider": {"mass_kg": mass, "viscous_n_m_s": viscous * RADIUS**2}},
            effects={"viscous": viscous > 0.0, "delay": True},
        ),
    )  # fmt: skip


def test_a_map_over_period_and_viscosity_is_the_closed_form(tmp_path):
    """k* = b (1 - E)/(tau (1 - E) - T E) in every cell; beyond b T/m = 3 another mode, z = -1, is first."""
    periods, viscosities = np.geomspace(3e-3, 0.1, 5), np.array([0.5, 1.0, 1.4618])
    rows = Axis("device.slider.viscous_n_m_s", tuple(viscosities * RADIUS**2))
    columns = Axis("computer.period_s", tuple(periods))
    result = border_map(carriage(tmp_path), CONSTANTS, ideal(1, emf=False), rows, columns, workers=1)
    b, t = viscosities[:, None], periods[None, :]
    tau, e = 0.05 / b, np.exp(-t * b / 0.05)
    np.testing.assert_allclose(result * COMMAND, b * (1 - e) / (tau * (1 - e) - t * e), rtol=1e-9)


@pytest.mark.parametrize("late", [0.0, 0.3, 1.6])
@pytest.mark.parametrize("path", ["cmd", "u"])
def test_a_pencil_is_the_scene_whatever_circuit_delay_and_path_are(tmp_path, late, path):
    """Against the border that knows no pencil: its root is to 1e-12, the pencil's to 1e-10."""
    scene = carriage(
        tmp_path, method="combined", analog_stiffness_n_per_m=60.0, analog_damping_n_s_per_m=0.3,
        command_path=path, delay_periods=int(late), delay_fraction=late - int(late),
    )  # fmt: skip
    circuit = lagging(ideal(1), 2e3, 300.0)
    expected = border(
        lambda k: held(at_wall(with_computer(scene, discrete_stiffness_n_per_m=k), circuit)), 1.0, 1e5
    ).value
    result = pencil(at_wall(scene, circuit)).first(1.0, 1e5)
    assert result == pytest.approx(expected, rel=1e-9)
    assert 1.0 < result < 1e5


def test_a_pencil_leaves_out_the_free_direction_of_a_chain():
    """Along the wall nothing holds a chain: its eigenvalue 1 is no border."""
    scene = load_scene(
        SCENES / "slope.toml",
        ('operator={type="mass", mass_kg=0.1}', "effects.pot_noise=none", "effects.encoder=false"),
    )
    circuit, q = ideal(2), touching(scene, CONSTANTS)
    expected = border(
        lambda k: held(
            HeldContact(with_computer(scene, discrete_stiffness_n_per_m=k), CONSTANTS, circuit, q)
        ),
        1.0,
        1e5,
    ).value
    result = pencil(HeldContact(scene, CONSTANTS, circuit, q))
    assert result.free == 1
    assert result.first(1.0, 1e5) == pytest.approx(expected, rel=1e-8)


def test_what_is_stable_nowhere_has_the_border_zero_and_what_is_always_none(tmp_path):
    scene = carriage(tmp_path, viscous=0.0)  # no braking at all
    q = touching(scene, CONSTANTS)
    assert pencil(HeldContact(scene, CONSTANTS, ideal(1, emf=False), q)).first(1.0, 1e5) == 0.0
    strong = carriage(tmp_path)
    assert pencil(HeldContact(strong, CONSTANTS, ideal(1, emf=False), q)).first(1.0, 10.0) == math.inf


def test_a_map_goes_on_where_it_was_interrupted(tmp_path):
    scene, circuit = carriage(tmp_path), ideal(1, emf=False)
    rows, columns = Axis("computer.period_s", (0.01, 0.02)), Axis("computer.delay_fraction", (0.0, 0.5))
    seen = []
    with Points(tmp_path / "map.jsonl", "a", lambda *a: seen.append(a)) as points:
        first = border_map(scene, CONSTANTS, circuit, rows, columns, points=points, workers=1)
    assert len(seen) == 2
    with Points(tmp_path / "map.jsonl", "a") as points:
        again = border_map(scene, None, None, rows, columns, points=points, workers=1)  # nothing is computed
    np.testing.assert_array_equal(first, again)


def test_only_numbers_of_the_scene_are_axes(tmp_path):
    scene = carriage(tmp_path)
    assert changed(scene, "device.slider.mass_kg", 0.3).device.slider.mass_kg == 0.3
    assert scene.device.slider.mass_kg == 0.05
    for key in ("computer.perod_s", "no.such", "computer.period_s.more"):
        with pytest.raises(KeyError):
            changed(scene, key, 1.0)


def test_delay_bounds_spring_and_damper(tmp_path):
    """One pole tau: stable iff k < b/tau + b^2/m, passive iff k <= b/tau (10501 and 10446 N/m at 1 kHz)."""
    lag, plain = lagging(ideal(1, emf=False), 1.0, 2e3 * math.pi), ideal(1, emf=False)
    circuit = replace(lag, a_pre=plain.a_pre, b_pre=plain.b_pre, c_pre=plain.c_pre, d_pre=plain.d_pre)
    scene = carriage(tmp_path, 0.1, 0.05, 1.6625, method="continuous", analog_stiffness_n_per_m=1.0,
                     discrete_stiffness_n_per_m=0.0)  # fmt: skip
    result = delay(at_wall(scene, circuit), 100.0)
    tau = 1 / (2e3 * math.pi)
    assert result.lag_s == pytest.approx(tau, rel=1e-6)
    assert result.viscosity_n_s_per_m == pytest.approx(1.6625, rel=1e-6)
    assert result.mass_kg == pytest.approx(0.05, rel=1e-12)
    assert result.spring_n_per_m * SPRING == pytest.approx(1.6625 / tau + 1.6625**2 / 0.05, rel=1e-8)
    assert result.passive_spring_n_per_m * SPRING == pytest.approx(1.6625 / tau, rel=1e-6)
    # at the border s = +-j sqrt(k/(m + b tau)), from the cubic's even part
    ring = math.sqrt(result.spring_n_per_m * SPRING / (0.05 + 1.6625 * tau)) / (2 * math.pi)
    assert result.spring_hz == pytest.approx(ring, rel=1e-6)


def test_a_damper_through_two_equal_poles_is_passive_to_eight_times_the_viscosity(tmp_path):
    """min Re c/(1 + jx)^2 = -c/8; the spring beside it, 1e-3 N/m, takes 1e-6 of b."""
    plain, pole = ideal(1, emf=False), 5e3
    circuit = replace(
        plain, model="linear", a_post=pole * np.array([[-1.0, 0.0], [1.0, -1.0]]),
        b_post=np.vstack([pole * plain.d_post, 0 * plain.d_post]), c_post=np.array([[0.0, 1.0]]),
        d_post=0 * plain.d_post,
    )  # fmt: skip
    scene = carriage(tmp_path, 0.1, 0.05, 1.6625, method="continuous", analog_stiffness_n_per_m=1.0,
                     discrete_stiffness_n_per_m=0.0)  # fmt: skip
    result = delay(at_wall(scene, circuit), 1e-3)
    assert result.passive_damper_n_s_per_m / (8 * 1.6625) == pytest.approx(1.0, rel=1e-3)


# ---- the onset


def samples_of(depths, k, onset=None):
    """Rows of samples: a spring of `k` N m/rad at the angle 0, wall below; depths in rad."""
    columns = sample_columns(1)
    rows = np.zeros((len(depths), len(columns)))
    for row, depth in zip(rows, depths, strict=True):
        for name, value in {
            "contact": float(depth > 0), "q_enc1": -depth, "u_rad1": 0.0 if depth > 0 else -depth,
            "ksp11": k if depth > 0 else 0.0,
        }.items():  # fmt: skip
            row[columns.index(name)] = value
    return rows


def test_a_contact_begins_with_k_x_and_ends_with_what_it_lets_go():
    """Onset 2 mrad, let go 1 mrad outside: k (2^2 - 1^2)/2 urad^2."""
    result = first_contact(samples_of([-0.003, 0.002, 0.005, 0.001, -0.001, -0.004], 2.0), RADIUS)
    assert result.jump_n == pytest.approx(2.0 * 0.002 / RADIUS)
    assert result.largest_n == pytest.approx(result.jump_n)
    assert result.onset_j == pytest.approx(2.0 * 0.002**2 / 2)
    assert result.contact_j == pytest.approx(2.0 * (0.002**2 - 0.001**2) / 2)
    assert first_contact(samples_of([-0.003, -0.002], 2.0), RADIUS) is None


@pytest.mark.parametrize(("period", "known"), [(0.003, 0.09), (0.025, 6.1), (0.1, 98.0)])
def test_the_worst_onset_is_that_of_theory(period, known):
    """k (v T)^2 / 2 of a 10 mm drop at k = 100, in mJ; the mean over the phases is a third."""
    v = math.sqrt(2 * 9.81 * 0.01)
    assert 1e3 * 0.5 * 100.0 * (v * period) ** 2 == pytest.approx(known, rel=0.03)  # to the digits told
    glide = Fall(1.0, 1e-9, 1e-9 * v, 0.0, v)  # neither pushed nor braked
    mean = glide.onset_j(100.0, period, 4096)
    assert mean == pytest.approx(0.5 * 100.0 * (v * period) ** 2 / 3, rel=1e-3)  # 3/(2 N) of N phases


def dropped(folder, period, **computer):
    """A drop of 10 mm on an analog wall, phases 8."""
    scene = scene_of(
        folder,
        merge(
            slider(
                computer={
                    "period_s": period, "method": "continuous", "analog_stiffness_n_per_m": 100.0,
                    "discrete_stiffness_n_per_m": 0.0, **computer,
                },
                device={"slider": {"mass_kg": 0.2, "viscous_n_m_s": 1.2 * RADIUS**2, "origin_m": [0.0, 0.01],
                                   "direction": [0.0, 1.0], "gravity_m_per_s2": [0.0, -9.81]}},
                effects={"viscous": True, "gravity": True},
            ),
            {"duration_s": 10.0, "wall": {"point_m": [0.0, 0.0], "normal": [0.0, 1.0]}},
        ),
    )  # fmt: skip
    rest = Rest(10.0, 1e-3, 1.0, 0.95, 8, 0.5, 1.05)
    return _Work(Job(scene, CONSTANTS, ideal(1, emf=False), rest), (100.0, 400.0))


def test_switching_on_at_samples_costs_rest_and_an_anchor_gives_it_back(tmp_path):
    """At 100 ms the wall adds k x^2/2 a contact; anchored springs are switched on relaxed: nothing."""
    late = sweep(dropped(tmp_path, 0.1))
    held = sweep(dropped(tmp_path, 0.1, onset="anchored"))
    ramped = sweep(dropped(tmp_path, 0.1, gain_ramp_samples=3))
    often, shares = sweep(dropped(tmp_path, 0.01))[0], sweep(dropped(tmp_path, 0.01, gain_ramp_samples=3))[0]
    # at constant speed the depths are x, x + vT, ...: the last of four steps alone is k/4 (x + 3 v T)
    assert shares["largest"] > 0.8 * 2 * often["largest"] * (3.5 / 4)
    assert shares["contact"] > 10 * often["contact"]  # (u^2 + (u+1)^2 + (u+2)^2 + (u+3)^2)/4 over u^2: 16
    for wall, anchor, ramp in zip(late, held, ramped, strict=True):
        assert wall["onset"] > 0.01
        assert anchor["jump"] == pytest.approx(0.0, abs=1e-9)
        assert anchor["contact"] < 1e-12
        assert anchor["share"] == 1.0
        assert ramp["jump"] == pytest.approx(wall["jump"] / 4, rel=1e-9)  # one share of four
    assert late[1]["share"] < 0.5


def test_the_onset_of_a_drop_is_that_of_its_fall(tmp_path):
    """Free fall with viscosity in closed form, phases and all: what the runs' first samples show."""
    work = dropped(tmp_path, 0.01)
    value = sweep(work)[0]
    tau, top = 0.2 / 1.2, 0.2 * 9.81 / 1.2
    t = 0.0
    for _ in range(60):  # Newton: 10 mm = top (t - tau (1 - exp(-t/tau)))
        t -= (top * (t - tau * -math.expm1(-t / tau)) - 0.01) / (top * -math.expm1(-t / tau)) if t else -0.045
    flight = Fall(0.2, 1.2, 0.2 * 9.81, t, top * -math.expm1(-t / tau))
    assert value["onset"] == pytest.approx(flight.onset_j(100.0 * SPRING, 0.01, 8) / SPRING, rel=1e-5)


@pytest.mark.slow
def test_a_mass_that_runs_away_ends_its_drop(tmp_path):
    """Far above any limit energy grows until the speed is absurd: not at rest, and no crash."""
    work = dropped(tmp_path, 0.1)
    job = replace(work.job, scene=work.job.scene.model_copy(update={"duration_s": 200.0}))
    assert Falls(job, "k_dp").share(5e4) == 0.0


@pytest.mark.parametrize(("dac_v", "share"), [(10.0, 1.0), (5.0, 0.5), (20.0, 1.0)])
def test_full_scale_is_the_converters_or_the_multipliers_whichever_ends_first(dac_v, share):
    """At an arm of 0.1 m, 3 N m/rad are 300 N/m; a converter of half the range gives half of it."""
    board = SimpleNamespace(k_fs=3.0, c_fs=0.07, v_fs=10.0, dac_v=dac_v)
    assert full_scale(board, np.array([0.1, -0.05])) == pytest.approx((300.0 * share, 7.0 * share), rel=1e-12)
