"""Our own time loop for the circuit models `ideal` and `linear`, against closed forms and other solvers.

Circuits are written down here from the netlists' formulas, so that the loop is tested without ngspice.
Numbers in comments are the hard cases' numbers of the project's list.
"""

import math
from dataclasses import replace
from decimal import Decimal, getcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_runs import Array, ideal, lagging, propagate, rows, samples
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from slope import ENCODER, RADIUS, slope_reference
from support import (
    COMMAND_TRUE,
    EMF_TRUE,
    GEAR,
    MOTOR_H,
    MOTOR_OHM,
    SCENES,
    SPRING_TRUE,
    TORQUE,
    V_NM,
    ExactSlider,
    merge,
    scene_of,
    slider,
)

from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError
from cosim.loop.linear import step_maps
from cosim.loop.linear.divided_differences import TOP, double, single
from cosim.loop.linear.matrix_phi import phi_functions
from cosim.loop.linear.step_layout import plan
from cosim.loop.noise import potentiometer_noise
from cosim.scene import load_scene
from cosim.scene.mechanism import mechanism
from mech import NoOperator
from mech.energy import energy

#: Rounding of some thousand steps, each of a few hundred products.
ROUNDING = 1e-11


# ---- divided differences and maps


def difference(nodes: list[float]) -> float:
    """exp[nodes] by its power series in 120 digits."""
    getcontext().prec = 120
    terms = 400
    symmetric = [Decimal(1)] + [Decimal(0)] * terms
    for node in nodes:
        for j in range(1, terms + 1):
            symmetric[j] += Decimal(node) * symmetric[j - 1]
    factorial, total = Decimal(math.factorial(len(nodes) - 1)), Decimal(0)
    for j in range(terms + 1):
        total += symmetric[j] / factorial
        factorial *= j + len(nodes)
    return float(total)


@pytest.mark.parametrize("a", [-1e-9, -0.5, -2.9, -3.1, -10.0, -40.0])
@pytest.mark.parametrize("b", [-1e-6, -0.5 - 1e-9, -2.95, -3.05, -10.00001, -10.0, -39.0])
def test_divided_differences_against_a_hundred_digits(a: float, b: float) -> None:
    of_a, of_b, both = (np.zeros(TOP + 1, complex) for _ in range(3))
    single(complex(a), of_a)
    single(complex(b), of_b)
    double(complex(a), complex(b), of_a, of_b, both)
    for r in range(TOP + 1):
        assert of_a[r] == pytest.approx(difference([a] + [0] * r), rel=1e-12)
        assert both[r] == pytest.approx(difference([a, b] + [0] * r), rel=1e-12)


@pytest.mark.parametrize("z", [-1e4, -1e8 + 3e7j, -1e13])
def test_divided_differences_of_poles_that_have_died_out(z: complex) -> None:
    # F_r = sum_k -1/(r-k)! z^-k once exp(z) is zero
    out = np.zeros(TOP + 1, complex)
    single(complex(z), out)
    for r in range(1, TOP + 1):
        expected = -sum(z**-k / math.factorial(r - k) for k in range(1, r + 1))
        assert abs(out[r] - expected) < 1e-13 * abs(expected)


def cascade(rng: Any, n: int, before: int, after: int) -> LinearCircuit:
    """A circuit of random coupled poles between 1 and 30 rad/s."""
    m = 2 * n * n

    def stable(size: int) -> Array:
        a = np.diag(-(10 ** rng.uniform(0, 1.5, size)))
        for i in range(0, size - 1, 2):
            a[i, i + 1], a[i + 1, i] = 5.0, -5.0
        q = np.linalg.qr(rng.normal(size=(size, size)))[0] if size else np.zeros((0, 0))
        return q @ a @ q.T

    shapes = {"b_pre": (before, 2 * n), "c_pre": (m, before), "d_pre": (m, 2 * n), "e_pre": (m, n),
              "gain": (m,), "b_post": (after, m + 2 * n), "c_post": (n, after),
              "d_post": (n, m + 2 * n)}  # fmt: skip
    random = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    return LinearCircuit(
        joints=n, model="linear", a_pre=stable(before), a_post=stable(after), offset=np.zeros(n),
        limit=np.array([[-math.inf, math.inf]] * n), **random,
    )  # fmt: skip


