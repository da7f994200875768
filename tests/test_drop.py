"""The drop test: rest where theory lets it, phases that shift samples only, curves and verdicts."""

import math

import numpy as np
import pytest
from support import SCENES

from cosim.effects import without_dynamics
from cosim.loop.propagate_run import prepare
from cosim.loop.setup import shift_samples
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.studies.drop import Job, Rest, scan, slope
from cosim.studies.limits import limits
from cosim.studies.model import circuit_of
from cosim.studies.study import load_study, run_study

QUIET = (
    "effects.encoder=false",
    "effects.dac=false",
    "effects.dac_settling=false",
    "computer.method=discrete",
    "computer.analog_stiffness_n_per_m=0",
)


def ideal_drop(*more):
    """The drop scene with the circuit ideal, its circuit and constants."""
    base = load_scene(SCENES / "drop.toml", (*QUIET, *more))
    scene = load_scene(SCENES / "drop.toml", (*QUIET, *more, *without_dynamics(base)))
    return scene, *circuit_of(resolve(scene))


def test_a_mass_rests_up_to_its_exact_limit():
    """k* of theory, section 1, for mass and viscosity of the scene; a drop gives up within a tenth of it."""
    period = 0.01
    scene, circuit, constants = ideal_drop(f"computer.period_s={period}", "duration_s=30")
    slider = scene.device.slider
    rotor = slider.rotor_inertia_kg_m2 * constants.gear**2 / slider.radius_m**2
    mass = slider.mass_kg + scene.operator.mass_kg + rotor
    b = limits(scene, constants, circuit).viscosity_n_s_per_m
    tau = mass / b
    decay = math.exp(-period / tau)
    exact = b * (1 - decay) / (tau * (1 - decay) - period * decay)
    found = scan(Job(scene, constants, circuit, Rest(30.0, 1e-3, 1.0, 0.95, 4, 0.8, 1.05)))
    assert found.exact_n_per_m == pytest.approx(exact, rel=1e-6)
    assert 0.9 * exact < found.first_n_per_m <= exact
    assert found.all_n_per_m <= found.first_n_per_m <= found.none_n_per_m
    # beyond the exact limit nothing can rest, whatever the phase
    assert all(
        share == 0.0 for k, share in zip(found.stiffness_n_per_m, found.share, strict=True) if k > exact
    )


def test_phases_shift_the_samples_and_nothing_else():
    """A free fall is the same whenever the computer looks; the samples come early by the share."""
    ends, times = [], []
    for share in (0.0, 0.3):
        scene, circuit, constants = ideal_drop("duration_s=0.04", "computer.period_s=0.01")
        run = prepare(scene, constants, circuit, record=False, sample_capacity=16)
        shift_samples(run.memory, share)
        run.run()
        state = run.memory.state[0]
        ends.append(float(state["q"][0]))
        times.append(run.memory.samples[: int(state["samples_used"]), 1].copy())
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)  # 40 ms of a 45 ms fall: no contact
    assert times[1][1:4] == pytest.approx(times[0][1:4] - 0.003, abs=1e-15)


def test_the_slope_of_a_power_law():
    periods = np.geomspace(3e-3, 0.1, 5)
    assert slope({t: 7.0 * t**-0.9 for t in periods}) == pytest.approx(-0.9, rel=1e-12)


def test_a_study_of_two_curves(tmp_path):
    file = tmp_path / "drop.toml"
    file.write_text(
        f"""
study = "drop"
title = "Two curves"
scene = "{SCENES / "drop.toml"}"
set = ["solver.model=auto", {", ".join(f'"{text}"' for text in QUIET)}]
[parameters]
periods_s = [0.005, 0.01, 0.02]
phases = 2
window_s = 6.0
from_share = 0.85
[[parameters.families]]
name = "plain"
[[parameters.families]]
name = "sprung"
set = ["computer.method=combined", "computer.analog_stiffness_n_per_m=100"]
""",
        encoding="utf-8",
    )
    result = run_study(load_study(file), tmp_path / "out")
    limits_found = result.table("limits").columns
    assert limits_found["curve"] == ["plain"] * 3 + ["sprung"] * 3
    assert {verdict.id: verdict.holds for verdict in result.verdicts}["F13a"]
    assert {verdict.id for verdict in result.verdicts} == {"F13a", "F13b", "F13c"}
    passive = result.table("passive").columns["stiffness [N/m]"]
    exact = limits_found["exact, contact held [N/m]"][:3]
    assert all(p < k for p, k in zip(passive, exact, strict=True))  # passive is stricter than stable
