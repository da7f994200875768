"""Equations of motion against MuJoCo, against each other, and with every effect off."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from chains import random_chain

from mech import Chain, Hand, NoOperator, ParameterError, PointMass, Slider, UserOperator, kernels
from mech.records import new_work

mujoco = pytest.importorskip("mujoco")


def mujoco_model(linkage, tip_mass=0.0):
    """The same chain for MuJoCo: hinges about z, gravity in the plane, a mass welded to the tip."""
    text, reach = "", 0.0
    armature = linkage.armature_kg_m2.tolist()
    for i in range(linkage.n):
        text += (
            f'<body pos="{reach!r} 0 0">'
            f'<joint axis="0 0 1" armature="{armature[i]!r}" damping="{linkage.viscous_n_m_s[i]!r}"/>'
            + point(linkage.coms_m[i], linkage.masses_kg[i], linkage.inertias_kg_m2[i])
        )
        reach = linkage.lengths_m[i]
    if tip_mass:
        # MuJoCo asks for some inertia of every body; 1e-14 kg m^2 is below the bounds used here.
        text += f'<body pos="{reach!r} 0 0">' + point(0.0, tip_mass, 1e-14) + "</body>"
    text += f'<site name="tip" pos="{reach!r} 0 0"/>' + "</body>" * linkage.n
    gx, gy = linkage.gravity_m_per_s2
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="{gx!r} {gy!r} 0"/><worldbody>{text}</worldbody></mujoco>'
    )


def point(com, mass, inertia):
    about = " ".join([repr(inertia)] * 3)
    return f'<inertial pos="{com!r} 0 0" mass="{mass!r}" diaginertia="{about}"/>'


def mujoco_at(model, q, v, tau=0.0):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    for column, unit in zip(mass, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return data, mass


@pytest.mark.parametrize("n", range(1, 7))
def test_mass_matrix_and_bias_agree_with_mujoco(n):
    rng = np.random.default_rng(100 + n)
    for _ in range(10):
        linkage = random_chain(rng, n)
        model = mujoco_model(linkage)
        q, v = rng.uniform(-math.pi, math.pi, n), rng.normal(0.0, 3.0, n)
        data, mass = mujoco_at(model, q, v)
        np.testing.assert_allclose(linkage.mass_matrix(q), mass, rtol=1e-9, atol=1e-12)
        scale = np.max(np.abs(data.qfrc_bias))
        np.testing.assert_allclose(linkage.bias(q, v), data.qfrc_bias, atol=1e-9 * scale)
        np.testing.assert_allclose(linkage.forward(q), data.site("tip").xpos[:2], atol=1e-12)


@pytest.mark.parametrize("n", range(1, 7))
def test_acceleration_agrees_with_mujoco(n):
    rng = np.random.default_rng(200 + n)
    for _ in range(10):
        linkage = random_chain(rng, n, viscous_n_m_s=rng.uniform(0.0, 0.01, n))
        q, v, tau = rng.uniform(-math.pi, math.pi, n), rng.normal(0.0, 3.0, n), rng.normal(0.0, 0.3, n)
        model = mujoco_model(linkage)
        data, mass = mujoco_at(model, q, v, tau)
        # Rounding of the torques, magnified by the inverse of M.
        atol = 1e-9 * np.linalg.norm(np.linalg.inv(mass), 2) * np.max(np.abs(data.qfrc_bias))
        np.testing.assert_allclose(linkage.acceleration(q, v, tau), data.qacc, atol=atol)


@pytest.mark.parametrize("n", range(1, 7))
def test_point_mass_is_a_mass_at_the_end_of_the_last_link(n):
    rng = np.random.default_rng(300 + n)
    linkage = random_chain(rng, n)
    held = PointMass(mass_kg=0.3)
    model = mujoco_model(linkage, tip_mass=0.3)
    q, v, tau = rng.uniform(-2, 2, n), rng.normal(0.0, 3.0, n), rng.normal(0.0, 0.3, n)
    data, mass = mujoco_at(model, q, v, tau)
    np.testing.assert_allclose(linkage.mass_matrix(q, held), mass, rtol=1e-9, atol=1e-12)
    atol = 1e-9 * np.linalg.norm(np.linalg.inv(mass), 2) * np.max(np.abs(data.qfrc_bias))
    np.testing.assert_allclose(linkage.acceleration(q, v, tau, held), data.qacc, atol=atol)


def evaluate(linkage, operator, q, v, tau, t=0.0):
    work, a = new_work(), np.empty(linkage.n)
    p, op = linkage.pack(), operator.pack()
    kernels.dynamics(p[0], op[0], t, *(np.array(x, dtype=float) for x in (q, v, tau)), a, work[0])
    return a, work[0]


@pytest.mark.parametrize("n", range(1, 7))
def test_force_of_the_operator_moves_the_bare_device_alike(n):
    # The force reported, with weight and inertia, must be the one that the device alone would need.
    rng = np.random.default_rng(400 + n)
    linkage = random_chain(rng, n)
    hand = Hand(waypoints_s_m=[(0.0, 0.1, 0.2)], force_s_n=[(0.0, 1.0, -2.0)])
    for held in (PointMass(mass_kg=0.3), hand):
        q, v, tau = rng.uniform(-2, 2, n), rng.normal(0.0, 3.0, n), rng.normal(0.0, 0.3, n)
        a, work = evaluate(linkage, held, q, v, tau)
        needed = linkage.mass_matrix(q) @ a + linkage.bias(q, v) - tau
        # Differences of torques that are large with respect to the result.
        np.testing.assert_allclose(linkage.jacobian(q).T @ work["f_op"], needed, atol=1e-11)


def test_inertial_force_is_minus_mass_times_the_tips_acceleration():
    linkage = random_chain(np.random.default_rng(1), 3, gravity_m_per_s2=(0.0, 0.0))
    q, v = np.array((0.4, -0.7, 1.2)), np.array((2.0, -1.0, 3.0))
    a, work = evaluate(linkage, PointMass(mass_kg=0.3), q, v, (0.1, 0.2, 0.0))
    h = 1e-5
    before, after = (linkage.forward(q + s * v + 0.5 * s * s * a) for s in (-h, h))
    seen = (after - 2 * linkage.forward(q) + before) / h**2
    # Second differences: truncation h^2 jerk, rounding 4 eps 0.5 m / h^2 = 4e-6 m/s^2.
    np.testing.assert_allclose(work["f_op"], -0.3 * seen, atol=1e-5)


@pytest.mark.parametrize("n", range(1, 7))
def test_power_of_the_torques_is_the_rate_of_the_energy(n):
    rng = np.random.default_rng(500 + n)
    linkage = random_chain(rng, n, viscous_n_m_s=0.01, coulomb_n_m=0.02, stops_rad=[(-0.5, 0.5)] * n)
    held = Hand(waypoints_s_m=[(0.0, 0.1, 0.2), (1.0, 0.2, 0.1)])
    q, v, tau = rng.uniform(-2, 2, n), rng.normal(0.0, 3.0, n), rng.normal(0.0, 0.3, n)
    a, work = evaluate(linkage, held, q, v, tau, t=0.3)
    power = (tau + work["tau_visc"][:n] + work["tau_coul"][:n] + work["tau_stop"][:n]) @ v
    power += work["f_drive"] @ work["rdot"]
    h = 1e-6
    after, before = (sum(linkage.energy(q + s * v + 0.5 * s * s * a, v + s * a, held)) for s in (h, -h))
    # Central difference over 2 microseconds, relative to the energy over the step.
    energy = abs(after) + abs(before)
    assert power == pytest.approx((after - before) / (2 * h), abs=1e-9 * energy / h)


def test_effects_that_are_off_leave_their_null_form():
    plain = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1, coriolis=False)
    p = plain.pack()[0]
    flags = ("slider", "coriolis", "heavy", "viscous_on", "coulomb_on", "stops_on")
    assert not any(p[name] for name in flags)
    a, work = evaluate(plain, NoOperator(), (0.6, 1.1), (5.0, -9.0), (0.1, 0.2))
    np.testing.assert_allclose(plain.mass_matrix((0.6, 1.1)) @ a, (0.1, 0.2), atol=1e-14)
    for name in ("bias", "tau_visc", "tau_coul", "tau_stop", "f_op", "f_drive"):
        assert not np.any(work[name])
    full = Chain(
        lengths_m=(0.1, 0.1),
        masses_kg=0.1,
        gravity_m_per_s2=(0, -9.81),
        viscous_n_m_s=0.1,
        coulomb_n_m=0.1,
        stops_rad=[(-1, 1), (-1, 1)],
    ).pack()[0]
    assert all(full[name] for name in flags[1:])


def test_coriolis_off_keeps_the_equation_of_motion_to_the_letter():
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1, coriolis=False)
    q, v, tau = np.array((0.6, 1.1)), np.array((5.0, -9.0)), np.array((0.1, 0.2))
    a, work = evaluate(linkage, PointMass(mass_kg=0.2), q, v, tau)
    np.testing.assert_allclose(
        linkage.jacobian(q).T @ work["f_op"], linkage.mass_matrix(q) @ a - tau, atol=1e-14
    )


def test_friction_opposes_motion_and_is_reported():
    linkage = Chain(
        lengths_m=(0.1, 0.1),
        masses_kg=0.1,
        viscous_n_m_s=(0.01, 0.02),
        coulomb_n_m=(0.03, 0.04),
        coulomb_speed_rad_per_s=0.05,
    )
    _, work = evaluate(linkage, NoOperator(), (0.6, 1.1), (0.1, -2.0), (0.0, 0.0))
    np.testing.assert_allclose(work["tau_visc"][:2], (-0.001, 0.04), rtol=1e-15)
    np.testing.assert_allclose(
        work["tau_coul"][:2], (-0.03 * math.tanh(2.0), 0.04 * math.tanh(40.0)), rtol=1e-15
    )


def test_end_stop_pushes_inwards_only():
    linkage = Chain(
        lengths_m=(0.1,),
        masses_kg=0.1,
        stops_rad=[(-1.0, 2.0)],
        stop_stiffness_n_m_per_rad=50.0,
        stop_damping_n_m_s=5.0,
    )

    def torque(q, v):
        return evaluate(linkage, NoOperator(), (q,), (v,), (0.0,))[1]["tau_stop"][0]

    assert torque(1.99, 3.0) == torque(-0.99, -3.0) == 0.0
    assert torque(2.1, 0.0) == pytest.approx(-5.0)
    assert torque(-1.1, 0.0) == pytest.approx(5.0)
    assert torque(2.1, 4.0) == pytest.approx(-0.1 * (50 + 5 * 4))  # harder on the way in
    assert torque(-1.1, 4.0) == pytest.approx(0.1 * (50 - 5 * 4))  # softer on the way out
    assert torque(2.1, -11.0) == torque(-1.1, 11.0) == 0.0  # never a pull


def test_slider_is_a_mass_on_a_line():
    linkage = Slider(
        radius_m=0.02,
        mass_kg=0.05,
        direction=(0.0, 1.0),
        rotor_inertia_kg_m2=1e-6,
        gear=8.0,
        gravity_m_per_s2=(0.0, -9.81),
    )
    inertia = (0.05 + 0.05) * 0.02**2 + 64e-6
    held = PointMass(mass_kg=0.05)
    a, work = evaluate(linkage, held, (0.1,), (3.0,), (0.01,))
    assert a[0] == pytest.approx((0.01 - 0.1 * 9.81 * 0.02) / inertia, rel=1e-14)
    np.testing.assert_allclose(work["f_op"], (0.0, -0.05 * (9.81 + 0.02 * a[0])), rtol=1e-13)
    np.testing.assert_allclose(work["r"], (0.0, 0.002), rtol=1e-15)
    kinetic, lift = linkage.energy((0.1,), (3.0,), held)
    assert kinetic == pytest.approx(0.5 * inertia * 9.0, rel=1e-15)
    assert lift == pytest.approx(0.1 * 9.81 * 0.002, rel=1e-14)


@pytest.mark.parametrize("n", range(1, 7))
def test_solve_refuses_what_is_not_positive_definite(n):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    good, right = root @ root.T + np.eye(n), rng.normal(size=n)
    x, factor = right.copy(), np.zeros((6, 6))
    kernels.solve(n, good, x, factor)
    np.testing.assert_allclose(good @ x, right, atol=1e-12)
    for bad in (good - 100.0 * np.eye(n), np.full((n, n), math.nan), np.zeros((n, n))):
        x = right.copy()
        kernels.solve(n, bad, x, factor)
        assert np.all(np.isnan(x))


#: Counts allocations in a process that sees the kernels as numba does: of 1 turn, and of 100.
ALLOCATIONS = """
import numpy as np
from numba import njit
from numba.core.runtime import _nrt_python, rtsys
from mech import Chain, Hand, kernels
from mech.energy import energy
from mech.records import new_work

