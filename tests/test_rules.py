"""Limits in closed form against published numbers, against the exact border, and against simulated motion."""

import math

import numpy as np
import pytest
import sampled_wall_rules
from held_scenes import RADIUS
from linear_runs import ideal, propagate, samples
from support import COMMAND_TRUE, V_NM, scene_of, slider

from cosim.analysis import closed_form_limits

#: What the hand-made board renders of what the computer asks.
COMMAND = COMMAND_TRUE * V_NM


@pytest.mark.parametrize(
    ("mass", "viscosity", "known"),
    [
        (0.05, 1.4618, (989.0, 599.3, 307.3, 133.0, 76.5, 51.2)),
        (0.20, 1.6069, (1075.6, 647.1, 325.7, 133.0, 68.9, 37.0)),
    ],
)
def test_exact_border_of_a_held_mass(mass, viscosity, known):
    """`known` are given to four digits; beside them the double root of the map itself, by hand."""
    for period, value in zip((3e-3, 5e-3, 10e-3, 25e-3, 50e-3, 100e-3), known, strict=True):
        result = sampled_wall_rules.held_mass(mass, viscosity, period)
        assert result == pytest.approx(value, abs=0.051)
        tau = mass / viscosity
        e = math.exp(-period / tau)
        step = np.array([[1.0, tau * (1 - e)], [0.0, e]])
        push = np.array([period - tau * (1 - e), 1 - e]) / viscosity
        z = np.linalg.eigvals(step - result * np.outer(push, [1.0, 0.0]))
        assert np.abs(z).max() == pytest.approx(1.0, abs=1e-12)


def test_passive_stiffness():
    """b = 1.6625: 2 b/T; Colgate and Schenkel's own K = 1000, B = +-1, T = 1 ms needs b = 1.5."""
    for period, value in ((3e-3, 1108), (5e-3, 665), (10e-3, 333), (25e-3, 133), (50e-3, 66.5), (0.1, 33.3)):
        assert sampled_wall_rules.colgate_schenkel(1.6625, period) == pytest.approx(value, rel=2e-3)
    for damping in (1.0, -1.0):
        assert sampled_wall_rules.colgate_schenkel(1.5, 1e-3, damping) == pytest.approx(1000.0, rel=1e-12)
    assert sampled_wall_rules.colgate_schenkel(0.5, 1e-3, 1.0) == 0.0


def test_gil_and_hulin():
    """b = 0.1, T = 1 ms: 200; with B = 1 N s/m 2200, where the exact border is 2178; a sample late: 66.7."""
    assert closed_form_limits.gil_hulin(0.1, 1e-3) == pytest.approx(200.0, rel=1e-12)
    assert closed_form_limits.gil_hulin(0.1, 1e-3, 1.0) == pytest.approx(2200.0, rel=1e-12)
    assert closed_form_limits.gil_hulin(0.1, 1e-3, delay=1e-3) == pytest.approx(0.1 / 1.5e-3, rel=1e-12)
    # its condition, b T/m = 1e-3, is what it is off by: b T/(6 m)
    assert sampled_wall_rules.held_mass(0.1, 0.1, 1e-3) == pytest.approx(200.03, abs=0.006)


def test_abbott_and_okamura():
    """b = 0.1, T = 1 ms, Delta = 0.1 mm, f_c = 0.1: 200 by damping; by friction 2000."""
    assert closed_form_limits.abbott_okamura(0.1, 1e-3, 0.1, 1e-4) == pytest.approx(200.0, rel=1e-12)
    assert closed_form_limits.abbott_okamura(10.0, 1e-3, 0.1, 1e-4) == pytest.approx(2000.0, rel=1e-12)
    assert closed_form_limits.abbott_okamura(0.1, 1e-3, 0.0, 1e-4) == 0.0
    assert closed_form_limits.abbott_okamura(0.1, 1e-3, 0.0, 0.0) == pytest.approx(200.0, rel=1e-12)


def test_diolaitis_plane_and_cycle():
    """Borders at 1/2, with delay 1/2 + t_d/T; m = 0.1, b = 0.05, K = 200, T = 1 ms: a cycle of 11.39 mm."""
    at = sampled_wall_rules.diolaiti(200.0, 0.1, 1e-3, 0.01, 1e-4)
    assert (at.beta, at.sigma) == pytest.approx((0.5, 0.5), rel=1e-12)
    assert (at.beta_border, at.sigma_border) == (0.5, 0.5)
    assert sampled_wall_rules.diolaiti(200.0, 0.1, 1e-3, 0.01, 1e-4, delay=5e-4).beta_border == pytest.approx(
        1.0
    )
    assert closed_form_limits.beta_stiffness(0.1, 1e-3, 5e-4) == pytest.approx(100.0)
    regions = {
        sampled_wall_rules.diolaiti(k, 0.1, 1e-3, f, 1e-4).region
        for k in (150.0, 250.0)
        for f in (0.005, 0.02)
    }
    assert len(regions) == 4
    case = (0.1, 0.05, 1e-3, 0.02)
    result = closed_form_limits.cycle_amplitude(200.0, *case)
    assert result == pytest.approx(11.39e-3, abs=0.006e-3)
    assert closed_form_limits.stiffness_of_cycle(result, *case) == pytest.approx(200.0, rel=1e-9)
    assert closed_form_limits.cycle_amplitude(99.0, *case) == math.inf
    # without viscosity: 4 f_c sqrt(m)/(pi A T/2) = K^(3/2)
    bare = closed_form_limits.stiffness_of_cycle(0.01, 0.1, 0.0, 1e-3, 0.02)
    assert closed_form_limits.cycle_amplitude(bare, 0.1, 0.0, 1e-3, 0.02) == pytest.approx(0.01, rel=1e-9)


