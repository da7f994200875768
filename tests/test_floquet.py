"""Which oscillation a mode of the sampled loop is: frequency and damping do not depend on the period."""

import math
from pathlib import Path

import numpy as np
import pytest
from held_scenes import at_wall
from linear_runs import ideal
from support import BOARD2, SCENES, merge, scene_of, shared_child, slider

from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact, touching, with_computer
from cosim.analysis.stability import held, stability
from cosim.analysis.stiffness_limits import limits
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.commands.stability import describe
from cosim.plan import resolve
from cosim.scene import Scene, load_scene

Board = tuple[Scene, LinearCircuit, DesignConstants]


@pytest.fixture(scope="module")
def press() -> Board:
    assert BOARD2.is_file()
    scene = load_scene(SCENES / "press.toml")
    return scene, *circuit_of(resolve(scene))


@pytest.mark.parametrize("period", [0.1, 0.025, 0.02, 0.003, 0.001])
def test_a_mode_that_nothing_samples_keeps_its_frequency(press: Board, period: float) -> None:  # 52
    """An analog wall near its border rings at 41.4 Hz: eigenvalues of continuous time, at any period."""
    scene, circuit, constants = press
    stiff = with_computer(scene, analog_stiffness_n_per_m=50e3, period_s=period)
    lifted = held(HeldContact.at_wall(stiff, constants, circuit))
    poles = np.linalg.eigvals(lifted.system.a)
    slow = poles[(poles.imag > 1.0) & (np.abs(poles) < 1e3)]
    assert len(slow) == 2
    assert slow.imag.max() / (2 * math.pi) == pytest.approx(41.0, abs=1.0)  # beyond half the rate of 25 ms
    modes = [mode for mode in stability(lifted).modes if mode.frequency_hz > 1.0]
    every = sorted((mode.frequency_hz, mode.damping) for mode in modes)
    expected = sorted((s.imag / (2 * math.pi), -s.real / abs(s)) for s in slow)
    np.testing.assert_allclose(every, expected, rtol=1e-6)
    assert not any(mode.ambiguous for mode in modes)


@pytest.mark.slow
def test_the_border_tells_the_same_frequency_at_every_period(press: Board) -> None:  # 52
    scene, circuit, constants = press
    rows = []
    for period in (0.025, 0.02, 0.001):
        result = limits(HeldContact.at_wall(with_computer(scene, period_s=period), constants, circuit))
        assert result.border.stability is not None
        assert result.border.stability.critical is not None
        rows.append((result.border.value, result.border.stability.critical.frequency_hz))
    np.testing.assert_allclose(rows, [rows[0]] * 3, rtol=1e-6)


def test_a_sampled_swing_has_the_frequency_that_its_samples_show(tmp_path: Path) -> None:
    """21: m x'' = -k x_k, held: z = 1 - k T^2/(4 m) +- ..., |z|^2 = 1 + k T^2/(2 m)."""
    mass, period = 0.2, 0.003
    tables = slider(
        computer={"period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
                  "discrete_stiffness_n_per_m": 1000.0},
        device={"slider": {"mass_kg": mass}},
    )  # fmt: skip
    scene = scene_of(tmp_path, tables)
    critical = stability(held(at_wall(scene, ideal(1, emf=False)))).critical
    assert critical is not None
    z = 1 - 1000.0 * period**2 / (4 * mass)
    turn = math.atan2(math.sqrt(1 + 1000.0 * period**2 / (2 * mass) - z**2), z)
    assert critical.growth == pytest.approx(math.sqrt(1 + 1000.0 * period**2 / (2 * mass)), rel=1e-5)
    assert critical.frequency_hz == pytest.approx(turn / (2 * math.pi * period), rel=1e-5)
    assert critical.share > 0.99


