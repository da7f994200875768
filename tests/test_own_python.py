"""The user's own Python: what it prints is heard, what it is told, and measures of one's own."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import K_FS, merge, quick, scene_of, simulate, slider

from cosim import cli
from cosim.errors import CosimError
from cosim.loop.userclass import PrintCapture
from cosim.results import Run
from reports import write_report

LAW = """
from cosim.loop.userlaw import Command
print("hello from the file")
class Law:
    def control(self, sample):
        if sample.tick == 0:
            print("period", sample.scene.computer.period_s, "k_fs", sample.board.k_fs)
        if sample.tick == 3:
            print("third", end="")
            print(" tick")
        {more}
        return Command()
"""
MEASURES = """
import numpy as np
class Lowest:
    unit = "m"
    text = "lowest place of the tip"
    def measure(self, run):
        print("asked with", len(run.samples["time"]), "samples")
        return run.signals["y"].min()
class Plain:
    def measure(self, run):
        return run.board.k_fs * run.scene.computer.period_s
class Bad:
    def measure(self, run):
        return run.signals["nonsense"].max()
class Endless:
    def measure(self, run):
        return float("nan")
class Mute:
    pass
class peak_force:
    def measure(self, run):
        return 1.0
"""


def tables(folder: Path, model: str = "linear", law: str = "", **more: Any) -> dict[str, Any]:
    (folder / "law.py").write_text(LAW.format(more=law or "pass"))
    (folder / "m.py").write_text(MEASURES)
    computer = {"law": f"{folder}/law.py:Law"} if law is not None else {}
    return slider(duration_s=0.2, computer=computer, solver={"model": model}, **more)


@pytest.mark.few(1)
@pytest.mark.parametrize("model", ["linear", "spice"])
def test_what_a_law_prints_reaches_run_file_terminal_and_page(
    model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scene_of(tmp_path, tables(tmp_path, model))
    assert cli.main(["run", str(scene.file), "-o", str(tmp_path / "out")]) == 0
    heard = ["hello from the file", f"period 0.025 k_fs {K_FS}", "third tick"]
    out = capsys.readouterr().out
    assert [line.strip() for line in out.splitlines() if "printed: " in line] == [
        f"printed: {x}" for x in heard
    ]
    run = Run.load(tmp_path / "out")
    assert list(run.printed) == heard
    page = write_report(run, tmp_path / "page").read_text()
    assert "Printed by the scene" in page
    assert "third tick" in page


OPERATOR = """
print("an operator is loaded")
class Hand:
    calls = 0
    def force(self, t, r, v):
        if self.calls == 0:
            print("first asked at", t)
        self.calls += 1
        return (0.0, 0.0)
"""


@pytest.mark.few(1)
@pytest.mark.parametrize("model", ["linear", "spice"])
def test_what_an_operator_prints_is_heard_too(model: str, tmp_path: Path) -> None:
    (tmp_path / "hand.py").write_text(OPERATOR)
    operator = {"type": "python", "file": f"{tmp_path}/hand.py:Hand"}
    assert list(quick(tmp_path, tables(tmp_path, model, law=None, operator=operator)).printed) == [
        "an operator is loaded", "first asked at 0.0",
    ]  # fmt: skip


@pytest.mark.slow
def test_effects_measures_by_a_users_class(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lowest place of a falling carriage: -g t^2 / 2 with gravity alone, 0 without."""
    falling = {"device": {"slider": {"gravity_m_per_s2": [0.0, -1.0]}}, "wall": {"point_m": [0.0, -1.0]}}
    scene = scene_of(
        tmp_path, merge(tables(tmp_path, "auto", law=None), {**falling, "effects": {"gravity": True}})
    )
    command = [
        "effects",
        str(scene.file),
        "--set",
        "duration_s=0.05",
        "--measure",
        f"{tmp_path}/m.py:Lowest",
        "--json",
    ]
    assert cli.main(command) == 0
    ledger = json.loads(capsys.readouterr().out)
    (gravity,) = [row for row in ledger["rows"] if row["effect"] == "gravity"]
    assert gravity["on"]["Lowest"] == pytest.approx(-1.0 * 0.05**2 / 2, rel=1e-3)
    assert cli.main([*command[:5], f"{tmp_path}/m.py:Mute"]) == 2


def test_what_it_printed_last_stands_beside_its_error(tmp_path: Path) -> None:
    with pytest.raises(CosimError, match=r"law.py:\d+: ZeroDivisionError.*printed last: third tick"):
        quick(tmp_path, tables(tmp_path, law="1 / (sample.tick - 3)"))


def test_a_law_that_prints_without_end_is_cut() -> None:
    result = PrintCapture()
    with result.listening():
        for k in range(3000):
            print(k, "x" * 1000)
    assert len(result.lines) == 1001
    assert result.lines[-1] == "... and 2000 more lines"
    assert max(map(len, result.lines)) == 500


def test_own_measures_are_measures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = tables(tmp_path, measures={"names": ["peak_current", "m.py:Lowest", "m.py:Plain"]})
    scene = scene_of(tmp_path, given)
    run = simulate(scene, tmp_path / "out")
    assert list(run.measures) == ["peak_current", "Lowest", "Plain"]
    lowest = run.measures["Lowest"]
    assert lowest == {
        "value": float(np.min(run.signals["y"])), "unit": "m", "text": "lowest place of the tip",
    }  # fmt: skip
    assert run.measures["Plain"]["value"] == pytest.approx(K_FS * 0.025, rel=1e-12)
    assert run.printed[-1] == "asked with 8 samples"  # every 25 ms of 0.2 s; none at the very end
    alone = simulate(scene_of(tmp_path, tables(tmp_path, measures={"names": ["m.py:Plain"]})), tmp_path / "b")
    assert set(alone.measures) > {"Plain", "peak_force", "ledger_closure"}  # on top of the standard set


def test_a_sweep_takes_an_own_measure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of(tmp_path, tables(tmp_path))
    monkeypatch.chdir(tmp_path)
    given = ["sweep", str(scene.file), "computer.period_s=0.02,0.05", "--measure", "m.py:Plain", "-o", "s"]
    assert cli.main([*given, "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["measures"]["Plain"] == pytest.approx([K_FS * 0.02, K_FS * 0.05], rel=1e-12)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("m.py:Bad", r"m.py:\d+: KeyError: 'nonsense'"),
        ("m.py:Endless", "is not finite: nan"),
        ("m.py:Mute", r"has no method measure\(run\)"),
        ("m.py:Lowst", "nearest is Lowest"),
        ("no.py:Lowest", "there is no file"),
        ("m.py:peak_force", "whose name no other measure has"),
        ("m.py:", "whose name no other measure has"),
    ],
)
def test_errors_of_an_own_measure_are_in_its_words(name: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(CosimError, match=reason):
        quick(tmp_path, tables(tmp_path, measures={"names": [name]}))
