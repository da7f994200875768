"""`cosim report` of several runs lists the inputs that are not the same: scene, board, seed, versions."""

import json
from pathlib import Path
from typing import Any

import pytest
from support import quick, scene_of, slider

from cosim.cli import main

SHORT = {"duration_s": 0.05, "solver": {"model": "linear"}}


def json_of(capsys: pytest.CaptureFixture[str], *words: Any) -> dict[str, Any]:
    assert main(["report", *map(str, words), "--json"]) == 0
    out: dict[str, Any] = json.loads(capsys.readouterr().out)
    return out


def test_two_runs_tell_in_what_they_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick(tmp_path, slider(**SHORT))
    edit = slider(**SHORT, seed=7, device={"values": {"r_sum_spring": "20k"}})
    quick(tmp_path, edit)
    runs = [tmp_path / "run0", tmp_path / "run1"]
    by_name = {row["input"]: row["values"] for row in json_of(capsys, *runs)["inputs"]}
    assert by_name["seed"] == ["0", "7"]
    assert by_name["device.values.r_sum_spring"] == [None, "20k"]
    netlist = {
        name: values for name, values in by_name.items() if "r_sum_spring" in name and "device" not in name
    }
    assert [("24.3k" in old, "20k" in new) for old, new in netlist.values()] == [(True, True)]
    assert len(by_name) == 3  # and nothing else
    page = (runs[0] / "report" / "report.html").read_text()
    assert "Inputs that differ" in page
    assert "r_sum_spring" in page


def test_equal_runs_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        quick(tmp_path, slider(**SHORT))
    runs = [str(tmp_path / "run0"), str(tmp_path / "run1")]
    assert main(["report", *runs]) == 0
    assert "all inputs are equal" in capsys.readouterr().out


def test_one_run_has_nothing_to_differ_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick(tmp_path, slider(**SHORT))
    assert json_of(capsys, tmp_path / "run0")["inputs"] == []
    assert "Inputs that differ" not in (tmp_path / "run0" / "report" / "report.html").read_text()
    assert scene_of(tmp_path, slider()).seed == 0
