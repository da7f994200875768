"""Hard cases of the closed loop: borders, limit cycles, friction, bad numbers, and what estimates say."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from cosim.accuracy.hard_cases.coupled_motion import _EMF, _SPRING, _STATED, two_masses
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
from cosim.accuracy.hard_cases.sampled import _HELD, _border

__all__ = ["CASES"]

_INERTIA = 0.2 * RADIUS**2


def _stretch(what: str) -> Callable[[CaseRunner, str], float]:
    """Return what finds the drift of energy or momentum of a free arm that swings through full stretch."""

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=1.0,
            device={
                "board": board(2), "linkage": "chain", "slider": None,
                "chain": {"lengths_m": [0.1, 0.1], "masses_kg": [0.2, 0.1], "coms_m": [0.05, 0.05],
                          "inertias_kg_m2": [1.7e-4, 8.3e-5]},
                "start": {"q_rad": [0.3, 0.5], "v_rad_per_s": [1.0, -5.0]},
            },
            effects={"coriolis": True}, solver={"max_step_s": 1e-3, "coupling_tolerance_rad": 1e-10},
        )  # fmt: skip
        s = {k: np.asarray(v) for k, v in runner.run(tables, model).signals.items()}
        if not np.any(np.diff(np.sign(np.sin(s["q2"])))):
            return math.nan  # it never was stretched
        if what == "energy":
            return float(np.abs(s["e_kin"] / s["e_kin"][0] - 1.0).max())
        both, v = s["q1"] + s["q2"], s["v1"] + s["v2"]
        momentum = (0.2 * 0.05**2 + 1.7e-4) * s["v1"] + 8.3e-5 * v
        x = 0.1 * np.cos(s["q1"]) + 0.05 * np.cos(both)
        y = 0.1 * np.sin(s["q1"]) + 0.05 * np.sin(both)
        vx = -0.1 * np.sin(s["q1"]) * s["v1"] - 0.05 * np.sin(both) * v
        vy = 0.1 * np.cos(s["q1"]) * s["v1"] + 0.05 * np.cos(both) * v
        momentum += 0.1 * (x * vy - y * vx)
        return float(np.abs(momentum / momentum[0] - 1.0).max())

    return find


def _stops_gain(runner: CaseRunner, model: str) -> float:
    """Largest gain of energy, over the start's, of an arm thrown against soft stops."""
    tables = slider(
        duration_s=1.0,
        device={
            "board": board(2), "linkage": "chain", "slider": None,
            "chain": {"lengths_m": [0.1, 0.1], "masses_kg": [0.2, 0.1], "coms_m": [0.05, 0.05],
                      "inertias_kg_m2": [1.7e-4, 8.3e-5], "stops_rad": [[-1.3, 0.4], [0.1, 1.2]]},
            "start": {"q_rad": [-0.5, 0.9], "v_rad_per_s": [2.0, -8.0]},
        },
        effects={"end_stops": True, "coriolis": True},
        solver={"max_step_s": 1e-3, "coupling_tolerance_rad": 1e-9},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    q = np.stack([np.asarray(signals[f"q{j}"]) for j in (1, 2)])
    free = ((q > [[-1.3], [0.1]]) & (q < [[0.4], [1.2]])).all(axis=0)  # nothing is stored in a stop
    energy = np.asarray(signals["e_kin"])[free]
    return float(max((energy / np.minimum.accumulate(energy)).max() - 1.0, 0.0))


def _parallel(runner: CaseRunner, model: str) -> float:
    """Growth [1/s] of the two-mass oscillator's amplitude, exchanged every 10 ms."""
    signals = two_masses(runner, model, 10.0, {"max_step_s": 0.01, "coupling_tolerance_rad": 1e-3})
    q1, q2, v1, v2 = (np.asarray(signals[name]) for name in ("q1", "q2", "v1", "v2"))
    # 0.01 kg m^2 each, springs 4 pi^2 to ground and 16 pi^2 between, over the inertia
    energy = v1**2 + v2**2 + 4 * math.pi**2 * (q1**2 + q2**2) + 16 * math.pi**2 * (q1 - q2) ** 2
    return math.log(float(energy[-1] / energy[0])) / 2 / 10.0


def _on_the_border(runner: CaseRunner, model: str) -> float:
    """Return the growth a sample, less 1, of a held spring at its border, over 1e4 samples of 3 ms."""
    count, period = 10_000, 3e-3
    tables = slider(
        duration_s=count * period,
        device={"slider": {"mass_kg": 1.0, "viscous_n_m_s": _border(period) * RADIUS**2},
                "start": {"q_rad": [0.001]}},
        computer={"period_s": period, "law": "law.py:Held"}, effects={"viscous": True},
        solver={"max_step_s": period},
    )  # fmt: skip
    samples = runner.run(tables, model, _HELD).samples
    q = np.abs(np.asarray(samples["q_enc1"]))
    # the amplitude from a swing's largest samples: 50 swings at either end
    early, late = q[: count // 4].max(), q[-(count // 4) :].max()
    return math.log(late / early) / (0.75 * count)


def _pin_error(step: float, runner: CaseRunner, model: str) -> float:
    """Return log(error over estimate) of the pins that the circuit sees, at steps forced to be long."""
    tables = slider(
        duration_s=0.06, device={"start": {"q_rad": [-0.04]}}, computer={"period_s": 0.06},
        wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]}, effects={"motor": "emf"},
        solver={"max_step_s": step, "coupling_tolerance_rad": 1e-3}, record={"nodes": ["vel1"]},
    )  # fmt: skip
    ran = runner.run(tables, model)
    t, q, v, pot_q, vel_v = (np.asarray(ran.signals[name]) for name in ("time", "q1", "v1", "pot1", "vel1"))
    stiffness = 100 * RADIUS**2 * _SPRING / _STATED
    rate = np.array([[0, 1], [-stiffness / _INERTIA, -_EMF / _INERTIA]])
    wrong = 0.0
    for n in range(1, len(t)):
        h = t[n] - t[n - 1]
        true_q, true_v = expm(rate * h) @ [q[n - 1], v[n - 1]]
        wrong = max(wrong, abs(pot_q[n] - true_q) + h * abs(vel_v[n] / 8.0 - true_v))
    return math.log(wrong / float(ran.stats["defect_max_rad"]))