@njit
def many(p, op, q, v, tau, a, y, out, jac, work, times):
    for _ in range(times):
        kernels.dynamics(p, op, 0.1, q, v, tau, a, work)
        kernels.flow(p, op, 0.1, y, tau, out, work)
        energy(p, op, q, v)
        kernels.tip(p, q, a)
        kernels.tip_velocity(p, q, v, a)
        kernels.jacobian(p, q, jac)
        kernels.inverse(p, 0.2, 0.1, 1.0, y)

lengths = (0.1, 0.2, 0.15, 0.1, 0.12, 0.1)
p = Chain(lengths_m=lengths, masses_kg=0.1, viscous_n_m_s=0.01, coulomb_n_m=0.01).pack()
op = Hand(waypoints_s_m=[(0.0, 0.1, 0.2)], force_s_n=[(0.0, 1.0, 0.0)]).pack()
arrays = (np.full(6, 0.3), np.ones(6), np.zeros(6), np.empty(6), np.zeros(18), np.empty(18), np.empty((2, 6)))
_nrt_python.memsys_enable_stats()
for times in (1, 1, 100):
    before = rtsys.get_allocation_stats().alloc
    many(p[0], op[0], *arrays, new_work()[0], times)
    print(rtsys.get_allocation_stats().alloc - before)
