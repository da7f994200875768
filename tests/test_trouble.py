"""The random search for trouble: what is drawn, what counts as apart, and a few scenes end to end."""

import json
import math

import numpy as np
import pytest

from benchmarks import trouble, trouble_scenes
from benchmarks.trouble import Answer, _confirmed, board_outcome, growth, judged, refusals
from benchmarks.trouble_boards import Slip, growing
from benchmarks.trouble_scenes import Drawn, drawn, twin_changes
from cosim import effects
from cosim.caution import collected
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.stability_gate import question


def reply(name, force, bound, *cautions):
    """A run with one measure."""
    return Answer(name, {"peak_force": (force, bound, "N")}, frozenset(cautions))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (reply("linear", 1.0, 1e-3), reply("units", 1.0015, 1e-3), "agreed"),
        (reply("linear", 1.0, 0.1), reply("units", 1.1, 0.1), "bounded"),
        (reply("linear", 1.0, 1e-3), reply("units", 1.005, 1e-3), "nearly"),
        (reply("linear", 1.0, 1e-3), reply("units", 1.007, 1e-3), "apart"),
        (reply("linear", 1.0, 1e-3), reply("units", 1.007, 1e-3, "sequence-differs"), "flagged"),
        (reply("linear", 1.0, 1e-3), reply("units", 1.007, 1e-3, "key-unused"), "apart"),
        (reply("linear", 1.0, None), reply("units", 1.2, 1e-3), "flagged"),
        (reply("linear", math.nan, 1e-3), reply("units", 1.0, 1e-3), "no number"),
    ],
)  # fmt: skip
def test_two_runs_are_judged_by_their_bounds(one, other, expected):
    assert judged([one], other)["outcome"] == expected


def test_all_models_are_held_against_one_another():
    """The worst pair decides, though each agrees with the first."""
    seen = judged([reply("ideal", 1.0, 1e-2), reply("linear", 1.009, 1e-6), reply("spice", 0.991, 1e-6)],
                  reply("units", 1.0, 1e-2))  # fmt: skip
    assert seen["outcome"] == "apart"
    assert seen["worst"]["between"] == ["linear", "spice"]


@pytest.fixture(scope="module")
def scenes():
    """Many scenes of a seed."""
    return [drawn(5, number) for number in range(400)]


def test_the_ranges_are_those_of_the_search(scenes):
    def span(key):
        values = [float(scene.changes[key]) for scene in scenes if scene.changes.get(key)]
        return min(values), max(values)

    for key, low, high in (
        ("computer.period_s", 1e-4, 0.2),
        ("computer.discrete_stiffness_n_per_m", 1.0, 1e5),
        ("operator.mass_kg", 1e-3, 10.0),
        ("device.values.tl072_gbw", 1e4, 1e9),
    ):
        least, most = span(key)
        assert low <= least < 2.0 * low, key
        assert 0.5 * high < most <= high, key
    assert {scene.twin for scene in scenes} == set(trouble_scenes.TWINS)
    for effect in trouble_scenes._RARE:
        assert any(scene.changes[f"effects.{effect}"] for scene in scenes), effect


def test_every_drawn_scene_and_twin_is_a_scene(scenes):
    """What the generator draws is refused by no check of keys or effects."""
    for number, scene in enumerate(scenes):
        with collected(forward=False):
            effects.check(load_scene(scene.file, scene.overrides({})))
            load_scene(scene.file, scene.overrides(twin_changes(scene, 5, number)))


def test_a_turned_arm_has_the_same_distance_from_the_wall():
    scene = Drawn(trouble.ROOT / "scenes" / "slope.toml", {}, "turned")

    def gap(more):
        tables = load_scene(scene.file, scene.overrides(more))
        (px, py), (nx, ny) = tables.wall.point_m, tables.wall.normal
        x, y = tables.device.start.tip_m
        return (x - px) * nx + (y - py) * ny, tables.device.start.tip_m

    (before, tip), (after, turned) = gap({}), gap(twin_changes(scene, 1, 1))
    assert before == pytest.approx(0.010, rel=1e-3)  # 10 mm off the wall, as the scene says
    assert after == pytest.approx(before, rel=1e-12)
    assert math.dist(tip, turned) > 1e-3


def test_an_arm_is_not_turned_whose_board_sees_the_angle_itself():
    """A resistor from the output of a difference amplifier to one input passes the common mode: the angle."""
    scenes = [drawn(81130, number) for number in range(700, 900)]
    uneven = [each for each in scenes if each.slip and each.slip.uneven and each.file.stem != "drop"]
    assert uneven
    assert not {each.twin for each in uneven} & {"turned", "mirrored"}
    assert {each.twin for each in scenes if each.slip and not each.slip.uneven} >= {"turned", "mirrored"}


