"""Hard cases of sampling: growth and its border, relays, first penetration, quantisation, the clock."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from cosim.accuracy.hard_cases.hard_case import (
    ALL,
    OWN,
    RADIUS,
    CaseRunner,
    HardCase,
    Ran,
    crossings,
    slider,
)

__all__ = ["CASES"]

_HELD = f"""
from cosim.loop.userlaw import Command
class Held:
    def control(self, sample):
        return Command(torque_n_m=-{1e3 * RADIUS**2!r} * sample.q_rad)
"""
_RELAY = """
import numpy as np
from cosim.loop.userlaw import Command
class Relay:
    def control(self, sample):
        return Command(torque_n_m=-0.02 * np.sign(sample.q_rad))
"""
#: Gain of an ideal op-amp is 1e9; over noise gains of 18 and a few others it leaves so much of a torque.
_IDEAL_GAIN = 1e-7


def _modulus(runner: CaseRunner, model: str, period: float, viscosity: float) -> float:
    """Largest eigenvalue of a sample of k = 1e3 N/m on m = 1 kg, from the states at the samples."""
    count = 12
    tables = slider(
        duration_s=count * period,
        device={
            "slider": {"mass_kg": 1.0, "viscous_n_m_s": viscosity * RADIUS**2}, "start": {"q_rad": [0.001]},
        },
        computer={"period_s": period, "law": "law.py:Held"},
        effects={"viscous": viscosity > 0.0},
    )  # fmt: skip
    ran = runner.run(tables, model, _HELD)
    t = np.asarray(ran.signals["time"])
    at = np.searchsorted(t, np.arange(count) * period - 1e-11)
    states = np.array([np.asarray(ran.signals["q1"])[at], np.asarray(ran.signals["v1"])[at] * period])
    size = np.abs(states[:, :-1]).max(axis=0)
    step = np.linalg.lstsq((states[:, :-1] / size).T, (states[:, 1:] / size).T, rcond=None)[0]
    return float(np.abs(np.linalg.eigvals(step)).max())


def _growth(period: float, runner: CaseRunner, model: str) -> float:
    return _modulus(runner, model, period, 0.0)


def _border(period: float) -> float:
    """Return the viscosity [N s/m] at which the exact map of a sample has an eigenvalue on the circle."""

    def beyond(b: float) -> float:
        block = expm(np.array([[0, 1, 0], [0, -b, -1e3], [0, 0, 0]]) * period)
        return float(np.abs(np.linalg.eigvals(block[:2, :2] + np.outer(block[:2, 2], [1, 0]))).max()) - 1.0

    low = 0.25 * 1e3 * period
    return float(brentq(beyond, low, 4 * low, xtol=1e-14, rtol=1e-14))


def _flips(period: float) -> Any:
    def find(runner: CaseRunner, model: str) -> float:
        share = 1e-6 if model in OWN else 1e-4
        low, high = (_modulus(runner, model, period, _border(period) * (1 + s * share)) for s in (-1, 1))
        return float(low > 1.0 > high)

    return find


def _relay_run(runner: CaseRunner, model: str) -> Ran:
    """Run x' = -2 sgn(x_k), T = 0.1 s, by a carriage that takes 1 ms to follow."""
    tau, b = 1e-3, 0.01
    tables = slider(
        duration_s=2.0, computer={"law": "law.py:Relay"}, effects={"viscous": True},
        device={"slider": {"mass_kg": tau * b / RADIUS**2, "viscous_n_m_s": b}, "start": {"q_rad": [0.05]}},
        solver={"max_step_s": 2e-4},
    )  # fmt: skip
    return runner.run(tables, model, _RELAY)


def _relay(runner: CaseRunner, model: str) -> float:
    """Return the swing of that cycle."""
    signals = _relay_run(runner, model).signals
    return float(np.ptp(np.asarray(signals["q1"])[np.asarray(signals["time"]) > 0.5]))


def _relay_period(runner: CaseRunner, model: str) -> float:
    """Return the period of that cycle over T: between crossings in one direction."""
    signals = _relay_run(runner, model).signals
    t, q, v = (np.asarray(signals[name]) for name in ("time", "q1", "v1"))
    passed = crossings(t, q, v, 0.0)
    up = passed[passed > 0.5][::2]
    return float(np.mean(np.diff(up))) / 0.1


def _first_seen(runner: CaseRunner, model: str) -> float:
    """Mean over phases of the depth that the computer first sees, over v T."""
    speed, period, phases = 0.2, 0.025, 4
    seen = []
    for k in range(phases):
        gap = speed * period * (1 + (k + 0.5) / phases)
        tables = slider(
            duration_s=2.9 * period, computer={"period_s": period},
            wall={"point_m": [0.0, -gap], "normal": [0.0, 1.0]},
            device={"start": {"v_rad_per_s": [-speed / RADIUS]}},
        )  # fmt: skip
        samples = runner.run(tables, model).samples
        depth = float(samples["pen"][int(np.argmax(np.asarray(samples["contact"])))])
        seen.append(depth if 0.0 <= depth <= speed * period else math.nan)
    return float(np.mean(seen)) / (speed * period)


def _ticks(runner: CaseRunner, model: str) -> float:
    """Return how many samples of 100 s are not at k T to the last bit."""
    tables = slider(duration_s=100.0, device={"start": {"v_rad_per_s": [1e-3]}}, solver={"max_step_s": 0.1})
    times = np.asarray(runner.run(tables, model).samples["time"])
    return float(np.count_nonzero(times != np.arange(len(times)) * 0.1)) + abs(len(times) - 1000.0)


