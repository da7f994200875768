"""`cosim compare` and `cosim effects`: what an edit, or an effect, does."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cosim.assets import netlists_folder, scenes_folder
from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.design_constants import Stated
from cosim.cli import main
from cosim.comparisons import effects_ledger
from cosim.comparisons.board_figures import Figure
from cosim.comparisons.compare_boards import _untold, changes, sides_of
from cosim.comparisons.dissipation import dissipation
from cosim.effects import EFFECTS
from cosim.effects.circuit import CIRCUIT
from cosim.errors import InputError
from cosim.ngspice import deck_file
from cosim.ngspice.deck import load_deck
from cosim.ngspice.lines import Line
from cosim.plan import resolve
from cosim.plausibility import constant_missed
from cosim.scene import load_scene
from cosim.scene.tolerance_table import Tolerance
from cosim.variants import Variant
from reports.boards import felt

DROP = str(scenes_folder() / "drop.toml")
BOARD = str(netlists_folder() / "board1.cir")
SHORT = ["--set", "duration_s=0.1"]


def compared(capsys, *words):
    """Run the command and return what it found, the rows by (quantity, place)."""
    assert main(["compare", *map(str, words), "--json"]) == 0, capsys.readouterr().err
    out = json.loads(capsys.readouterr().out)
    rows = {(row["quantity"], place): row for row in out["changed"] for place in row["places"] or [""]}
    return out, rows


@pytest.fixture
def edited(tmp_path):
    """The shipped board with one resistor of the summing amplifier changed."""
    folder = tmp_path / "edited"
    shutil.copytree(netlists_folder(), folder)
    block = folder / "blocks" / "summer.cir"
    text = block.read_text()
    assert "r_sum_spring=24.3k" in text
    block.write_text(text.replace("r_sum_spring=24.3k", "r_sum_spring=27k"))
    return folder / "board1.cir"


def test_compare_shows_the_share_of_an_edited_resistor(tmp_path, edited, capsys):
    result, rows = compared(capsys, BOARD, edited, DROP, "--out", tmp_path / "out")
    before, after = rows["spring at full-scale gain", "motor 1 from joint 1"]["values"]
    # the summing amplifier weighs a spring with r_sum_fb / r_sum_spring
    assert after / before == pytest.approx(24.3 / 27.0, rel=1e-4)
    # more of its output comes back to the inverting input past a larger leg: the loop is faster
    before, after = rows["crossover", "xsum1.xop (tl072)"]["values"]
    assert after > before
    assert result["boards"] == ["A netlists/board1", "B edited/board1"]
    assert {"clips first at rated torque", "clips first in this scene"} <= set(result["findings"][0])
    assert any(quantity.startswith("heat of the winding") for quantity, _ in rows)
    shown = [word for row in result["changed"] for word in (row["quantity"], *row["places"])]
    assert not [word for word in shown if "_" in word or "xboard" in word]  # names are for people
    page = tmp_path / "out" / "report"
    for name in ("changed", "paths", "poles", "compare"):
        assert (page / "figures" / f"{name}.png").stat().st_size > 10_000
    html = (page / "report.html").read_text()
    assert "http" not in html.replace("http://www.w3.org", "")


@pytest.mark.slow
def test_compare_with_a_value_and_with_the_last_run(tmp_path, edited, capsys):
    last = tmp_path / "last"
    assert main(["run", DROP, *SHORT, "--out", str(last)]) == 0
    capsys.readouterr()
    # a run holds its board: what happens to the netlists later does not change it
    same, rows = compared(capsys, BOARD, DROP, "--last", last, "--out", tmp_path / "a")
    assert same["boards"] == ["A run last", "B board1"]
    assert not [row for row in same["changed"] if row["section"] not in ("measures", "dissipation")]
    assert rows  # the stored run lasted a tenth of a second only, and that is shown
    _, by_edit = compared(capsys, edited, DROP, "--last", last, "--out", tmp_path / "b")
    _, by_value = compared(capsys, BOARD, DROP, "--set", "r_sum_spring=27k", "--out", tmp_path / "c")
    place = ("spring at full-scale gain", "motor 1 from joint 1")
    assert by_edit[place]["values"] == by_value[place]["values"]


def test_a_constant_that_run_and_check_miss_is_told_once():
    """They measure it in two ways, and differ in its last digits and in the worst of equal places."""
    run = [constant_missed("k_fs", 3.0003, 5.999, "ksp1")]
    checked = [constant_missed("k_fs", 3.0003, 5.998, "ksp12"), constant_missed("v_nm", 15.62, 7.81, "cmd1")]
    assert _untold(checked, run) == checked[1:]
    assert _untold(checked, []) == checked
    assert _untold(checked, [constant_missed("k_fs", 4.0, 5.999, "ksp1")]) == checked  # another board's


def side(figures, tolerance=None):
    """A side of a comparison that holds figures: (section, quantity, place, unit, value, part)."""
    scene = load_scene(DROP).model_copy(update={"tolerance": Tolerance.model_validate(tolerance or {})})
    return SimpleNamespace(
        plan=SimpleNamespace(scene=scene), figures=tuple(Figure(*figure) for figure in figures)
    )


def test_what_is_felt_leads_and_the_tools_own_bounds_come_last():
    """7 % of the scene's largest force and 8 % of a stiffness are noticed; a bound is felt by nobody."""

    def figures(k):
        return [
            ("bounds", "error of that model up to 1000 Hz, at most", "", "%", 1e-3 * (1 + 9 * k)),
            ("loops", "phase margin", "xsum1.xop", "deg", 80.0 - 40.0 * k, "tl072"),
            ("measures", "peak force", "", "N", 2.0 + 0.02 * k),
            ("measures", "steady tangential force", "", "N", 1e-4 + 3e-4 * k),
            ("measures", "steady normal force", "", "N", 1.0 + 0.28 * k),
            ("measures", "rendered stiffness", "", "N/m", 100.0 - 20.0 * k),
            ("measures", "heat", "", "A^2 s", 1.0 + k),
        ]

    rows = changes([side(figures(0)), side(figures(1))])
    names = [row.quantity for row in rows]
    assert names[:2] == ["rendered stiffness", "steady normal force"]
    assert [row.felt for row in rows[:2]] == pytest.approx([20.0 / 8.0, 0.28 / (0.07 * 2.0)], rel=1e-9)
    assert names[-1].startswith("error of that model")
    assert next(row for row in rows if row.quantity == "phase margin").felt is None
    small = next(row for row in rows if row.quantity == "steady tangential force")
    assert small.felt == pytest.approx(3e-4 / (0.07 * 2.0), rel=1e-9)
    assert felt(rows)[0].startswith("Felt: rendered stiffness: 100 N/m, 80 N/m")
    stated = [side(figures(0), {"peak_force": 0.001}), side(figures(1))]
    assert changes(stated)[0].quantity == "peak force"  # ten times what the scene allows
    assert felt([row for row in rows if row.felt is None or row.felt < 1]) == [
        "No force, stiffness or damping at the hand changes by what is noticed or tolerated."
    ]


