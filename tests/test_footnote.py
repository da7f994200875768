"""Footnote 1 as studies: numbers of theory, independent ways to the same quantity, and null forms."""

import numpy as np
import pytest
from support import SCENES

from cosim.circuits.delay import spring_delays
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.studies.eta import active_from, block_delays, unstable_from
from cosim.studies.points import Points
from cosim.studies.study import load_study
from cosim.studies.tip import Wanted, reached, tip_of

PAPER = SCENES / "paper"


def scene(name, *changes):
    return load_scene(SCENES / f"{name}.toml", ("solver.model=linear", *changes))


@pytest.fixture(scope="module")
def carriage():
    return tip_of(scene("drop"))


@pytest.fixture(scope="module")
def arm():
    return tip_of(scene("slope"))


def tau_of(changed):
    return max(path.total_s for path in spring_delays(resolve(changed).board))


def rendered(tip):
    """What the board makes of 1 N/m: its resistors are not quite its design constants (1e-3)."""
    return float(tip.impedance(Wanted(1.0), np.array([1e-3]))[0].real)


def test_the_viscosity_is_back_emf_and_bearings(carriage):
    """kt^2 gear^2/R + viscous, over r^2: 0.04^2 64/5 and 5e-4 N m s/rad at 0.1333 m."""
    expected = (0.04**2 * 64 / 5.0 + 5e-4) / 0.1333**2
    # what is left of the driver's 10 mOhm behind a loop gain of 8e4/3 is 4e-7 Ohm beside 5 Ohm
    assert carriage.viscosity() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["drop", "slope"])
def test_delay_eats_all_damping_where_the_spring_turns_active(name, request):
    """b/sum(tau) from blocks, against the damping over all frequencies of the fitted circuit."""
    tip = request.getfixturevalue({"drop": "carriage", "slope": "arm"}[name])
    limit = tip.viscosity() / tau_of(tip.scene)
    assert active_from(tip) * rendered(tip) == pytest.approx(limit, rel=1e-6)


def test_a_mass_alone_is_stable_a_little_longer(carriage):
    """k < b/tau + b^2/m for one pole; the other delays are 0.6 % of the sum, and stand in it."""
    b, tau = carriage.viscosity(), tau_of(carriage.scene)
    mass = 0.1428 + 0.05 + 2e-6 * 64 / 0.1333**2
    # the back-EMF passes the winding as the spring does: only the bearings' part is free of the lag
    free = 5e-4 / 0.1333**2
    found = unstable_from(carriage) * rendered(carriage)
    assert b / tau < found < b / tau + b**2 / mass
    assert found == pytest.approx(b / tau + b * free / mass, rel=2e-3)


def test_the_headline_s_tables_are_k_sum_tau_over_b(arm):
    spec = load_study(PAPER / "5_1_eta.toml")
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    limits = result.table("limits").columns
    b, tau = arm.viscosity(), tau_of(arm.scene)
    assert limits["practical limit b/sum [N/m]"][0] == pytest.approx(b / tau, rel=1e-9)
    assert limits["eta at 100 N/m [%]"][0] == pytest.approx(100.0 * 100.0 * tau / b, rel=1e-9)
    blocks = result.table("blocks").columns
    pairs = zip(blocks["case"], blocks["delay [us]"], strict=True)
    own = [late for case, late in pairs if case == "as built"]
    assert sum(own) == pytest.approx(1e6 * tau, rel=1e-9)
    assert all(verdict.holds for verdict in result.verdicts)
    band = result.table("viscosity").columns["b [N s/m]"]
    assert band[0] < b < band[-1]


def test_poses_reach_the_whole_workspace(arm):
    poses = reached(arm, 5, 0.15)
    assert len(poses) == 25
    # 1/(w^T B^-1 w) with equal joints' B: B/|J^T n|^2, and |J^T n| is at most the reach of both
    inner = arm.joint_viscosity()
    assert inner == pytest.approx(np.diag(np.diag(inner)), abs=1e-9)
    for tip in poses:
        assert tip.viscosity() == pytest.approx(inner[0, 0] / (tip.torques @ tip.torques), rel=1e-6)
    assert block_delays([]) == {}
