"""``--set`` of whole tables, and figures of the small that are exact."""

import math

import numpy as np
import pytest
from support import SCENES

from cosim.scene import Scene, load_scene
from cosim.studies.device import PRESETS
from cosim.studies.poses import unevenness
from cosim.variants import TABLES, overrides, parse_settings
from mech import Chain


def test_a_table_of_the_scene_is_set_as_a_whole() -> None:
    scene = load_scene(SCENES / "press.toml", overrides(['operator={type="none"}']))
    assert scene.operator.type == "none"
    mass = load_scene(SCENES / "press.toml", overrides(['operator={type="mass", mass_kg=0.1}']))
    assert mass.operator.type == "mass"


def test_only_tables_are_taken_for_tables() -> None:
    assert set(TABLES) <= set(Scene.model_fields)
    assert parse_settings(["r12={2*r}"])[0].is_netlist
    assert parse_settings(["wall=10k"])[0].is_netlist  # a parameter of the board may have any name
    assert not parse_settings(["wall={normal=[0.0, 1.0]}"])[0].is_netlist


def test_published_limits_of_devices() -> None:
    """CHAI3D 3.3: Omni 3.3 N, 700 N/m, 5 N s/m; Premium 1.5 8.5 N, 800, 5; Falcon 8 N, 3000, 20."""
    known = {each.name: (each.force_n, each.stiffness_n_per_m, each.damping_n_s_per_m) for each in PRESETS}
    assert known["Phantom Omni"] == (3.3, 700.0, 5.0)
    assert known["Phantom Premium 1.5"] == (8.5, 800.0, 5.0)
    assert known["Falcon"] == (8.0, 3000.0, 20.0)


@pytest.mark.parametrize("pose", [(0.6, 1.1), (-0.4, 2.0)])
def test_energy_round_a_circle_is_that_of_the_enclosed_area(pose: tuple[float, float]) -> None:
    """Area within the joints' path: 1/|det J| over the disc, by Gauss and the trapezoid rule."""
    chain = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05), inertias_kg_m2=(0, 0))
    q, radius = np.array(pose), 0.01
    centre = chain.forward(q)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    area = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        r = 0.5 * radius * (1 + node)
        for turn in 2 * math.pi * np.arange(48) / 48:
            at = chain.inverse(centre + r * np.array([math.cos(turn), math.sin(turn)]), seed=q)
            area += 0.5 * radius * weight * r * (2 * math.pi / 48) / abs(np.linalg.det(chain.jacobian(at)))
    normal, mismatch, stiffness = np.array([-math.sqrt(0.5), math.sqrt(0.5)]), 0.01, 100.0
    w = chain.jacobian(q).T @ normal
    off = stiffness * w[0] * w[1]
    circle_j = unevenness(chain, q, normal, stiffness, mismatch, radius).circle_j
    assert circle_j == pytest.approx(
        mismatch * abs(off) * area * math.sqrt(2.0), rel=1e-7
    )  # a polygon: 1.6e-3 less
