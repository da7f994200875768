"""Impedance and stiffest walls against plain formulas; the device's numbers; both studies on small files."""

import csv
import json
import math

import numpy as np
import pytest
import sampled_wall_rules
from held_scenes import RADIUS, at_wall
from legible import faults
from linear_runs import CONSTANTS, ideal, lagging
from support import COMMAND_TRUE, EMF_TRUE, KT, SCENES, SPRING_TRUE, V_NM, merge, scene_of, slider

from cosim.analysis.held_contact import with_computer
from cosim.analysis.impedance import displayed, full_scale, impedance, largest
from cosim.analysis.stability import held, stability
from cosim.cli import main
from cosim.studies.device import device_numbers, forces, workspace
from cosim.studies.study import load_study, run_study
from mech import Chain

HZ = np.geomspace(0.1, 1000.0, 41)
COMMAND, SPRING = COMMAND_TRUE * V_NM, SPRING_TRUE / CONSTANTS.k_fs
BACK_EMF = EMF_TRUE / RADIUS**2  # N s/m at the tip


def carriage(folder, more=None, **computer):
    """A carriage of 0.2 kg at 25 ms; a wall shows nothing but what `computer` asks of it."""
    shown = {"analog_stiffness_n_per_m": 1.0, "discrete_stiffness_n_per_m": 1.0}
    tables = slider(computer={"period_s": 0.025, "method": "combined", **shown})
    none = dict.fromkeys(shown, 0.0)
    return with_computer(scene_of(folder, merge(tables, more or {})), **{**none, **computer})


def test_free_air_is_mass_and_back_emf(tmp_path):
    scene = carriage(tmp_path)
    result = impedance(at_wall(scene, ideal(1)), HZ)
    # rounding, and 1e-9 of op-amp gain that the hand-made board does not have
    assert result == pytest.approx(2j * np.pi * HZ * 0.2 + BACK_EMF, rel=1e-9)


def test_an_analog_spring_behind_a_pole(tmp_path):
    """K/(s (1 + s tau)) beside the mass; the pole before the multipliers is far away, the back-EMF off."""
    tau = 1e-3
    circuit = lagging(ideal(1, emf=False), 1e9, 1.0 / tau)
    scene = carriage(tmp_path, analog_stiffness_n_per_m=100.0)
    s = 2j * np.pi * HZ
    expected = 0.2 * s + 100.0 * SPRING / (s * (1.0 + s * tau))
    # the far pole delays by 1e-9 s, 6e-6 rad at 1 kHz
    assert impedance(at_wall(scene, circuit), HZ) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("late", "filter_hz", "settling"),
    [(0.0, None, 0.0), (0.25, None, 0.0), (0.25, 6.0, 0.0), (0.0, 6.0, 4e-3)],
)
def test_a_sampled_wall_is_its_fundamental(tmp_path, late, filter_hz, settling):
    """Against a staircase summed by hand: K + B (1 - 1/z)/T, held for T, half a period late on average.

    With the velocity's low-pass, sample by sample; a ramp of converters is the mean of steps within it.
    """
    k, b, period = 80.0, 1.5, 0.025
    more = {"effects": {"delay": True}}
    if filter_hz is not None:
        more |= {"computer": {"velocity": {"filter_hz": filter_hz}}}
    if settling:
        more = merge(more, {"computer": {"dac": {"settling_s": settling}}, "effects": {"dac_settling": True}})
    scene = carriage(
        tmp_path, more, discrete_stiffness_n_per_m=k / COMMAND,
        discrete_damping_n_s_per_m=b / COMMAND, delay_fraction=late,
    )  # fmt: skip
    for hz in (0.7, 5.0, 33.0):
        # many turns of a sine of 1 m: the staircase's Fourier coefficient at hz, each step exactly
        count, before = 20_000, 200
        n = np.arange(-before, count)
        x = np.exp(2j * np.pi * hz * period * n)
        speed = (x - x * np.exp(-2j * np.pi * hz * period)) / period
        if filter_hz is not None:
            keep = math.exp(-2.0 * math.pi * filter_hz * period)  # of a pole at so many hertz, a period later
            for i in range(1, len(speed)):
                speed[i] = keep * speed[i - 1] + (1.0 - keep) * speed[i]
        n, force = n[before:], (k * x + b * speed)[before:]
        w = 2 * np.pi * hz
        fundamental = 0.0
        nodes, weights = np.polynomial.legendre.leggauss(8)
        for node, weight in zip(nodes, weights, strict=True):
            begin = (n + late) * period + settling * (1.0 + node) / 2.0
            part = (np.exp(-1j * w * (begin + period)) - np.exp(-1j * w * begin)) / (-1j * w)
            fundamental += weight / 2.0 * np.sum(force * part) / (count * period)
        expected = 0.2j * w + fundamental / (1j * w)
        value = impedance(at_wall(scene, ideal(1, emf=False)), np.array([hz]))[0]
        assert value == pytest.approx(expected, rel=1e-6)  # 5e-7 of the board's resistors in COMMAND


