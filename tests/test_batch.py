"""Measures of a batch of devices against runs of plans that were made for each of them."""

from pathlib import Path

import numpy as np
import pytest

from cosim.comparisons.measure_values import measure
from cosim.errors import InputError
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch

SCENES = Path(__file__).parents[1] / "scenes"
KEYS = ("xdiff1.r11", "rsp11", "scene:computer.analog_stiffness_n_per_m")
VALUES = np.array([[10e3, 24.3e3, 100.0], [9.9e3, 24.6e3, 100.0], [10.1e3, 24.3e3, 95.0]])
NAMES = ("max_penetration", "k_max", "rest_force")


#: The drop with parts that the model `ideal` can carry.
PLAIN = ('effects.opamp="ideal"', 'effects.vca="ideal"', 'effects.differentiator="ideal"',
         'effects.driver_level="ideal"', 'effects.motor="ideal"')  # fmt: skip


def drop(model, *overrides):
    plain = PLAIN if model == "ideal" else ()
    return load_scene(SCENES / "drop.toml", ["duration_s=0.1", f'solver.model="{model}"', *plain, *overrides])


@pytest.mark.few(1)
@pytest.mark.parametrize("model", ["ideal", "linear", "spice"])
def test_a_batch_measures_what_each_device_measures_alone(model):
    with Batch(resolve(drop(model)), KEYS, NAMES) as batch:
        measures = batch.measures(VALUES)
        assert not batch.failures
        again = batch.measures(VALUES[::-1])[::-1]
    assert np.array_equal(measures, again)
    for values, row in zip(VALUES, measures, strict=True):
        own = ", ".join(f'"{k}"="{v!r}"' for k, v in zip(KEYS[:2], values[:2].tolist(), strict=True))
        stiffness = f"computer.analog_stiffness_n_per_m={float(values[2])!r}"
        scene = drop(model, stiffness, f"device.values={{{own}}}")
        truth = measure(resolve(scene), NAMES).rows
        # both keep the reduction's tolerance; unreduced models and `spice` are the same but for rounding
        rtol = 2.0 * scene.solver.reduction_tolerance if model == "linear" else 1e-6
        np.testing.assert_allclose(row, [truth[name]["value"] for name in NAMES], rtol=rtol, atol=1e-12)


def test_a_device_that_is_unstable_fails_alone():
    plan = resolve(drop("linear"))
    # a feedback resistor of negative value
    with Batch(plan, ("xsum1.r31",), ("max_penetration",)) as batch:
        measures = batch.measures(np.array([[10e3], [-10e3], [10.1e3]]))
    assert np.isfinite(measures[[0, 2]]).all()
    assert np.isnan(measures[1]).all()
    assert list(batch.failures) == [1]


def test_what_is_no_component_or_no_measure_is_refused():
    plan = resolve(drop("linear"))
    for keys, names, words in (
        (("xdiff1.r99",), NAMES, "xdiff1.r99"),
        (("scene:device.chain.masses_kg[0]",), NAMES, "not a number of this scene"),
        (KEYS, ("max_penetratio",), "nearest is max_penetration"),
        (KEYS, ("own.py:Mine",), "none of a batch"),
    ):
        with pytest.raises(InputError, match=words):
            Batch(plan, keys, names)
