"""Helpers of the tests that run whole scenes: small scenes from dictionaries, one simulation process for all.

The numbers of the ideal boards are computed here from the resistors in the netlists and from Ohm's law, apart
from the design constants that the computer believes: a test that compares the two tests the board as well.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from cosim.accuracy.hard_cases.hard_case import merge, toml
from cosim.circuits.decks import lockstep_deck
from cosim.errors import CosimError, SimulationError
from cosim.loop.run_messages import RunAnswer, RunRequest
from cosim.loop.spice import run_spice as simulation
from cosim.ngspice.child import Child, start_early
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.results import Run
from cosim.runner import run as run_plan
from cosim.scene import Scene, load_scene

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parent.parent
BOARD1, BOARD2 = ROOT / "netlists" / "board1.cir", ROOT / "netlists" / "board2.cir"
SCENES = ROOT / "scenes"

# What ngspice makes of the ideal parts, from netlists/: motor 5 Ohm, driver -20k/10k, summing amplifier 10k,
# difference amplifier 169k/10k, potentiometer 20 V on 340 degrees. The multiplier's 0.1 Ohm is loaded by its
# summing resistor (4e-6); what an op-amp gain of 1e9 leaves out is below 1e-7.
KT, GEAR, MOTOR_OHM, MOTOR_H = 0.04, 8.0, 5.0, 1.5e-3
POT_V = 20.0 / 5.93411946  # V/rad
SIEMENS = 2.0 / MOTOR_OHM  # A of motor current per V of the summing amplifier
TORQUE = KT * GEAR  # N m per A
SPRING_TRUE = POT_V * 16.9 * (10e3 / 24.3e3) / (1 + 0.1 / 24.3e3) * SIEMENS * TORQUE  # N m/rad at ksp = 10 V
COMMAND_TRUE = 0.5 * SIEMENS * TORQUE  # N m per V at cmd
EMF_TRUE = KT**2 * GEAR**2 / MOTOR_OHM  # N m s/rad at the joint
# What the board tells the computer.
V_RAD, K_FS, V_FS, V_NM = 3.37034, 3.0003, 10.0, 15.625


def slider(**top: Any) -> dict[str, Any]:
    """Carriage of 0.2 kg on board1, every effect in its null form; tables of `top` are merged in."""
    base: dict[str, Any] = {
        "title": "slider",
        "duration_s": 0.5,
        "device": {
            "board": str(BOARD1),
            "linkage": "slider",
            "slider": {"radius_m": 0.1333, "mass_kg": 0.2, "direction": [0.0, 1.0], "origin_m": [0.0, 0.0]},
            "start": {"q_rad": [0.0]},
        },
        "computer": {"period_s": 0.025, "method": "continuous", "analog_stiffness_n_per_m": 100.0},
        "wall": {"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
    }
    return merge(base, top)


def scene_of(folder: Path, tables: Mapping[str, Any], *overrides: str) -> Scene:
    """A scene that went through a file, as a user's does; on ngspice where the tables say nothing else."""
    file = folder / "scene.toml"
    file.write_text(toml(merge({"solver": {"model": "spice"}}, tables)))
    return load_scene(file, overrides)


_child: list[Child] = []


def shared_child() -> Child:
    """The simulation's process, shared by all tests of a session; replaced after a run that failed."""
    if not _child:
        _child.append(start_early("cosim.loop.spice.run_spice"))
    return _child[0]


def simulate(scene: Scene, out: Path | None = None) -> Run:
    """Run a scene in the shared process."""
    try:
        return run_plan(resolve(scene), out, formats=(), child=shared_child())
    except CosimError:
        _child.clear()  # a failed call ends its process
        raise


def quick(folder: Path, tables: Mapping[str, Any], *overrides: str) -> Run:
    """Scene from tables, run in the shared process; the result lies in a folder of its own."""
    number = sum(1 for _ in folder.glob("run*"))
    return simulate(scene_of(folder, tables, *overrides), folder / f"run{number}")


def at_times(run: Run, times: Array, name: str) -> Array:
    """Values of a signal at instants that are accepted points."""
    t = np.asarray(run.signals["time"])
    index = np.searchsorted(t, times - 1e-11)
    assert np.abs(t[index] - times).max() < 1e-11, "not an accepted point"
    values: Array = np.asarray(run.signals[name])[index]
    return values


def count_equations(payload: Mapping[str, Any], report: Any) -> dict[str, Any]:
    """In a child: rows of ngspice's matrix (nodes and branches) for the lockstep deck of a plan."""
    plan = payload["plan"]
    simulator = Simulator()
    simulator.load(lockstep_deck(plan.board, plan.circuit, plan.tolerances, ()).replace(".save", "*save"))
    simulator.attach(source=lambda name, t: 0.0)
    simulator.command("op")
    names = [name for name in simulator.vector_names() if name != "time"]
    return {"names": names, "count": len(names)}


