"""Hard cases of instants: knots beside samples, jumps, simultaneous and repeated contacts, long delays."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
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
    slider,
)

__all__ = ["CASES"]

_SPRING = """
from cosim.loop.userlaw import Command
class Spring:
    def control(self, sample):
        return Command(u_rad=0 * sample.q_rad, stiffness=[[0.5]] if sample.tick else [[0.0]])
"""
_COUNTS = """
from cosim.loop.userlaw import Command
class Counts:
    def control(self, sample):
        return Command(torque_n_m=0.01 * (1 + sample.tick % 7))
"""


def _pushed() -> float:
    """Return where a push ends [m]: 0.2 s of a force growing to 1 N on 0.2 kg and 1 N s/m, 0.2 s of 1 N."""
    tau, s = 0.2, 0.2
    left = math.exp(-s / tau)
    v, x = -5.0 * (s - tau * (1 - left)), -5.0 * (s * s / 2 - tau * s + tau**2 * (1 - left))
    return x - s + (v + 1.0) * tau * (1 - left)


def _beside_a_sample(runner: CaseRunner, model: str) -> float:
    """Largest change of where a push ends that begins on a sample, an ulp before or an ulp behind it.

    No number where it ends elsewhere than it should.
    """
    ends = []
    for at in (0.1, math.nextafter(0.1, 0.0), math.nextafter(0.1, 1.0)):
        hand = {
            "type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 1.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[at, 0.0, 0.0], [0.3, 0.0, -1.0]],
        }  # fmt: skip
        ran = runner.run(slider(operator=hand, effects={"operator_dynamics": True}), model)
        if len(ran.samples["time"]) != 5:
            return math.nan  # a sample was lost, or fired twice
        ends.append(float(ran.signals["y"][-1]))
    if not abs(ends[0] / _pushed() - 1.0) < 1e-6:
        return math.nan
    return float(np.ptp(ends)) / abs(ends[0])


def _both_limits(friction_n_m: float, runner: CaseRunner, model: str) -> float:
    """Return the current at the right of the first gain's jump, over that of a spring at this very angle."""
    tables = slider(
        duration_s=0.2,
        device={"start": {"q_rad": [0.12], "v_rad_per_s": [-1.0]}, "slider": {"coulomb_n_m": friction_n_m}},
        computer={"law": "law.py:Spring"}, effects={"coulomb": friction_n_m > 0.0},
        solver={"rtol": 1e-9},  # Newton's last iteration but one is what ngspice hands over
    )  # fmt: skip
    signals = runner.run(tables, model, _SPRING).signals
    t, q, i = (np.asarray(signals[name]) for name in ("time", "q1", "imot1"))
    at = np.flatnonzero(t == 0.1)
    if len(at) != 2 or i[at[0]] != 0.0:
        return math.nan  # a limit is missing, or the left one knows of the jump
    return float(i[at[1]] / q[at[1]] / (i[-1] / q[-1]))


def _two_links(stops: list[float], speeds: list[float]) -> dict[str, Any]:
    zero = [0.0, 0.0]
    return slider(
        duration_s=2.5,
        device={
            "board": board(2), "linkage": "chain", "slider": None,
            "chain": {"lengths_m": [0.1, 0.1], "masses_kg": [0.1, 0.1], "coms_m": [0.05, 0.05],
                      "inertias_kg_m2": [8e-5, 8e-5], "stop_restitution": 0.8,
                      "stops_rad": [[-stop, stop] for stop in stops]},
            "start": {"q_rad": zero, "v_rad_per_s": speeds},
        },
        effects={"end_stops": True},
    )  # fmt: skip


