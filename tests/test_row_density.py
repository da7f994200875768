"""Measures do not depend on how dense the rows of a run are."""

from pathlib import Path

import numpy as np
import pytest
from support import SCENES, simulate

from cosim.effects import without_dynamics
from cosim.scene import load_scene

#: Shares by which rows ten times sparser may move a measure: a cubic through rows 2 ms apart, on signals of
#: some 20 rad/s between samples and of the circuit's settling behind them; ripple is a difference of such.
BOUND, RIPPLE = 2e-4, 5e-3
#: The largest force stands where the driver has settled but for 5 %: rows there are as far apart as the time
#: since the sample, 2.6 time constants of 0.3 ms, and a cubic is off by some 1 % of what is left.
PEAK = 1e-3
#: Not figures of a signal, or at the size of the integration's own errors.
LEFT_OUT = ("ledger_closure", "headroom")


@pytest.mark.few(1)
@pytest.mark.parametrize("model", ["ideal", "linear", "spice"])
def test_rows_ten_times_sparser_move_no_measure(tmp_path: Path, model: str) -> None:  # 53
    rows = []
    for step in (2e-3, 2e-4):
        asked = (f"solver.model={model}", f"solver.max_step_s={step}", "computer.period_s=0.1")
        if model == "ideal":
            asked = (*without_dynamics(load_scene(SCENES / "slope.toml")), *asked)
        scene = load_scene(SCENES / "slope.toml", asked)
        run = simulate(scene, tmp_path / f"{step}")
        rows.append({name: measure["value"] for name, measure in run.measures.items()})
    sparse, dense = rows
    assert sparse.keys() == dense.keys()
    assert 0.5 < dense["contact_share"] < 1.0
    assert sparse["contact_share"] == pytest.approx(dense["contact_share"], rel=1e-6)
    for name in sparse.keys() - set(LEFT_OUT):
        bound = RIPPLE if name in ("force_ripple", "tangential_ratio", "steady_tangential_force") else BOUND
        bound = PEAK if name in ("peak_force", "peak_normal_force") else bound
        assert sparse[name] == pytest.approx(dense[name], rel=bound, abs=1e-12), name


@pytest.mark.parametrize("step", [2e-3, 3e-6])
def test_no_two_rows_are_further_apart_than_the_longest_step(tmp_path: Path, step: float) -> None:
    """A step that is short because it was asked for is a row: 3 us in periods of 25 ms were none."""
    asked = ("solver.model=linear", f"solver.max_step_s={step}", "duration_s=0.12")
    run = simulate(load_scene(SCENES / "press.toml", asked), tmp_path / "out")
    # on the way to an instant steps below a sixteenth may be left out: an eighth of a step in all
    assert np.diff(run.signals["time"]).max() <= step * 1.126