def test_a_swing_of_nearly_half_the_rate_is_two_at_once(tmp_path: Path) -> None:
    """A loop whose samples change sign every time moves at + and - half its rate alike: x(t) is real.

    k T^2/(2 m) = 7.975 turns them by 0.488 of a turn and trebles them, s T = 1.10 + 3.07i or 1.10 - 3.22i.
    With x'' constant in between, the mean of exp(-s t) x(t) falls as 1/s^3: squared 1.3 to 1.
    """
    mass, period = 0.2, 0.1
    tables = slider(
        computer={"period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
                  "discrete_stiffness_n_per_m": 319.0},
        device={"slider": {"mass_kg": mass}},
    )  # fmt: skip
    scene = scene_of(tmp_path, tables)
    critical = stability(held(at_wall(scene, ideal(1, emf=False)))).critical
    assert critical is not None
    assert critical.frequency_hz == pytest.approx(0.488 / period, rel=2e-3)
    assert critical.share == pytest.approx(1.3 / 2.3, abs=0.05)


def test_the_words_name_the_limit_to_design_for(press: Board) -> None:
    """The board's gain DACs end at 612 N/m, far below the border: full scale over the largest w_i w_j."""
    scene, circuit, constants = press
    result = limits(HeldContact.at_wall(scene, constants, circuit))
    text = describe(result)
    assert "decays x" in text
    assert "grows" not in text
    assert result.gil_hulin_n_per_m is None  # a rule for sampled walls
    assert "Gil" not in text
    assert result.board_n_per_m is not None
    jac_normal = HeldContact.at_wall(scene, constants, circuit).torques
    full = constants.k_fs * constants.dac_v / constants.v_fs
    assert result.board_n_per_m == pytest.approx(
        full / np.abs(np.outer(jac_normal, jac_normal)).max(), rel=1e-9
    )
    assert result.design == (result.board_n_per_m, "the board's range")
    assert "design for" in text


def test_a_sampled_wall_is_designed_for_passivity(tmp_path: Path) -> None:
    tables = merge(
        slider(),
        {
            "computer": {"method": "discrete", "analog_stiffness_n_per_m": 0.0,
                         "discrete_stiffness_n_per_m": 20.0, "period_s": 0.01},
            "device": {"slider": {"viscous_n_m_s": 0.01}},
            "effects": {"viscous": True},
        },
    )  # fmt: skip
    result = limits(at_wall(scene_of(tmp_path, tables), ideal(1, emf=False)))
    value, which = result.design
    assert which == "the largest passive stiffness"
    assert value == result.passive_n_per_m
    assert result.board_n_per_m is None
    assert "Gil and Hulin's rule knows" in describe(result)


@pytest.mark.slow
def test_a_device_without_damping_has_limits_all_the_same(tmp_path: Path) -> None:
    """No viscosity at all: nothing sampled is stable or passive, and the command says so."""
    tables = slider(
        computer={"method": "discrete", "analog_stiffness_n_per_m": 0.0, "discrete_stiffness_n_per_m": 20.0},
    )
    result = limits(at_wall(scene_of(tmp_path, tables), ideal(1, emf=False)))
    assert result.viscosity_n_s_per_m == 0.0
    assert result.border.value == 0.0
    assert result.design[0] == 0.0
    assert "no stiffness is stable" in describe(result)
    assert "UNSTABLE" in describe(result)


@pytest.mark.parametrize(
    ("origin", "point", "normal", "angle"),
    [
        ([0.0, 0.01], [0.0, 0.0], [0.0, 1.0], -0.01 / 0.1333),  # a fall of 10 mm at a radius of 133.3 mm
        ([0.0, -0.02], [0.3, 0.01], [0.0, 1.0], 0.03 / 0.1333),
        ([0.0, 0.01], [0.0, 0.0], [0.6, 0.8], -0.01 / 0.1333),  # along a slope as well: 0.8 s = -0.8 x 10 mm
    ],
)
def test_a_slider_that_touches_stands_on_the_wall(origin, point, normal, angle):
    """Broken once: with + in place of - no test failed, for a slider's theory is the same at every angle."""
    where = [f"device.slider.origin_m={origin}", f"wall.point_m={point}", f"wall.normal={normal}"]
    plan = resolve(load_scene(SCENES / "drop.toml", where))
    assert touching(plan.scene, plan.stated(shared_child())) == pytest.approx([angle], rel=1e-12)
