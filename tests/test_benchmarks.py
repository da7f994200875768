"""The benchmarks' figures: names, targets and form; that both sides of a pair do the same work."""

import importlib
import json
import math
import re
import typing
from pathlib import Path

import numpy as np
import pytest
from support import SCENES

from benchmarks.__main__ import write
from benchmarks.figure import TARGETS, figure, interleaved
from benchmarks.filesource_peer import with_filesource
from benchmarks.monolithic import recorded_steps
from benchmarks.regression import BAND, BANDS, allowed, committed, worse
from benchmarks.rig import CURRENTS, Outcome, error, instants, slope
from benchmarks.same_results import SHORT, differences
from benchmarks.stiff import System, sundials
from benchmarks.suite import SUITE
from benchmarks.table import show
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.scene import load_scene

LATEST = Path(__file__).resolve().parents[1] / "benchmarks" / "latest.json"
KEYS = {"name", "ratio", "min", "max", "error_ours", "error_peer", "target", "command"}
STATED = {
    "lockstep_vs_replay": 1.10,
    "lockstep_vs_replay_points": 1.2,
    "callback_share": 0.05,
    "lockstep_vs_monolithic": 0.7,
    "lockstep_vs_pyspice": 0.3,
    "growth_exponent": 1.3,
    "memory_100s_mb": 500.0,
    "help_vs_numpy": 3.0,
    "warm_run_outside_s": 1.0,
    "warm_linear_outside_s": 0.5,
    "stability_s": 1.0,
    "linear_vs_monolithic_slope": 1 / 50,
    "ideal_vs_monolithic_slope": 1 / 150,
    "linear_vs_monolithic_drop": 1 / 1000,
    "linear_vs_stiff_solvers": 1 / 20,
    "extraction_vs_ac": 20.0,
    "reextraction_vs_ac": 0.5,
    "auto_vs_all_effects": 0.25,
    "fig13_vs_monolithic": 1 / 400,
    "border_map": 1000.0,
    "extraction_cached_ms": 50.0,
    "mc_extraction_vs_ac": 0.3,
    "batch_vs_single": 1 / 20,
    "two_level_vs_plain_press": 1 / 30,
    "two_level_vs_plain_drop": 1 / 30,
    "two_level_vs_plain_slope": 1 / 30,
    "yield_vs_plain": 1 / 30,
    "engine_overhead": 0.10,
    "two_cores": 1 / 1.8,
}

#: Without a committed figure: its median is 0 here, and a share of nothing is no band.
NOT_YET = {"engine_overhead"}


def check_form(rows):
    for row in rows:
        assert set(row) >= KEYS, row["name"]
        assert row["target"] == STATED[row["name"]]
        assert row["min"] <= row["ratio"] <= row["max"] or row["name"] == "growth_exponent"
        assert row["command"] == f"python -m benchmarks {row['name']}"
        for key in ("error_ours", "error_peer"):
            assert row[key] is None or math.isfinite(row[key])


def test_every_study_of_the_paper_has_a_short_form():
    assert {path.stem for path in (SCENES / "paper").glob("*.toml")} - {"claims"} == set(SHORT)


def test_one_bit_is_a_difference():
    ones = np.ones(3)
    case = {"signals.q1": ones, "measures.force": {"value": 0.1, "unit": "N"}}
    assert differences(case, {"signals.q1": ones.copy(), "measures.force": {"value": 0.1, "unit": "N"}}) == []
    assert differences(case, case | {"signals.q1": np.nextafter(ones, 2.0)}) == [
        "signals.q1: by up to 2.22e-16 of 1"  # the spacing of doubles behind 1
    ]
    assert (
        len(differences(case, case | {"measures.force": {"value": math.nextafter(0.1, 1.0), "unit": "N"}}))
        == 1
    )
    assert differences(case, {"signals.q1": ones[1:]}) == [
        "only one of them has measures.force", "signals.q1: 3 values -> 2"
    ]  # fmt: skip


def test_every_figure_has_its_target_and_its_measurement():
    assert {name: target for name, (target, _, _) in TARGETS.items()} == STATED
    assert [name for names in SUITE for name in names] == list(STATED)


@pytest.mark.skipif(not LATEST.exists(), reason="no figures yet: `make bench` writes them")
def test_latest_figures_are_complete():
    rows = json.loads(LATEST.read_text(encoding="utf-8"))
    check_form(rows)
    assert {row["name"] for row in rows} == set(STATED) - NOT_YET