def _simultaneous(runner: CaseRunner, model: str) -> float:
    """Return how far two links that strike their stops at the same instants are from where they should be.

    The inertia of one is felt by the other, and without Coriolis torques both go straight. Impulses at both
    stops turn both speeds around: v' = -e v has impulses -(1 + e) M v, which push away from either stop. An
    impact of one joint alone would change the other's speed. The slower one goes to its stop of 0.5 rad with
    1 rad/s, to the other with 0.8, and on with 0.64; the faster one does twice of it, whichever it is.
    """
    knots = [0.0, 0.5, 0.5 + 1.0 / 0.8, 0.5 + 1.0 / 0.8 + 1.0 / 0.64], [0.0, 0.5, -0.5, 0.5]
    worst = 0.0
    for sizes in ((1.0, 2.0), (2.0, 1.0)):
        tables = _two_links([0.5 * size for size in sizes], [*sizes])
        signals = runner.run(tables, model).signals
        right = np.interp(np.asarray(signals["time"]), *knots)
        for name, size in zip(("q1", "q2"), sizes, strict=True):
            worst = max(worst, float(np.abs(np.asarray(signals[name]) - size * right).max()))
    return worst


def _hits(which: int) -> Callable[[CaseRunner, str], float]:
    """Return what finds the instant of a hit of a carriage between stops, several hits in one step."""

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=0.1, solver={"max_step_s": 0.1},
            device={"slider": {"stops_rad": [[-0.2, 0.2]], "stop_restitution": 1.0},
                    "start": {"v_rad_per_s": [10.0]}},
            effects={"end_stops": True},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        t, q = (np.asarray(signals[name]) for name in ("time", "q1"))
        hits = np.unique(t[np.abs(q) == 0.2])
        return float(hits[which]) if len(hits) > which else math.nan

    return find


def _dip(what: str) -> Callable[[CaseRunner, str], float]:
    """Return what finds when a flight's top enters or leaves a stop 0.2 mrad below it, within one step."""

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=0.1, solver={"max_step_s": 0.1, "coupling_tolerance_rad": 1e-9},
            device={"slider": {"stops_rad": [[-90.0, _STOP]], "stop_stiffness_n_m_per_rad": _STIFF,
                               "stop_damping_n_m_s": 0.0},
                    "start": {"v_rad_per_s": [1.0]}},
            effects={"end_stops": True, "gravity": True},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        t, q, v = (np.asarray(signals[name]) for name in ("time", "q1", "v1"))
        at = crossings(t, q, v, _STOP)
        at = t[q == _STOP] if model in OWN else at  # our own loop has rows there
        return float(at[0] if what == "enters" else at[-1]) if len(at) == 2 else math.nan

    return find


def _lost_samples(runner: CaseRunner, model: str) -> float:
    """Return how many of 25 commands do not arrive 2.5 periods after their sample."""
    period = 3e-3
    tables = slider(
        duration_s=0.09, computer={"period_s": period, "law": "law.py:Counts", "delay_periods": 2,
                                   "delay_fraction": 0.5},
        effects={"delay": True},
    )  # fmt: skip
    signals = runner.run(tables, model, _COUNTS).signals
    t, volts = np.asarray(signals["time"]), np.asarray(signals["cmd1"])
    after = np.searchsorted(t, (np.arange(25) + 2.6) * period)
    asked = 0.01 * (1 + np.arange(25) % 7) * 15.625
    return float(np.count_nonzero(np.abs(volts[after] - asked) > 1e-6 * asked))


def _contact(which: int, end: int) -> Callable[[CaseRunner, str], float]:
    """Return what finds when a carriage between two soft stops enters (0) one or leaves it (1), in one step.

    No number where it does not touch them three times in the period, and stay clear of them in between.
    """

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=0.1, solver={"max_step_s": 0.1, "coupling_tolerance_rad": 1e-9},
            device={"slider": {"stops_rad": [[-0.05, 0.05]], "stop_stiffness_n_m_per_rad": _STIFF,
                               "stop_damping_n_m_s": 0.0},
                    "start": {"v_rad_per_s": [_SPEED]}},
            effects={"end_stops": True},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        t, q, v = (np.asarray(signals[name]) for name in ("time", "q1", "v1"))
        at = [crossings(t, side * q, side * v, 0.05) for side in (1, -1)]
        if model in OWN:  # our own loop has rows there
            at = [t[side * q == 0.05] for side in (1, -1)]
        instants = np.concatenate(at)[[0, 1, 4, 5, 2, 3]] if [len(x) for x in at] == [4, 2] else ()
        return float(instants[2 * which + end]) if len(instants) else math.nan

    return find