_SATURATING = """
from cosim.loop.userlaw import Command
class Saturating:
    def control(self, sample):
        return Command(u_rad=0 * sample.q_rad, damping=[[-{gain!r}]])
"""


def _saturated(runner: CaseRunner, model: str) -> float:
    """Amplitude over the describing function's: a negative damper of 0.04 against 0.02 N m s/rad, clipped."""
    gain, b, stiffness, limit = 0.04, 0.02, 50.0, 0.875 * 0.32
    a = brentq(lambda a: 2 / math.pi * (math.asin(1 / a) + math.sqrt(1 - 1 / a**2) / a) - b / gain, 1.01, 9)
    w = math.sqrt(stiffness / 0.2)
    amplitude = float(a) * limit / gain / w
    tables = slider(
        duration_s=6.0,
        device={"values": {"r_ilim": repr(15000 * 4.75 / 0.875 - 13750)}, "slider": {"viscous_n_m_s": b},
                "start": {"q_rad": [amplitude]}},
        computer={"law": "law.py:Saturating", "analog_damping_n_s_per_m": 1.0},
        operator={"type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": stiffness,
                  "damping_n_s_per_m": 0.0, "waypoints_s_m": [[0.0, 0.0, 0.0]]},
        effects={"driver_limit": True, "viscous": True, "operator_dynamics": True},
        solver={"coupling_tolerance_rad": 1e-7},
    )  # fmt: skip
    # the board's damper gives 0.9994 of what is stated: the gain of 10k to 24.3k and the pads beside it
    signals = runner.run(tables, model, _SATURATING.format(gain=gain)).signals
    late = np.asarray(signals["time"]) > 4.0
    return float(np.ptp(np.asarray(signals["q1"])[late])) / 2 / amplitude


_NOT_A_NUMBER = """
import math
from cosim.loop.userlaw import Command
class Broken:
    def control(self, sample):
        return Command(torque_n_m=math.nan if sample.tick == 3 else 0.0)
"""


def _bad_law(runner: CaseRunner, model: str) -> float:
    tables = slider(computer={"law": "law.py:Broken", "period_s": 0.01}, duration_s=0.1)
    return runner.refusal(lambda: runner.run(tables, model, _NOT_A_NUMBER), "torque_n_m", "0.03")


def _bad_key(key: str, tables: dict[str, Any]) -> HardCase:
    def find(runner: CaseRunner, model: str) -> float:
        return runner.refusal(lambda: runner.run(slider(**tables), model), key)

    return HardCase(
        f"not a number, {key}", 42, "refused by name (1)", 1.0, {"ideal": 0.0}, "NaN fails every comparison",
        find, broken="errors do not name the key",
    )  # fmt: skip


