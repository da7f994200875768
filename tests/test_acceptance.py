"""Acceptance rows A1 to A7 as studies: against resistors, kinematics and closed forms worked out apart."""

import numpy as np
import pytest
from support import K_FS, SCENES, SPRING_TRUE

from cosim.analysis.held_contact import HeldContact
from cosim.caution import collected
from cosim.plan import resolve
from cosim.storage.checkpoint import Points
from cosim.studies import equations, paper_passivity
from cosim.studies.study import load_study
from mech import Chain

PAPER = SCENES / "paper"
CHAIN = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05), inertias_kg_m2=(1e-4, 1e-4))
NORMAL = np.array([-1.0, 1.0]) / np.sqrt(2.0)


@pytest.fixture(scope="module")
def arm():
    """The paper's study on the ideal board, held at a pose."""
    spec = load_study(PAPER / "0_1_acceptance.toml")
    level = spec.parameters.levels[0]
    scene = spec.scene(*level.set, "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0")
    return HeldContact.of(resolve(scene)).at([0.6, 1.1])


def test_the_jacobian_s_error_is_that_of_differences():
    """h^2/6 times a third derivative of at most 0.2 m: 3e-12; rounding of 1e-17 m over 2 h: 1e-12."""
    assert equations.jacobian_error(CHAIN, np.array([0.6, 1.1])) < 1e-11


def test_gains_are_those_of_the_resistors(arm):
    """Springs: 169k/10k, 10k/24.3k, 20k/10k, 5 Ohm, by hand; what op-amps of gain 1e9 leave out is 1e-7."""
    by_name = {name: (wanted, got) for name, _, wanted, got in equations.gains(arm)}
    assert len(by_name) == 12
    w = np.array([[-0.15563073, -0.09916648], [0.06964911, -0.01288445]]).T @ NORMAL  # J^T n of theory
    assert by_name["ksp12"][0] == pytest.approx(100.0 * w[0] * w[1], rel=1e-6)
    for name in ("ksp11", "ksp12", "ksp21", "ksp22", "u, ksp12"):
        wanted, got = by_name[name]
        assert got / wanted == pytest.approx(SPRING_TRUE / K_FS, rel=1e-5), name


def test_the_force_is_that_of_kinematics_and_resistors(arm):
    normal, tangent = equations.static_force(arm, 0.01)
    share, half_way = equations.linearised(CHAIN, arm.q, NORMAL, 0.01)
    assert normal == pytest.approx(100.0 * 0.01 * (1.0 + share) * SPRING_TRUE / K_FS, rel=1e-5)
    assert abs(tangent) < 1e-12
    # first order in the depth with J of the pose, second order half way
    there, there_half_way = equations.linearised(CHAIN, arm.q, NORMAL, 0.001)
    assert share / there == pytest.approx(10.0, rel=0.2)
    assert half_way / there_half_way == pytest.approx(100.0, rel=0.2)


@pytest.mark.few(1)
@pytest.mark.parametrize(("change", "holds"), [((), True), (("device.values.r_sum_spring=24.543k",), False)])
def test_the_arm_s_rows_hold_and_a_resistor_breaks_one(change, holds):
    """1 % of the springs' resistor is ten times what A2 allows; the dampers' have their own."""
    spec = load_study(PAPER / "0_1_acceptance.toml", change)
    given = spec.parameters
    small = given.model_copy(update={"levels": given.levels[:1], "points": 5})
    with Points(None) as points:
        result = equations.analyse(type(spec)(**{**vars(spec), "parameters": small}), points)
    by_name = {}
    for verdict in result.verdicts:
        by_name.setdefault(verdict.id, verdict.holds)
    assert by_name == {"A1": True, "A2": holds, "A3": holds, "A4": holds}
    slopes = dict(zip(*list(result.table("slopes").columns.values())[::2], strict=True))
    # the circuit's part shrinks with the resistor; (11) at 2 mm of depth is 2e-3
    share = 1.0 if holds else 24.3 / 24.543
    assert slopes["continuous"] == pytest.approx(100.0 * share * SPRING_TRUE / K_FS, rel=5e-3)
    assert slopes["discrete"] == pytest.approx(133.0, rel=1e-3)
    assert slopes["combined"] == pytest.approx(slopes["continuous"] + slopes["discrete"], rel=3e-3)


@pytest.mark.parametrize(
    ("damping", "wall_damping", "period", "known"),
    [(1.6625, 0.0, 0.025, 133.0), (1.5, -1.0, 1e-3, 1000.0), (0.1 + 2.0, 0.0, 0.025, 168.0)],
)
def test_the_largest_passive_stiffness(damping, wall_damping, period, known):
    assert paper_passivity.largest_passive(damping, wall_damping, period) == pytest.approx(known, rel=1e-9)


def test_the_slider_s_rows_hold():
    spec = load_study(PAPER / "0_2_passive.toml")
    small = spec.parameters.model_copy(update={"depths_m": (0.01,), "dampers_n_s_per_m": (2.0,)})
    with collected() as cautions, Points(None) as points:
        result = paper_passivity.analyse(type(spec)(**{**vars(spec), "parameters": small}), points)
    assert [str(each) for each in cautions] == []  # what its own runs leave out is no slip of anyone
    assert [(v.id, v.holds) for v in result.verdicts] == [
        ("A5", True), ("A6", True), ("A6", None), ("A7", True)
    ]  # fmt: skip
    dampers = result.table("dampers").columns
    # kt^2 gear^2/R and bearings over r^2, and 2 N s/m of resistors that are good to 1e-4
    bare = (0.04**2 * 64 / 5.0 + 5e-4) / 0.1333**2
    assert dampers["b + k_sd of the netlist [N s/m]"][0] == pytest.approx(bare, rel=1e-5)
    assert dampers["by search [N/m]"][2] == pytest.approx(2.0 * (bare + 2.0) / 0.025, rel=1e-4)
    energies = result.table("energies").columns
    bound, least = energies["-k x(0)^2/2 [mJ]"][0], energies["least taken up [mJ]"][0]
    assert bound == pytest.approx(-5.0)
    # the hand's spring pulls it through rest at 10 mm 135/235 to 1.5 mm: all but (1.5/10)^2 comes out
    assert bound < least < 0.97 * bound