"""


@pytest.mark.slow
def test_kernels_do_not_allocate():
    # They run inside ngspice's callbacks. Arrays that Python hands over are counted once a call of `many`,
    # whatever the number of turns inside it.
    env = {**os.environ, "COSIM_BUILDS_LIBRARIES": "1", "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", ALLOCATIONS], env=env, capture_output=True, text=True, check=True
    )
    _, one, hundred = done.stdout.split()
    assert one == hundred


def test_gravity_of_the_users_mass_is_carried_by_the_user():
    class Weight:
        mass_kg = 0.5

        def force(self, t, r, v):
            return (0.0, 0.0)

    linkage = Chain(lengths_m=(0.1,), masses_kg=0.1, gravity_m_per_s2=(0.0, -9.81))
    user = UserOperator(Weight(), "Weight")
    expected = linkage.bias((0.0,), (0.0,)) / linkage.mass_matrix((0.0,), user)[0]
    np.testing.assert_allclose(linkage.acceleration((0.0,), (0.0,), (0.0,), user), -expected, rtol=1e-14)


def test_poses_of_the_wrong_shape_or_nan_are_refused():
    linkage = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1)
    for q in ((0.1,), (0.1, math.nan), "no", (0.1, 0.2, 0.3)):
        with pytest.raises(ParameterError, match=r"q = .*: must be 2 finite numbers"):
            linkage.forward(q)