def test_figures_replace_those_of_their_name(tmp_path):
    file = tmp_path / "latest.json"
    write(file, [figure("growth_exponent", [1.0, 2.0, 3.0]), figure("callback_share", [0.04])])
    write(file, [figure("callback_share", [0.02, 0.03, 0.01], error_ours=1e-6, error_peer=2e-6)])
    rows = {row["name"]: row for row in json.loads(file.read_text(encoding="utf-8"))}
    check_form(rows.values())
    assert rows["growth_exponent"]["ratio"] == 2.0
    assert (rows["callback_share"]["min"], rows["callback_share"]["max"]) == (0.01, 0.03)


def test_a_figure_says_whether_it_meets_its_target():
    assert "MISSED" in show(figure("callback_share", [0.06]))
    assert "met" in show(figure("callback_share", [0.05], details={"calls": {"source": 3}}))
    with pytest.raises(ValueError, match="callback_share"):
        figure("callback_share", [float("nan")])


def test_runs_are_interleaved_behind_a_warm_up():
    order = []
    times = interleaved(2, lambda: order.append("a") or 1.0, lambda: order.append("b") or 2.0)
    assert order == ["a", "b"] * 3
    assert times == [[1.0, 1.0], [2.0, 2.0]]


def _types(hint):
    """Return the classes in a type hint."""
    inner = typing.get_args(hint)
    return {hint} if not inner else {kind for each in inner for kind in _types(each)}


def test_what_a_child_sends_is_none_of_the_benchmarks_own_types():
    """A parent reads types of the package and plain ones only."""
    folder = Path(__file__).resolve().parents[1] / "benchmarks"
    texts = {path.stem: path.read_text(encoding="utf-8") for path in folder.glob("*.py")}
    targets = set(re.findall(r'"(benchmarks\.\w+:\w+)"', "".join(texts.values())))
    targets |= {f"benchmarks.sides:{name}" for name in re.findall(r'_call\("(\w+)"', texts["suite"])}
    assert len(targets) >= 14
    for target in targets:
        module, _, name = target.partition(":")
        hint = typing.get_type_hints(getattr(importlib.import_module(module), name))["return"]
        assert not any(kind.__module__.startswith("benchmarks") for kind in _types(hint)), target


@pytest.mark.slow
def test_both_loops_of_the_comparison_with_pyspice_answer():
    plan = slope("duration_s=0.1")
    with Child() as compiled, Child() as plain:
        ours = Outcome(**compiled.call("benchmarks.sides:lockstep_run", {"plan": plan}))
        peer = Outcome(**plain.call("benchmarks.pyspice:run", {"plan": plan, "constants": ours.constants}))
    # the same method and tolerances: what differs is the order of some sums, 1e-16 of a current a step
    assert peer.stats["points"] == pytest.approx(ours.stats["points"], rel=0.02)
    assert error(peer.signals, ours.signals, CURRENTS, instants(plan)) < 1e-9


