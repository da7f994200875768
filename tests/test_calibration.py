"""Calibrated constants against the design's formulas."""

import numpy as np
import pytest
from extraction_boards import extract, shipped
from support import SCENES, shared_child

from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch
from cosim.tolerance.calibration import calibrated
from cosim.tolerance.preparation import Asked, Prepared, prepare

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


#: Spring of the slider at the joint [N m/rad]: 100 N/m at a reach of 133.3 mm.
TARGET = 1.7769


def trimmed(names: tuple[str, ...], *overrides: str) -> Prepared:
    """A slider whose summing amplifier has a trimmer, set so that the spring is what the design says."""
    trim = f'tolerance.trim."xsum1.r31"="least_stiffness to {TARGET} N m/rad"'
    model = "solver.model=linear"
    return prepare(Asked(SCENES / "drop.toml", (model, trim, *overrides), names))


def devices(of: Prepared, *changes: dict[str, float]) -> np.ndarray:
    """Devices as designed but for some components, which are given by their share."""
    values = np.tile(of.tolerances.nominal, (len(changes), 1))
    for row, change in zip(values, changes, strict=True):
        for key, share in change.items():
            row[of.tolerances.keys.index(key)] *= 1.0 + share
    return values


DRAWN = (
    {"xdrv1.xmotor:motor_r": 0.1},
    {"xdrv1.r42": 0.01, "xsum1.r31": -0.01},
    {"rsp11": 0.01},
    {"rcmd1": -0.01, "xdrv1.xmotor:motor_r": -0.1},
    {"rsp11": -0.01, "rcmd1": 0.01},
)


def test_a_trimmer_takes_off_what_it_is_set_by() -> None:
    """Of ideal parts the spring is proportional to r31: one setting meets the target whatever else varies."""
    of = trimmed(("least_stiffness",), *IDEAL)
    values = devices(of, *DRAWN)
    measured = of.batch(("least_stiffness",), "linear").measures(values)[:, 0]
    assert measured == pytest.approx(TARGET, rel=1e-6)
    # without a trimmer it is what the netlist's formula says, r31/rsp r42/r41 over the winding's resistance
    free = Batch(of.plan, of.tolerances.keys, ("least_stiffness",))
    with free:
        spread = free.measures(devices(of, {}, *DRAWN))[:, 0]
    shares = [1.0]
    for change in DRAWN:
        share = dict.fromkeys(("xsum1.r31", "rsp11", "xdrv1.r42", "xdrv1.xmotor:motor_r"), 0.0) | change
        gain = (1 + share["xsum1.r31"]) * (1 + share["xdrv1.r42"])
        shares.append(gain / (1 + share["rsp11"]) / (1 + share["xdrv1.xmotor:motor_r"]))
    assert spread / spread[0] == pytest.approx(shares, rel=1e-6)


@pytest.mark.slow
def test_what_a_trimmer_leaves() -> None:
    """The commands' gain is r31/rcmd, the spring's, which is right now, r31/rsp: rsp/rcmd is what is left.

    Winding and driver drop out. Of a wall half of whose stiffness goes by commands, half of it is left.
    """
    quiet = ("effects.encoder=false", "effects.dac=false", "effects.dac_settling=false", "duration_s=3")
    of = trimmed(("rendered_stiffness",), *quiet)
    measured = of.batch(("rendered_stiffness",), "linear").measures(devices(of, {}, *DRAWN))[:, 0]
    left = [1.0, *((1 + c.get("rsp11", 0.0)) / (1 + c.get("rcmd1", 0.0)) for c in DRAWN)]
    assert measured / measured[0] == pytest.approx(0.5 + 0.5 * np.array(left), rel=1e-4)
