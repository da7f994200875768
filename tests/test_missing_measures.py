"""A device that lacks one measure keeps the others; the reason is the measure's own, wherever it is told."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support import SCENES

import cosim.tolerance.batch as batch_module
from cosim import cli
from cosim.circuits.fitting.rational_fit import FitError
from cosim.comparisons.board_measures import BoardMeasures
from cosim.errors import InputError, Problem, SimulationError, StorageError
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch
from cosim.tolerance.distributions import Shape
from cosim.tolerance.missing import lacks, reasons_of, text_of
from cosim.tolerance.monte_carlo import draw
from cosim.tolerance.random_variables import Component, Tolerances
from cosim.tolerance.spec import Spec
from cosim.tolerance.study_results import find
from cosim.tolerance.trim import Trim, Trimmed
from cosim.tolerance.unit_cube import sampling
from cosim.tolerance.value_expression import Recipe, Term

#: Of a run, of the contact that is held, of the board.
NAMES = ("max_penetration", "peak_normal_force", "k_max", "least_stiffness", "rest_force", "phase_margin")
KEY = "xsum1.r31"
PLAIN = ('effects.opamp="ideal"', 'effects.vca="ideal"', 'effects.differentiator="ideal"',
         'effects.driver_level="ideal"', 'effects.motor="ideal"')  # fmt: skip


def plan(model, *overrides):
    plain = PLAIN if model == "ideal" else ()
    return resolve(
        load_scene(SCENES / "drop.toml", ["duration_s=0.02", f'solver.model="{model}"', *plain, *overrides])
    )


def measured(of, values, names=NAMES, key=KEY):
    """Return measures by name of each device, and why others are missing."""
    with Batch(of, (key,), names) as batch:
        table = batch.measures(np.array([[value] for value in values]))
        missing = dict(batch.failures)
    for k, row in enumerate(table):  # a value or a reason, never both, never neither
        assert {n for n, v in zip(names, row, strict=True) if np.isnan(v)} == set(missing.get(k, {}))
    return [dict(zip(names, row.tolist(), strict=True)) for row in table], missing


@pytest.mark.parametrize("model", ["linear", "spice"])
def test_an_unstable_board_keeps_what_it_has_without_a_model(model):
    """Its rest and the margins of its loops are ngspice's; its neighbours have all but a contact."""
    rows, missing = measured(plan(model), [10e3, -10e3, 10.1e3])
    assert set(missing) == {0, 1, 2}
    for k in (0, 2):  # in 20 ms it does not fall down to the floor
        assert dict(missing[k]) == {"peak_normal_force": "the tip never touches the wall"}
    assert set(missing[1]) == set(NAMES[:4])
    assert all("unstable" in why for why in missing[1].values())
    assert rows[1]["rest_force"] == pytest.approx(0.0, abs=1e-9)
    assert rows[1]["phase_margin"] < 0.0 < rows[0]["phase_margin"]


@pytest.mark.parametrize("error", [
    InputError(Problem("no such thing", key="key")), SimulationError("stuck"), FitError("no fit"),
    np.linalg.LinAlgError("singular matrix"), ZeroDivisionError("division by zero"), float("inf"),
], ids=lambda error: type(error).__name__)  # fmt: skip
@pytest.mark.parametrize("name", ["k_max", "least_stiffness", "rest_force", "phase_margin"])
def test_what_refuses_one_measure_leaves_the_others(name, error, monkeypatch):
    """Within the process that measures: each kind of refusal, at each measure."""
    of = plan("linear")
    payload = {"plan": of, "keys": (KEY,), "nominal": [10e3], "names": NAMES, "alone": False}

    class Boards(BoardMeasures):
        def row(self, asked):
            if asked == name:
                if isinstance(error, Exception):
                    raise error
                return {"value": error}
            return {"value": 2.0}

    class Draws:
        def at(self, *_):
            return None

        def deck(self, _):
            return of.board

    monkeypatch.setattr(batch_module, "BoardMeasures", Boards)
    monkeypatch.setattr(batch_module, "_draws", lambda *_: Draws())
    monkeypatch.setattr(batch_module._Device, "_run", lambda *_: {"max_penetration": 1.0})
    device = batch_module._Device(payload)
    of.stated()
    row, reasons = device.measured([10e3])
    values = dict(zip(NAMES, row, strict=True))
    assert set(reasons) == {"peak_normal_force", name}
    assert (str(error) if isinstance(error, Exception) else "inf") in reasons[name]
    assert {n: v for n, v in values.items() if v == v} == {
        n: 1.0 if n == "max_penetration" else 2.0 for n in NAMES if n not in reasons
    }