def test_growth_is_that_of_a_sampled_spring():
    """A mass on a sampled and held spring: z^2 - (2 - c/2) z + 1 + c/2 = 0 with c = K T^2/M = 0.25."""
    off = ("rotor_inertia", "viscous", "gravity", "encoder", "dac", "dac_settling")
    changes = {f"effects.{name}": False for name in off} | {
        "effects.opamp": "ideal", "effects.vca": "ideal", "effects.driver_level": "ideal",
        "effects.motor": "ideal", "effects.differentiator": "ideal", "computer.method": "discrete",
        "computer.analog_stiffness_n_per_m": 0.0, "computer.discrete_stiffness_n_per_m": 500.0,
        "computer.period_s": 0.01, "device.slider.mass_kg": 0.15, "operator.mass_kg": 0.05,
    }  # fmt: skip
    scene = Drawn(trouble.ROOT / "scenes" / "drop.toml", changes, "units")
    # the board's constants are written with five digits
    assert growth(scene, None) == pytest.approx(math.sqrt(1.125), rel=1e-5)
    assert _confirmed({"outcome": "apart"}, scene, None)["outcome"] == "unstable"


UNSTABLE = "board.cir: xop: the board is unstable: a pole at {} rad/s (1 kHz) in the loop of xop"


@pytest.mark.parametrize(
    ("words", "poles", "expected"),
    [
        ([UNSTABLE.format("+100")], [100.4 + 0j], "unstable"),
        ([UNSTABLE.format("+3 +- 4j")] * 2, [3.01 - 4j], "unstable"),
        ([UNSTABLE.format("+100"), ""], [100 + 0j], "apart"),  # one model runs it
        ([""], [100 + 0j], "apart"),
        ([UNSTABLE.format("+100")], [], "apart"),  # it is stable
        ([UNSTABLE.format("+100")], [120 + 0j], "apart"),  # another pole is told
        (["no operating point"], None, "refused"),
        ([""], None, "apart"),
    ],
)
def test_a_board_is_unstable_where_all_models_and_the_true_poles_say_so(words, poles, expected):
    assert board_outcome(words, poles) == expected


@pytest.mark.slow
def test_an_angle_s_follower_with_two_lags_grows_as_its_characteristic_equation_says(tmp_path):
    """Loop gain w/s 1/(1 + 3 x + x^2), x = s R C: unstable from w R C = 3 on; inputs swapped at +w."""
    poles = {}
    for lag in (2.8, 3.2):
        farad = lag / (2 * math.pi * 3e6 * 1e4)
        rows = f"Rs1 out f1 10k\nCs1 f1 0 {farad!r}\nRs2 f1 f2 10k\nCs2 f2 0 {farad!r}\n"
        wrong = Slip(
            "angle", lambda text, rows=rows: text.replace("xop wiper out", f"{rows}xop wiper f2"), ""
        )
        board = wrong.board("board1.cir", tmp_path / str(lag))
        scene = Drawn(trouble.ROOT / "scenes" / "drop.toml", {"device.board": str(board)}, "units")
        with collected(forward=False):
            asked = question(resolve(load_scene(scene.file, scene.overrides({}))))
        poles[lag] = growing(asked.boards[0], asked.commanded)
        words = refusals(scene, None)
        assert board_outcome(words, poles[lag]) == ("unstable" if lag > 3.0 else "apart"), words
        assert any(words) == (lag > 3.0)
    assert not poles[2.8]
    x = np.roots([1.0, 3.0, 1.0, 3.2])
    expected = max(x.real) / (farad * 1e4)
    # 1 Ohm of the output against 1.58 kOhm of the differentiator: 0.06 % of the loop, 1 % of 3.2 - 3
    assert max(pole.real for pole in poles[3.2]) == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_the_pole_that_is_told_is_the_true_one_where_two_fits_agree_on_a_faster():
    """568 krad/s by the independent nodal analysis; two fits of the impedance agree on 10 Mrad/s at 4 GHz."""
    assert trouble.outcome(drawn(81130, 1606), 81130, 1606, None)["outcome"] == "unstable"


@pytest.mark.slow
def test_a_pole_of_a_board_is_told_where_a_fit_finds_another_far_beyond():
    """38 krad/s by the independent nodal analysis; in rounding a fit finds 9e13 rad/s."""
    assert trouble.outcome(drawn(20261215, 621), 20261215, 621, None)["outcome"] == "unstable"


@pytest.mark.slow
def test_a_few_scenes_end_to_end(tmp_path, monkeypatch, capsys):
    out = tmp_path / "trouble.jsonl"
    monkeypatch.setattr("sys.argv", ["trouble", "--seed", "1", "-n", "5", "--out", str(out)])
    assert trouble.main() == 0, capsys.readouterr().out
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    assert len(rows) == 5
    assert all(row["outcome"] in ("agreed", "bounded") for row in rows)
    assert all(row["compared"] >= 8 for row in rows)