@pytest.mark.parametrize(("n", "before", "after"), [(1, 3, 2), (2, 4, 3), (2, 0, 0), (1, 0, 2), (1, 3, 0)])
def test_one_step_maps_against_the_exponential_of_everything(n: int, before: int, after: int) -> None:
    rng = np.random.default_rng(7)
    circuit, h = cascade(rng, n, before, after), 0.3
    m = len(circuit.gain)
    k = plan(circuit, range(m), gear=GEAR, commands=True, speeds=True, bent=True)
    gains, features = rng.normal(size=m), rng.normal(size=k.features)
    # a chain of integrators makes each polynomial; three more take the moments of each current
    widths = [step_maps.ANGLE] * n + [step_maps.DAC] * 2 * n + [step_maps.SPEED] * n
    start = np.cumsum([0, *widths])
    z, w = slice(0, before), slice(before, before + after)
    inputs, moments = before + after, before + after + start[-1]
    a = np.zeros((moments + 3 * n, moments + 3 * n))
    x0 = np.zeros(len(a))
    x0[:inputs] = features[:inputs]
    pins = np.zeros((4 * n, len(a)))
    rate = np.zeros((n, len(a)))
    for i, width in enumerate(widths):
        at = inputs + start[i]
        pins[i, at] = 1.0
        for power in range(width):
            x0[at + power] = features[at + power] * math.factorial(power) / h**power
            if power + 1 < width:
                a[at + power, at + power + 1] = 1.0
        if i < n:
            rate[i, at + 1] = 1.0
    a[z] = circuit.b_pre @ pins[: 2 * n]
    a[z, z] += circuit.a_pre
    x = circuit.d_pre @ pins[: 2 * n] + circuit.e_pre @ rate
    x[:, z] += circuit.c_pre
    behind = np.vstack([gains[:, None] * x, pins[2 * n :]])
    a[w] = circuit.b_post @ behind
    a[w, w] += circuit.a_post
    current = circuit.d_post @ behind
    current[:, w] += circuit.c_post
    for o in range(n):
        at = moments + 3 * o
        a[at], a[at + 1, at], a[at + 2, at + 1] = current[o], 1.0, 1.0
    x1 = expm(a * h) @ x0
    powers = np.vander(step_maps.NODES, 3, increasing=True)
    expected = np.zeros(k.results)
    for o in range(n):
        # the parabola c with int (1-x)^(l-1)/(l-1)! c dx = moment l
        table = [[math.factorial(p) / math.factorial(p + l) for p in range(3)] for l in (1, 2, 3)]  # noqa: E741
        moment = [x1[moments + 3 * o + i] / h ** (i + 1) for i in range(3)]
        expected[3 * o : 3 * o + 3] = powers @ np.linalg.solve(table, moment)
    expected[3 * n : 4 * n] = current @ x1
    expected[4 * n : 4 * n + after], expected[4 * n + after :] = x1[w], x1[z]

    out, matrix, moving = np.zeros(k.results), np.zeros((3 * n, k.moving)), np.zeros(k.moving)
    slot = step_maps.slot_of(k, h)
    step_maps.currents(k, slot, gains, features, out, matrix)
    for j in range(n):
        at = inputs + step_maps.ANGLE * j
        moving[3 * n + step_maps.ANGLE * j :][: step_maps.ANGLE] = features[at : at + step_maps.ANGLE]
        at = inputs + start[3 * n + j]
        curve = np.array([features[at + 1], 2 * features[at + 2], 3 * features[at + 3]]) / (GEAR * h)
        moving[3 * j : 3 * j + 3] = powers @ curve
    out[: 3 * n] += matrix @ moving
    for f in np.flatnonzero(k.move >= 0):
        features[f] = moving[k.move[f]]
    step_maps.finish(k, slot, gains, features, out)
    assert np.abs(out - expected).max() < 1e-12 * np.abs(expected).max()


