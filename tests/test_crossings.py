"""Friction that holds and slips, stops that are hit and left: located instants against closed forms.

Circuits are those of `test_propagation`; numbers in comments are the hard cases' numbers of the project's
list. Instants are found to 2^-36 of an interval between events or to 1 ps, whichever is longer.
"""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chains import random_chain
from linear_runs import ideal, propagate, rows, samples
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from slope import RADIUS
from support import BOARD2, GEAR, merge, scene_of, slider

from cosim.errors import InputError
from cosim.loop.linear.run_linear import Propagation
from cosim.plan import resolve
from cosim.scene.mechanism import mechanism
from mech import NoOperator
from mech.energy import energy
from mech.kernels import dynamics
from mech.records import NMAX, new_work
from mech.stiction import settle

Array = Any
MASS = 0.2
INERTIA = MASS * RADIUS**2
#: A free carriage, its wall out of reach; the computer wakes once in 0.1 s.
FREE: dict[str, Any] = {
    "computer": {"period_s": 0.1},
    "wall": {"point_m": [0.0, -5.0], "normal": [0.0, 1.0]},
    "solver": {"max_step_s": 0.1},
    "effects": {"operator_dynamics": True},
}


def free(**top: Any) -> dict[str, Any]:
    return merge(slider(**FREE), top)


def pushed(force: list[list[float]], **top: Any) -> dict[str, Any]:
    """A force (rows t, N along the carriage) without a hand's mass, damping and stiffness."""
    hand = {
        "type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 0.0,
        "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[t, 0.0, f] for t, f in force],
    }  # fmt: skip
    return free(**merge({"operator": hand}, top))


def go(tmp_path: Path, tables: dict[str, Any], tol: float = 1e-12, **how: Any) -> Propagation:
    return propagate(scene_of(tmp_path, tables), ideal(1, emf=False), tol=tol, **how)


def coulomb(torque: float, **device: Any) -> dict[str, Any]:
    device = merge({"slider": {"coulomb_n_m": torque}}, device)
    return {"device": device, "effects": {"coulomb": True}}


def stops(low: float, high: float, **how: float) -> dict[str, Any]:
    return {"device": {"slider": {"stops_rad": [[low, high]], **how}}, "effects": {"end_stops": True}}


# ---- friction


def test_a_held_joint_does_not_creep(tmp_path: Path) -> None:  # 16
    weight = 9.81 * MASS * RADIUS
    tables = free(duration_s=60.0, **merge(coulomb(1.001 * weight), {"effects": {"gravity": True}}))
    made = go(tmp_path, tables)
    assert (rows(made, "q1") == 0.0).all()
    assert (rows(made, "v1") == 0.0).all()
    assert rows(made, "tau_coul1")[-1] == pytest.approx(weight, rel=1e-12)


@pytest.mark.parametrize("margin", [0.999, 1.0 - 1e-9])
def test_a_joint_slips_as_soon_as_its_load_exceeds_its_friction(tmp_path: Path, margin: float) -> None:  # 16
    weight = 9.81 * MASS * RADIUS
    made = go(tmp_path, free(**merge(coulomb(margin * weight), {"effects": {"gravity": True}})))
    fall = -0.5 * 9.81 / RADIUS * (1.0 - margin) * 0.5**2
    assert made.memory.state[0]["q"][0] == pytest.approx(fall, rel=1e-6)


def test_slip_starts_when_a_growing_force_reaches_friction(tmp_path: Path) -> None:  # 16
    # m x'' = c t - f from t* = f/c on: x = c (t - t*)^3 / (6 m)
    torque, slope = 0.02, 1.0
    made = go(tmp_path, pushed([[0.0, 0.0], [0.5, 0.5 * slope]], **coulomb(torque)))
    begun = torque / RADIUS / slope
    t = rows(made, "time")
    expected = slope * np.maximum(t - begun, 0.0) ** 3 / (6 * MASS) / RADIUS
    assert np.abs(rows(made, "q1") - expected).max() < 1e-11
    moving = t[rows(made, "v1") != 0.0]
    assert moving[0] > begun
    still = t[rows(made, "v1") == 0.0]
    assert abs(still[-1] - begun) < 1e-9


