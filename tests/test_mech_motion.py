"""Motions whose energy, period or restitution is known."""

import math

import numpy as np
import pytest
from reference.free_motion import WORKS, free_motion
from scipy.optimize import brentq

from mech import Chain, Hand, NoOperator, ParameterError, PointMass, Slider, UserOperator

G = (0.0, -9.81)


def span(linkage, motion):
    """Range of the gravity energy over the motion: the scale on which energy is exchanged [J]."""
    return np.ptp([linkage.energy(q, np.zeros(linkage.n))[1] for q in motion.q])


@pytest.mark.few(1)
@pytest.mark.parametrize("n", [1, 2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (4, 5, 6))])
def test_free_swing_keeps_its_energy_for_ten_seconds(n):
    linkage = Chain(
        lengths_m=(0.1,) * n, masses_kg=0.1, gravity_m_per_s2=G, rotor_inertia_kg_m2=1e-6, gear=8.0
    )
    motion = free_motion(linkage, [0.3] + [0.5] * (n - 1), np.zeros(n), 10.0, rtol=1e-10)
    # Required: 1e-8 relative. Tolerance 1e-10 a step over some 1e3 steps.
    assert np.max(np.abs(motion.imbalance)) <= 1e-8 * span(linkage, motion)
    assert np.all(motion.works == 0.0)


@pytest.mark.slow
def test_chaotic_swing_keeps_its_energy():
    # Hard case 15: the trajectory means nothing after some seconds, the energy does.
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.2, 0.1), gravity_m_per_s2=G)
    motion = free_motion(linkage, (1.5, 0.4), (0.0, 0.0), 10.0)
    assert np.ptp(motion.q[:, 1]) > 2 * math.pi  # the second link goes round: it is the chaotic regime
    assert np.max(np.abs(motion.imbalance)) <= 1e-8 * span(linkage, motion)


def test_pendulum_from_179_degrees():
    # Hard case 14: T / T0 = (2/pi) K(sin(179 deg / 2)) = 3.9010652.
    linkage = Chain(lengths_m=(0.25,), masses_kg=0.1, gravity_m_per_s2=G)
    inertia = linkage.mass_matrix((0.0,))[0, 0]
    small = 2 * math.pi * math.sqrt(inertia / (0.1 * 9.81 * 0.125))
    hanging = -math.pi / 2
    start = hanging + math.radians(179.0)
    motion = free_motion(linkage, (start,), (0.0,), 4.2 * small)
    passes = [
        brentq(lambda t: motion.at(t)[0][0] - hanging, a, b, xtol=1e-14)
        for a, b, one, two in zip(
            motion.time[:-1], motion.time[1:], motion.q[:-1, 0], motion.q[1:, 0], strict=True
        )
        if (one - hanging) * (two - hanging) < 0
    ]
    # Half a period between passes; eight digits are printed.
    assert 2 * (passes[1] - passes[0]) / small == pytest.approx(3.9010652, abs=0.5e-7)


@pytest.mark.slow
def test_motion_through_full_stretch_is_smooth():
    # Hard case 12: nothing inverts J, so its singularity cannot be seen in the joints.
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1)
    motion = free_motion(linkage, (0.0, 0.5), (0.0, -2.0), 1.0)
    crossing = np.flatnonzero(np.diff(np.sign(motion.q[:, 1])))
    assert crossing.size >= 1
    assert np.all(np.isfinite(motion.v))
    assert np.max(np.abs(motion.imbalance)) <= 1e-10 * motion.energy[0]


def test_end_stop_at_speed_returns_less_than_it_took():
    # Hard case 20. Depth in a Hunt-Crossley stop is below that of its spring alone, v sqrt(I/k).
    linkage = Chain(
        lengths_m=(0.1,),
        masses_kg=0.1,
        stops_rad=[(-0.5, 0.5)],
        stop_stiffness_n_m_per_rad=100.0,
        stop_damping_n_m_s=10.0,
    )
    motion = free_motion(linkage, (0.0,), (5.0,), 3.0, max_step_s=0.05)
    inertia = linkage.mass_matrix((0.0,))[0, 0]
    deepest = np.max(np.abs(motion.q)) - 0.5
    assert 0 < deepest < 5.0 * math.sqrt(inertia / 100.0)
    assert np.sum(np.diff(np.sign(motion.v[:, 0])) != 0) >= 3  # it went to and fro
    inside = np.abs(motion.q[:, 0]) < 0.5
    kept = motion.energy[inside]
    assert np.all(np.diff(kept) <= 1e-10 * kept[0])
    assert kept[-1] < 0.9 * kept[0]
    assert np.max(np.abs(motion.imbalance)) <= 1e-9 * kept[0]


