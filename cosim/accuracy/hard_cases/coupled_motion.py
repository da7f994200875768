"""Hard cases of circuit and mechanics together: stiffness, limits, energy, invariance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from cosim.accuracy.hard_cases.hard_case import ALL, OWN, RADIUS, CaseRunner, HardCase, board, merge, slider

__all__ = ["CASES"]

#: The shipped boards as resistors and Ohm's law have it: potentiometer 20 V on 340 degrees, difference
#: amplifier 169k/10k, summer 10k/24.3k, driver 2 V/V on 5 Ohm, 0.04 N m/A, gear 8.
_TORQUE = 0.04 * 8.0
_POT = 20.0 / 5.93411946
_SPRING = _POT * 16.9 * (10e3 / 24.3e3) / (1 + 0.1 / 24.3e3) * (2.0 / 5.0) * _TORQUE  # N m/rad at full scale
_DAMPER = _POT * 0.1 * (10e3 / 6.19e3) / (1 + 0.1 / 6.19e3) * (2.0 / 5.0) * _TORQUE  # N m s/rad at full scale
_EMF = (0.04 * 8.0) ** 2 / 5.0  # N m s/rad
#: What the board states of the first, and the computer believes.
_STATED = 3.0003
_STATED_C = 0.06969
_AMPLITUDE = 0.1  # rad, of the two-mass oscillator

_SPRINGS = """
from cosim.loop.userlaw import Command
class Springs:
    def control(self, sample):
        return Command(u_rad=0 * sample.q_rad, stiffness={k})
"""


def two_masses(
    runner: CaseRunner, model: str, duration_s: float, solver: dict[str, float]
) -> Mapping[str, Any]:
    """Run two rotors of 0.01 kg m^2, springs 4 pi^2 to ground and 16 pi^2 between all in the circuit."""
    inertia, amplitude = 0.01, _AMPLITUDE
    k, k12 = 4 * math.pi**2 * inertia, 16 * math.pi**2 * inertia
    springs = (np.array([[k + k12, -k12], [-k12, k + k12]]) * _STATED / _SPRING).tolist()
    rotor = inertia / 64.0
    nothing = [0.0, 0.0]
    tables = slider(
        duration_s=duration_s,
        device={
            "board": board(2), "linkage": "chain", "slider": None,
            "chain": {"lengths_m": [0.1, 0.1], "masses_kg": nothing, "coms_m": nothing,
                      "inertias_kg_m2": nothing, "rotor_inertia_kg_m2": [rotor, rotor]},
            "start": {"q_rad": [amplitude, 0.0]},
        },
        computer={"analog_stiffness_n_per_m": 1.0, "law": "law.py:Springs"},
        effects={"rotor_inertia": True}, solver=solver,
    )  # fmt: skip
    return runner.run(tables, model, _SPRINGS.format(k=springs)).signals


def _two_masses(runner: CaseRunner, model: str) -> float:
    """Return the two-mass oscillator's error over its amplitude."""
    amplitude = _AMPLITUDE
    signals = two_masses(runner, model, 2.0, {"coupling_tolerance_rad": 1e-10})
    t = 2 * math.pi * np.asarray(signals["time"])
    errors = [
        np.asarray(signals[f"q{j}"]) - amplitude / 2 * (np.cos(t) - sign * np.cos(3 * t))
        for j, sign in ((1, -1), (2, 1))
    ]
    return float(np.abs(errors).max()) / amplitude


def _light_tip(runner: CaseRunner, model: str) -> float:
    """1 g on 1e4 N/m in the circuit, 25 periods of 503 Hz: error over amplitude."""
    amplitude = 1e-3 / RADIUS
    law = _SPRINGS.format(k=1e4 * RADIUS**2 * _STATED / _SPRING)
    tables = slider(
        duration_s=0.05, device={"slider": {"mass_kg": 1e-3}, "start": {"q_rad": [amplitude]}},
        computer={"period_s": 0.05, "analog_stiffness_n_per_m": 1.0, "law": "law.py:Springs"},
        solver={"coupling_tolerance_rad": 1e-9},
    )  # fmt: skip
    signals = runner.run(tables, model, law).signals
    exact = amplitude * np.cos(math.sqrt(1e7) * np.asarray(signals["time"]))
    return float(np.abs(np.asarray(signals["q1"]) - exact).max()) / amplitude


