"""Null limits: with its own number at its end, every effect is the effect switched off.

Each effect of the registry has a row here, on the cheapest circuit model that carries it; what the row leaves
between the two runs, and why, stands beside it. Where the number at its end takes the effect out of the
equations altogether, not a byte may change.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import BOARD2, merge, quick, slider

from cosim.effects import EFFECTS, circuit_model
from cosim.results import Run

#: The hand takes a carriage into a wall of spring and damper and out again; it ends before the fifth sample.
HAND = {
    "type": "hand", "mass_kg": 0.05, "damping_n_s_per_m": 5.0, "stiffness_n_per_m": 200.0,
    "waypoints_s_m": [[0.0, 0.0, 0.01], [0.15, 0.0, -0.02], [0.3, 0.0, 0.0]],
}  # fmt: skip
SLIDER = slider(
    duration_s=0.3,
    computer={"period_s": 0.01, "analog_damping_n_s_per_m": 2.0},
    operator=HAND,
    device={"start": {"q_rad": [0.05]}},
    solver={"model": "auto", "max_step_s": 5e-4},
    effects={"operator_dynamics": True},
)
#: What a slider does not have: an arm of two links pressed into a wall.
ARM: dict[str, Any] = {
    "title": "arm",
    "duration_s": 0.2,
    "device": {
        "board": str(BOARD2),
        "linkage": "chain",
        "chain": {
            "lengths_m": [0.1, 0.1], "masses_kg": [0.1, 0.1], "coms_m": [0.05, 0.05],
            "inertias_kg_m2": [8e-5, 8e-5],
        },
        "start": {"q_rad": [0.6, 1.1]},
    },
    "computer": {"period_s": 0.01, "method": "continuous", "analog_stiffness_n_per_m": 100.0},
    "wall": {"point_m": [0.07, 0.16], "normal": [0.0, 1.0]},
    "solver": {"model": "auto"},
}  # fmt: skip

#: Nothing changes: the number takes the effect out of the equations.
SAME = 0.0
#: Both runs are ngspice's at rtol 1e-4, its steps chosen anew: several samples add their errors.
SPICE = 1e-3
#: A smooth change of the integrator's steps by a stiff but bounded addition; its own tolerance is 1e-7 rad.
STEPS = 1e-5


def values(**numbers: str) -> dict[str, Any]:
    return {"device": {"values": numbers}}


def pot(**numbers: float) -> dict[str, Any]:
    return {"device": {"potentiometer": numbers}}


def computer(**numbers: Any) -> dict[str, Any]:
    return {"computer": numbers}


def carriage(**numbers: Any) -> dict[str, Any]:
    return {"device": {"slider": numbers}}


FAST = {"tl072_gbw": "1e10", "tl072_aol": "1e9"}
GBW = {"opamp": "gbw"}
#: The computer renders a part of the wall, from what encoders tell.
SAMPLED = computer(
    method="combined", command_path="cmd", discrete_stiffness_n_per_m=50.0, discrete_damping_n_s_per_m=1.0
)
#: Data of op-amps, multipliers and drivers that are as good as ideal ones at their level `full`.
PERFECT_OPAMP = {
    "tl072_gbw": "1e10", "tl072_aol": "1e9", "tl072_sr": "1e13", "tl072_vos": "0", "tl072_ib": "0",
    "tl072_ro": "1m", "tl072_f2": "1e11",
}  # fmt: skip
PERFECT_VCA = {
    "ad633_bw": "1e10", "ad633_sr": "1e13", "ad633_scale": "0", "ad633_nlx": "0", "ad633_nly": "0",
    "ad633_ft": "0", "ad633_vosin": "0", "ad633_vosout": "0",
}  # fmt: skip
PERFECT_DRIVER = {
    "opa548_gbw": "1e10", "opa548_aol": "1e9", "opa548_sr": "1e13", "opa548_vos": "0", "opa548_ib": "0",
    "opa548_f2": "1e11",
}  # fmt: skip

#: effect -> rows of (value, what stands in both runs, the effect's number at its end, bound as a share of the
#: largest motor current and of the tip's travel)
ROWS: dict[str, list[tuple[Any, dict[str, Any], dict[str, Any], float]]] = {
    # delay of 18/(2 pi 1e10) s and a gain error of 18/1e9 a stage, in a model certified to 1e-6 of each path
    "opamp": [
        ("gbw", {}, values(**FAST), 1e-5),
        ("full", {}, values(**PERFECT_OPAMP), SPICE),
    ],
    "opamp_slew": [(True, {"effects": GBW}, values(tl072_sr="1e15"), SPICE)],
    "opamp_saturation": [(True, {"effects": GBW}, values(tl072_drop="-1e4"), SPICE)],
    # no offset: the same gains, from an operating point of zero volts; fitted to 1e-9 of each path
    "opamp_offset": [
        (True, {}, values(tl072_vos="0", tl072_ib="0", opa548_vos="0", opa548_ib="0"), 1e-7)
    ],
    "vca": [
        ("gbw", {}, values(ad633_bw="1e10"), 1e-5),
        ("full", {}, values(**PERFECT_VCA), SPICE),
    ],
    "vca_gain_error": [(True, {}, values(ad633_scale="0"), 1e-7)],
    "vca_offset": [(True, {}, values(ad633_vosin="0", ad633_vosout="0"), 1e-7)],
    "vca_nonlinearity": [(True, {}, values(ad633_nlx="0", ad633_nly="0", ad633_ft="0"), SPICE)],
    # time constants of 1 ns and 0.1 ps; a model certified to 1e-6 of the path
    "differentiator": [("corner", {}, values(r_der_in="1m", c_der_fb="1e-18"), 1e-4)],
    "driver_level": [
        ("gbw", {}, values(opa548_gbw="1e10", opa548_aol="1e9"), 1e-5),
        ("full", {}, values(**PERFECT_DRIVER, r_ilim="-13749.9"), SPICE),
    ],
    "driver_limit": [(True, {}, values(r_ilim="-13749.9"), 1e-7)],  # 0.7 MA
    # no magnet, no back-EMF; L/R of 2e-13 s
    "motor": [
        ("emf", {}, values(motor_k="1e-12"), 1e-7),
        ("full", {}, values(motor_k="1e-12", motor_l="1e-12"), 1e-5),
    ],
    "potentiometer": [("full", {}, values(pot_r="0", pot_rw="1"), 1e-7)],  # the ideal one has 1 Ohm
    "temperature": [(True, {}, {"device": {"temperature_c": 27.0}}, SAME)],
    # sources without power still land on every tick: other steps
    "component_noise": [(True, {}, values(ad633_en="1e-30", tl072_en="1e-30", opa548_en="1e-30"), 1e-3)],
    "pot_noise": [
        ("white", {}, pot(noise_rad=0.0), STEPS),
        ("peak_to_peak", {}, pot(noise_rad=0.0), STEPS),
        ("static", {}, pot(noise_rad=0.0), STEPS),
        ("position", {}, pot(noise_rad=0.0), STEPS),
    ],
    "pot_linearity": [(True, {}, pot(linearity_rad=0.0), SAME)],
    "pot_calibration": [(True, {}, pot(gain_error=0.0, zero_rad=0.0), SAME)],
    # half a count of 2 pi/(8 * 4e6) rad of a travel of 0.2 rad is 5e-7; the damper sees it over a period
    "encoder": [(True, SAMPLED, computer(encoder={"pulses_per_rev": 1000000, "decoding": 4}), 1e-4)],
    "dac": [(True, SAMPLED, computer(dac={"bits": 30}), 1e-7)],  # half a code is 1e-9 of the range
    "dac_settling": [(True, {}, computer(dac={"settling_s": 0.0}), SAME)],
    "dac_skew": [(True, {}, computer(dac={"skew_s": 0.0}), SAME)],
    "delay": [(True, {}, computer(delay_periods=0, delay_fraction=0.0), SAME)],
    "period_jitter": [
        ("uniform", {}, computer(jitter_share=0.0), SAME),
        ("normal", {}, computer(jitter_share=0.0), SAME),
    ],
    # of a preload F = k x: at most F (l1 + l2) on k y^2 with x = 0.07 mm, y = 0.156 m: 6e-4 of the stiffness
    "geometric_stiffness": [(True, {"wall": {"point_m": [0.07, 0.1557]}}, {}, 2e-3)],
    "gravity": [(True, {}, carriage(gravity_m_per_s2=[0.0, 0.0]), SAME)],
    # of v^2 = 1e-6: in 0.2 s less than 1e-7 rad of the 0.6 that the joint stands at
    "coriolis": [
        (True, {"wall": None}, {"device": {"start": {"v_rad_per_s": [1e-3, -1e-3]}}}, 1e-6)
    ],
    "viscous": [(True, {}, carriage(viscous_n_m_s=0.0), SAME)],
    "coulomb": [(True, {}, carriage(coulomb_n_m=0.0), STEPS)],
    "rotor_inertia": [(True, {}, carriage(rotor_inertia_kg_m2=0.0), SAME)],
    "end_stops": [(True, {}, carriage(stops_rad=[[-9.0, 9.0]]), STEPS)],
    # wind-up tau/k_s = 0.3 N m / 3e4 N m/rad = 1e-5 rad of 0.2 rad, and a shaft that rings by as much
    "shaft": [
        (
            True,
            {"effects": {"rotor_inertia": True}, "device": {"slider": {"rotor_inertia_kg_m2": 1e-4}}},
            carriage(shaft_stiffness_n_m_per_rad=3e4),
            1e-3,
        )
    ],
    "backlash": [
        (
            True,
            {
                "effects": {"rotor_inertia": True, "shaft": True},
                "device": {
                    "slider": {"rotor_inertia_kg_m2": 1e-4, "shaft_stiffness_n_m_per_rad": 500.0}
                },
            },
            carriage(backlash_rad=0.0),
            STEPS,
        )
    ],
    # a hand without mass and damping
    "operator_dynamics": [
        (True, {"operator": {"mass_kg": 0.0, "damping_n_s_per_m": 0.0}}, {}, SAME)
    ],
}  # fmt: skip
#: A choice between two devices has no number that leads from one to the other.
CHOICE_OF_DEVICE = {"driver"}
ON_AN_ARM = {"geometric_stiffness", "coriolis"}


def digest(run: Run) -> str:
    return hashlib.sha256(Path(run.signals.path).read_bytes()).hexdigest()


def apart(first: Run, second: Run, name: str) -> float:
    """Largest difference of a signal in the middle of the periods, as a share of its largest value."""
    times = (np.arange(first.scene.duration_s / 0.01 - 1) + 0.5) * 0.01
    a, b = (np.interp(times, run.signals["time"], run.signals[name]) for run in (first, second))
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))


def test_every_effect_has_a_null_limit() -> None:
    """Every setting of every effect but the choices between devices."""
    assert set(ROWS) == {effect.name for effect in EFFECTS} - CHOICE_OF_DEVICE
    for effect in EFFECTS:
        if effect.name not in CHOICE_OF_DEVICE:
            assert [row[0] for row in ROWS[effect.name]] == sorted(effect.on, key=_order(effect.name)), effect


def _order(name: str) -> Any:
    stated = [row[0] for row in ROWS[name]]
    return lambda value: stated.index(value) if value in stated else -1


@pytest.mark.few(14)
@pytest.mark.parametrize(
    ("name", "value", "both", "null", "bound"),
    [(name, *row) for name, rows in ROWS.items() for row in rows],
    ids=[f"{name}-{row[0]}" for name, rows in ROWS.items() for row in rows],
)
def test_null_limit(
    tmp_path: Path, name: str, value: Any, both: dict[str, Any], null: dict[str, Any], bound: float
) -> None:
    effect = next(each for each in EFFECTS if each.name == name)
    base = merge(merge(ARM if name in ON_AN_ARM else SLIDER, both), null)
    on_tables = merge(base, {"effects": {name: value}})
    on = quick(tmp_path, on_tables)
    model = circuit_model(on.scene)
    # the cheapest model that carries the effect; the other run on the same one
    off = quick(tmp_path, merge(base, {"effects": {name: effect.null}, "solver": {"model": model}}))
    assert on.plan["model"] == off.plan["model"] == model
    if bound == SAME:
        assert digest(on) == digest(off)
        return
    by_name = {signal: apart(on, off, signal) for signal in ("imot1", "q1")}
    print(name, value, model, {key: f"{each:.1e}" for key, each in by_name.items()})
    assert max(by_name.values()) < bound