def test_at_low_frequency_a_wall_is_as_stiff_as_it_says(tmp_path):
    scene = carriage(tmp_path, analog_stiffness_n_per_m=100.0, discrete_stiffness_n_per_m=60.0)
    s = 2j * np.pi * 1e-3
    value = impedance(at_wall(scene, ideal(1)), np.array([1e-3]))[0] * s
    assert value.real == pytest.approx(100.0 * SPRING + 60.0 * COMMAND, rel=1e-6)


def test_the_stiffest_walls(tmp_path):
    """Analog at full scale or short of b/tau + b^2/m, discrete short of the exact border of a held mass."""
    viscous = {"device": {"slider": {"viscous_n_m_s": 1.6 * RADIUS**2}}, "effects": {"viscous": True}}
    scene, plain = carriage(tmp_path, viscous), ideal(1, emf=False)
    wall = displayed(at_wall(scene, plain), spring=False, damper=False, margin=0.8).scene
    border = sampled_wall_rules.held_mass(0.2, 1.6, 0.025)
    assert wall.computer.discrete_stiffness_n_per_m * COMMAND == pytest.approx(0.8 * border, rel=1e-6)
    assert wall.computer.analog_stiffness_n_per_m == 0.0
    wall = displayed(at_wall(scene, plain), spring=True, damper=False).scene
    assert wall.computer.analog_stiffness_n_per_m == pytest.approx(CONSTANTS.k_fs / RADIUS**2, rel=1e-12)
    # a slow circuit oscillates before full scale
    slow = lagging(plain, 1e9, 2 * math.pi * 8.0)
    alone = with_computer(scene, method="continuous")
    result = largest(at_wall(alone, slow), "analog_stiffness_n_per_m", cap=CONSTANTS.k_fs / RADIUS**2)
    assert result.by == "stability"
    assert result.value * SPRING == pytest.approx(1.6 * 2 * math.pi * 8.0 + 1.6**2 / 0.2, rel=1e-6)
    wall = displayed(at_wall(scene, slow), spring=True, damper=False, margin=0.8)
    assert stability(held(wall)).stable


def test_full_scale_is_that_of_the_largest_gain():
    direction = np.array([0.1, -0.2])
    stiffness, damping = full_scale(CONSTANTS, direction)
    assert stiffness == pytest.approx(CONSTANTS.k_fs / 0.04)
    assert damping == pytest.approx(CONSTANTS.c_fs / 0.04)


def test_forces_at_the_tip_against_all_directions():
    """A box of torques seen from every direction: the largest force along each is where J^T F leaves it."""
    chain = Chain(
        lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05), inertias_kg_m2=(1e-4, 1e-4)
    )
    jac = chain.jacobian(np.array([0.6, 1.1]))
    turn = np.linspace(0.0, 2.0 * np.pi, 20_001)
    along = np.array([np.cos(turn), np.sin(turn)])
    most = 0.28 / np.abs(jac.T @ along).max(axis=0)
    result = forces(jac, 0.28)
    # the grid of 3e-4 rad misses a smooth minimum by its square, a corner by itself
    assert result.any_n == pytest.approx(most.min(), rel=1e-6)
    assert result.best_n == pytest.approx(most.max(), rel=1e-3)
    assert forces(np.array([[0.0], [0.14]]), 0.28).any_n == pytest.approx(2.0)


def test_numbers_of_a_carriage(tmp_path):
    """Every number from the board's statements: 0.28 N m on 133 mm, k_fs/r^2, 2 m/T-like damping limits."""
    stops = {"stops_rad": [[-1.0, 0.5]], "viscous_n_m_s": 1.6 * RADIUS**2}
    scene = carriage(tmp_path, {"device": {"slider": stops}, "effects": {"viscous": True}})
    result = device_numbers(at_wall(scene, ideal(1, emf=False)))
    assert result.continuous_n == pytest.approx(0.875 * KT * 8 / RADIUS)
    assert result.peak_n == pytest.approx(1.987 * KT * 8 / RADIUS)
    assert (result.analog_n_per_m.by, result.analog_n_per_m.value) == (
        "full scale", pytest.approx(CONSTANTS.k_fs / RADIUS**2),
    )  # fmt: skip
    assert result.discrete_n_per_m.value * COMMAND == pytest.approx(
        sampled_wall_rules.held_mass(0.2, 1.6, 0.025), rel=1e-6
    )
    # the largest damping by the map of a period, written out by hand
    damped = result.discrete_n_s_per_m.value * COMMAND
    tau, period = 0.2 / 1.6, 0.025
    e = math.exp(-period / tau)
    x, v = tau * (1 - e), np.array([period - tau * (1 - e), 1 - e]) / 1.6
    # state: position, speed, last position; force -B (position - last)/T
    step = np.array([[1.0, x, 0.0], [0.0, e, 0.0], [1.0, 0.0, 0.0]])
    step[:2] -= damped / period * np.outer(v, [1.0, 0.0, -1.0])
    z = np.linalg.eigvals(step)
    z = z[np.abs(z - 1.0) > 1e-9]
    assert np.abs(z).max() == pytest.approx(1.0, abs=1e-6)
    assert result.workspace.height_m == pytest.approx(1.5 * RADIUS)
    assert result.workspace.width_m == 0.0


