"""Hard cases of the mechanics: free motion, friction, stops, contacts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cosim.accuracy.hard_cases.hard_case import (
    ALL,
    OWN,
    RADIUS,
    CaseRunner,
    HardCase,
    board,
    crossings,
    merge,
    slider,
)

__all__ = ["CASES"]

_G, _MASS = 9.81, 0.2
_LOCATED = "instants are located to 2^-36 of an interval between events, and rows are exact there"
_EXACT = "each interval between events is a matrix exponential: rounding"


def _hand(force: list[list[float]], stiffness: float = 0.0, damping: float = 0.0) -> dict[str, Any]:
    """Return an operator that pushes along the carriage (rows t, N), with a spring to 0."""
    return {
        "type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping,
        "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[t, 0.0, f] for t, f in force],
    }  # fmt: skip


def _free_direction(runner: CaseRunner, model: str) -> float:
    """Return how far a constant force drives along a direction that no spring holds."""
    tables = slider(operator=_hand([[0.0, 0.5]]), effects={"operator_dynamics": True})
    return float(runner.run(tables, model).signals["y"][-1])


def _drift(periods: float) -> Any:
    stiffness = 2000.0  # 1e6 periods of 20 N/m are more seconds than a scene may have
    swing = 2 * math.pi * math.sqrt(_MASS / stiffness)

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=periods * swing, operator=_hand([[0.0, 0.0]], stiffness),
            device={"start": {"q_rad": [0.1]}}, computer={"period_s": 1.0}, solver={"max_step_s": 1.0},
            effects={"operator_dynamics": True},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        energy = np.asarray(signals["e_kin"]) + 0.5 * stiffness * np.asarray(signals["y"]) ** 2
        return float(np.abs(energy / energy[0] - 1.0).max())

    return find


def _pendulum(runner: CaseRunner, model: str) -> float:
    """Period from 179 degrees over that of small swings; the motor is idle."""
    com = 0.125
    small = 2 * math.pi * math.sqrt(com / _G)
    hanging = -math.pi / 2
    tables = slider(
        duration_s=3.4 * small,
        device={
            "linkage": "chain", "slider": None,
            "chain": {"lengths_m": [0.25], "masses_kg": [0.1], "coms_m": [com], "inertias_kg_m2": [0.0]},
            "start": {"q_rad": [hanging + math.radians(179.0)]},
        },
        effects={"gravity": True}, solver={"max_step_s": 1e-3},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    t, q, v = (np.asarray(signals[name]) for name in ("time", "q1", "v1"))
    at = crossings(t, q, v, hanging)
    return float(2.0 * (at[1] - at[0]) / small)


def _chaos(runner: CaseRunner, model: str) -> float:
    """Energy that a chaotic swing of two links wins or loses in 10 s, over what it turns over."""
    tables = slider(
        duration_s=10.0,
        device={
            "board": board(2), "linkage": "chain", "slider": None,
            "chain": {"lengths_m": [0.1, 0.1], "masses_kg": [0.2, 0.1], "coms_m": [0.05, 0.05],
                      "inertias_kg_m2": [1.7e-4, 8.3e-5]},
            "start": {"q_rad": [1.5, 0.4]},
        },
        effects={"gravity": True, "coriolis": True}, solver={"max_step_s": 1e-3},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    energy = np.asarray(signals["e_kin"]) + np.asarray(signals["e_grav"])
    return float(np.ptp(energy) / np.ptp(np.asarray(signals["e_kin"])))


def _on_a_slope(margin: float, **top: Any) -> dict[str, Any]:
    weight = _G * _MASS * RADIUS
    device = {"slider": {"coulomb_n_m": margin * weight}}
    return slider(**merge({"device": device, "effects": {"coulomb": True, "gravity": True}}, top))


def _creep(runner: CaseRunner, model: str) -> float:
    tables = _on_a_slope(1.001, duration_s=60.0)
    return float(np.abs(runner.run(tables, model).signals["y"]).max())


def _slip(runner: CaseRunner, model: str) -> float:
    """Instant at which a growing force of 1 N/s moves a carriage held by 0.15 N, by how far it has got."""
    torque = 0.15 * RADIUS
    tables = slider(
        operator=_hand([[0.0, 0.0], [0.5, 0.5]]), device={"slider": {"coulomb_n_m": torque}},
        effects={"coulomb": True, "operator_dynamics": True},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    t, y, v = (np.asarray(signals[name]) for name in ("time", "y", "v1"))
    if np.any(v[t < 0.15 - 1e-9]):
        return math.nan  # it crept
    return float(t[-1] - np.cbrt(6 * _MASS * y[-1]))


def _released(what: str) -> Any:
    """Return a case of a mass on a spring of the hand's, let go on dry friction: 4.4 half swings."""
    stiffness, friction, start = 50.0, 0.15, 0.0264 / RADIUS  # N/m, N, rad: 8.8 times the range of rest

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=2.0, operator=_hand([[0.0, 0.0]], stiffness),
            device={"slider": {"coulomb_n_m": friction * RADIUS}, "start": {"q_rad": [start]}},
            effects={"coulomb": True, "operator_dynamics": True},
        )  # fmt: skip
        ran = runner.run(tables, model)
        t, y = np.asarray(ran.signals["time"]), np.asarray(ran.signals["y"])
        if what == "rest":
            return float(y[-1])
        if what == "instant":
            return float(t[np.argmax(y == y[-1])])
        return float(ran.measures["ledger_closure"]["value"])

    return find