def test_stop_restitution_matches_hunt_and_crossley():
    # For small damping e = 1 - (2/3) (c/k) v (Hunt and Crossley 1975), next term of the order (c v/k)^2.
    linkage = Chain(
        lengths_m=(0.1,),
        masses_kg=0.1,
        stops_rad=[(-10.0, 0.5)],
        stop_stiffness_n_m_per_rad=100.0,
        stop_damping_n_m_s=1.0,
    )
    speed = 2.0
    motion = free_motion(linkage, (0.4,), (speed,), 0.2, max_step_s=0.01)
    loss = 1.0 * speed / 100.0
    assert -motion.v[-1, 0] / speed == pytest.approx(1 - 2 / 3 * loss, abs=loss**2)


def test_ledger_closes_with_every_effect_in_force():
    linkage = Chain(
        lengths_m=(0.1, 0.1),
        masses_kg=0.1,
        gravity_m_per_s2=G,
        viscous_n_m_s=1e-3,
        coulomb_n_m=2e-3,
        coulomb_speed_rad_per_s=0.1,
        rotor_inertia_kg_m2=1e-6,
        gear=8.0,
        stops_rad=[(-1.0, 1.0), (0.1, 2.0)],
    )
    hand = Hand(waypoints_s_m=[(0.0, 0.15, 0.0), (0.5, 0.1, 0.1)], force_s_n=[(0.2, 0, 0), (0.4, 2, 1)])
    motion = free_motion(linkage, (0.2, 0.4), (0.0, 0.0), 1.0, operator=hand, tau=(0.05, -0.02), rtol=1e-10)
    works = dict(zip(WORKS, motion.works[-1], strict=True))
    assert all(works[name] != 0 for name in ("motors", "operator", "viscous", "coulomb"))
    assert np.all(np.diff(motion.works[:, 2:4], axis=0) <= 0)  # friction only takes
    exchanged = np.sum(np.abs(np.diff(motion.works, axis=0)))
    assert np.max(np.abs(motion.imbalance)) <= 1e-8 * exchanged


def test_free_direction_moves_as_force_over_mass():
    # Hard case 11 without a circuit: x = F t^2 / (2 m).
    linkage = Slider(radius_m=0.02, mass_kg=0.15)
    hand = Hand(mass_kg=0.05, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, force_s_n=[(0.0, 0.3, 0.0)])
    motion = free_motion(linkage, (0.0,), (0.0,), 2.0, operator=hand)
    assert linkage.forward(motion.q[-1])[0] == pytest.approx(0.3 * 4.0 / (2 * 0.2), rel=1e-12)


def test_mass_falls_freely_on_the_slider():
    # The paper's drop without friction: 10 mm take sqrt(2 h / g).
    linkage = Slider(
        radius_m=0.02, mass_kg=0.0, rotor_inertia_kg_m2=1e-12, direction=(0.0, 1.0), gravity_m_per_s2=G
    )
    motion = free_motion(linkage, (0.0,), (0.0,), math.sqrt(0.02 / 9.81), operator=PointMass(mass_kg=0.05))
    # The rotor's 1e-12 kg m^2 add 5e-8 of the mass.
    assert linkage.forward(motion.q[-1])[1] == pytest.approx(-0.01, rel=1e-7)


def test_hand_carries_the_tip_to_its_last_waypoint():
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=0.05)
    hand = Hand(waypoints_s_m=[(0.0, 0.1, 0.1), (1.0, 0.12, 0.08)])
    motion = free_motion(linkage, linkage.inverse((0.1, 0.1)), (0.0, 0.0), 8.0, operator=hand, rtol=1e-9)
    # The slowest mode decays with b/(2 m) = 5.3/s: exp(-37) after 7 s.
    np.testing.assert_allclose(linkage.forward(motion.q[-1]), (0.12, 0.08), atol=1e-9)


def test_dense_output_agrees_with_the_steps():
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1, gravity_m_per_s2=G)
    motion = free_motion(linkage, (0.0, 0.5), (0.0, 0.0), 0.5)
    for i in (0, len(motion.time) // 2, -1):
        q, v = motion.at(motion.time[i])
        np.testing.assert_allclose(q, motion.q[i], atol=1e-12)
        np.testing.assert_allclose(v, motion.v[i], atol=1e-11)


def test_a_force_that_becomes_nan_stops_the_motion_with_the_users_error():
    class Breaks:
        def force(self, t, r, v):
            return (math.nan, 0.0) if t > 0.1 else (0.0, 0.0)

    linkage = Chain(lengths_m=(0.1,), masses_kg=0.1)
    with pytest.raises(ParameterError, match=r"Breaks.force\(t=0\.1.*two finite numbers"):
        free_motion(linkage, (0.0,), (0.0,), 1.0, operator=UserOperator(Breaks(), "Breaks"), max_step_s=0.01)


def test_arguments_are_checked():
    linkage = Chain(lengths_m=(0.1,), masses_kg=0.1)
    with pytest.raises(ParameterError, match="duration_s"):
        free_motion(linkage, (0.0,), (0.0,), 0.0)
    with pytest.raises(ParameterError, match="tau"):
        free_motion(linkage, (0.0,), (0.0,), 1.0, tau=(1.0, 2.0), operator=NoOperator())