@pytest.mark.parametrize("shift", [-1, 0, 1], ids=["before", "on", "behind"])
def test_slip_on_a_sample_and_one_ulp_beside_it(tmp_path: Path, shift: int) -> None:  # 25
    # friction is reached at 0.2 s, which is a sample, or one ulp beside it
    begun = 0.2
    for _ in range(abs(shift)):
        begun = math.nextafter(begun, math.copysign(math.inf, shift))
    made = go(tmp_path, pushed([[0.0, 0.0], [0.5, 0.5]], **coulomb(begun * RADIUS)))
    expected = 0.3**3 / (6 * MASS) / RADIUS
    assert made.memory.state[0]["q"][0] == pytest.approx(expected, abs=1e-11)
    stuck = rows(made, "v1") == 0.0
    assert np.count_nonzero(np.diff(stuck)) == 1
    assert (samples(made, "tick") == np.arange(5)).all()


def test_decay_under_friction_is_linear_and_ends_held(tmp_path: Path) -> None:  # 16
    # half swings shrink by 2 f/k; at rest where |k x| <= f
    stiffness, torque, start = 20.0, 0.02, 0.31
    hand = {"type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": 0.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]]}  # fmt: skip
    tables = free(duration_s=4.0, operator=hand, **coulomb(torque, start={"q_rad": [start]}))
    made = go(tmp_path, tables)
    gap = torque / (stiffness * RADIUS**2)
    half = math.pi * math.sqrt(MASS / stiffness)
    peaks, x = [start], start
    while abs(x) > gap:
        x = -(x - math.copysign(2 * gap, x))
        peaks.append(x)
    assert len(peaks) == 4
    t, q, v = (rows(made, name) for name in ("time", "q1", "v1"))
    for i, peak in enumerate(peaks[1:], 1):
        at = np.argmin(np.abs(t - i * half))
        assert abs(t[at] - i * half) < 1e-9
        assert q[at] == pytest.approx(peak, abs=1e-10)
        assert v[at] == 0.0
    rest = t > (len(peaks) - 1) * half + 1e-9
    assert np.ptp(q[rest]) == 0.0
    assert (v[rest] == 0.0).all()


def test_stick_slip_of_a_dragged_mass(tmp_path: Path) -> None:  # 16
    # m x'' = c t - k x - f from rest: x = v s - v/w sin(w s), v = c/k, s = t - f/c; the speed v (1 - cos w s)
    # touches zero once a period, where friction is just at its limit
    stiffness, torque, slope = 40.0, 0.02, 1.0
    hand = {"mass_kg": 0.0, "stiffness_n_per_m": stiffness}
    made = go(
        tmp_path,
        pushed([[0.0, 0.0], [2.0, 2.0 * slope]], duration_s=2.0, operator=hand, **coulomb(torque)),
    )
    w, v = math.sqrt(stiffness / MASS), slope / stiffness
    s = np.maximum(rows(made, "time") - torque / RADIUS / slope, 0.0)
    assert w * s[-1] > 3 * 2 * math.pi
    expected = (v * s - v / w * np.sin(w * s)) / RADIUS
    # an instant late by d where speed and its rate are zero: d^3 v w^2 / 6 and less
    assert np.abs(rows(made, "q1") - expected).max() < 1e-9


def test_energy_lost_is_what_friction_takes(tmp_path: Path) -> None:
    tables = free(duration_s=1.0, **coulomb(0.03, start={"q_rad": [0.0], "v_rad_per_s": [3.0]}))
    made = go(tmp_path, tables)
    assert made.step.total[3] == pytest.approx(-0.5 * INERTIA * 9.0, rel=1e-9)
    assert made.memory.state[0]["q"][0] == pytest.approx(0.5 * INERTIA * 9.0 / 0.03, rel=1e-9)


ARM: dict[str, Any] = {
    "title": "arm",
    "wall": None,
    "duration_s": 0.4,
    "device": {
        "board": None,
        "linkage": "chain",
        "slider": None,
        "chain": {
            "lengths_m": [0.1, 0.1], "masses_kg": [0.1, 0.08], "coms_m": [0.05, 0.05],
            "inertias_kg_m2": [1e-4, 1e-4], "coulomb_n_m": [0.01, 0.0], "gravity_m_per_s2": [0.0, -9.81],
        },
        "start": {"q_rad": [-1.2, 0.9]},
    },
    "effects": {"coulomb": True, "gravity": True, "coriolis": True},
}  # fmt: skip


