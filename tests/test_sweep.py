"""`cosim sweep`: ranges, points that survive, table and picture."""

import csv
import json

import numpy as np
import pytest

from cosim.assets import scenes_folder
from cosim.cli import main
from cosim.comparisons import sweep as module
from cosim.comparisons.sweep import parse_range
from cosim.errors import InputError, SimulationError
from cosim.studies.study import load_study

DROP = str(scenes_folder() / "drop.toml")
FAST = ["--set", "duration_s=0.05", "--set", "solver.model=linear"]


def test_ranges():
    assert parse_range("R12=8k:12k:3").values == ("8000", "10000", "12000")
    assert parse_range("computer.period_s=0.001:0.1:3:log").values == ("0.001", "0.01", "0.1")
    assert parse_range("wall.normal=[0, 1],[1, 1]").values == ("[0, 1]", "[1, 1]")
    logs = np.log([float(v) for v in parse_range("x=3m:100m:12:log").values])
    # six digits are kept of each value
    np.testing.assert_allclose(np.diff(logs), np.log(100 / 3) / 11, rtol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "x=1:2",
        "x=1:2:1",
        "x=1:1:3",
        "x=a:2:3",
        "x=-1:1:3:log",
        "x=1:2:3:cubic",
        "=1:2:3",
        "x=",
        "x=1:2:99999",
    ],
)
def test_what_is_no_range(text):
    with pytest.raises(InputError, match="is not a range"):
        parse_range(text)


def test_the_rendered_force_follows_the_stiffness(tmp_path, capsys):
    asked = ["sweep", DROP, "computer.analog_stiffness_n_per_m=50:200:4", "--measure", "peak_current", *FAST]
    asked += ["--set", "computer.method=continuous", "--set", "computer.discrete_stiffness_n_per_m=0"]
    assert main([*asked, "--out", str(tmp_path), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    current = out["measures"]["peak_current"]
    assert current == sorted(current)
    with (tmp_path / "sweep.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["computer.analog_stiffness_n_per_m [N/m]", "peak_current [A]"]
    assert [float(row[1]) for row in rows[1:]] == current
    assert (tmp_path / "sweep.png").stat().st_size > 5000


@pytest.fixture
def counted(monkeypatch):
    """Replace the simulation and count what is run; a value in `broken` fails."""
    seen, broken = [], set()

    def pretend(plan, names, child, measurer):
        period = plan.scene.computer.period_s
        if period in broken:
            raise SimulationError("did not converge")
        seen.append(period)
        return {"measures": {"peak_force": period, "max_penetration": 2 * period}, "warnings": []}

    monkeypatch.setattr(module, "_measured", pretend)
    return seen, broken


def test_a_sweep_goes_on_where_it_was_stopped(tmp_path, counted, capsys):
    seen, broken = counted
    asked = ["sweep", DROP, "computer.period_s=0.01:0.03:3", "--out", str(tmp_path), "--json"]
    broken.add(0.02)
    assert main(asked) == 1
    out = json.loads(capsys.readouterr().out)
    assert out["measures"]["peak_force"] == [0.01, None, 0.03]
    assert "did not converge" in out["failed"]["computer.period_s=0.02"]
    broken.clear()
    assert main([*asked[:2], "computer.period_s=0.01:0.04:4", *asked[3:]]) == 0
    assert seen == [0.01, 0.03, 0.02, 0.04]  # only what was missing
    assert json.loads(capsys.readouterr().out)["measures"]["max_penetration"] == [0.02, 0.04, 0.06, 0.08]
    assert main([*asked, "--set", "seed=7"]) == 0  # another scene: its points are its own
    assert seen[4:] == [0.01, 0.02, 0.03]


def test_two_ranges_make_a_grid(tmp_path, counted, capsys):
    asked = ["sweep", DROP, "computer.period_s=0.01,0.02", "seed=1:3:3", "--out", str(tmp_path), "--json"]
    assert main(asked) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["values"][:4] == [["0.01", "1"], ["0.01", "2"], ["0.01", "3"], ["0.02", "1"]]


def test_slips_are_reported_before_anything_runs(tmp_path, counted, capsys):
    out = ["--out", str(tmp_path / "out")]
    for words, each in (
        (["computer.period_s=-3:-1:3"], "out of range"),
        (["computer.perod_s=0.01:0.02:3"], "did you mean"),
        (["seed=1:3:3", "--measure", "max_force"], "nearest is peak_force"),
        (["seed=1:3:3", "seed=4:6:3"], "twice"),
        (["seed=1:3:3", "--set", "duration_s=1,2"], "for all points"),
    ):
        assert main(["sweep", DROP, *words, *out]) == 2
        assert each in capsys.readouterr().err
    assert not counted[0]
    assert not (tmp_path / "out").exists()


def test_an_edited_law_or_operator_is_another_sweep_and_another_study(tmp_path):
    law, hand = tmp_path / "law.py", tmp_path / "hand.py"
    law.write_text("class Law:\n    def control(self, sample): ...\n")
    hand.write_text("class Hand:\n    def force(self, t, r, v): return 0, 0\n")
    own = (f"computer.law={law}:Law", f"operator={{type = 'python', file = '{hand}:Hand'}}")
    file = tmp_path / "preload.toml"
    file.write_text(f'study = "congruence"\ntitle = "t"\nscene = "{scenes_folder() / "slope.toml"}"\n')

    def digests():
        return module._digest(DROP, own, False), load_study(file, own).digest()

    before = digests()
    assert digests() == before
    for user in (law, hand):
        user.write_text(user.read_text() + "# edited\n")
        after = digests()
        assert all(new != old for new, old in zip(after, before, strict=True))
        before = after