def test_nearly_equal_poles_in_one_chain() -> None:  # 4
    # 1/((s + 1)(s + 1 + 1e-8)): t exp(-t), peak 1/e at t = 1; eigenvectors are conditioned 4e8, so 1e-7
    bare = ideal(1, emf=False)
    size = len(bare.gain)
    pre = np.array([[-1.0, 0.0], [1.0, -1.0 - 1e-8]])
    circuit = replace(
        bare, a_pre=pre, b_pre=np.array([[1.0, 0.0], [0.0, 0.0]]), c_pre=np.zeros((size, 2)),
        d_pre=0 * bare.d_pre, e_pre=0 * bare.e_pre,
    )  # fmt: skip
    circuit.c_pre[0, 1] = 1.0
    k = plan(circuit, [0], gear=GEAR, commands=False, speeds=False, bent=False)
    for h in (0.5, 1.0, 2.0):
        features, out = np.zeros(k.features), np.zeros(k.results)
        features[0] = 1.0
        step_maps.finish(k, step_maps.slot_of(k, h), np.ones(size), features, out)
        assert out[5] == pytest.approx(h * math.exp(-h), abs=1e-7)


def test_poles_that_cannot_be_told_apart_are_refused() -> None:
    bare = ideal(1)
    chain = -np.eye(3) + np.diag([1e-3, 1e-3], 1)
    with pytest.raises(InputError, match="coincide"):
        plan(
            replace(bare, a_pre=chain, b_pre=np.zeros((3, 2)), c_pre=np.zeros((2, 3))), [0], gear=GEAR,
            commands=False, speeds=False, bent=False,
        )  # fmt: skip


@pytest.mark.parametrize("h", [1e-6, 1e-3, 1.0])
def test_matrix_exponential_of_large_norm(h: float) -> None:  # 6
    # a double integrator (no eigenvectors) that drives poles up to 6e7 rad/s, each one level below the last
    a = np.zeros((6, 6))
    a[0, 1] = 1.0
    for i, pole in enumerate((3.0, 2e3, 5e5, 6e7)):
        a[2 + i, 2 + i], a[2 + i, 1 + i] = -pole, pole
    result = phi_functions(a, h, 2)
    getcontext().prec = 60
    nodes = [0, 0, -3 * h, -2e3 * h, -5e5 * h, -6e7 * h]
    # column of the integrator's speed: products of the couplings times divided differences
    values, of_b, both = (np.zeros(TOP + 1, complex) for _ in range(3))
    single(complex(nodes[2]), values)
    assert result[0][0, 1] == pytest.approx(h, rel=1e-12)
    assert result[0][2, 1] == pytest.approx((3 * h * values[1]).real, rel=1e-9)
    single(complex(nodes[3]), of_b)
    double(complex(nodes[3]), complex(nodes[2]), of_b, values, both)
    assert result[0][3, 1] == pytest.approx((3 * h * 2e3 * h * both[1]).real, rel=1e-9)
    assert np.isfinite(result[0]).all()


def exponential(a: list[list[float]], h: float) -> np.ndarray:
    """exp(a h) in 90 digits: halved until small, its power series, squared as often."""
    getcontext().prec = 90
    n, halvings = len(a), 40
    share = Decimal(h) / 2**halvings
    z = [[Decimal(x) * share for x in row] for row in a]

    def times(x: list[list[Decimal]], y: list[list[Decimal]]) -> list[list[Decimal]]:
        return [[sum((x[i][k] * y[k][j] for k in range(n)), Decimal(0)) for j in range(n)] for i in range(n)]

    out = [[Decimal(i == j) for j in range(n)] for i in range(n)]
    term = out
    for k in range(1, 20):
        term = [[x / k for x in row] for row in times(term, z)]
        out = [[x + y for x, y in zip(*rows, strict=True)] for rows in zip(out, term, strict=True)]
    for _ in range(halvings):
        out = times(out, out)
    return np.array([[float(x) for x in row] for row in out])