def test_one_joint_held_while_the_other_swings(tmp_path: Path) -> None:
    friction = [0.07, 2e-3]
    tables = merge(
        slider(**FREE),
        merge(ARM, {"device": {"board": str(BOARD2), "chain": {"coulomb_n_m": friction}}}),
    )
    scene = scene_of(tmp_path, tables)
    made = propagate(scene, ideal(2, emf=False), tol=1e-12)
    linkage = mechanism(scene, GEAR)
    t, q, v = rows(made, "time"), *(np.stack([rows(made, f"{k}{j}") for j in (1, 2)]) for k in ("q", "v"))

    # the same by an independent integrator, its modes found by the signs of what this one does
    held = (v[0] == 0.0) & (np.r_[v[0][1:], 0.0] == 0.0)
    assert held.any()
    assert not held.all()

    def rates(_t: float, y: Array, slide: Array, fixed: Array) -> Array:
        mass = linkage.mass_matrix(y[:2])
        torque = -linkage.bias(y[:2], y[2:]) - slide * friction
        a = np.zeros(2)
        loose = ~fixed
        a[loose] = np.linalg.solve(mass[np.ix_(loose, loose)], torque[loose])
        return np.concatenate([y[2:], a])

    def need(y: Array, slide: Array) -> float:
        """Torque that joint 1 needs to stay."""
        mass, torque = linkage.mass_matrix(y[:2]), -linkage.bias(y[:2], y[2:]) - slide * friction
        return float(mass[0, 1] * torque[1] / mass[1, 1] - torque[0])

    y, now = np.array([-1.2, 0.9, 0.0, 0.0]), 0.0
    slide, fixed = np.array([0.0, -1.0]), np.array([True, False])
    checked = 0
    while now < 0.4:
        events = []
        for j in range(2):
            if fixed[j]:
                events.append(lambda _t, y, slide=slide: friction[0] - abs(need(y, slide)))
            else:
                events.append(lambda _t, y, j=j, sign=slide[j]: sign * y[2 + j] + 1e-13)
        for event in events:
            event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
        span = solve_ivp(
            lambda t, y, slide=slide, fixed=fixed: rates(t, y, slide, fixed), (now, 0.4), y, "DOP853",
            events=events, rtol=1e-12, atol=1e-14, dense_output=True,
        )  # fmt: skip
        inside = (t >= now) & (t <= span.t[-1])
        assert np.abs(span.sol(t[inside])[:2] - q[:, inside]).max() < 1e-8
        checked += int(inside.sum())
        y, now = span.y[:, -1].copy(), float(span.t[-1])
        if span.status != 1:
            break
        for j in range(2):
            if not len(span.t_events[j]):
                continue
            if fixed[j]:
                fixed[j], slide[j] = False, -math.copysign(1.0, need(y, slide))
            else:
                y[2 + j] = 0.0
                slide[j] = 0.0
                if j == 0:
                    fixed[0] = abs(need(y, slide)) <= friction[0]
                    slide[0] = 0.0 if fixed[0] else -math.copysign(1.0, need(y, slide))
                else:
                    slide[1] = math.copysign(1.0, rates(now, y, np.array([slide[0], 0.0]), fixed)[3])
    assert checked > 0.9 * len(t)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_which_joints_start_does_not_depend_on_their_order(n: int) -> None:  # 27
    # the only pattern of held, + and - that is consistent, found by trying all of them
    rng = np.random.default_rng(3)
    moved = 0
    for _ in range(40):
        friction = rng.uniform(0.0, 0.3, n)
        linkage = random_chain(rng, n, coulomb_n_m=tuple(friction), rotor_inertia_kg_m2=1e-3)
        p, nobody, w = linkage.pack()[0], NoOperator().pack()[0], new_work()[0]
        q, v, tau, a = (np.zeros(NMAX) for _ in range(4))
        q[:n], tau[:n] = rng.uniform(-2, 2, n), rng.normal(0, 0.3, n)
        w["mode"]["located"] = 1
        settle(p, nobody, 0.0, q, v, tau, a, w)
        mass = linkage.mass_matrix(q[:n])
        wanted = tau[:n] - linkage.bias(q[:n], np.zeros(n))
        fitting = []
        for signs in itertools.product((-1, 0, 1), repeat=n):
            sign = np.array(signs)
            loose = sign != 0
            values = np.zeros(n)
            if loose.any():
                values[loose] = np.linalg.solve(mass[np.ix_(loose, loose)], (wanted - sign * friction)[loose])
            hold = mass @ values - wanted
            if (np.abs(hold[~loose]) <= friction[~loose]).all() and (values * sign >= 0).all():
                fitting.append(values)
        assert len(fitting) == 1
        moved += int((fitting[0] != 0).sum())
        assert a[:n] == pytest.approx(fitting[0], rel=1e-9, abs=1e-9)
        after = np.zeros(NMAX)
        dynamics(p, nobody, 0.0, q, v, tau, after, w)
        assert (after == a).all()
    assert moved > 20


