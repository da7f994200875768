"""Measures do not depend on how dense the rows of a run are."""

from pathlib import Path

import numpy as np
import pytest
from support import SCENES, shared_child, simulate

from cosim.accuracy.estimate import estimator
from cosim.effects import without_dynamics
from cosim.plan import resolve
from cosim.runner import run
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


#: Scenes, and changes that make signals with edges, kinks and noise between the rows.
VARIANTS = {
    **{
        name: (name, ())
        for name in ("press", "slope", "slope_discrete", "slope_combined", "slope_joint_pd", "drop")
    },
    "coulomb": ("slope", ("effects.coulomb=true",)),
    "position noise": ("slope", ("effects.pot_noise=position",)),
    "settling at once": ("slope_discrete", ("effects.dac_settling=false",)),
    "late": ("press", ("effects.delay=true", "computer.delay_fraction=0.37")),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("model", ["ideal", "linear", "spice"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_rows_ten_times_denser_are_within_the_printed_errors(
    tmp_path: Path, variant: str, model: str
) -> None:
    """At T = 0.1 s rows of 2 ms are all there is between samples: what they miss is in the error."""
    name, changes = VARIANTS[variant]
    runs = []
    for step in (2e-3, 2e-4):
        asked = (*changes, f"solver.model={model}", f"solver.max_step_s={step}", "computer.period_s=0.1")
        if model == "ideal":
            asked = (*without_dynamics(load_scene(SCENES / f"{name}.toml")), *asked)
        plan = resolve(load_scene(SCENES / f"{name}.toml", asked))
        errors = estimator(plan, shared_child())
        runs.append(run(plan, tmp_path / f"{step}", formats=(), child=shared_child(), errors=errors).measures)
    sparse, dense = runs
    assert sparse.keys() == dense.keys()
    assert len(sparse) >= 12
    for measure, row in sparse.items():
        if measure == "ledger_closure" or (model == "spice" and measure == "headroom"):
            continue  # they have no error
        apart = abs(row["value"] - dense[measure]["value"])
        assert apart <= row["error"] + dense[measure]["error"], measure


@pytest.mark.parametrize("model", ["ideal", "linear"])
def test_the_error_covers_the_density_of_rows_alone(tmp_path: Path, model: str) -> None:
    """A slider is solved exactly from event to event: runs with other rows differ by their rows only.

    Not so with an encoder, where a last digit may move a reading by a whole count, nor over a ramp of gains.
    """
    runs = []
    for step in (2e-3, 2e-5):
        asked = (
            f"solver.model={model}",
            f"solver.max_step_s={step}",
            "computer.period_s=0.1",
            "effects.encoder=false",
            "effects.dac_settling=false",
        )
        if model == "ideal":
            asked = (*without_dynamics(load_scene(SCENES / "drop.toml")), *asked)
        plan = resolve(load_scene(SCENES / "drop.toml", asked))
        errors = estimator(plan, shared_child()) if step == 2e-3 else None
        runs.append(run(plan, tmp_path / f"{step}", formats=(), child=shared_child(), errors=errors))
    sparse, dense = runs
    t = np.asarray(sparse.signals["time"])
    both = np.isin(np.round(np.asarray(dense.signals["time"]) / 1e-9), np.round(t / 1e-9))
    # exact: the same force at the instants that both have
    np.testing.assert_allclose(
        np.asarray(dense.signals["fy"])[both], np.asarray(sparse.signals["fy"]), rtol=0.0, atol=1e-8
    )
    for measure, row in sparse.measures.items():
        if measure != "ledger_closure":
            apart = abs(row["value"] - dense.measures[measure]["value"])
            assert apart <= row["error"], measure
            assert row["error"] <= 3e-3 * abs(row["value"]), measure  # and it is worth being told


@pytest.mark.parametrize("period", [pytest.param(0.01, marks=pytest.mark.slow), 0.1])
def test_the_error_covers_a_ramp_of_gains_in_one_step(tmp_path: Path, period: float) -> None:
    """DACs settle in 10 us, one step of the run; steps of 0.5 us follow gain and input over the ramp."""
    runs = []
    for step in (2e-4, 5e-7):
        asked = ("solver.model=linear", f"solver.max_step_s={step}", f"computer.period_s={period}",
                 "effects.encoder=false", "duration_s=0.3")  # fmt: skip
        plan = resolve(load_scene(SCENES / "drop.toml", asked))
        errors = estimator(plan, shared_child()) if step == 2e-4 else None
        runs.append(run(plan, tmp_path / f"{step}", formats=(), child=shared_child(), errors=errors).measures)
    rough, close = runs
    for measure in ("max_penetration", "contact_share", "peak_force", "heat"):
        apart = abs(rough[measure]["value"] - close[measure]["value"])
        assert apart <= rough[measure]["error"], measure
    assert rough["max_penetration"]["error"] < 1e-6 * rough["max_penetration"]["value"]


@pytest.mark.parametrize("step", [2e-3, 3e-6])
def test_no_two_rows_are_further_apart_than_the_longest_step(tmp_path: Path, step: float) -> None:
    """A step that is short because it was asked for is a row: 3 us in periods of 25 ms were none."""
    asked = ("solver.model=linear", f"solver.max_step_s={step}", "duration_s=0.12")
    run = simulate(load_scene(SCENES / "press.toml", asked), tmp_path / "out")
    # on the way to an instant steps below a sixteenth may be left out: an eighth of a step in all
    assert np.diff(run.signals["time"]).max() <= step * 1.126