def test_workspace_of_the_arm():
    """l1 l2 times the base's turn times the difference of the cosines of the bend."""
    from cosim.scene import load_scene

    room, poses = workspace(load_scene(SCENES / "slope.toml"))
    assert room.area_m2 == pytest.approx(0.01 * 2 * math.pi * 2 * math.cos(0.15), rel=1e-9)
    reach = 0.2 * math.cos(0.075)
    # the grid of the turn, 5 degrees, meets all four ends of the ring
    assert room.width_m == pytest.approx(2 * reach, rel=2e-3)
    assert poses.shape[1] == 2


@pytest.mark.slow
def test_the_command_tells_and_writes_the_numbers(tmp_path, capsys):
    out = tmp_path / "numbers.csv"
    scene = str(SCENES / "slope.toml")
    assert main(["device", scene, "--json", "-o", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    case = printed["cases"][0]
    assert case["analog_n_per_m"]["by"] == "full scale"
    assert case["stiffness_n_per_m"] > case["analog_n_per_m"]["value"]
    assert case["workspace"]["area_m2"] > 0.1
    assert {each["name"]: each["force_n"] for each in printed["published"]}["Falcon"] == 8.0
    rows = dict(list(csv.reader(out.read_text().splitlines()))[1:])
    assert float(rows["continuous force, any direction [N]"]) == pytest.approx(case["continuous_n"])


SMALL = """
study = "maps"
title = "Maps"
scene = "{scene}"
set = [
  "solver.model=auto", "computer.period_s=0.025", "effects.encoder=false", "effects.dac=false",
  "computer.method=discrete", "computer.analog_stiffness_n_per_m=0", "computer.discrete_stiffness_n_per_m=1",
]
[parameters]
periods_s = [0.01, 0.05]
stiffness_shares = [0.3, 1.2]
dampings_n_s_per_m = [0.0, 2.0]
stiffness_n_per_m = [20.0, 400.0]
phases = 2
window_s = 10.0
[[parameters.panels]]
name = "ideal"
set = [
  "effects.opamp=ideal", "effects.vca=ideal", "effects.driver_level=ideal", "effects.motor=emf",
  "effects.differentiator=ideal", "effects.dac_settling=false",
]
[[parameters.panels]]
name = "rough"
set = ["effects.coulomb=true", "effects.encoder=true"]
[[parameters.widths]]
name = "discrete only"
[[parameters.widths]]
name = "with spring and damper"
spring = true
damper = true
"""


@pytest.mark.long
def test_the_maps_hold_what_theory_says(tmp_path):
    file = tmp_path / "maps.toml"
    file.write_text(SMALL.format(scene=SCENES / "drop.toml"), encoding="utf-8")
    result = run_study(load_study(file), tmp_path / "out")
    limits = result.table("kt_limits").columns
    assert limits["panel"] == ["ideal", "ideal", "rough", "rough"]
    # the ideal circuit on a plain mass: closed form; b from back-EMF and bearings
    b = EMF_TRUE / 0.1333**2 + 5e-4 / 0.1333**2
    for row, period in enumerate((0.01, 0.05)):
        # 2e-5: rotor and carriage make 0.2 kg to 4e-6; what the board states and what its resistors make
        assert limits["exact border [N/m]"][row] == pytest.approx(
            sampled_wall_rules.held_mass(0.2, b, period), rel=2e-5
        )
        passive = limits["passive (Colgate, Schenkel) [N/m]"][row]
        assert passive == pytest.approx(2 * b / period, rel=1e-4)
        assert limits["Abbott, Okamura [N/m]"][row] == pytest.approx(2 * b / period, rel=1e-5)
        assert limits["Diolaiti, sigma = 1/2 [N/m]"][row] is None
    delta = 2 * math.pi / 16_000 * 0.1333
    assert limits["Diolaiti, sigma = 1/2 [N/m]"][2] == pytest.approx(2 * 0.016 / 0.1333 / delta, rel=1e-9)
    points = result.table("kt_points").columns
    assert set(points["share at rest"]) <= {0.0, 0.5, 1.0}
    plain = [s for p, s in zip(points["panel"], points["share at rest"], strict=True) if p == "ideal"]
    assert plain == [1.0, 0.0, 1.0, 0.0]
    assert all(verdict.holds is not False for verdict in result.verdicts)
    walls = result.table("walls").columns
    assert walls["displayed [N/m]"][1] > 2 * walls["displayed [N/m]"][0]
    from reports.studies.stability_maps import draw
    from reports.style import look

    with look():
        drawn = draw(result)
        assert [part for part, _, _ in drawn] == ["kt", "kb", "zwidth"]
        assert not [fault for _, _, each in drawn for fault in faults(each.figure)]