# ---- stops


@pytest.mark.parametrize("period", [0.1, 1.0])
def test_bouncing_ball(tmp_path: Path, period: float) -> None:  # 17
    e, h, g = 0.7, 1.0, 9.81
    tables = free(
        duration_s=4.0, computer={"period_s": period},
        **merge(
            stops(0.0, 90.0, stop_restitution=e),
            {"device": {"start": {"q_rad": [h / RADIUS]}}, "effects": {"gravity": True}},
        ),
    )  # fmt: skip
    made = go(tmp_path, tables)
    t, q, v = (rows(made, name) for name in ("time", "q1", "v1"))
    first = math.sqrt(2 * h / g)
    assert first == pytest.approx(0.4515236, abs=1e-7)
    impacts = t[1:][(v[1:] > 0.0) & (q[1:] == 0.0)]
    flight = 2 * e * first
    expected = first + flight * (1 - e ** np.arange(len(impacts))) / (1 - e)
    assert len(impacts) > 30
    assert np.abs(impacts - expected).max() < 1e-7
    end = t[(q == 0.0) & (v == 0.0)][0]
    assert end == pytest.approx(2.5586340, abs=1e-7)
    assert (q >= 0.0).all()
    assert (q[t >= end] == 0.0).all()
    assert rows(made, "tau_stop1")[-1] == pytest.approx(MASS * g * RADIUS, rel=1e-12)
    assert made.step.total[4] == pytest.approx(-MASS * g * h, rel=1e-6)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("stop", [0.0, 0.3, 3.0])
@pytest.mark.parametrize(("period", "e"), [(1e-3, 0.3), (1e-3, 0.95), (1e-2, 0.1), (0.1, 0.7), (1.0, 0.95)])
def test_bouncing_on_any_stop(tmp_path: Path, period: float, e: float, stop: float, side: int) -> None:
    # 17, 50: away from zero an angle moves by whole units in its last place, which the last flights are below
    g, first = 10.0, 0.1
    height = 0.5 * g * first**2
    limits = (stop, 90.0) if side < 0 else (-90.0, stop)
    device = {
        "slider": {"gravity_m_per_s2": [0.0, side * g * RADIUS]},
        "start": {"q_rad": [stop - side * height]},
    }
    flight = 2 * e * first
    over = first + flight / (1 - e)
    tables = free(
        duration_s=1.05 * over + 2 * period, computer={"period_s": period},
        **merge(stops(*limits, stop_restitution=e), {"device": device, "effects": {"gravity": True}}),
    )  # fmt: skip
    made = go(tmp_path, tables)
    t, q, v = (rows(made, name) for name in ("time", "q1", "v1"))
    impacts = t[1:][(-side * v[1:] > 0.0) & (q[1:] == stop)]
    expected = first + flight * (1 - e ** np.arange(len(impacts))) / (1 - e)
    assert len(impacts) > math.log(1e-7) / math.log(e)  # flights of 1e-8 s are flown
    assert np.abs(impacts - expected).max() < 1e-7
    end = t[(q == stop) & (v == 0.0)][0]
    assert end == pytest.approx(over, abs=1e-7)
    assert (side * (q - stop) <= 0.0).all()
    assert (q[t >= end] == stop).all()
    assert made.step.total[4] == pytest.approx(-MASS * g * RADIUS * height * RADIUS, rel=1e-6)


@pytest.mark.parametrize("speed", [1e-3, 1e-6, 1e-9])
def test_a_soft_stop_away_from_zero_is_left_however_slowly(tmp_path: Path, speed: float) -> None:  # 20
    # half a period of the spring-mass within the stop, whatever the speed; the free path before and behind it
    k, stop, end = 20.0, 3.0, 0.15
    inside = math.pi * math.sqrt(INERTIA / k)
    gap = 1e-3 * speed
    tables = free(
        duration_s=end,
        **merge(
            stops(-90.0, stop, stop_stiffness_n_m_per_rad=k, stop_damping_n_m_s=0.0),
            {"device": {"start": {"q_rad": [stop - gap], "v_rad_per_s": [speed]}}},
        ),
    )  # fmt: skip
    state = go(tmp_path, tables, tol=1e-10 * speed).memory.state[0]
    assert state["v"][0] == pytest.approx(-speed, rel=1e-6)
    assert stop - state["q"][0] == pytest.approx(speed * (end - inside - 1e-3), rel=1e-5, abs=5e-15)


