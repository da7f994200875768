"""Parameters that are refused, all at once, with name, value and range; and what an import costs."""

import math
import subprocess
import sys

import numpy as np
import pytest

from mech import Chain, ParameterError, Slider


def refused(make):
    with pytest.raises(ParameterError) as caught:
        make()
    return {problem.name: problem for problem in caught.value.problems}


def test_all_that_is_wrong_is_reported_at_once_with_value_and_range():
    problems = refused(
        lambda: Chain(
            lengths_m=(0.1, -0.2),
            masses_kg=(-0.1, math.nan),
            viscous_n_m_s=(0.1,),
            coulomb_n_m=-1,
            gear=0,
            coulomb_speed_rad_per_s=0.0,
            stops_rad=[(1.0, -1.0), (0.0, 1.0)],
            stop_stiffness_n_m_per_rad=0.0,
            gravity_m_per_s2=(0.0, math.inf),
        )
    )
    assert list(problems) == [
        "lengths_m[1]",
        "masses_kg[0]",
        "masses_kg[1]",
        "gear[0]",
        "gear[1]",
        "viscous_n_m_s",
        "coulomb_n_m[0]",
        "coulomb_n_m[1]",
        "gravity_m_per_s2[1]",
        "coulomb_speed_rad_per_s",
        "stop_stiffness_n_m_per_rad",
        "stops_rad",
    ]
    assert str(problems["masses_kg[0]"]) == "masses_kg[0] = -0.1: must be a finite number >= 0"
    assert problems["lengths_m[1]"].allowed == "a finite number > 0"
    assert "2 numbers" in problems["viscous_n_m_s"].allowed
    assert "low < high" in problems["stops_rad"].allowed


@pytest.mark.parametrize("lengths", [(), (0.1,) * 7, 0.1, "0.1"])
def test_one_to_six_links(lengths):
    assert list(refused(lambda: Chain(lengths_m=lengths, masses_kg=0.1))) == ["lengths_m"]


@pytest.mark.parametrize("value", ["0.1", None, True, (0.1, 0.2, 0.3), math.inf])
def test_masses_are_numbers(value):
    assert all(
        name.startswith("masses_kg") for name in refused(lambda: Chain(lengths_m=(0.1, 0.1), masses_kg=value))
    )


def test_every_joint_must_move_some_inertia():
    assert "masses_kg" in refused(lambda: Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.0)))
    Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.0), rotor_inertia_kg_m2=1e-7)
    assert "mass_kg" in refused(lambda: Slider(radius_m=0.01, mass_kg=0.0))
    Slider(radius_m=0.01, mass_kg=0.0, rotor_inertia_kg_m2=1e-7)


def test_slider_parameters():
    problems = refused(lambda: Slider(radius_m=0.0, mass_kg=-1.0, direction=(0.0, 0.0), gear=math.nan))
    assert set(problems) == {"radius_m", "mass_kg", "direction", "gear[0]"}


def test_stops_may_be_open_on_one_side():
    linkage = Chain(lengths_m=(0.1,), masses_kg=0.1, stops_rad=[(-math.inf, 1.0)])
    p = linkage.pack()[0]
    assert p["stops_on"]
    assert p["stop_low"][0] == -math.inf
    assert p["stop_high"][0] == 1.0
    assert refused(lambda: Chain(lengths_m=(0.1,), masses_kg=0.1, stops_rad=[(math.nan, 1.0)]))


def test_links_left_out_are_slender_rods():
    linkage = Chain(lengths_m=(0.3,), masses_kg=0.2)
    # A rod about its end: m l^2 / 3.
    assert linkage.mass_matrix((0.0,))[0, 0] == pytest.approx(0.2 * 0.3**2 / 3, rel=1e-15)


def test_mechanisms_are_values():
    one, two = (Chain(lengths_m=[0.1, 0.1], masses_kg=np.array((0.1, 0.1))) for _ in range(2))
    assert one == two
    assert hash(one) == hash(two)
    record = one.pack()
    record["n"] = 0
    assert one.pack()["n"][0] == 2  # a caller's copy


def test_import_is_light():
    # `cosim --help` imports the scene, the scene names the mechanisms.
    code = "import sys, mech; sys.exit(any(name in sys.modules for name in ('numba', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