@pytest.mark.parametrize("h", [3.51e-4, 0.02, 0.3])
@pytest.mark.parametrize("fast", [1e4, 2e7, 6e9])
def test_a_wall_s_slow_modes_are_exact_beside_the_poles_of_amplifiers(h: float, fast: float) -> None:
    """A mass on spring and damper of a circuit: angle, speed, the differentiator's two lags, two amplifiers.

    Seen to fail with eigenvectors as `eig` returns them, right to the rounding of the fastest pole: beside
    2e7 rad/s 1e-8 of the motion was lost in 0.02 s, beside 6e9 rad/s 7e-5 in 0.3 s.
    """
    a = np.zeros((6, 6))
    a[0, 1], a[1, 5] = 1.0, 21.0
    a[2, [0, 2]], a[3, [0, 3]] = (634.0, -634.0), (9656.0, -9656.0)
    a[4, [0, 2, 3, 4]] = fast * np.array([-2.0, 130.0, -130.0, -1.0])
    a[5, [4, 5]] = 0.3 * fast, -0.3 * fast
    expected = exponential(a.tolist(), h)
    result = phi_functions(a, h, 1)[0]
    most = np.abs(expected).max(axis=0)
    assert (np.abs(result - expected) / most).max() < 2e-12  # six digits of sixteen may be lost, two are


# ---- one joint: closed forms


@pytest.mark.few(4)
@pytest.mark.parametrize("exact", [True, False], ids=["exponential", "collocation"])
@pytest.mark.parametrize("encoder", [False, True], ids=["exact angle", "encoder"])
@pytest.mark.parametrize(
    ("method", "kp", "kd", "k_dp", "path", "period"),
    [
        ("continuous", 0.0, 0.0, 100.0, "cmd", 0.025),
        ("combined", 100.0, 0.0, 100.0, "cmd", 0.01),
        ("combined", 100.0, 0.2, 100.0, "u", 0.01),
        ("discrete", 133.0, 0.0, 0.0, "cmd", 0.025),
    ],
)
def test_a_drop_follows_the_exact_sampled_solution(
    tmp_path: Path, method: str, kp: float, kd: float, k_dp: float, path: str, period: float,
    encoder: bool, exact: bool,
) -> None:  # fmt: skip
    tables = slider(
        duration_s=1.0,
        device={"slider": {"origin_m": [0.0, 0.01], "rotor_inertia_kg_m2": 2e-6}},
        operator={"type": "mass", "mass_kg": 0.05},
        computer={
            "period_s": period, "method": method, "discrete_stiffness_n_per_m": kp,
            "discrete_damping_n_s_per_m": kd, "analog_stiffness_n_per_m": k_dp, "command_path": path,
        },
        effects={"motor": "emf", "gravity": True, "encoder": encoder, "rotor_inertia": True},
    )  # fmt: skip
    made = propagate(scene_of(tmp_path, tables), ideal(1), tol=1e-13, exact=exact)
    reference = ExactSlider(
        inertia=0.25 * RADIUS**2 + 2e-6 * GEAR**2, radius=RADIUS, viscosity=EMF_TRUE, period=period,
        q_wall=-0.01 / RADIUS, kp=kp, kd=kd, k_dp=k_dp, path=path, encoder_step=ENCODER if encoder else 0.0,
    )  # fmt: skip
    states = reference.solve(0.0, 0.0, round(1.0 / period), [(0.0, -9.81 * 0.25)], rows(made, "time"))
    assert samples(made, "contact").sum() > 15
    assert np.abs(rows(made, "q1") - states[:, 0]).max() < 1e-9
    assert np.abs(rows(made, "v1") - states[:, 1]).max() < 1e-8


def period_map(tmp_path: Path, period: float, viscosity: float) -> Array:
    """Map of (q, v) over one period of a sampled spring of 1e3 N/m on 1 kg, from three runs in contact."""
    tables = slider(
        duration_s=period,
        device={"slider": {"mass_kg": 1.0, "viscous_n_m_s": viscosity * RADIUS**2}},
        computer={
            "period_s": period, "method": "discrete", "discrete_stiffness_n_per_m": 1e3,
            "analog_stiffness_n_per_m": 0.0, "command_path": "cmd",
        },
        effects={"viscous": viscosity > 0},
    )  # fmt: skip
    ends = []
    for q, v in ((-0.1, 0.0), (-0.2, 0.0), (-0.1, 0.1)):
        start = {"device": {"start": {"q_rad": [q], "v_rad_per_s": [v]}}}
        made = propagate(scene_of(tmp_path, merge(tables, start)), ideal(1, emf=False))
        ends.append(np.array([rows(made, "q1")[-1], rows(made, "v1")[-1]]))
    return np.column_stack([(ends[1] - ends[0]) / -0.1, (ends[2] - ends[0]) / 0.1])