def _clipped(runner: CaseRunner, model: str) -> float:
    """Force at the tip of a driver set to its rated 0.875 A, pressed into its limit by 5 N."""
    tables = slider(
        duration_s=1.0,
        device={"values": {"r_ilim": repr(15000 * 4.75 / 0.875 - 13750)}},
        computer={"period_s": 0.01, "analog_stiffness_n_per_m": 150.0},
        wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        operator={
            "type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 20.0, "stiffness_n_per_m": 100.0,
            "waypoints_s_m": [[0.0, 0.0, 0.0]], "force_s_n": [[0.1, 0.0, 0.0], [0.5, 0.0, -5.0]],
        },
        effects={"driver_limit": True, "operator_dynamics": True},
        solver={"coupling_tolerance_rad": 1e-8},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    return float(_TORQUE * np.interp(0.95, signals["time"], np.asarray(signals["imot1"])) / RADIUS)


def _power_up(runner: CaseRunner, model: str) -> float:
    """Return the energy from nowhere of a start 5 mm inside an undamped wall, over the spring's."""
    tables = slider(
        duration_s=0.06, computer={"period_s": 0.06}, wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        device={"start": {"q_rad": [-5e-3 / RADIUS]}}, solver={"coupling_tolerance_rad": 1e-10},
    )  # fmt: skip
    signals = runner.run(tables, model).signals
    stored = 0.5 * 100 * RADIUS**2 * _SPRING / _STATED * np.asarray(signals["q1"]) ** 2
    total = np.asarray(signals["e_kin"]) + stored
    return float(np.abs(total / total[0] - 1.0).max())


def _rotor(inertia: float) -> HardCase:
    """Return the case of a bare rotor that its own back-EMF slows down."""
    tau = inertia * 64.0 / _EMF

    def find(runner: CaseRunner, model: str) -> float:
        zero = [0.0]
        tables = slider(
            duration_s=0.5,
            device={
                "linkage": "chain", "slider": None,
                "chain": {"lengths_m": [RADIUS], "masses_kg": zero, "coms_m": zero, "inertias_kg_m2": zero,
                          "rotor_inertia_kg_m2": [inertia]},
                "start": {"q_rad": [0.5], "v_rad_per_s": [20.0]},
            },
            computer={"period_s": 0.02}, effects={"motor": "emf", "rotor_inertia": True},
            solver={"coupling_tolerance_rad": 1e-9, "rtol": 1e-5},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        exact = 20.0 * np.exp(-np.asarray(signals["time"]) / tau)
        return float(np.abs(np.asarray(signals["v1"]) - exact).max()) / 20.0

    return HardCase(
        f"rotor of {inertia:g} kg m^2 on its back-EMF", 45, "largest error of the speed, relative", 0.0,
        {**dict.fromkeys(OWN, 1e-5), "spice": 1e-3},
        f"tolerances of 1e-9 rad over {tau:.1e} s are speeds of {1e-9 / tau / 20:.0e}; spice: the list's own",
        find, broken="back-EMF 1 % too large",
    )  # fmt: skip


def _rotated(angle: float, mirrored: bool = False) -> Any:
    """Largest change of a scalar measure when slider, wall, gravity and hand are turned or mirrored."""

    def turned(x: float, y: float) -> list[float]:
        if mirrored:
            x = -x
        c, s = math.cos(angle), math.sin(angle)
        return [c * x - s * y, s * x + c * y]

    def tables(turn: Any) -> dict[str, Any]:
        return slider(
            duration_s=0.5,
            device={
                "slider": {"direction": turn(0.0, 1.0), "gravity_m_per_s2": turn(0.0, -9.81),
                           "origin_m": turn(0.0, 0.01)},
                "start": {"q_rad": [0.0]},
            },
            computer={"period_s": 0.01},
            wall={"point_m": [0.0, 0.0], "normal": turn(0.0, 1.0)},
            operator={
                "type": "hand", "mass_kg": 0.1, "damping_n_s_per_m": 5.0, "stiffness_n_per_m": 50.0,
                "waypoints_s_m": [[0.0, *turn(0.0, 0.01)], [0.3, *turn(0.0, -0.005)]],
            },
            effects={"gravity": True, "operator_dynamics": True},
            solver={"coupling_tolerance_rad": 1e-9},
        )  # fmt: skip

    def find(runner: CaseRunner, model: str) -> float:
        one, other = (runner.run(tables(turn), model).measures for turn in (lambda x, y: [x, y], turned))
        names = ("peak_force", "max_penetration", "contact_share", "rendered_stiffness", "peak_current")
        return max(float(abs(one[n]["value"] - other[n]["value"]) / abs(one[n]["value"])) for n in names)

    return find


def _row_spacing(runner: CaseRunner, model: str) -> float:
    """Largest change of a measure over its bounds, steps and rows ten times closer."""
    tables = merge(
        slider(duration_s=0.5, computer={"period_s": 0.01}, solver={"coupling_tolerance_rad": 1e-7}),
        {
            "wall": {"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
            "device": {"start": {"q_rad": [0.0213], "v_rad_per_s": [-1.0]}},
            "operator": {"type": "mass", "mass_kg": 0.05},
        },
    )  # fmt: skip
    one, other = (
        runner.run(merge(tables, {"solver": {"max_step_s": step}}), model, estimate=True).measures
        for step in (2e-3, 2e-4)
    )
    worst = 0.0
    for name, row in one.items():
        if row.get("error") is not None and other[name].get("error") is not None:
            room = row["error"] + other[name]["error"]
            apart = abs(row["value"] - other[name]["value"])
            worst = max(worst, apart / room if room else math.inf * apart if apart else 0.0)
    return worst


CASES = (
    HardCase("two-mass oscillator over the coupling", 32, "largest error over amplitude", 0.0,
             {**dict.fromkeys(OWN, 1e-6), "spice": 1e-3}, "the list's own bounds of the models", _two_masses,
             broken="difference amplifier of 170k for 169k"),
    HardCase("1 g on a circuit's 1e4 N/m", 34, "largest error over amplitude", 0.0,
             {**dict.fromkeys(OWN, 1e-4), "spice": 1e-3},
             "1e-9 rad a step over 25 periods, 1e-7 of the amplitude each; spice: the list's own",
             _light_tip, broken="difference amplifier of 170k for 169k"),
    HardCase("driver at its current limit", 40, "force [N]", 0.875 * _TORQUE / RADIUS,
             dict.fromkeys(ALL, 2.1e-3), "the limit's diodes are sharp to 0.1 %", _clipped,
             broken="a limit 3 % too high"),
    HardCase("power-up inside the wall", 44, "energy from nowhere, relative", 0.0,
             {**dict.fromkeys(OWN, 1e-6), "spice": 1e-5}, "the spring's energy is all there is", _power_up,
             broken="difference amplifier of 170k for 169k"),
    *(_rotor(inertia) for inertia in (1e-7, 1e-6, 4e-6)),
    HardCase("rows and steps ten times closer", 53, "change of a measure over its bounds", 0.5,
             dict.fromkeys(ALL, 0.5), "no measure moves by more than its printed bounds", _row_spacing,
             broken="bounds a hundredth as wide"),
    HardCase("frame turned by 0.7 rad", 54, "change of a measure, relative", 0.0, {"ideal": 1e-6},
             "the list's own", _rotated(0.7), broken="the motors' push without its x"),
    HardCase("frame turned by 2.9 rad and mirrored", 54, "change of a measure, relative", 0.0,
             {"ideal": 1e-6}, "the list's own", _rotated(2.9, mirrored=True),
             broken="the motors' push without its x"),
)  # fmt: skip