def test_a_measure_that_appears_is_beyond_any_tolerance():
    one = [("measures", "peak force", "", "N", 2.0)]
    two = [*one, ("measures", "tangential ratio", "", "", 0.1)]
    rows = changes([side(one, {"tangential_ratio": 0.5}), side(two)])
    assert [(row.quantity, row.felt) for row in rows] == [("tangential ratio", np.inf)]


@pytest.mark.slow
def test_another_part_in_the_same_place_is_the_same_loop(tmp_path, capsys):
    """Amplifiers pair by instance: OPA2134 for TL072 moves crossovers by their gain-bandwidths, 8/3."""
    _, rows = compared(capsys, DROP, "--set", "device.parts.tl072=opa2134", *SHORT, "--out", tmp_path)
    before, after = rows["crossover", "xsum1.xop (tl072 / opa2134)"]["values"]
    assert after / before == pytest.approx(8.0 / 3.0, rel=2e-2)
    assert not [row for row in rows.values() if row["section"] == "loops" and None in row["values"]]


def test_what_can_be_compared(tmp_path, capsys):
    plain, tried = Variant((), (), ""), Variant((("R12", "8k"),), ("device.values.R12=8k",), "")
    assert [side.label for side in sides_of([], [tried], None)] == ["A as it stands", "B R12=8k"]
    assert [side.label for side in sides_of(["x.cir"], [tried], tmp_path)] == [
        f"A run {tmp_path.name}",
        "B R12=8k",
    ]
    for boards, variants, last in (
        ([], [plain], None),
        (["a", "b"], [tried], None),
        (["a", "b"], [plain], tmp_path),
    ):
        with pytest.raises(InputError):
            sides_of(boards, variants, last)
    assert main(["compare", DROP, "--last", str(tmp_path / "nothing"), "--out", str(tmp_path / "o")]) == 2
    assert "no such file or folder" in capsys.readouterr().err