@pytest.mark.parametrize(("period", "growth"), [(3e-3, 1.002247), (0.1, 2.449490)])
def test_sampled_spring_without_damping_grows(tmp_path: Path, period: float, growth: float) -> None:  # 21
    assert COMMAND_TRUE * V_NM == pytest.approx(1.0, rel=1e-12)
    result = math.sqrt(np.linalg.det(period_map(tmp_path, period, 0.0)))
    assert result == pytest.approx(math.sqrt(1 + 1e3 * period**2 / 2), rel=1e-9)
    assert result == pytest.approx(growth, abs=1e-6)


@pytest.mark.parametrize(("period", "border"), [(3e-3, 1.49888), (0.1, 28.7841)])
def test_sampled_spring_on_its_stability_border(tmp_path: Path, period: float, border: float) -> None:  # 22
    def radius(viscosity: float) -> float:
        return float(np.abs(np.linalg.eigvals(period_map(tmp_path, period, viscosity))).max())

    # the exact border from k* = b (1-E)/(tau (1-E) - T E), E = exp(-T b), tau = 1/b, by bisection
    low, high = 0.9 * border, 1.1 * border
    for _ in range(60):
        b = 0.5 * (low + high)
        e = math.exp(-period * b)
        low, high = (low, b) if b * (1 - e) / ((1 - e) / b - period * e) > 1e3 else (b, high)
    assert high == pytest.approx(border, rel=1e-5)
    assert radius(high * (1 - 1e-6)) > 1.0 > radius(high * (1 + 1e-6))


@pytest.mark.slow
def test_wall_entered_at_speed_is_seen_at_a_depth_within_one_period(tmp_path: Path) -> None:  # 24
    period, speed = 0.01, 0.2
    seen = []
    for phase in np.linspace(0.0, 1.0, 20, endpoint=False) + 0.025:
        start = {"q_rad": [(1.0 + phase) * speed * period / RADIUS], "v_rad_per_s": [-speed / RADIUS]}
        tables = slider(duration_s=0.03, device={"start": start}, computer={"period_s": period})
        made = propagate(scene_of(tmp_path, tables), ideal(1, emf=False))
        first = np.flatnonzero(samples(made, "contact"))[0]
        seen.append(samples(made, "pen")[first])
    assert min(seen) > 0.0
    assert max(seen) < speed * period
    assert np.mean(seen) == pytest.approx(speed * period / 2, rel=1e-9)


def pressed(mass: float = 0.2, **top: Any) -> dict[str, Any]:
    """A carriage that its weight presses on an analog spring, at rest at the start but for a small kick."""
    sag = 9.81 * mass / (100.0 * SPRING_TRUE / 3.0003) / RADIUS
    return merge(
        slider(
            device={"slider": {"mass_kg": mass}, "start": {"q_rad": [-sag], "v_rad_per_s": [0.05]}},
            effects={"gravity": True},
        ),
        top,
    )


def test_undamped_oscillation_keeps_its_energy(tmp_path: Path) -> None:  # 13
    mass = 0.025
    stiffness = 100.0 * RADIUS**2 * SPRING_TRUE / 3.0003
    inertia = mass * RADIUS**2
    per_second = math.sqrt(stiffness / inertia) / (2 * math.pi)
    made = propagate(
        scene_of(tmp_path, pressed(mass, duration_s=1e5, computer={"period_s": 1.0})),
        ideal(1, emf=False), rows=False,
    )  # fmt: skip
    assert 1e5 * per_second > 1e6
    state = made.memory.state[0]
    # where the spring, as rendered, holds the weight: u is v_rad times the wall's angle, zero
    rest = -9.81 * mass * RADIUS / stiffness
    energy = 0.5 * inertia * state["v"][0] ** 2 + 0.5 * stiffness * (state["q"][0] - rest) ** 2
    assert samples(made, "contact").all()
    assert energy == pytest.approx(0.5 * inertia * 0.05**2, rel=1e-9)