def _soft_stop(runner: CaseRunner, model: str) -> float:
    """Largest difference of `spice` and `linear` over their bounds, a soft stop struck at 10 rad/s."""
    tables = slider(
        duration_s=0.2, solver={"coupling_tolerance_rad": 1e-8},
        device={"slider": {"stops_rad": [[-0.5, 0.5]]}, "start": {"v_rad_per_s": [10.0]}},
        effects={"end_stops": True, "motor": "emf"},
    )  # fmt: skip
    one, other = (runner.run(tables, each, estimate=True).measures for each in (model, "linear"))
    worst = 0.0
    for name in ("peak_current", "heat"):
        room = one[name]["error"] + other[name]["error"]
        worst = max(worst, abs(one[name]["value"] - other[name]["value"]) / room)
    return float(worst)


def _ring(period: float) -> HardCase:
    """Return the case of a spring in the circuit alone, seen through samples however rare."""
    stiffness = (2 * math.pi * 41.44) ** 2 * _INERTIA

    def find(runner: CaseRunner, model: str) -> float:
        law = (
            "from cosim.loop.userlaw import Command\nclass Springs:\n    def control(self, sample):\n"
            f"        k = {stiffness * _STATED / _SPRING!r}\n"
            "        return Command(u_rad=0 * sample.q_rad, stiffness=[[k]])\n"
        )
        tables = slider(
            duration_s=0.5, device={"start": {"q_rad": [0.01]}},
            computer={"period_s": period, "law": "law.py:Springs"}, solver={"coupling_tolerance_rad": 1e-9},
        )  # fmt: skip
        signals = runner.run(tables, model, law).signals
        t, q, v = (np.asarray(signals[name]) for name in ("time", "q1", "v1"))
        keep = np.append(np.diff(t) > 0.0, True)
        at = crossings(t[keep], q[keep], v[keep], 0.0)
        return float((len(at) - 1) / 2.0 / (at[-1] - at[0]))

    return HardCase(
        f"circuit's mode of 41.44 Hz, samples of {1e3 * period:g} ms", 52, "frequency [Hz]", 41.44,
        {**dict.fromkeys(OWN, 41.44e-6), "spice": 41.44e-4},
        "crossings of cubics between rows: 1e-6; spice: the list's own 1e-3 of the amplitude over 20 swings",
        find, broken="difference amplifier of 170k for 169k",
    )  # fmt: skip


def _friction_border(share: float) -> HardCase:
    """Return the case of a held spring and friction alone: it decays below a speed and grows above."""
    period, friction, stiffness = 3e-3, 0.05, 1e3
    speed = share * 8 * friction / math.pi / (stiffness * period)
    w = math.sqrt(stiffness)

    def find(runner: CaseRunner, model: str) -> float:
        tables = slider(
            duration_s=2.0,
            device={"slider": {"mass_kg": 1.0, "coulomb_n_m": friction * RADIUS},
                    "start": {"q_rad": [speed / w / RADIUS]}},
            computer={"period_s": period, "law": "law.py:Held"}, effects={"coulomb": True},
            solver={"max_step_s": 1e-3, "coupling_tolerance_rad": 1e-10},
        )  # fmt: skip
        v = np.abs(np.asarray(runner.run(tables, model, _HELD).signals["v1"]))
        half = len(v) // 2
        return float(v[half:].max() > v[:half].max())

    return HardCase(
        f"held spring on friction alone, {share:g} of its border", 60, "grows (1) or decays (0)",
        float(share > 1.0), dict.fromkeys(ALL, 0.0),
        "energy of a swing: k T v = 8 f/pi; k T^2/m = 0.009 moves it by less than 2 %", find,
        broken=f"friction 5 % too {'large' if share > 1.0 else 'small'}",
    )  # fmt: skip


_SKEWED = """
from cosim.loop.userlaw import Command
class Skewed:
    def control(self, sample):
        on = sample.tick > 0
        return Command(u_rad=0 * sample.q_rad + (0.05 if on else 0.0), stiffness=[[0.5 if on else 0.0]])
"""