@pytest.mark.parametrize("depth", [1e-4, 1e-7, -1e-7])
def test_grazing_contact(tmp_path: Path, depth: float) -> None:  # 18, 28
    # thrown up against a stop so soft that it does nothing: both crossings lie inside one step
    speed, g = 10.0, 9.81 / RADIUS
    top = speed**2 / (2 * g)
    tables = free(
        duration_s=1.0, computer={"period_s": 1.0}, solver={"max_step_s": 1.0},
        **merge(
            stops(-90.0, top - depth, stop_stiffness_n_m_per_rad=1e-9, stop_damping_n_m_s=0.0),
            {"device": {"start": {"q_rad": [0.0], "v_rad_per_s": [speed]}}, "effects": {"gravity": True}},
        ),
    )  # fmt: skip
    made = go(tmp_path, tables)
    t, q = rows(made, "time"), rows(made, "q1")
    touched = t[q == top - depth]
    if depth < 0:
        assert len(touched) == 0
        return
    assert len(touched) == 2
    assert np.ptp(touched) == pytest.approx(2 * math.sqrt(2 * depth / g), rel=1e-6, abs=4e-9)


@pytest.mark.parametrize(("zeta", "expected"), [(0.05, 0.8545), (0.3, 0.3723)])
def test_spring_damper_contact_left_at_the_surface(
    tmp_path: Path, zeta: float, expected: float
) -> None:  # 19
    # a hand's spring and damper, entered at x = 0 with speed 1: back at x = 0 after half a damped period
    stiffness = 50.0
    w = math.sqrt(stiffness / MASS)
    half = math.pi / (w * math.sqrt(1 - zeta**2))
    hand = {"type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": stiffness,
            "damping_n_s_per_m": 2 * zeta * w * MASS, "waypoints_s_m": [[0.0, 0.0, 0.0]]}  # fmt: skip
    tables = free(
        duration_s=half, operator=hand,
        device={"start": {"q_rad": [0.0], "v_rad_per_s": [-1.0]}},
    )  # fmt: skip
    for exact in (True, False):
        state = go(tmp_path, tables, exact=exact).memory.state[0]
        assert state["v"][0] == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)), rel=1e-9)
        assert state["v"][0] == pytest.approx(expected, abs=1e-4)
        assert abs(state["q"][0]) < 1e-10


@pytest.mark.parametrize("side", [-1, 1])
def test_a_stop_that_gives_takes_what_hunt_and_crossley_say(tmp_path: Path, side: int) -> None:  # 20
    # m v dv/dx = -k x (1 + u v), u = c/k: v/u - ln(1 + u v)/u^2 is the same at both ends, deepest at v = 0
    k, c, speed = 20.0, 4.0, 2.0
    u = c / k
    tables = free(
        duration_s=0.4,
        **merge(
            stops(-0.5, 0.5, stop_stiffness_n_m_per_rad=k, stop_damping_n_m_s=c),
            {"device": {"start": {"q_rad": [0.0], "v_rad_per_s": [side * speed]}}},
        ),
    )  # fmt: skip
    made = go(tmp_path, tables)
    t, q, v = (rows(made, name) for name in ("time", "q1", "v1"))

    def left(v: float) -> float:
        return v / u - math.log1p(u * v) / u**2

    out = brentq(lambda v: left(-v) - left(speed), 0.0, speed, xtol=1e-14)
    after = np.flatnonzero((side * v < 0) & (np.abs(q) < 0.5))
    assert np.abs(v[after[:3]]) == pytest.approx(out, rel=1e-9)
    entered, exited = t[np.abs(q) == 0.5][:2]
    assert entered == pytest.approx(0.25, abs=1e-9)
    assert (rows(made, "tau_stop1")[(t > entered) & (t < exited)] * -side > 0.0).all()
    depth = math.sqrt(2 * INERTIA / k * left(speed))
    assert np.abs(q).max() <= 0.5 + depth * (1 + 1e-9)
    assert made.step.total[4] == pytest.approx(-0.5 * INERTIA * (speed**2 - out**2), rel=1e-9)