def test_integer_ticks_do_not_drift(tmp_path: Path) -> None:  # 29
    made = propagate(
        scene_of(tmp_path, pressed(duration_s=10000.0, computer={"period_s": 0.1})), ideal(1), rows=False
    )
    assert len(samples(made, "tick")) == 100_000
    assert (samples(made, "time") == np.arange(100_000) * 0.1).all()


@pytest.mark.parametrize("gbw", [1e5, 1e8])
def test_cost_and_gain_do_not_depend_on_the_bandwidth(tmp_path: Path, gbw: float) -> None:  # 1
    # 100 s at rest under its weight on the spring: the current is the weight's torque whatever the poles
    pole = 2 * math.pi * gbw / 17.9
    tables = pressed(duration_s=100.0, effects={"motor": "emf"})
    for exact in (True, False):
        made = propagate(scene_of(tmp_path, tables), lagging(ideal(1), pole, pole), rows=False, exact=exact)
        state = made.memory.state[0]
        # work, not wall time: steps, maps and their size are the same for every bandwidth
        assert state["points"] <= 4001
        assert state["rejected"] <= 1
        current = made.step.current[0]
        assert current == pytest.approx(9.81 * 0.2 * RADIUS / TORQUE, rel=1e-9)


def test_bandwidth_changes_neither_steps_nor_answer_on_an_arm(tmp_path: Path) -> None:
    scene = load_scene(
        SCENES / "slope.toml", ["effects.encoder=false", "effects.dac=false", "effects.dac_settling=false"]
    )
    poles = (2 * math.pi * 1e5, 2 * math.pi * 1e8)
    runs = [propagate(scene, lagging(ideal(2), pole, pole), rows=False) for pole in poles]
    points = [int(made.memory.state[0]["points"]) for made in runs]
    assert points[0] == pytest.approx(points[1], rel=0.1)
    ends = [made.memory.state[0]["q"][:2] for made in runs]
    # 2 / (2 pi 1e5) = 3 us of delay on 233 N/m: a negative damping of 7e-4 N s/m, 1e-4 of the arm's own
    assert np.abs(ends[0] - ends[1]).max() < 1e-4


def test_stiff_circuit_by_collocation_and_by_exponential(tmp_path: Path) -> None:
    tables = slider(
        duration_s=1.0,
        device={
            "slider": {"origin_m": [0.0, 0.01]},
            "potentiometer": {"noise_rad": 1e-3, "noise_bandwidth_hz": 170.0},
        },
        operator={
            "type": "hand", "stiffness_n_per_m": 30.0, "waypoints_s_m": [[0.0, 0.0, 0.01], [0.3, 0.0, -0.01]],
            "force_s_n": [[0.3, 0.0, 0.0], [0.61, 0.0, -1.0]],
        },
        computer={
            "period_s": 0.01, "analog_damping_n_s_per_m": 1.0, "dac": {"settling_s": 1e-4, "skew_s": 3e-4},
        },
        effects={
            "motor": "emf", "dac": True, "dac_settling": True, "dac_skew": True, "pot_noise": "white",
            "operator_dynamics": True,
        },
    )  # fmt: skip
    circuit = lagging(replace(ideal(1), e_pre=0 * ideal(1).e_pre), 3e3, MOTOR_OHM / MOTOR_H)
    scene = scene_of(tmp_path, tables)
    one, other = (propagate(scene, circuit, tol=1e-11, exact=exact) for exact in (True, False))
    assert one.exact.made[0] > 4
    t = np.arange(0, 101) * 0.01
    a, b = (np.interp(t, rows(made, "time"), rows(made, "q1")) for made in (one, other))
    assert np.abs(a - b).max() < 1e-8


