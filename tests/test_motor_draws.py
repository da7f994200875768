"""Torque constants of single motors: each its own draw, on all models, against what they scale."""

import numpy as np
import pytest
from support import SCENES

from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.applied_draw import motors
from cosim.tolerance.batch import Batch

KEYS = ("xdrv1.xmotor:motor_k", "xdrv2.xmotor:motor_k")
K = 0.04


def plan(model: str, *more: str):
    return resolve(load_scene(SCENES / "press.toml", [f"solver.model={model}", *more]))


def measured(model: str, names: tuple[str, ...], values: np.ndarray, *more: str) -> np.ndarray:
    with Batch(plan(model, *more), KEYS, names) as batch:
        measures = batch.measures(values)
        assert not batch.failures
    return measures


def test_each_motor_turns_its_own_joint() -> None:
    assert motors(plan("linear"), ("rsp11", KEYS[1], KEYS[0])) == {1: 1, 2: 0}


def test_curl_is_what_motors_differ_by() -> None:
    """Row i of the joints' stiffness is k_t of motor i times what it is: K21 - K12 follows by hand.

    The tip's curl is (K12 - K21)/det J. As designed K12 = K21 = k, so motors with shares a1, a2 more make it
    k (a1 - a2)/det J: what one adds the other takes, and equal ones add nothing.
    """
    off = np.array([[K, K], [1.1 * K, K], [K, 1.1 * K], [1.1 * K, 1.1 * K], [1.2 * K, K]])
    curl = measured("linear", ("curl",), off, "effects.driver=current")[:, 0]
    one, two, both, more = curl[1:] - curl[0]
    assert abs(both) < 1e-9 * abs(one)
    assert one == pytest.approx(-two, rel=1e-9)
    assert more == pytest.approx(2.0 * one, rel=1e-9)


@pytest.mark.slow
def test_a_run_on_linear_is_that_of_ngspice() -> None:
    off = np.array([[1.1 * K, K], [K, 1.1 * K]])
    names = ("rendered_stiffness", "rest_force")
    mine, theirs = (measured(model, names, off, "duration_s=1") for model in ("linear", "spice"))
    assert mine == pytest.approx(theirs, rel=1e-3)
    assert abs(mine[0, 0] / mine[1, 0] - 1.0) > 1e-3