def _bounce(which: int) -> Any:
    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=3.0,
            device={
                "slider": {"stops_rad": [[0.0, 90.0]], "stop_restitution": 0.7},
                "start": {"q_rad": [1.0 / RADIUS]},
            },
            effects={"end_stops": True, "gravity": True},
        )  # fmt: skip
        t, q, v = (np.asarray(runner.run(tables, model).signals[n]) for n in ("time", "q1", "v1"))
        if q.min() < 0.0:
            return math.nan  # it fell through
        if which == 0:
            return float(t[np.argmax(q == 0.0)])
        return float(t[np.argmax((q == 0.0) & (v == 0.0))])

    return find


def _any_stop(stop: float, e: float, side: int) -> HardCase:
    g, first = 10.0, 0.1
    height = 0.5 * g * first**2
    over = first + 2 * e * first / (1 - e)

    def find(runner: CaseRunner, model: str) -> float:
        limits = [stop, 90.0] if side < 0 else [-90.0, stop]
        tables = slider(
            duration_s=1.05 * over + 0.02, computer={"period_s": 0.01},
            device={
                "slider": {"gravity_m_per_s2": [0.0, side * g * RADIUS], "stops_rad": [limits],
                           "stop_restitution": e},
                "start": {"q_rad": [stop - side * height]},
            },
            effects={"end_stops": True, "gravity": True},
        )  # fmt: skip
        t, q, v = (np.asarray(runner.run(tables, model).signals[n]) for n in ("time", "q1", "v1"))
        return float(t[np.argmax((q == stop) & (v == 0.0))])

    where = "upper" if side > 0 else "lower"
    return HardCase(
        f"rigid stop, {where} at {stop:g} rad, e = {e:g}", 50, "instant of rest [s]", over,
        dict.fromkeys(OWN, 1e-7), _LOCATED, find, broken="gravity 0.1 % too weak",
    )  # fmt: skip


def _grazing(depth: float) -> HardCase:
    speed, g = 10.0, _G / RADIUS
    top = speed**2 / (2 * g)

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=1.0, computer={"period_s": 1.0}, solver={"max_step_s": 1.0},
            device={
                "slider": {"stops_rad": [[-90.0, top - depth]], "stop_stiffness_n_m_per_rad": 1e-9,
                           "stop_damping_n_m_s": 0.0},
                "start": {"v_rad_per_s": [speed]},
            },
            effects={"end_stops": True, "gravity": True},
        )  # fmt: skip
        t, q = (np.asarray(runner.run(tables, model).signals[n]) for n in ("time", "q1"))
        touched = t[q == top - depth]
        return float(np.ptp(touched)) if len(touched) else 0.0

    expected = 2 * math.sqrt(2 * depth / g) if depth > 0 else 0.0
    # each end is late by d where the speed is sqrt(2 depth g): the depth's last digits over it
    return HardCase(
        f"grazing contact, {depth:g} rad deep", 18, "time in contact [s]", expected,
        dict.fromkeys(OWN, 1e-6 * expected + 4e-9), "the angle's last digits over the speed there", find,
        broken="gravity 0.1 % too weak",
    )  # fmt: skip