def test_a_stored_board_is_the_same_and_is_checked_like_any_netlist(tmp_path):
    board = load_deck(BOARD, levels={"opamp": "full"})
    deck_file.save(board, tmp_path)
    assert deck_file.load(tmp_path) == board
    record = json.loads((tmp_path / deck_file.FILE).read_text())
    for line, reason in ((".include /etc/passwd", "not allowed"), ("shell rm x", "not allowed")):
        bad = replace(board, lines=(*board.lines, Line(line)))
        deck_file.save(bad, tmp_path)
        with pytest.raises(InputError, match=reason):
            deck_file.load(tmp_path)
    record["lines"][3]["text"] += " "
    (tmp_path / deck_file.FILE).write_text(json.dumps(record))
    with pytest.raises(InputError, match="was changed"):
        deck_file.load(tmp_path)
    (tmp_path / deck_file.FILE).write_text("{}")
    with pytest.raises(InputError, match="does not hold what a result holds"):
        deck_file.load(tmp_path)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_heat_of_motor_and_driver(sign):
    ohm, kt, gear, current, speed = 3.0, 0.025, 8.0, 0.5, 2.0
    constants = dict.fromkeys(Stated.names(), 1.0) | {"kt": kt, "gear": gear}
    stated = Stated(**constants, numbers={"m_r": ohm}, parts={"motor": ("m",)})
    run = SimpleNamespace(
        scene=SimpleNamespace(joints=1),
        signals={
            "time": np.array([0.0, 1.0, 3.0]),
            "imot1": sign * np.full(3, current),
            "v1": sign * np.full(3, speed),
        },
    )
    (heat,) = dissipation(run, stated)
    # what the supply gives, V I, is what winding and driver heat and what the shaft takes, kt gear w I
    shaft = kt * gear * speed * current
    assert heat.motor_mean_w == pytest.approx(ohm * current**2, rel=1e-12)
    assert heat.driver_peak_w + heat.motor_peak_w + shaft == pytest.approx(SUPPLY_V * current, rel=1e-12)
    assert dissipation(run, Stated(**constants)) == []


def test_effects_of_a_misspelt_measure(capsys):
    assert main(["effects", str(scenes_folder() / "press.toml"), "--set", "seed=1,2"]) == 2
    assert "one value" in capsys.readouterr().err


@pytest.mark.slow
def test_effects_ledger_knows_what_matters(tmp_path, capsys):
    assert main(["effects", str(scenes_folder() / "slope.toml"), "--json", "--out", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["runs"] <= 2 * len(result["rows"]) + 2
    # what the scene states no data for
    assert set(result["not_applicable"]) == {
        "differentiator", "temperature", "dac_skew", "delay", "end_stops", "shaft", "backlash",
    }  # fmt: skip
    size = {(row["effect"], row["value"]): abs(row["on"]["peak_force"]) for row in result["rows"]}
    # delays of a microsecond take b / sum(tau), above 1e5 N/m, to matter; noise and the motor matter at once
    assert size["opamp", "gbw"] < 0.01 * size["motor", "full"]
    assert size["opamp", "gbw"] < 0.01 * size["pot_noise", "white"]
    assert (tmp_path / "effects.png").is_file()


@pytest.mark.slow
def test_every_choice_of_the_ledger_runs_on_a_board_of_its_own():
    """What one effect makes of the netlist may not be the board of another."""
    path = scenes_folder() / "press.toml"
    runner = effects_ledger._Runner(
        path, ("solver.model=auto", "device.temperature_c=50"), (), None, None, None
    )
    null = {effect.name: effect.null for effect in EFFECTS}
    for effect in CIRCUIT:
        for value in effect.on:
            settings = {**effects_ledger._with_required(null, effect), effect.name: value}
            words = [f"effects.{name}={effects_ledger._toml(each)}" for name, each in settings.items()]
            alone = resolve(load_scene(path, [*runner.overrides, *words]))
            assert runner._plan(settings).board.text == alone.board.text, (effect.name, value)