_INERTIA, _STIFF = 0.2 * RADIUS**2, 200.0
# of `_dip`: gravity [rad/s^2], its stop [rad], speed there [rad/s], swing in it [rad/s], both instants [s]
_FALL = 9.81 / RADIUS
_STOP = 1.0 / (2 * _FALL) - 2e-4
_SPEED_AT = math.sqrt(2 * 2e-4 * _FALL)
_SWING = math.sqrt(_STIFF / _INERTIA)
_IN = (1.0 - _SPEED_AT) / _FALL
_OUT = _IN + 2 / _SWING * math.atan2(_SPEED_AT * _SWING, _FALL)
# of the carriage of `_contact`: its speed [rad/s], a half turn in a stop and a flight between them [s]
_SPEED = 5.0
_TURN, _FLIGHT = math.pi * math.sqrt(_INERTIA / _STIFF), 0.1 / _SPEED

CASES = (
    HardCase("push that begins on a sample or an ulp beside it", 25, "change of the end, relative", 0.0,
             {**dict.fromkeys(OWN, 1e-12), "spice": 1e-9},
             "an ulp of 0.1 s is 1e-17 s; a step of the lockstep falls otherwise", _beside_a_sample,
             broken="a force 0.1 % too small; ideal, linear: the hand's knots are no events"),
    *(HardCase(f"jump at a sample, {path}", 26, "current at its right over the spring's", 1.0,
               {**dict.fromkeys(OWN, 1e-9), "spice": 2e-8},
               "two rows at one instant; gains and angles are exact; spice: order two in steps of 4 and 8 us "
               "at 12 rad/s, 4e-9, and as much for the predicted angle",
               partial(_both_limits, friction),
               broken=f"no row for the right-hand limit in {module}; on spice, in jump_rows")
      for path, friction, module in (("exact", 0.0, "exact_steps"), ("by collocation", 1e-6, "stepper"))),
    HardCase("two stops struck at one instant", 27, "largest error of the angles [rad]", 0.0,
             dict.fromkeys(OWN, 1e-9), "located to 2^-36 of an interval of a second, at 2 rad/s",
             _simultaneous,
             broken="only the first joint of an instant rebounds: 0.87 rad"),
    *(HardCase(f"two hits in one step, number {k + 1}", 28, "instant [s]", (0.2 + 0.4 * k) / 10.0,
               dict.fromkeys(OWN, 1e-10), "located to 2^-36 of an interval", _hits(k),
               broken="no step is cut at a crossing") for k in (0, 1)),
    *(HardCase(f"dip into a stop within a step, {what}", 28, "instant [s]", at,
               {**dict.fromkeys(OWN, 1e-11), "spice": 1e-8},
               "two crossings, each located to 2^-36 of 0.1 s; spice: the coupling's 1e-9 rad at 0.17 rad/s",
               _dip(what), broken="no step is cut at a crossing; spice also: no look between a step's ends")
      for what, at in (("enters", _IN), ("leaves", _OUT))),
    HardCase("delay of 2.5 periods", 30, "commands lost", 0.0, dict.fromkeys(ALL, 0.0),
             "each has its own instant", _lost_samples,
             broken="at most one period of delay in queue_time: 25 lost"),
    *(HardCase(f"contact {k + 1} of 3 within one period of 100 ms, {what}", 58, "instant [s]",
               _FLIGHT / 2 + k * (_TURN + _FLIGHT) + end * _TURN,
               {**dict.fromkeys(OWN, 2e-11), "spice": 2e-9},
               "six crossings, each located to 2^-36 of 0.1 s; spice: ten times the coupling's 1e-9 rad over "
               "5 rad/s, for the steps in the stops before",
               _contact(k, end), broken="no step is cut at a crossing")
      for k in (1, 2) for end, what in enumerate(("made", "lost"))),
)  # fmt: skip