@pytest.mark.parametrize(("period", "known"), [(3e-3, 0.09e-3), (25e-3, 6.1e-3), (0.1, 98e-3)])
def test_energy_of_switching_on_late(period, known):
    """10 mm drop, k = 100 N/m: v^2 = 2 g h."""
    speed = math.sqrt(2.0 * 9.81 * 0.01)
    assert sampled_wall_rules.switching_energy(100.0, speed, period) == pytest.approx(known, rel=0.025)


def swing(folder, amplitude, seconds):
    """Amplitude [m] of the first and last turn: m = 0.1, b = 0.05, K = 200, T = 1 ms, f_c = 0.02."""
    stiffness, depth = 200.0, 0.2
    scene = scene_of(folder, slider(
        duration_s=seconds,
        computer={
            "period_s": 1e-3, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
            "discrete_stiffness_n_per_m": stiffness / COMMAND,
        },
        device={
            "slider": {"mass_kg": 0.1, "viscous_n_m_s": 0.05 * RADIUS**2, "coulomb_n_m": 0.02 * RADIUS},
            "start": {"q_rad": [-(depth + amplitude) / RADIUS]},
        },
        operator={"type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0,
                  "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, -stiffness * depth]]},
        effects={"viscous": True, "coulomb": True},
    ))  # fmt: skip
    pen = samples(propagate(scene, ideal(1, emf=False), rows=False), "pen") - depth
    turn = round(2.0 * math.pi * math.sqrt(0.1 / 200.0) / 1e-3)
    return np.abs(pen[:turn]).max(), np.abs(pen[-turn:]).max()


def test_a_simulated_swing_turns_at_diolaitis_cycle(tmp_path):
    """Below the amplitude a swing dies out, above it grows: between both ends lies the cycle.

    Theory averages over a turn. The hold delays by exactly T/2 only to (w T)^2/24 = 8e-5, b takes no part
    in w, and friction's own distortion of the sine is of order f_c/(K A) = 0.9 %; 2 % are allowed.
    """
    cycle = closed_form_limits.cycle_amplitude(200.0, 0.1, 0.05, 1e-3, 0.02)
    begin, end = swing(tmp_path, 0.98 * cycle, 8.0)
    assert begin == pytest.approx(0.98 * cycle, rel=0.01)
    assert end < 0.9 * begin
    begin, end = swing(tmp_path, 1.02 * cycle, 8.0)
    assert end > 1.1 * begin


@pytest.mark.parametrize(("share", "rests"), [(0.95, True), (1.05, False)])
def test_a_quantised_wall_rests_as_far_as_friction_holds_half_a_step(tmp_path, share, rests):
    """K = 2 f_c/Delta of Abbott and Okamura, sigma = 1/2 of Diolaiti: sharp where the push is between steps.

    The position is pushed to the middle between two of the forces that the wall can show: what is left on
    either side is K Delta/2, which friction holds or does not. Viscosity is plenty: 2 b/T is ten times K.
    """
    coulomb, period, pulses = 0.02, 1e-3, 1047
    step = 2.0 * math.pi / (pulses * 8) * RADIUS
    stiffness = share * 2.0 * coulomb / step
    viscosity = 10.0 * stiffness * period / 2.0
    assert closed_form_limits.abbott_okamura(viscosity, period, coulomb, step) == pytest.approx(
        stiffness / share
    )
    assert (
        sampled_wall_rules.diolaiti(stiffness, viscosity, period, coulomb, step).region == "rests"
    ) is rests
    push = 500.5 * step * stiffness
    scene = scene_of(tmp_path, slider(
        duration_s=3.0,
        computer={
            "period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
            "discrete_stiffness_n_per_m": stiffness / COMMAND,
            "encoder": {"pulses_per_rev": pulses, "decoding": 1},
        },
        device={
            "slider": {"mass_kg": 0.1, "viscous_n_m_s": viscosity * RADIUS**2,
                       "coulomb_n_m": coulomb * RADIUS},
            "start": {"q_rad": [-495.0 * step / RADIUS]},
        },
        operator={"type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0,
                  "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, -push]]},
        effects={"viscous": True, "coulomb": True, "encoder": True},
    ))  # fmt: skip
    made = propagate(scene, ideal(1, emf=False), rows=False)
    # exact tip positions of the last second
    place = samples(made, "y")[-1000:]
    moved = np.ptp(place)
    if rests:
        assert moved == 0.0
    else:
        assert 0.0 < moved < 2.0 * step
