"""Soft end stops struck at speed on ngspice: rebounds of theory, our own loop's run, within the estimate."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from support import merge, quick, slider

from cosim.results import Run

MASS, RADIUS = 0.2, 0.1333
SPEED, STOP, K, C = 10.0, 0.5, 100.0, 1.0


def struck(folder: Path, model: str, tol: float, **top: Any) -> Run:
    """A free carriage between two stops, 10 rad/s; the wall is out of reach."""
    device = {
        "slider": {"stops_rad": [[-STOP, STOP]], "stop_stiffness_n_m_per_rad": K, "stop_damping_n_m_s": C},
        "start": {"v_rad_per_s": [SPEED]},
    }
    tables = slider(
        duration_s=0.5, device=device, effects={"end_stops": True},
        wall={"point_m": [0.0, -5.0], "normal": [0.0, 1.0]},
        solver={"model": model, "coupling_tolerance_rad": tol},
    )  # fmt: skip
    folder.mkdir()
    return quick(folder, merge(tables, top))


def rebound(speed: float) -> float:
    """Speed behind a stop: v/u - ln(1 + u v)/u^2 is the same at both ends (Hunt and Crossley), u = c/k."""
    u = C / K

    def left(v: float) -> float:
        return v / u - math.log1p(u * v) / u**2

    return float(brentq(lambda v: left(-v) - left(speed), 0.0, speed, xtol=1e-14))


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> CubicHermiteSpline:
    run = struck(tmp_path_factory.mktemp("linear") / "run", "linear", 1e-10, solver={"max_step_s": 2e-4})
    t, q, v = (np.asarray(run.signals[name]) for name in ("time", "q1", "v1"))
    keep = np.append(np.diff(t) > 0.0, True)
    return CubicHermiteSpline(t[keep], q[keep], v[keep])


def test_a_soft_stop_struck_at_speed(tmp_path: Path, reference: CubicHermiteSpline) -> None:  # 51
    errors = []
    for number, tol in enumerate((1e-6, 1e-7, 1e-8)):
        run = struck(tmp_path / str(number), "spice", tol)
        t, q, v = (np.asarray(run.signals[name]) for name in ("time", "q1", "v1"))
        # steps are taken again from four times the tolerance on; what the circuit adds is seen afterwards
        assert run.stats["defect_max_rad"] < 10 * tol
        estimate = run.stats["defect_sum_rad"]
        assert estimate < 1e-3
        errors.append(np.abs(q - reference(t)).max())
        assert errors[-1] < estimate
        # the flights between the stops are at the speeds of theory; in flight nothing changes them
        flying = np.abs(q) < STOP - 1e-3
        expected = SPEED
        for bounce in range(4):
            start = np.flatnonzero(
                flying & (np.sign(v) == (-1) ** bounce) & (np.abs(np.abs(v) - expected) < 0.02)
            )
            assert len(start)
            assert np.abs(v[start]) == pytest.approx(expected, abs=estimate / 0.025)  # speeds weigh a period
            expected = rebound(expected)
        assert run.ledger["closure"] < 1e-6
    # ten times the tolerance down, the error is down by at least the square root of it
    assert errors[1] < errors[0] / math.sqrt(10.0)
    assert errors[2] < errors[1] / math.sqrt(10.0)


def test_a_dip_into_a_stop_within_one_step_is_seen(tmp_path: Path) -> None:  # 18, 28
    """Thrown up against a stop 0.2 mrad below the top of its flight: contact lasts 2 sqrt(2 d/a)."""
    g, depth = 9.81 / RADIUS, 2e-4
    speed = 1.0
    top = speed**2 / (2 * g)
    run = struck(
        tmp_path / "dip", "spice", 1e-8, duration_s=0.1, effects={"gravity": True},
        device={"slider": {"stops_rad": [[-90.0, top - depth]], "stop_stiffness_n_m_per_rad": 1e-6,
                           "stop_damping_n_m_s": 0.0},
                "start": {"v_rad_per_s": [speed]}},
    )  # fmt: skip
    t, q = np.asarray(run.signals["time"]), np.asarray(run.signals["q1"])
    inside = np.flatnonzero(q > top - depth)
    assert len(inside) > 2
    # ends of steps lie on both crossings, to 1e-11 rad behind the surface and the predictor's error before it
    lasted = t[inside[-1] + 1] - t[inside[0]]
    assert lasted == pytest.approx(2 * math.sqrt(2 * depth / g), rel=1e-3)