def _glitch(runner: CaseRunner, model: str) -> float:
    """Return the torque between gain and equilibrium of skewed DACs, over the old equilibrium's."""
    period, skew, angle = 0.02, 5e-3, 0.1
    tables = slider(
        duration_s=2 * period,
        device={"slider": {"mass_kg": 100.0}, "start": {"q_rad": [angle]}},
        computer={"period_s": period, "law": "law.py:Skewed", "dac": {"skew_s": skew}},
        effects={"dac_skew": True}, solver={"coupling_tolerance_rad": 1e-9},
    )  # fmt: skip
    signals = runner.run(tables, model, _SKEWED).signals
    t, q, i = (np.asarray(signals[name]) for name in ("time", "q1", "imot1"))
    inside = (t > period + 0.1 * skew) & (t < period + 0.9 * skew)
    late = t > period + 1.1 * skew
    if not inside.any() or not np.allclose(i[late] / (0.05 - q[late]), -(i / q)[inside][0], rtol=1e-4):
        return math.nan  # the equilibrium never came, or came early
    return float(np.mean((0.32 * i / -q)[inside])) / (0.5 * _SPRING / _STATED)


def _consistent(runner: CaseRunner, model: str) -> float:
    """Whether a netlist's own initial voltage is said to count for nothing, and does."""
    from cosim.ngspice.deck import load_deck

    currents = []
    for line in ("", ".ic v(inn)=5"):
        place = runner.netlists({"blocks/diffamp.cir": partial("{1}\n{0}\n".format, line)})
        tables = slider(
            device={"board": str(place / "board1.cir"), "start": {"q_rad": [-0.02]}}, duration_s=0.1,
            computer={"period_s": 0.02}, wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        )  # fmt: skip
        currents.append(float(runner.run(tables, model).signals["imot1"][-1]))
        noted = any("operating point" in note for note in load_deck(place / "board1.cir").notes)
    return float(noted and currents[0] == currents[1])


CASES = (
    HardCase("gains before equilibria", 47, "torque of the glitch over its closed form", 1.0,
             {**dict.fromkeys(OWN, 1e-6), "spice": 1e-4}, "old equilibrium and new gain on a mass at rest",
             _glitch, broken="equilibria released without the skew"),
    HardCase("initial voltage in a netlist", 43, "said and without effect (1)", 1.0, dict.fromkeys(ALL, 0.0),
             "a run starts from the operating point", _consistent,
             broken="no word on the operating point in the note"),
    *(HardCase(f"arm through full stretch, {what}", 12, "drift, relative", 0.0,
               {**dict.fromkeys(OWN, 1e-8), "spice": 1e-5}, "steps of 1e-10 rad; joints know no stretch",
               _stretch(what), broken="no Coriolis torques") for what in ("energy", "momentum")),
    HardCase("arm thrown against soft stops", 20, "gain of energy, relative", 0.0,
             {**dict.fromkeys(OWN, 1e-7), "spice": 1e-5}, "1e-9 rad a step on stops of 1e3 N m/rad",
             _stops_gain, broken="no Coriolis torques"),
    HardCase("two-mass oscillator exchanged every 10 ms", 33, "growth [1/s]", 0.0, {"spice": 0.3948e-2},
             "a hundredth of the 0.3948 of held values", _parallel,
             broken="the angle is held over a step"),
    HardCase("border of the sampled spring, 1e4 samples", 36, "growth a sample, less 1", 0.0,
             dict.fromkeys(ALL, 1e-6), "the list's own", _on_the_border,
             broken="DACs 10 us late: 1.5e-5"),
    *(HardCase(f"steps forced to {1e3 * step:g} ms", 37, "log of error over estimate", 0.0,
               {"spice": math.log(3.0)}, "the list's own factor of 3",
               partial(_pin_error, step), broken="a fifth of the defect reported") for step in (4e-3, 1e-3)),
    HardCase("negative damper in a clipped driver", 39, "amplitude over the describing function's", 1.0,
             {"ideal": 0.01, "spice": 0.01}, "third harmonics of a swing of Q = 9 and the stated gain",
             _saturated, broken="a limit 3 % too high"),
    HardCase("law that is not a number", 42, "refused with sample and name (1)", 1.0, dict.fromkeys(ALL, 0.0),
             "NaN fails every comparison", _bad_law,
             broken="userlaw without its check"),
    *(_bad_key(key, tables) for key, tables in (
        ("mass_kg", {"device": {"slider": {"mass_kg": math.nan}}}),
        ("analog_stiffness_n_per_m", {"computer": {"analog_stiffness_n_per_m": math.inf}}),
        ("max_step_s", {"solver": {"max_step_s": math.nan}}),
    )),
    HardCase("soft stop struck at 10 rad/s", 51, "difference over bounds", 0.5, {"spice": 0.5},
             "two models agree within their estimates", _soft_stop,
             broken="bounds a hundredth as wide"),
    *(_ring(period) for period in (0.025, 0.02, 0.001)),
    *(_friction_border(share) for share in (0.97, 1.03)),
)  # fmt: skip