def test_noise_is_the_same_path_in_every_model(tmp_path: Path) -> None:
    tables = slider(
        duration_s=0.1, seed=5,
        device={"potentiometer": {"noise_rad": 1e-3, "noise_bandwidth_hz": 200.0}},
        effects={"pot_noise": "white"},
    )  # fmt: skip
    made = propagate(scene_of(tmp_path, tables), ideal(1))
    grid = potentiometer_noise("white", 1, 5, 0.1, 1e-3, 200.0, 0.1, 2 * math.pi)
    t, seen = rows(made, "time"), rows(made, "pot1") - rows(made, "q1")
    expected = np.interp(t, np.arange(len(grid.grid)) * grid.dt, grid.grid[:, 0])
    assert np.abs(seen - expected).max() < 1e-15
    assert np.isin(np.round(np.arange(1, 40) * grid.dt, 12), np.round(t, 12)).all()


# ---- events


def test_a_kink_on_a_sample_and_one_ulp_beside_it(tmp_path: Path) -> None:  # 25
    ends = []
    for at in (0.1, math.nextafter(0.1, 0.0), math.nextafter(0.1, 1.0)):
        hand = {
            "type": "hand", "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 1.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]],
            "force_s_n": [[at, 0.0, 0.0], [0.3, 0.0, -1.0]],
        }  # fmt: skip
        made = propagate(
            scene_of(tmp_path, slider(operator=hand, effects={"operator_dynamics": True})), ideal(1)
        )
        assert (samples(made, "tick") == np.arange(len(samples(made, "tick")))).all()
        ends.append((float(made.memory.state[0]["q"][0]), len(samples(made, "tick"))))
    assert len({count for _, count in ends}) == 1
    assert np.ptp([q for q, _ in ends]) < ROUNDING


def test_samples_later_than_a_period_all_arrive(tmp_path: Path) -> None:  # 30
    tables = slider(
        duration_s=0.09,
        device={"start": {"q_rad": [-0.05]}},
        computer={"period_s": 3e-3, "method": "combined", "discrete_stiffness_n_per_m": 50.0,
                  "delay_periods": 2, "delay_fraction": 0.5},
        effects={"delay": True, "motor": "emf"},
    )  # fmt: skip
    made = propagate(scene_of(tmp_path, tables), ideal(1))
    t, command = rows(made, "time"), rows(made, "cmd1")
    asked = samples(made, "cmd_nm1") * V_NM
    for tick in range(25):
        after = np.searchsorted(t, (tick + 2.5) * 3e-3 + 1e-9)
        assert command[after] == pytest.approx(asked[tick], rel=1e-12)
    assert len(set(asked[:25])) > 20  # out of contact they are zero


@pytest.mark.few(1)
@pytest.mark.parametrize("lag", [0.0, 3e-4], ids=["ideal", "with L/R"])
def test_current_limit_reached_and_left_between_samples(tmp_path: Path, lag: float) -> None:  # 28, 40
    # 1 s without a new gain: the oscillation meets the limit twice a period, inside long steps
    limit = 0.3
    circuit = ideal(1, emf=False, limit=limit)
    if lag:
        quick = lagging(circuit, 1.0, 1.0 / lag)
        circuit = replace(
            quick, a_pre=circuit.a_pre, b_pre=circuit.b_pre, c_pre=circuit.c_pre, d_pre=circuit.d_pre
        )
    tables = slider(
        duration_s=1.0,
        device={"start": {"q_rad": [-0.9]}},
        computer={"period_s": 1.0},
        solver={"max_step_s": 0.1},
    )
    made = propagate(scene_of(tmp_path, tables), circuit, tol=1e-12)
    stiffness, inertia = 100.0 * RADIUS**2 * SPRING_TRUE / 3.0003, 0.2 * RADIUS**2

    def rates(t: float, y: Array) -> list[float]:
        wanted = -stiffness * y[0] / TORQUE
        current = y[2] if lag else wanted
        change = (wanted - y[2]) / lag if lag else 0.0
        return [y[1], TORQUE * min(max(current, -limit), limit) / inertia, change]

    start = [-0.9, 0.0, stiffness * 0.9 / TORQUE]
    t = rows(made, "time")
    reference = solve_ivp(rates, (0, 1), start, "DOP853", t, rtol=1e-12, atol=1e-14, max_step=1e-4)
    assert np.abs(rows(made, "imot1")).max() <= limit
    assert (np.abs(np.diff(np.sign(np.abs(reference.y[2]) - limit))) > 0).sum() >= 4 or not lag
    # two instants a period are found to 1 s / 2^18; the torque's error there is of second order
    assert np.abs(rows(made, "q1") - reference.y[0]).max() < 1e-8