def _restitution(zeta: float) -> HardCase:
    stiffness = 50.0
    w = math.sqrt(stiffness / _MASS)
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=math.pi / (w * math.sqrt(1 - zeta**2)),
            operator=_hand([[0.0, 0.0]], stiffness, 2 * zeta * w * _MASS),
            device={"start": {"v_rad_per_s": [-1.0]}}, effects={"operator_dynamics": True},
        )  # fmt: skip
        return float(runner.run(tables, model).signals["v1"][-1])

    bounds = {**dict.fromkeys(OWN, 1e-9), "spice": 1e-5}
    return HardCase(
        f"spring-damper contact, zeta = {zeta:g}", 19, "speed after over before", expected, bounds,
        f"{_EXACT}; spice: coupling tolerance 1e-12 rad over some 1e4 steps, and their weight h", find,
        broken="the hand's damping 0.1 % too large",
    )  # fmt: skip


CASES = (
    HardCase("singular stiffness, free direction", 11, "way in 0.5 s [m]", 0.5 * 0.5**2 / (2 * _MASS),
             {**dict.fromkeys(OWN, 1e-12), "spice": 1e-9}, f"a parabola; {_EXACT}", _free_direction,
             broken="mass 0.1 % too large"),
    HardCase("undamped spring and mass, 1e5 periods", 13, "drift of energy, relative", 0.0,
             dict.fromkeys(OWN, 1e-9), "the list's own; 6e3 products of matrices, rounding 1e-16 each",
             _drift(1e5), broken="a viscosity of 6e-15 N m s"),
    HardCase("undamped spring and mass, 1e6 periods", 13, "drift of energy, relative", 0.0,
             dict.fromkeys(OWN, 1e-9), "the list's own", _drift(1e6), slow=True,
             broken="a viscosity of 6e-15 N m s"),
    HardCase("pendulum from 179 deg", 14, "period over that of small swings", 3.9010652,
             {**dict.fromkeys(OWN, 1e-6), "spice": 1e-4},
             "the list's own; spice: 1e-12 rad a step grow 1e2 times near the top", _pendulum,
             broken="gravity 0.1 % too weak"),
    HardCase("chaotic swing of two links", 15, "drift of energy, relative", 0.0, dict.fromkeys(OWN, 1e-8),
             "the list's own, over 10 s", _chaos, broken="no Coriolis torques"),
    HardCase("stick on a slope", 16, "creep in 60 s [m]", 0.0, dict.fromkeys(ALL, 0.0),
             "a held joint does not move at all", _creep,
             broken="friction a smooth step: 0.30 m"),
    HardCase("slip of a held carriage", 16, "instant of slip [s]", 0.15,
             {**dict.fromkeys(OWN, 1e-9), "spice": 1e-7},
             f"{_LOCATED}; spice: 1e-12 rad a step, some 1e3 steps, over a speed of 0.3 m/s", _slip,
             broken="friction 0.1 % too large"),
    # a half swing takes pi sqrt(m/k) and 2 f/k of the amplitude: 26.4, 20.4, 14.4, 8.4, 2.4 mm
    HardCase("spring let go on dry friction, rest", 16, "place [m]", 0.0024,
             {**dict.fromkeys(OWN, 1e-10), "spice": 1e-8},
             "the instants of rest; spice: 1e-12 rad a step over some 1e4 steps", _released("rest"),
             broken="spice: steps end anywhere, 4e-8 m"),
    HardCase("spring let go on dry friction, instant", 16, "instant [s]", 4 * math.pi * math.sqrt(_MASS / 50),
             {**dict.fromkeys(OWN, 1e-9), "spice": 1e-6}, "the same over an acceleration of 1 m/s^2",
             _released("instant"), broken="spice: steps end anywhere, 3e-4 s"),
    HardCase("spring let go on dry friction, energy", 16, "what no work explains, share", 0.0,
             {**dict.fromkeys(OWN, 1e-9), "spice": 1e-8}, "the same", _released("energy"),
             broken="spice: steps end anywhere, 4e-8"),
    HardCase("bouncing ball, first impact", 17, "instant [s]", math.sqrt(2 / _G), dict.fromkeys(OWN, 1e-9),
             _LOCATED, _bounce(0), broken="gravity 0.1 % too weak"),
    HardCase("bouncing ball, rest", 17, "instant [s]", math.sqrt(2 / _G) * 1.7 / 0.3,
             dict.fromkeys(OWN, 1e-7), f"{_LOCATED}; some fifty bounces", _bounce(1),
             broken="gravity 0.1 % too weak"),
    *(_grazing(depth) for depth in (1e-4, 1e-7, -1e-7)),
    *(_restitution(zeta) for zeta in (0.05, 0.3)),
    *(_any_stop(stop, e, side) for stop, e, side in
      ((0.0, 0.7, -1), (0.3, 0.1, 1), (3.0, 0.95, -1), (3.0, 0.3, 1))),
)  # fmt: skip