def _pressed(
    wall: float, b: float, friction: float, counts: int, at_m: float, depth_m: float, duration_s: float
) -> dict[str, Any]:
    """Return the scene of a carriage pressed into a quantised wall, T = 1 ms.

    Parameters
    ----------
    wall, b, friction : stiffness [N/m], viscosity [N s/m] and dry friction [N] at the tip
    counts : of the encoder, a turn of the motor
    at_m, depth_m : where it starts, below the wall, and where the push is in balance
    duration_s : of the run
    """
    return slider(
        duration_s=duration_s,
        device={
            "slider": {"viscous_n_m_s": b * RADIUS**2, "coulomb_n_m": friction * RADIUS,
                       "coulomb_speed_rad_per_s": 1e-4},
            "start": {"q_rad": [-at_m / RADIUS]},
        },
        computer={
            "period_s": 1e-3, "method": "discrete", "discrete_stiffness_n_per_m": wall,
            "analog_stiffness_n_per_m": 0.0, "encoder": {"pulses_per_rev": counts, "decoding": 1},
        },
        wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        operator={
            "type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 0.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.0, 0.0, -wall * depth_m]],
        },
        effects={"viscous": True, "coulomb": True, "encoder": True},
        solver={"coupling_tolerance_rad": 1e-7},
    )  # fmt: skip


def _count_m(counts: int) -> float:
    """Return one count at the tip [m]: the board's gear is 8."""
    return RADIUS * 2 * math.pi / (counts * 8.0)


def _quantised(share: float) -> HardCase:
    """Return the case of a push between two steps of a wall: friction holds it, or it never rests."""
    friction, step = 0.02, _count_m(500)
    wall = share * 2 * friction / step

    def find(runner: CaseRunner, model: str) -> float:
        tables = _pressed(wall, 0.2, friction, 500, 20 * step, 20.5 * step, 0.6)
        samples = runner.run(tables, model).samples
        late = np.asarray(samples["time"]) > 0.3
        return float(np.count_nonzero(np.diff(np.asarray(samples["pen"])[late])) > 10)

    return HardCase(
        f"quantised wall, K = {share:g} of 2 f_c/D", 31, "cycles for ever (1) or rests (0)",
        float(share > 1.0), dict.fromkeys(ALL, 0.0), "one side of the border is rest, the other is not", find,
        broken="no encoder counts" if share > 1.0 else "friction a fifth too small",
    )  # fmt: skip


def _sampled_wall(share: float) -> HardCase:
    """Return the case of a large swing within a wall, whose steps are far below what friction holds.

    A sample later by half a period on average, the spring gives pi w A^2 K T/2 a cycle, the damper takes
    pi w A^2 b and friction 4 f_c A: beyond K = 2 b/T any swing above some millimetres grows.
    """
    b, swing, depth = 0.2, 6e-3, 10e-3
    border = 2 * b / 1e-3
    wall, friction = share * border, border * _count_m(20_000)  # 2 f_c/D is twice the border

    def find(runner: CaseRunner, model: str) -> float:
        tables = _pressed(wall, b, friction, 20_000, depth - swing, depth, 1.5)
        samples = runner.run(tables, model).samples
        t, beside = np.asarray(samples["time"]), np.asarray(samples["pen"]) - depth
        early, late = (float(np.abs(beside[part]).max()) for part in (t < 0.3, t > 1.2))
        return float(late > early)

    return HardCase(
        f"quantised wall, K = {share:g} of 2 b/T", 31, "a swing of 6 mm grows (1) or dies (0)",
        float(share > 1.0), dict.fromkeys(ALL, 0.0), "it dies on one side of the border, grows on the other",
        find, broken="viscosity half as large" if share < 1.0 else "viscosity twice as large",
    )  # fmt: skip


_PERIODS = (0.003, 0.1)
CASES = (
    *(HardCase(f"undamped sampled spring, T = {1e3 * T:g} ms", 21, "growth a sample",
               math.sqrt(1 + 1e3 * T**2 / 2), dict.fromkeys(ALL, _IDEAL_GAIN * 3),
               "parabolas between samples are exact; op-amp gains of 1e9 leave 1e-7",
               partial(_growth, T), broken="mass 0.1 % too large") for T in _PERIODS),
    *(HardCase(f"border of the sampled spring, T = {1e3 * T:g} ms", 22,
               "verdict flips at b (1 -+ 1e-6), spice 1e-4", 1.0, dict.fromkeys(ALL, 0.0),
               "the exact border of the map of one sample", _flips(T),
               broken="viscosity 0.1 % too large") for T in _PERIODS),
    HardCase("sampled relay", 23, "peak to peak [rad]", 2.0 * (0.1 - 2e-3 * math.log(2)),
             dict.fromkeys(ALL, 2e-5), "rows 0.2 ms apart miss the top by M h^2/(8 tau), 1e-5", _relay,
             broken="viscosity 0.1 % too large"),
    HardCase("sampled relay, period", 23, "period over T", 2.0, dict.fromkeys(ALL, 1e-6),
             "a ramp crosses zero between two rows: interpolation is exact", _relay_period,
             broken="a relay that answers a sample later: 6"),
    HardCase("wall seen at samples", 24, "mean first depth over v T", 0.5, dict.fromkeys(ALL, 1e-9),
             "free flight at constant speed: rounding", _first_seen,
             broken="wall 1 um off"),
    HardCase("clock of 1000 periods", 29, "samples beside k T", 0.0, dict.fromkeys(ALL, 0.0),
             "integer ticks: the very float", _ticks, broken="a period one ulp too long"),
    *(_quantised(share) for share in (0.9, 1.1)),
    *(_sampled_wall(share) for share in (0.8, 1.2)),
)  # fmt: skip