def test_voltages_of_dacs_that_jump_are_those_behind_the_jump():
    """On press the row of a sample has the old voltage: the deck was a sample late, 3.6 % of the force."""
    plan = resolve(load_scene(SCENES / "press.toml", ["duration_s=0.1"]))
    assert plan.scene.computer.dac.settling_s == 0.0
    period = plan.scene.computer.period_s
    rows = np.repeat(np.arange(4) * period, 2)  # both limits of each sample
    codes = np.append(0.0, np.repeat([1.0, 2.0, 3.0, 4.0], 2)[:-1])
    time = np.append(np.sort(np.append(rows, rows + 1e-5)), 0.1)
    held = np.interp(time, np.append(rows + np.tile([0.0, 1e-9], 4), 0.1), np.append(codes, 4.0))
    signals = {"time": time, **dict.fromkeys(plan.circuit.channels, held)}
    run = Outcome({}, signals, np.arange(4)[:, None] * period, ("time",))
    steps = recorded_steps(plan, run)
    assert steps.volts[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert 0.0 < steps.settle_s < 1e-6
    assert len({t for t, _ in steps.corners(0, 0, 4)}) == 8  # no two corners at one time


@pytest.mark.slow
def test_both_sides_of_the_pairs_do_the_same_work():
    with Child() as child:
        got = child.call("benchmarks.sides:same_work", {"duration_s": 0.3})
    # the replay takes the recorded angles instead of predicted ones, so a rejected step may differ
    assert got["replay_points"] == pytest.approx(got["points"], rel=0.02)
    # the recorded cubic against the predictor: local errors of the coupling, 1e-7 rad of half a radian
    assert got["replay_difference"] < 1e-5
    # repeated without ngspice the callbacks end in the same state, or `seconds` raises
    assert got["calls"]["accepted"] == got["points"]
    # the linkage as circuit elements: same physics, both at a tolerance of 1e-4
    assert got["monolithic_difference"] < 1e-3


def test_a_figure_worse_than_committed_is_named():
    before = {name: 0.5 * target for name, (target, _, _) in TARGETS.items()}
    for name, ratio in before.items():
        at_the_edge, beyond = (figure(name, [allowed(name, ratio) * share]) for share in (1 - 1e-9, 1 + 1e-9))
        assert worse([at_the_edge], before) == []
        (line,) = worse([beyond], before)
        assert line.startswith(f"{name}: ")
        assert worse([beyond], {}) == []  # nothing is committed: nothing to hold it against


def test_what_is_committed_passes_itself():
    """The slowest repetition lies within the band as well, which is wider than the spread."""
    rows = {row["name"]: row for row in json.loads(LATEST.read_text(encoding="utf-8"))}
    assert set(BANDS) <= set(rows)
    assert all(0.0 < band <= 1.0 for band in (BAND, *BANDS.values()))
    outside = {name for name, row in rows.items() if row["max"] > allowed(name, row["ratio"])}
    assert outside <= {"linear_vs_monolithic_drop"}  # its largest is 1.33 of the median
    assert committed(LATEST) == {name: row["ratio"] for name, row in rows.items()}


def test_the_gate_fails_the_command(tmp_path, monkeypatch, capsys):
    import benchmarks.__main__ as program
    import benchmarks.suite as suite

    better = [figure("help_vs_numpy", [0.5])]
    monkeypatch.setattr(suite, "SUITE", {("help_vs_numpy",): lambda repetitions: better})
    monkeypatch.setattr(program, "COMMITTED", tmp_path / "committed.json")
    out = ["--out", str(tmp_path / "out" / "fresh.json")]
    commit = ["--commit"]
    for argv, ratio, code in (
        (commit, 0.5, 0),
        (out, 0.6, 0),
        (out, 0.7, 1),
        (commit, 0.7, 0),
        (out, 0.7, 0),
    ):
        better[:] = [figure("help_vs_numpy", [ratio])]
        monkeypatch.setattr("sys.argv", ["benchmarks", "help_vs_numpy", *argv])
        assert program.main() == code
        if code:
            assert "WORSE than committed: help_vs_numpy: 0.7, committed 0.5" in capsys.readouterr().out
    assert (tmp_path / "out" / "fresh.json").exists()


def test_sundials_where_it_is_installed():
    pytest.importorskip("sksundae", reason="scikit-sundae is not installed (pip install '.[bench]')")
    a = np.array([[0.0, 1.0], [-1e6, -2e3]])  # critically damped, rate 1000/s
    b = np.array([0.0, 1e6])
    nothing = np.zeros((1, 2))
    system = System(
        1e-3, [a] * 3, [b] * 3, [nothing] * 3, [np.zeros(1)] * 3, np.zeros(2), np.array([1.0, 1e3])
    )
    solvers = sundials()
    assert [*solvers] == ["CVODE", "IDA"]
    x = np.arange(1, 4)
    for solver in solvers.values():
        # y = 1 - (1 + x) exp(-x) at x = 1000/s t; an error of 20 tolerances over some hundred steps
        np.testing.assert_allclose(solver(system, 1e-8)[:, 0], 1 - (1 + x) * np.exp(-x), atol=2e-7)


def test_the_dacs_of_an_exported_deck_come_from_a_file(tmp_path):
    deck = ["title", "Bu1 u1 0 v=pwl(time,-1.0,2.0,0.5,2.0,0.6,3.0,4.0,3.0)", "Vksp11 ksp11 0 dc 4.0", ".end"]
    file = tmp_path / "dacs.txt"
    lines = with_filesource(deck, ("u1", "ksp11"), file)
    assert lines[:2] == ["title", "Vksp11 ksp11 0 dc 4.0"]
    assert lines[2] == "Adacs [%vd(u1,0)] dacs"
    assert lines[3].startswith(f'.model dacs filesource(file="{file}" ')
    assert lines[4:] == [".end"]
    # from 0 on; its last value holds for ever
    np.testing.assert_array_equal(np.loadtxt(file), [[0, 2], [0.5, 2], [0.6, 3], [1e6 + 4, 3]])
