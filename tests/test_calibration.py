"""Calibrated constants against the design's formulas."""

import numpy as np
import pytest
from extraction_boards import extract, shipped
from support import SCENES, shared_child

from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch
from cosim.tolerance.calibration import calibrated

IDEAL = (
    "effects.opamp=ideal", "effects.vca=ideal", "effects.driver_level=ideal", "effects.motor=ideal",
    "effects.differentiator=ideal",
)  # fmt: skip


@pytest.mark.parametrize(
    ("overrides", "factors"),
    [
        ({}, (1.0, 1.0, 1.0)),
        # the summing amplifier's feedback scales all, the spring's input resistor the spring alone
        ({"r_sum_fb": "10.2k"}, (1.02, 1.02, 1 / 1.02)),
        ({"r_sum_spring": "24.543k"}, (1 / 1.01, 1.0, 1.0)),
        # of one joint of two: the mean of both
        ({"xdiff1.r12": "172.38k", "xdiff1.r14": "172.38k"}, (1.01, 1.0, 1.0)),
    ],
)
def test_the_computer_learns_what_its_board_renders(
    overrides: dict[str, str], factors: tuple[float, float, float]
) -> None:
    """Ideal parts render the formulas of the netlist, of which the constants are rounded to 1e-4."""
    plan = resolve(load_scene(SCENES / "press.toml", [*IDEAL, "solver.model=linear"]))
    design = plan.stated(shared_child())
    result = calibrated(design, extract(shipped(2, "ideal", overrides=overrides)))
    for name, factor in zip(("k_fs", "c_fs", "v_nm"), factors, strict=True):
        assert getattr(result, name) == pytest.approx(getattr(design, name) * factor, rel=3e-4)


@pytest.mark.slow
def test_what_calibration_takes_off_the_spread() -> None:
    """A slider's stiffness is one gain: calibrated, each device renders what is commanded."""
    values = np.array([[10e3, 24.3e3, 5.0], [10.2e3, 24.0e3, 4.6], [9.9e3, 24.5e3, 5.4]])
    keys = ("xsum1.r31", "rsp11", "xdrv1.xmotor:motor_r")
    rows = []
    for kind in ("none", "gains"):
        still = ("solver.model=linear", "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0")
        scene = load_scene(SCENES / "drop.toml", [*still, f"tolerance.calibration={kind}", "duration_s=3"])
        with Batch(resolve(scene), keys, ("rendered_stiffness",)) as batch:
            rows.append(batch.measures(values)[:, 0])
            assert not batch.failures
    free, result = rows
    assert np.ptp(free) / free[0] > 0.1  # 1.02 * 5/4.6 against 0.99 * 5/5.4 in gain
    assert np.ptp(result) / result[0] < 0.01  # what gives is the steps of DACs and encoder