@pytest.mark.parametrize("e", [0.0, 0.6])
def test_the_ledger_closes_over_impacts_with_a_mass_at_the_tip(tmp_path: Path, e: float) -> None:
    # the device's energy changes by the works: what the operator's mass loses in an impact passes through it
    chain = {"stops_rad": [[-1.3, 0.4], [0.1, 1.2]], "stop_restitution": e}
    device = {
        "board": str(BOARD2), "chain": chain,
        "start": {"q_rad": [-0.5, 0.9], "v_rad_per_s": [2.0, -8.0]},
    }  # fmt: skip
    more = {"duration_s": 0.5, "effects": {"end_stops": True}, "device": device}
    tables = merge(slider(**FREE), merge(ARM, {**more, "operator": {"type": "mass", "mass_kg": 0.4}}))
    scene = scene_of(tmp_path, tables)
    made = propagate(scene, ideal(2, emf=False), tol=1e-11)
    p, nobody = mechanism(scene, GEAR).pack()[0], NoOperator().pack()[0]
    q, v = (np.stack([rows(made, f"{k}{j}") for j in (1, 2)], axis=1) for k in ("q", "v"))
    assert ((q[:, 1] == 0.1) | (q[:, 0] == 0.4)).any()
    held = [sum(energy(p, nobody, q[at], v[at])) for at in (0, -1)]
    assert held[1] - held[0] == pytest.approx(made.step.total.sum(), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("e", [None, 0.0, 0.6, 1.0])
def test_an_arm_on_its_stops_never_gains_energy(tmp_path: Path, e: float | None) -> None:  # 20
    chain: dict[str, Any] = {"stops_rad": [[-1.3, 0.4], [0.1, 1.2]], "coulomb_n_m": [1e-3, 1e-3]}
    if e is not None:
        chain["stop_restitution"] = e
    tables = merge(
        slider(**FREE),
        merge(
            ARM,
            {
                "duration_s": 2.0,
                "effects": {"end_stops": True},
                "device": {
                    "board": str(BOARD2), "chain": chain,
                    "start": {"q_rad": [-0.5, 0.9], "v_rad_per_s": [2.0, -8.0]},
                },
            },
        ),
    )  # fmt: skip
    scene = scene_of(tmp_path, tables)
    made = propagate(scene, ideal(2, emf=False), tol=1e-11)
    p, nobody = mechanism(scene, GEAR).pack()[0], NoOperator().pack()[0]
    q, v = (np.stack([rows(made, f"{k}{j}") for j in (1, 2)], axis=1) for k in ("q", "v"))
    held = np.array([sum(energy(p, nobody, a, b)) for a, b in zip(q, v, strict=True)])
    if e is not None:
        assert (np.diff(held) < 1e-9 * np.ptp(held)).all()
        assert q.min(axis=0) == pytest.approx([-1.3, 0.1], abs=0)
    else:
        assert held[-1] < held[0]
    lost = made.step.total.sum()
    assert held[-1] - held[0] == pytest.approx(lost, rel=1e-6)


# ---- samples


def test_a_jump_at_a_sample_keeps_both_limits(tmp_path: Path) -> None:  # 26
    # the carriage is in the wall from the start; a delay of half a period brings the gain at 0.05 s
    tables = slider(
        duration_s=0.2, device={"start": {"q_rad": [-0.1]}},
        computer={"period_s": 0.1, "delay_fraction": 0.5}, effects={"delay": True},
    )  # fmt: skip
    made = go(tmp_path, tables)
    t, gain, current = (rows(made, name) for name in ("time", "ksp11", "imot1"))
    at = np.flatnonzero(t == 0.05)
    assert len(at) == 2  # the limit from the left, and the one from the right
    assert (gain[: at[0] + 1] == 0.0).all()
    assert len(set(gain[at[1] :])) == 1
    assert gain[-1] > 0.0
    assert current[at[0]] == 0.0
    # at the very instant of the jump the spring pulls with all it has
    stiff = current[at[1]] / rows(made, "q1")[at[1]]
    assert stiff == pytest.approx(current[-1] / rows(made, "q1")[-1], rel=1e-9)


def test_impacts_are_refused_where_they_are_not_located(tmp_path: Path) -> None:
    tables = slider(**stops(-1.0, 1.0, stop_restitution=0.5))
    with pytest.raises(InputError, match="does not locate impacts"):
        resolve(scene_of(tmp_path, tables))
    bare = slider(
        device={"slider": {"stop_restitution": 0.5}}, solver={"model": "ideal"}, effects={"end_stops": True}
    )
    with pytest.raises(InputError, match="there is no stop"):
        resolve(scene_of(tmp_path, bare))