def test_a_run_that_fails_leaves_what_needs_none(monkeypatch):
    """`spice` runs a sample apart: its crash, twice, is none of the board's measures."""

    def hangs(*_words, **_more):
        raise SimulationError("no progress for 60 s")

    monkeypatch.setattr(batch_module, "run", hangs)
    rows, missing = measured(plan("spice"), [10e3])
    assert missing[0] == dict.fromkeys(NAMES[:2], "no progress for 60 s")
    assert np.isfinite([rows[0][name] for name in NAMES[2:]]).all()


def test_a_measure_that_takes_the_process_along_leaves_those_of_another_kind(monkeypatch):
    """A crash within ngspice tells not which measure it was: it is looked for."""
    real = Batch._call

    def call(self, target, payload, count):
        if "phase_margin" in payload["names"] and payload["values"][:, 0].max() > 10.05e3:
            raise SimulationError("ngspice crashed")
        return real(self, target, payload, count)

    monkeypatch.setattr(Batch, "_call", call)
    _rows, missing = measured(plan("linear"), [10e3, 10.1e3])
    assert "phase_margin" not in missing[0]
    lost = {name: why for name, why in missing[1].items() if name != "peak_normal_force"}
    assert lost == dict.fromkeys(("rest_force", "phase_margin"), "ngspice crashed")


def test_a_full_disk_is_no_device_s_fault(monkeypatch):
    def full(*_words, **_more):
        raise StorageError("no space left on device")

    monkeypatch.setattr(batch_module, "run", full)
    with Batch(plan("spice"), (KEY,), NAMES[:1]) as batch, pytest.raises(StorageError, match="no space"):
        batch.measures(np.array([[10e3]]))


def test_a_reason_has_no_name_that_changes(monkeypatch):
    """The folder of a run is another one each time; the kept bytes must not be."""
    key = "scene:computer.analog_stiffness_n_per_m"
    of = plan("spice")
    reasons = [measured(of, [-10.0], NAMES[:1], key)[1] for _ in range(2)]
    assert reasons[0] == reasons[1]
    assert "out of range" in reasons[0][0]["max_penetration"]


def test_reasons_come_back_from_their_text():
    reasons = {"k_max": "stable: up to 1 MN/m", "curl": "one joint, not two", "eta": "stable: up to 1 MN/m"}
    assert reasons_of(text_of(reasons)) == reasons
    assert text_of({}) == ""
    assert reasons_of("") == {}


def test_measures_that_the_same_devices_lack_are_told_together():
    missing = {7: {"a": "x", "b": "x"}, 3: {"a": "y", "b": "y", "c": "z"}}
    told = [(each.names, each.samples, each.first, each.why) for each in lacks(missing, ("a", "b", "c", "d"))]
    assert told == [(("a", "b"), 2, 3, "y"), (("c",), 1, 3, "z")]


class Plane:
    """Two measures of one resistor: itself, which a device may lack, and its double."""

    def __init__(self):
        self.failures = {}

    def measures(self, values):
        own = values[:, 0].copy()
        own[values[:, 1] > 1.0] = np.nan  # a device that has none, whatever is set
        own[(values[:, 1] < 1.0) & (own > 1.25)] = np.nan  # and one that has none at the first step
        self.failures = {k: {"own": "saturated"} for k in np.flatnonzero(np.isnan(own)).tolist()}
        return np.stack([own, 2.0 * values[:, 0]], axis=1)


def test_a_device_that_cannot_be_trimmed_says_why():
    trimmed = Trimmed(Plane(), ("own", "double"), Trim("r1", "own", 1.2), (0,))
    rows = trimmed.measures(np.array([[1.0, 1.0], [1.0, 2.0], [0.1, 1.0], [1.24, 0.5]]))
    assert rows[[0, 3]] == pytest.approx(np.array([[1.2, 2.4]] * 2), rel=1e-4)
    assert np.isnan(rows[[1, 2]]).all()
    assert trimmed.failures[1] == dict.fromkeys(("own", "double"), "r1 does not bring own to 1.2: saturated")
    assert trimmed.failures[2] == dict.fromkeys(("own", "double"), "r1 does not bring own to 1.2")
    assert set(trimmed.failures) == {1, 2}


