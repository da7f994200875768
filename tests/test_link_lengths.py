"""A device's link lengths are its own; its computer reckons with those of the design, unless calibrated."""

import numpy as np
import pytest
from support import SCENES

from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch

KEY = "scene:device.slider.radius_m"
STILL = (
    "solver.model=linear", "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0",
    "duration_s=3",
)  # fmt: skip


@pytest.mark.parametrize("calibration", ["none", "gains"])
def test_what_a_slider_of_another_radius_renders(calibration: str) -> None:
    """Drum r = a r0, known as r0, a weight W on it, the wall 10 mm below where the angle is 0.

    The joint's spring is k r0^2, and its torque W r: the computer sees a depth of W/k a. The true position is
    a times the one that it sees: the depth is 10 mm (a - 1) + W/k a^2. A calibrated one renders W/k.
    """
    scene = load_scene(SCENES / "drop.toml", [*STILL, f"tolerance.calibration={calibration}"])
    nominal, above = scene.device.slider.radius_m, 0.01
    a = np.array([1.0, 0.97, 1.03])
    with Batch(resolve(scene), (KEY,), ("steady_penetration",)) as batch:
        value = batch.measures(a[:, None] * nominal)[:, 0]
        assert not batch.failures
    depth = value[0]
    expected = above * (a - 1.0) + depth * a**2 if calibration == "none" else np.full(3, depth)
    # the encoder's step, 0.1 mm at the tip, and the DACs' leave some of the 1.4 mm that are looked for
    assert value == pytest.approx(expected, abs=1.2e-4)


def test_theory_agrees() -> None:
    """The border of stability goes with what is rendered: k_max r^-2 of the joint's own is the same."""
    scene = load_scene(SCENES / "drop.toml", STILL)
    nominal = scene.device.slider.radius_m
    kept = {}
    for calibration in ("none", "gains"):
        planned = resolve(load_scene(scene, [f"tolerance.calibration={calibration}"]))
        with Batch(planned, (KEY,), ("k_max",)) as batch:
            kept[calibration] = batch.measures(np.array([[nominal], [1.03 * nominal]]))[:, 0]
            assert not batch.failures
    # a computer that reckons with r0 asks the joint for k r0^2, one that knows r for k r^2
    assert kept["none"][1] / kept["gains"][1] == pytest.approx(1.03**2, rel=2e-3)
