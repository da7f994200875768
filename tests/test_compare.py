"""`cosim compare` and `cosim effects`: what an edit, or an effect, does."""

import json
import shutil

import pytest

from cosim.assets import netlists_folder, scenes_folder
from cosim.cli import main
from cosim.studies.compare import figures


def test_figures_are_named_by_what_they_are_about():
    check = {
        "joints": 2,
        "file": "x",
        "loops": ({"path": "xboard.xsum1.xop", "stable": True, "crossover_hz": 5.0, "gain_margin_db": None},),
        "admittance_a_s": [[1.0, 2.0], [3.0, 4.0]],
    }
    assert figures(check) == {
        "joints": 2.0,
        "loops xboard.xsum1.xop crossover_hz": 5.0,
        "admittance_a_s 1 1": 1.0,
        "admittance_a_s 1 2": 2.0,
        "admittance_a_s 2 1": 3.0,
        "admittance_a_s 2 2": 4.0,
    }


def test_compare_shows_the_share_of_an_edited_resistor(tmp_path, capsys):
    edited = tmp_path / "netlists"
    shutil.copytree(netlists_folder(), edited)
    block = edited / "blocks" / "summer.cir"
    text = block.read_text()
    assert "r_sum_spring=24.3k" in text
    block.write_text(text.replace("r_sum_spring=24.3k", "r_sum_spring=27k"))
    code = main(
        [
            "compare",
            str(netlists_folder() / "board1.cir"),
            str(edited / "board1.cir"),
            str(scenes_folder() / "drop.toml"),
            "--out",
            str(tmp_path / "out"),
            "--json",
        ]
    )
    assert code == 0
    result = json.loads(capsys.readouterr().out)
    before, after = result["changed"]["constants k_fs 11 measured"]
    # the summing amplifier weighs a spring with r_sum_fb / r_sum_spring
    assert after / before == pytest.approx(24.3 / 27.0, rel=1e-4)
    assert (tmp_path / "out" / "report" / "report.html").is_file()


def test_effects_of_a_misspelt_measure(capsys):
    assert main(["effects", str(scenes_folder() / "press.toml"), "--set", "seed=1,2"]) == 2
    assert "one value" in capsys.readouterr().err


@pytest.mark.slow
def test_effects_ledger_knows_what_matters(tmp_path, capsys):
    assert main(["effects", str(scenes_folder() / "slope.toml"), "--json", "--out", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["runs"] <= 2 * len(result["rows"]) + 2
    size = {(row["effect"], row["value"]): abs(row["on"]["peak_force"]) for row in result["rows"]}
    # delays of a microsecond take b / sum(tau), above 1e5 N/m, to matter; noise and the motor matter at once
    assert size["opamp", "gbw"] < 0.01 * size["motor", "full"]
    assert size["opamp", "gbw"] < 0.01 * size["pot_noise", "white"]
    assert size["delay", "True"] == 0.0  # the scene states no delay
    assert (tmp_path / "effects.png").is_file()