def test_table_page_and_yield_of_a_study_in_which_devices_lack_a_measure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The study ends as the device as designed touches the floor: the lighter ones have not reached it yet.

    What a device lacks counts as not passing; what it has is in mean and yield like that of any other one.
    """
    scene = str(SCENES / "drop.toml")
    rows, _ = measured(plan("linear", "duration_s=0.06"), [10e3], ("contact_share",))
    touches_s = 0.06 * (1.0 - rows[0]["contact_share"])
    words = ["mc", scene, "--model", "linear", "--set", "tolerance.mass=20%",
             "--set", f"duration_s={touches_s + 1e-5!r}",
             "--spec", "peak_normal_force < 1", "--spec", "rest_force < 1", "--measure", "k_max",
             "-n", "24"]  # fmt: skip
    out = tmp_path / "mc"
    assert cli.main([*words, "--json", "-o", str(out)]) == 0
    result = json.loads(capsys.readouterr().out)
    lost = sorted(map(int, result["missing"]))
    assert 3 < len(lost) < 21
    why = {"peak_normal_force": "the tip never touches the wall"}
    assert all(each == why for each in result["missing"].values())
    assert result["yields"]["peak_normal_force <= 1 N"]["value"] == pytest.approx(1 - len(lost) / 24)
    assert result["yields"]["rest_force <= 1 N"]["value"] == 1.0
    assert result["measures"]["peak_normal_force"]["lacking"] == len(lost)
    assert result["measures"]["k_max"]["lacking"] == 0
    said = " ".join(f"{each['text']}: {each['advice']}" for each in result["warnings"])
    assert f"{len(lost)} of 24 devices have no peak_normal_force, the first (sample {lost[0]})" in said
    assert "they count as not passing peak_normal_force <= 1 N" in said
    table = pq.read_table(out / "samples.parquet")
    assert {k: reasons_of(text) for k, text in enumerate(table["missing"].to_pylist()) if text} == (
        dict.fromkeys(lost, why)
    )
    assert np.isfinite(table["k_max"].to_numpy()).all()
    rows = list(csv.DictReader(io.StringIO((out / "samples.csv").read_text())))
    assert [k for k, row in enumerate(rows) if row["missing"]] == lost
    assert [k for k, row in enumerate(rows) if row["pass"] == "0"] == lost
    page = (out / "report.html").read_text()
    assert "Measures that devices lack" in page
    assert "not passing peak_normal_force &lt;= 1 N" in page
    # one of them alone: what it has, and why not the rest
    assert cli.main([*words, "--json", "--sample", str(lost[0])]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert set(alone["measures"]) == {"rest_force", "k_max"}
    assert alone["missing"] == why
    assert cli.main(["verify", str(out), "--samples", "24"]) == 0


def test_a_measure_that_all_devices_but_one_lack_leaves_the_others_their_distribution() -> None:
    two = Two()
    points = sampling("plain", 40, 1, 3)
    parts = (
        Component("r0", 1.0, "Ohm", "", recipe=Recipe(1.0, terms=(Term(0, Shape("gauss", -0.03, 0.03)),))),
    )
    study = draw(Tolerances(parts, ("r0",)), points, ("k_max", "curl"), two, "linear")
    findings = find(study, [Spec("k_max", low=0.0)])
    assert set(findings.summaries) == {"curl"}
    assert "k_max: fewer than two devices have it" in findings.notes
    assert findings.yields["k_max >= 0 N/m"].value == 0.0


class Two:
    """One measure that the device as designed has alone, and another one."""

    def __init__(self):
        self.failures = {}

    def measures(self, values):
        table = np.stack([np.where(values[:, 0] == 1.0, 1.0, np.nan), values[:, 0]], axis=1)
        self.failures = {k: {"k_max": "none"} for k in np.flatnonzero(np.isnan(table[:, 0])).tolist()}
        return table


def test_the_device_as_designed_is_refused_with_each_measure_s_own_reason(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["mc", str(SCENES / "drop.toml"), "--model", "linear", "--set", "duration_s=0.02", "--measure",
             "curl", "--measure", "peak_normal_force", "--measure", "k_max", "-n", "4"]  # fmt: skip
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert "curl: the device as designed has no such measure: it is of an arm of two joints" in " ".join(
        said.replace("'", "").split()
    )
    assert "the tip never touches the wall" in said
    assert "k_max" not in said