def simulate_without_pole(request: RunRequest, report: Any) -> RunAnswer:
    """In a child: a run with the bound of the back-EMF's coupled pole taken away."""
    kept = simulation.back_emf_viscosity
    simulation.back_emf_viscosity = lambda simulator, circuit, state: np.zeros((circuit.joints,) * 2)
    try:
        return simulation.simulate(request, report)
    finally:
        simulation.back_emf_viscosity = kept


def simulate_unheard(request: RunRequest, report: Any) -> RunAnswer:
    """In a child: a run that fails in what ngspice itself tells of the time, not in a step."""

    def heard(progress: dict[str, Any]) -> None:
        if progress.get("time_s", 0.0) > 0.0 and "points" not in progress:
            raise SimulationError("nobody listens")
        report(progress)

    return simulation.simulate(request, heard)


class Arm:
    """The two-link arm by the textbook (Spong, Craig): kinematics and equations of motion, for one test each.

    Written out for relative angles with the usual h = -m2 l1 lc2 sin(q2) form; nothing of `mech` is used.
    """

    def __init__(self, l1: float, l2: float, m1: float, m2: float, c1: float, c2: float, i1: float, i2: float,
                 rotor: float) -> None:  # fmt: skip
        self.l1, self.l2 = l1, l2
        self.m1, self.m2, self.c1, self.c2, self.i1, self.i2 = m1, m2, c1, c2, i1, i2
        self.rotor = rotor

    def tip(self, q: Array) -> Array:
        a, b = q[0], q[0] + q[1]
        return np.array(
            [self.l1 * np.cos(a) + self.l2 * np.cos(b), self.l1 * np.sin(a) + self.l2 * np.sin(b)]
        )

    def jacobian(self, q: Array) -> Array:
        a, b = q[0], q[0] + q[1]
        return np.array(
            [
                [-self.l1 * np.sin(a) - self.l2 * np.sin(b), -self.l2 * np.sin(b)],
                [self.l1 * np.cos(a) + self.l2 * np.cos(b), self.l2 * np.cos(b)],
            ]
        )

    def inverse(self, r: Array, elbow: int = 1) -> Array:
        cosine = (r @ r - self.l1**2 - self.l2**2) / (2 * self.l1 * self.l2)
        q2 = elbow * math.acos(cosine)
        q1 = math.atan2(r[1], r[0]) - math.atan2(self.l2 * math.sin(q2), self.l1 + self.l2 * math.cos(q2))
        return np.array([q1, q2])

    def mass_and_bias(self, q: Array, v: Array, tip_mass: float) -> tuple[Array, Array]:
        """M [2, 2] and Coriolis torques [2], a point mass at the end of link 2 included."""
        # the mass at the tip moves the second link's centre of mass: add it as a third body
        l1 = self.l1
        s, c = math.sin(q[1]), math.cos(q[1])
        p2 = self.m2 * self.c2 + tip_mass * self.l2
        j2 = self.i2 + self.m2 * self.c2**2 + tip_mass * self.l2**2
        j1 = self.i1 + self.m1 * self.c1**2 + (self.m2 + tip_mass) * l1**2
        m = np.array([[j1 + j2 + 2 * l1 * p2 * c, j2 + l1 * p2 * c], [j2 + l1 * p2 * c, j2]])
        h = -l1 * p2 * s
        bias = np.array([h * (2 * v[0] * v[1] + v[1] ** 2), -h * v[0] ** 2])
        return m + self.rotor * np.eye(2), bias


def paper_law(
    arm: Arm, q: Array, v: Array, wall: tuple[Array, Array], method: str, kp: float, kd: float, k_dp: float,
    k_dd: float, path: str = "cmd",
) -> dict[str, Array]:  # fmt: skip
    """Section III in matrices: (6)-(9), (12), with R = [normal, tangent] and an inverse that is analytic."""
    point, normal = wall
    rotation = np.column_stack([normal, [normal[1], -normal[0]]])
    r, jac = arm.tip(q), arm.jacobian(q)
    pen = float(normal @ (point - r))
    zero = np.zeros((2, 2))
    out = {"pen": np.array(pen), "u": q.copy(), "ksp": zero, "ksd": zero.copy(), "cmd": np.zeros(2)}
    if not pen > 0:
        return out
    if method != "discrete":
        out["ksp"] = jac.T @ rotation @ np.diag([k_dp, 0.0]) @ rotation.T @ jac
        out["ksd"] = jac.T @ rotation @ np.diag([k_dd, 0.0]) @ rotation.T @ jac
        out["u"] = arm.inverse(r + pen * normal, 1 if q[1] > 0 else -1)
    if method == "joint_pd":
        out["ksp"], out["ksd"] = np.diag(np.diag(out["ksp"])), np.diag(np.diag(out["ksd"]))
    if method in ("discrete", "combined", "joint_pd"):
        deep = rotation @ np.diag([1.0, 0.0]) @ rotation.T
        torque = -jac.T @ (kp * deep @ (r - (r + pen * normal)) + kd * deep @ jac @ v)
        if path == "u" and method == "combined":
            out["u"] = out["u"] + np.linalg.lstsq(out["ksp"], torque, rcond=1e-9)[0]
        else:
            out["cmd"] = torque
    return out


