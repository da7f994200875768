"""Every measure of a run is what its words say: signals that are polynomials in time, figures by hand."""

import math

import numpy as np
import pytest
from linear_runs import CONSTANTS
from support import SCENES

from cosim.measures import standard
from cosim.scene import load_scene

#: Depth in the wall 1 mm (t - 1), forces on the operator 2 + t and -t/2 along normal and tangent, motors 5 t,
#: currents 1 - t and -0.6 t, for 2 s.
NORMAL = np.array([math.sqrt(0.5), math.sqrt(0.5)])
TANGENT = np.array([NORMAL[1], -NORMAL[0]])
POINT = np.array([0.06, 0.08])
Q = np.array([0.6, 1.1])


@pytest.fixture(scope="module")
def measures() -> dict[str, float]:
    scene = load_scene(
        SCENES / "slope.toml", [f"wall.point_m={POINT.tolist()}", f"wall.normal={NORMAL.tolist()}"]
    )
    t = np.linspace(0.0, 2.0, 41)
    depth = 1e-3 * (t - 1.0)
    place = POINT[:, None] - np.outer(NORMAL, depth) + np.outer(TANGENT, 0.01 * t)
    lengths = np.array(scene.device.chain.lengths_m)
    angles = np.cumsum(Q)
    jacobian = np.array(
        [[-(lengths[j:] * np.sin(angles[j:])).sum() for j in (0, 1)],
         [(lengths[j:] * np.cos(angles[j:])).sum() for j in (0, 1)]]
    )  # fmt: skip
    speed = np.linalg.solve(jacobian, -1e-3 * NORMAL + 0.01 * TANGENT)
    force = -(np.outer(NORMAL, 2.0 + t) + np.outer(TANGENT, -0.5 * t))
    motors = np.outer(NORMAL, 5.0 * t) + np.outer(TANGENT, 7.0 * t)
    signals = {"time": t, "x": place[0], "y": place[1], "fx": force[0], "fy": force[1], "fmx": motors[0],
               "fmy": motors[1], "imot1": 1.0 - t, "imot2": -0.6 * t}  # fmt: skip
    for j in (0, 1):
        signals |= {f"q{j + 1}": np.full_like(t, Q[j]), f"v{j + 1}": np.full_like(t, speed[j])}
    samples = {"saturated": np.array([0.0, 2.0, 1.0]), "unsolved": np.array([0.0, 0.0, 1.0])}
    amplifiers = [
        {
            "path": path,
            "part": "tl072",
            "peak_v": peak,
            "swing_v": swing,
            "headroom": 1.0 - peak / (swing or 1),
        }
        for path, peak, swing in (("xa", 5.0, 13.5), ("xb", 9.0, 12.0), ("xc", 14.0, None))
    ]
    rows = standard(scene, CONSTANTS, signals, samples, amplifiers, {"closure": 3e-9})
    assert "xb (tl072) clips first" in rows["headroom"]["text"]
    return {name: row["value"] for name, row in rows.items()}


RATED = CONSTANTS.i_rated


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("peak_force", math.hypot(4.0, 1.0)),
        ("max_penetration", 1e-3),
        ("contact_share", 0.5),
        ("peak_normal_force", 4.0),
        ("mean_normal_force", 3.5),  # of the second half
        # of the last fifth, 1.6 to 2 s
        ("steady_penetration", 0.8e-3),
        ("steady_normal_force", 3.8),
        ("steady_tangential_force", -0.9),
        ("rendered_stiffness", 9.0 / 0.8e-3),
        ("tangential_ratio", 0.9 / 3.8),
        ("force_ripple", 0.4 / math.sqrt(12.0)),
        # of both motors, whatever the current's sign
        ("peak_current", 1.2),
        ("rated_share", 1.2 / RATED),
        ("over_rated", ((1.0 - RATED) + (2.0 - RATED / 0.6)) / 2.0),  # what both spend beyond counts once
        ("heat", 2.0 / 3.0 + 0.36 * 8.0 / 3.0),
        ("dac_saturations", 3.0),
        ("unreachable_samples", 1.0),
        ("headroom", 0.25),
        ("ledger_closure", 3e-9),
    ],
)
def test_a_measure_is_what_its_words_say(measures: dict[str, float], name: str, value: float) -> None:
    assert measures[name] == pytest.approx(value, rel=1e-9)


def test_no_measure_of_a_run_is_without_a_figure_by_hand(measures: dict[str, float]) -> None:
    (mark,) = test_a_measure_is_what_its_words_say.pytestmark
    assert {name for name, _ in mark.args[1]} == set(measures)
