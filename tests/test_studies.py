"""Study files, their points and page; footnote 2 as the simplest of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support import SCENES

from cosim.errors import InputError
from cosim.storage.checkpoint import Points
from cosim.studies.poses import drag, gains, unevenness
from cosim.studies.preload import apparent, felt, pressed
from cosim.studies.study import STUDIES, is_study, load_study, run_study, study_named
from mech import Chain

CHAIN = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05), inertias_kg_m2=(1e-4, 1e-4))
FILE = """
study = "congruence"
title = "Under a preload"
scene = "{scene}"
[parameters]
preload_n = 1.0
points = 7
"""


@pytest.fixture
def study_file(tmp_path):

    path = tmp_path / "preload.toml"
    path.write_text(FILE.format(scene=SCENES / "slope.toml"), encoding="utf-8")
    return path


def test_every_study_is_what_its_name_says():
    for name in STUDIES:
        assert study_named(name).name == name


def test_a_result_is_kept_until_what_it_depends_on_changes(study_file, tmp_path):
    spec = load_study(study_file)
    first = run_study(spec, tmp_path / "out")
    calls = []
    again = run_study(spec, tmp_path / "out", on_progress=lambda *a: calls.append(a))
    assert again == first
    assert (tmp_path / "out" / "workspace.csv").read_text().startswith("x [m],y [m]")
    changed = load_study(study_file, ("wall.normal=[0.0, 1.0]",))
    assert run_study(changed, tmp_path / "out").digest != first.digest
    edited = load_study(study_file, ("device.values.r_sum_spring=20k",))
    assert edited.digest() != first.digest


def test_an_interrupted_study_goes_on_at_its_points(tmp_path):
    path = tmp_path / "points.jsonl"
    with Points(path, "a") as points:
        assert points.get("one", lambda: {"k": 1.0}) == {"k": 1.0}
    with path.open("a") as stream:
        stream.write('{"key": "two", "val')  # cut off
    with Points(path, "a") as points:
        assert points.get("one", pytest.fail) == {"k": 1.0}
        assert points.get("two", lambda: 2) == 2
    with Points(path, "b") as points:  # depends on something else now
        assert points.get("one", lambda: 3) == 3
    assert json.loads(path.read_text().splitlines()[0]) == {"digest": "b"}


def test_all_that_is_wrong_with_a_study_file_is_reported(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text('study = "congruense"\nscene = 3\ntittle = "x"\n', encoding="utf-8")
    assert is_study(path)
    with pytest.raises(InputError) as caught:
        load_study(path)
    text = str(caught.value)
    assert 'did you mean "congruence"?' in text
    assert 'did you mean "title"?' in text
    assert "bad.toml:2: scene = 3: is required" in text


def test_a_parameter_out_of_range_is_named(study_file):
    study_file.write_text(study_file.read_text().replace("preload_n = 1.0", "preload_n = -1.0"))
    with pytest.raises(InputError, match=r"preload.toml:6: parameters.preload_n = -1.0.*> 0.*N"):
        load_study(study_file)


@pytest.mark.parametrize("compensated", [False, True])
def test_apparent_stiffness_is_what_pressing_finds(compensated):
    """Two ways: the formula of theory, and the pose solved for forces a little off."""
    q, force, k = np.array([0.6, 1.1]), np.array([1.0, -2.0]), np.diag([100.0, 100.0])
    result = apparent(CHAIN, q, k, force, compensated=compensated)
    # central differences of 1e-4 N: (1e-4 N / 1 N)^2 = 1e-8 of it, and rounding of 1e-16 m / 1e-6 m
    assert result == pytest.approx(pressed(CHAIN, q, k, force, compensated=compensated), rel=1e-6, abs=1e-5)
    if compensated:
        assert result == pytest.approx(k, abs=1e-9)
    else:
        jac = CHAIN.jacobian(q)
        shift = np.linalg.inv(jac).T @ np.array([[0.24161234, 0.21121741], [0.21121741, 0.21121741]])
        assert k - result == pytest.approx(shift @ np.linalg.inv(jac), rel=1e-6)


NORMAL = np.array([-1.0, 1.0]) / np.sqrt(2.0)


@pytest.mark.long
def test_the_compensating_law_holds_the_stiffness_in_runs():
    """What the circuit shows within a period, against the formula; 20 mN on 100 N/m move it by 0.2 mm."""
    spec = load_study(SCENES / "paper" / "7_footnote2.toml", ("effects.opamp=ideal", "effects.vca=ideal"))
    spec = replace(spec, parameters=spec.parameters.model_copy(update={"settle_s": 1.2}))
    normal, q = np.array(spec.scene().wall.normal), np.array(spec.parameters.pose_rad)
    wanted = 100.0 * np.outer(normal, normal)
    with Points(None) as points:
        plain, held = (felt(spec, 1.0, points, compensated=c) for c in (False, True))
    shift = apparent(CHAIN, q, wanted, -1.0 * normal, compensated=False) - wanted
    assert np.linalg.norm(shift, 2) > 5.0
    # second order: curvature of the arm over 0.2 mm in 0.1 m, 2e-3 of 100 N/m in each direction; the hand has
    # not quite come to rest: exp(-1.2 s/0.2 s) of 10 N/m
    assert plain - wanted == pytest.approx(shift, abs=0.3)
    assert held == pytest.approx(wanted, abs=0.3)


@pytest.mark.parametrize(
    ("q", "at_wall", "diagonal"), [((0.6, 1.1), 0.024, 0.95), ((1.0, 1.6), -0.010, -0.13)]
)
def test_joint_pd_drags_along_the_wall(q, at_wall, diagonal):
    """Numbers of theory, given to their last digit: l = 0.1 m, slope 45 degrees, k = 100 N/m, 7.5 mm deep."""
    result = drag(CHAIN, np.array(q), NORMAL, 100.0, 7.5e-3)
    assert abs(result.coupled) < 1e-12
    assert result.coupled_at_wall == pytest.approx(at_wall, abs=6e-4)
    assert result.diagonal == pytest.approx(diagonal, abs=6e-3)


def test_unequal_multipliers_drag_and_feed_energy():
    """1 % at q = (0.6, 1.1): drag 2.3 %, curl about 1.5 N/m; energy of a small circle is curl times area."""
    q, radius = np.array([0.6, 1.1]), 1e-3
    result = unevenness(CHAIN, q, NORMAL, 100.0, 0.01, radius)
    assert result.drag == pytest.approx(0.023, abs=5e-4)
    assert result.curl_n_per_m == pytest.approx(1.5, abs=0.06)
    # both are the antisymmetric part of one matrix, whose curvature over 1 mm in 0.1 m is 1e-4 of it
    assert result.circle_j == pytest.approx(result.curl_n_per_m * np.pi * radius**2, rel=2e-4)


def test_mismatch_is_what_drawing_it_gives():
    """Standard deviations against 4000 draws: good to 1/sqrt(2 n), 1.1 %."""
    q, rng = np.array([0.6, 1.1]), np.random.default_rng(1)
    jac = CHAIN.jacobian(q)
    inverse, ksp = np.linalg.inv(jac), gains(jac, NORMAL, 100.0)
    tangent = np.array([NORMAL[1], -NORMAL[0]])
    drags, curls = [], []
    for _ in range(4000):
        k = inverse.T @ (ksp * (1.0 + 0.01 * rng.standard_normal((2, 2)))) @ inverse
        drags.append((tangent @ k @ NORMAL) / (NORMAL @ k @ NORMAL))
        curls.append(k[0, 1] - k[1, 0])
    result = unevenness(CHAIN, q, NORMAL, 100.0, 0.01, 1e-3)
    assert result.drag == pytest.approx(np.std(drags), rel=0.04)
    assert result.curl_n_per_m == pytest.approx(np.std(curls), rel=0.04)


def test_mismatch_makes_the_least_eigenvalue_negative():
    """Rank 1 has the least eigenvalue 0; a small E shifts it by e.g. v^T (E o K) v, v across J^T n."""
    q = np.array([0.6, 1.1])
    w = CHAIN.jacobian(q).T @ NORMAL
    v = np.array([-w[1], w[0]]) / np.linalg.norm(w)
    signs = np.array([[-1.0, 1.0], [-1.0, -1.0]])
    shift = 0.01 * v @ (signs * gains(CHAIN.jacobian(q), NORMAL, 100.0)) @ v
    result = unevenness(CHAIN, q, NORMAL, 100.0, 0.01, 1e-3)
    # second order in 1 %: a hundredth of the shift
    assert result.least_n_m_per_rad == pytest.approx(shift, rel=0.03)
    assert result.least_n_m_per_rad < 0.0