def hand_force(tables: Mapping[str, Any], t: float, r: Array, rdot: Array) -> Array:
    """Force on the device without the hand's inertia: spring, damper about a minimum-jerk path, push."""
    way = np.array(tables["waypoints_s_m"])
    k = int(np.clip(np.searchsorted(way[:, 0], t, side="right") - 1, 0, len(way) - 1))
    goal, speed = way[k, 1:], np.zeros(2)
    if k + 1 < len(way) and t >= way[0, 0]:
        span = way[k + 1, 0] - way[k, 0]
        x = (t - way[k, 0]) / span
        step = way[k + 1, 1:] - way[k, 1:]
        goal = goal + step * (10 * x**3 - 15 * x**4 + 6 * x**5)
        speed = step * (30 * x**2 - 60 * x**3 + 30 * x**4) / span
    push = np.array(tables.get("force_s_n", [[0.0, 0.0, 0.0]]))
    wanted = np.array([np.interp(t, push[:, 0], push[:, 1]), np.interp(t, push[:, 0], push[:, 2])])
    force: Array = (
        tables["stiffness_n_per_m"] * (goal - r) + tables["damping_n_s_per_m"] * (speed - rdot) + wanted
    )
    return force


class ExactSlider:
    """The sampled one-joint device solved exactly: matrix exponentials between samples, the law written out.

    Ideal board, wall across the slider's direction. The state is (q, v, f, 1), f a force [N] at the tip that
    changes linearly; what the computer holds enters the last column.
    """

    def __init__(
        self, *, inertia: float, radius: float, viscosity: float = 0.0,
        hand: tuple[float, float, float] = (0, 0, 0), period: float, q_wall: float = 0.0, kp: float = 0.0,
        kd: float = 0.0, k_dp: float = 0.0, path: str = "cmd", encoder_step: float = 0.0,
    ) -> None:  # fmt: skip
        self.inertia, self.radius, self.viscosity, self.hand = inertia, radius, viscosity, hand
        self.period, self.q_wall, self.kp, self.kd, self.k_dp = period, q_wall, kp, kd, k_dp
        self.path, self.encoder_step = path, encoder_step

    def seen(self, q: float) -> float:
        """Angle that the encoder shows: its nearest count."""
        step = self.encoder_step
        return q if step == 0 else math.floor(q / step + 0.5) * step

    def held(self, q: float, q_before: float) -> tuple[float, float]:
        """Spring constant and constant torque until the next sample, as the circuit renders them."""
        rate = (q - q_before) / self.period
        pen = self.radius * (self.q_wall - q)
        if not pen > 0:
            return 0.0, 0.0
        torque = self.radius * (self.kp * pen - self.kd * self.radius * rate)
        k = self.k_dp * self.radius**2
        u = self.q_wall
        if self.path == "u":
            u, torque = u + torque / k, 0.0
        true = k * SPRING_TRUE / K_FS
        return true, true * u * V_RAD / POT_V + torque * COMMAND_TRUE * V_NM

    def system(self, k: float, torque: float, slope: float) -> Array:
        """Rate of (q, v, f, 1)."""
        stiffness, damping, rest = self.hand
        r, i = self.radius, self.inertia
        return np.array(
            [
                [0, 1, 0, 0],
                [
                    -(k + stiffness * r * r) / i,
                    -(self.viscosity + damping * r * r) / i,
                    r / i,
                    (torque + stiffness * r * rest) / i,
                ],
                [0, 0, 0, slope],
                [0, 0, 0, 0],
            ]
        )

    def solve(
        self, q: float, v: float, samples: int, force: list[tuple[float, float]], times: Array
    ) -> Array:
        """States (q, v) [len(times), 2] at ascending `times`; `force` are rows (t, N), linear between."""
        knots = np.array(force)
        state = np.array([q, v, force[0][1], 1.0])
        before = self.seen(q)
        out = np.zeros((len(times), 2))
        done = 0
        for n in range(samples):
            start, end = n * self.period, (n + 1) * self.period
            now = self.seen(state[0])
            k, torque = self.held(now, before)
            before = now
            inside = knots[(knots[:, 0] > start + 1e-12) & (knots[:, 0] < end - 1e-12), 0]
            edges = [start, *inside, end]
            for a, b in pairwise(edges):
                fa, fb = np.interp([a, b], knots[:, 0], knots[:, 1])
                state[2] = fa
                rate = self.system(k, torque, (fb - fa) / (b - a))
                while done < len(times) and times[done] <= b + 1e-12:
                    out[done] = (expm(rate * (times[done] - a)) @ state)[:2]
                    done += 1
                state = expm(rate * (b - a)) @ state
        assert done == len(times)
        return out