# ---- an arm


@pytest.mark.parametrize("encoder", [False, True], ids=["exact angle", "encoder"])
@pytest.mark.parametrize("kind", ["slope", "slope_discrete", "slope_joint_pd"])
def test_slope_follows_dop853_on_the_textbook_equations(kind: str, encoder: bool) -> None:
    scene = load_scene(
        SCENES / f"{kind}.toml",
        [
            "effects.motor=emf",
            "effects.dac=false",
            "effects.dac_settling=false",
            f"effects.encoder={str(encoder).lower()}",
        ],
    )
    made = propagate(scene, ideal(2))
    times, states, forces = slope_reference(kind, encoder=encoder)
    at = np.searchsorted(rows(made, "time"), times - 1e-11)
    angle = max(np.abs(rows(made, f"q{j + 1}")[at] - states[:, j]).max() for j in range(2))
    miss = np.hypot(rows(made, "fx")[at] - forces[:, 0], rows(made, "fy")[at] - forces[:, 1])[1:]
    assert angle < 1e-8
    assert miss.max() < 1e-6 * np.hypot(*forces.T).max()


def test_long_steps_keep_what_they_promise() -> None:
    """One step a period: 81 points for 2 s, and the force within 1e-4 of its peak."""
    scene = load_scene(
        SCENES / "slope.toml", ["effects.motor=emf", "effects.dac=false", "effects.dac_settling=false"]
    )
    _, states, _ = slope_reference("slope", encoder=True)
    for tol in (1e-5, 1e-7, 1e-9):
        made = propagate(scene, ideal(2), tol=tol, rows=False)
        state = made.memory.state[0]
        error = np.abs(state["q"][:2] - states[-1, :2]).max()
        assert error < 10 * tol
        assert error < 2 * state["defect_sum"] + 1e-9 or tol > 1e-6
    scene = load_scene(
        SCENES / "slope.toml",
        ["effects.motor=emf", "effects.dac=false", "effects.dac_settling=false", "effects.encoder=false"],
    )
    made = propagate(scene, ideal(2), tol=1e-6, rows=False)
    assert made.memory.state[0]["points"] < 100


def test_energy_account_closes(tmp_path: Path) -> None:
    scene = load_scene(SCENES / "slope.toml", ["effects.dac=false", "effects.dac_settling=false"])
    circuit = lagging(replace(ideal(2), e_pre=0 * ideal(2).e_pre), 1e6, MOTOR_OHM / MOTOR_H)
    made = propagate(scene, circuit)
    state = made.memory.state[0]
    linkage, nobody = mechanism(scene, GEAR), NoOperator().pack()[0]
    held = sum(energy(linkage.pack()[0], nobody, state["q"], state["v"]))
    turned = np.abs(made.step.total).sum()
    assert turned > 0.02
    assert abs(held - made.step.total.sum()) < 1e-7 * turned


def test_the_current_behind_an_event_is_the_limited_one(tmp_path: Path) -> None:
    """Where the stepper moves (friction has instants of its own), the first row stands behind an event."""
    limit, friction = 0.3, 1e-6
    tables = slider(
        duration_s=0.1, device={"start": {"q_rad": [-0.9]}}, effects={"coulomb": True},
        computer={"period_s": 0.02},
    )  # fmt: skip
    tables["device"]["slider"]["coulomb_n_m"] = friction
    made = propagate(scene_of(tmp_path, tables), ideal(1, emf=False, limit=limit), tol=1e-9)
    assert rows(made, "imot1")[0] == limit  # the spring asks for 5 A
    assert np.abs(rows(made, "imot1")).max() <= limit
    inertia = 0.2 * RADIUS**2
    assert rows(made, "a1")[0] == pytest.approx(TORQUE * limit / inertia, rel=1e-4)
    assert np.abs(rows(made, "a1")).max() <= (TORQUE * limit + friction) / inertia * (1 + 1e-12)
