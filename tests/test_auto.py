"""``effects = "auto"``: the chosen effects meet the tolerance, nothing is chosen silently."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.choice import SCENES, compared
from cosim.assets import netlists_folder, scenes_folder
from cosim.cli import main
from cosim.comparisons import choose_effects, measure_values
from cosim.comparisons.choose_effects import choose
from cosim.comparisons.effect_candidates import Candidates, ladder
from cosim.effects import EFFECTS
from cosim.errors import InputError
from cosim.measures import Tolerance, tolerances
from cosim.plan import resolve
from cosim.provenance import effects_digest
from cosim.results import Run
from cosim.scene import Level, load_scene
from cosim.scene.schema import CHOICES

DROP = scenes_folder() / "drop.toml"
BOARD = netlists_folder() / "board1.cir"
FREE = ("solver.model=auto", "effects=auto")


def amounts(*stated: str) -> dict[str, Tolerance]:
    return tolerances(load_scene(DROP, [*FREE, *(f"tolerance.{text}" for text in stated)]))


# --- what a scene may say -------------------------------------------------------------------------


def test_a_tolerance_is_a_share_or_an_amount_with_its_unit():
    result = amounts(
        "peak_force=0.01",
        'heat="2 %"',
        'max_penetration="0.1 mm"',
        'peak_normal_force="0.05 N"',
        'headroom="0.1"',
    )
    assert result["peak_force"] == Tolerance(0.01, True)
    assert result["heat"] == Tolerance(0.02, True)
    assert result["max_penetration"].allowed(7.0) == pytest.approx(1e-4, rel=1e-12)
    assert result["peak_normal_force"].allowed(7.0) == 0.05
    assert result["headroom"] == Tolerance(0.1, False)


@pytest.mark.parametrize(
    "stated",
    [
        'max_penetration="0.1 N"',
        'heat="1 mA^2 s"',
        'peak_force="much"',
        'peak_force="-1 N"',
        'peak_force="0 N"',
    ],
)
def test_an_amount_in_another_unit_is_an_error(stated):
    with pytest.raises(InputError) as caught:
        amounts(stated)
    assert caught.value.problems[0].key == "tolerance." + stated.partition("=")[0]


def test_what_is_wrong_with_a_tolerance_is_reported(capsys):
    run_it = ["run", str(DROP), "--set", "effects=auto", "--set"]
    assert main([*run_it, "tolerance.max_force=0.01"]) == 2
    assert "nearest is peak_force" in capsys.readouterr().err
    assert main([*run_it, "tolerance.peak_force=2"]) == 2
    assert "out of range" in capsys.readouterr().err
    assert main(run_it[:-1]) == 2
    assert "needs the change of a measure" in capsys.readouterr().err


def test_effects_may_be_a_word_but_no_other_one(capsys):
    assert main(["run", str(DROP), "--set", "effects=atuo"]) == 2
    assert 'the word "auto"' in capsys.readouterr().err


def test_open_effects_never_run_as_none():
    with pytest.raises(InputError, match="still to be chosen"):
        resolve(load_scene(DROP, [*FREE, "tolerance.peak_force=0.01"]))


def test_auto_forgets_the_effects_of_the_file_it_extends_but_not_what_stands_beside_it(tmp_path):
    text = f'extends = "{DROP.as_posix()}"\n[tolerance]\npeak_force = 0.01\n'
    (tmp_path / "word.toml").write_text(f'effects = "auto"\n{text}')
    (tmp_path / "table.toml").write_text(f"{text}[effects]\nauto = true\ngravity = true\n")
    assert Candidates(tmp_path / "word.toml").fixed.keys() == {e.name for e in EFFECTS if e.design}
    both = Candidates(tmp_path / "table.toml")
    assert both.fixed["gravity"] == "stated by the scene"
    assert both.null["gravity"] is True


def test_auto_keeps_what_is_a_choice_of_the_experiment(tmp_path):
    """The hand of the extended scene has its mass and damping, the driver its kind: nothing chooses them."""
    slope, word = scenes_folder() / "slope.toml", tmp_path / "word.toml"
    rest = f'extends = "{slope.as_posix()}"\n[tolerance]\npeak_force = 0.01\n'
    word.write_text(f'effects = "auto"\n{rest}')
    base = load_scene(slope).effects
    for scene in (load_scene(word), load_scene(slope, ["effects=auto", "tolerance.peak_force=0.01"])):
        assert scene.effects.model_fields_set - {"auto"} == CHOICES & base.model_fields_set
        assert scene.effects.operator_dynamics is True
        assert scene.effects.opamp is Level.IDEAL
    word.write_text(f"{rest}[effects]\nauto = true\noperator_dynamics = false\n")
    assert load_scene(word).effects.operator_dynamics is False


@pytest.mark.parametrize(
    "words",
    [
        ["check", "SCENE"],
        ["compare", str(BOARD), str(BOARD), "SCENE"],
        ["export", "SCENE"],
        ["sweep", "SCENE", "computer.period_s=0.01:0.02:2"],
        ["noise", "SCENE"],
        ["stability", "SCENE"],
    ],
    ids=lambda words: words[0],
)
def test_a_command_that_does_not_choose_says_who_does(tmp_path, capsys, words):
    scene = tmp_path / "open.toml"
    scene.write_text(f'effects = "auto"\nextends = "{DROP.as_posix()}"\n[tolerance]\npeak_force = 0.01\n')
    out = ["-o", str(tmp_path / "out")] if words[0] in ("compare", "export", "sweep") else []
    assert main([*(str(scene) if word == "SCENE" else word for word in words), *out]) == 2
    err = capsys.readouterr().err
    assert "still to be chosen" in err
    assert str(scene) in err
    assert not (tmp_path / "out").exists()


def test_a_ladder_climbs_from_the_models_that_many_carry_to_those_that_few_do():
    for effect in EFFECTS:
        rungs = ladder(effect)
        carried = [len(effect.at_full if r.value == "full" else effect.models) for r in rungs]
        assert carried == sorted(carried, reverse=True)
        assert [r.step for r in rungs] == list(range(1, len(rungs) + 1))
        assert set(r.value for r in rungs) <= set(effect.on)


# --- the procedure, with a device whose effects are known exactly -----------------------------------


@pytest.fixture
def device(monkeypatch):
    """Replace the simulation by a sum of known contributions to one measure."""
    share: dict[tuple[str, str], float] = {}
    seen: list[str] = []

    def pretend(plan, folder, **_):
        value = 10.0
        for effect in EFFECTS:
            value += share.get((effect.name, str(effect.value(plan.scene))), 0.0)
        seen.append(effects_digest(plan.scene))
        return SimpleNamespace(
            measures={"peak_force": {"value": value, "unit": "N", "text": ""}},
            stats={"cpu_s": 0.0},
            warnings=(),
        )

    monkeypatch.setattr(measure_values, "run", pretend)
    return share, seen


def value_of(share, scene):
    return 10.0 + sum(share.get((e.name, str(e.value(scene))), 0.0) for e in EFFECTS)


@pytest.mark.few(1)
@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [5, pytest.param(6, marks=pytest.mark.slow), 7, pytest.param(8, marks=pytest.mark.slow)]
)
def test_whatever_the_effects_do_the_choice_meets_the_tolerance(device, seed):
    share, seen = device
    rng = np.random.default_rng(seed)
    candidates = Candidates(DROP, (*FREE, "tolerance.peak_force=0.01"))
    for rung in candidates.rungs:
        share[rung.effect.name, str(rung.value)] = float(rng.choice([-1, 1]) * 10 ** rng.uniform(-3, 0.3))
    plan, _ = choose(DROP, (*FREE, "tolerance.peak_force=0.01"))
    full = value_of(share, candidates.plan(candidates.everything()).scene)
    assert abs(value_of(share, plan.scene) - full) <= 0.01 * abs(full) * (1 + 1e-12)
    assert len(set(seen)) == len(seen) == plan.choice["runs"]  # nothing is run twice


@pytest.mark.slow
def test_the_same_question_has_the_same_answer(device):
    share, _ = device
    rng = np.random.default_rng(5)
    asked = (*FREE, "tolerance.peak_force=0.01")
    for rung in Candidates(DROP, asked).rungs:
        share[rung.effect.name, str(rung.value)] = float(rng.choice([-1, 1]) * 10 ** rng.uniform(-3, 0.3))
    first, again = (choose(DROP, asked)[0].choice for _ in range(2))
    assert again == first


@pytest.mark.slow
@pytest.mark.long
def test_many_small_effects_that_add_up_are_found(device):
    share, _ = device
    candidates = Candidates(DROP, (*FREE, "tolerance.peak_force=0.01"))
    for rung in candidates.rungs:
        share[rung.effect.name, str(rung.value)] = 0.06  # 0.6 % each, every one below the tolerance
    plan, _ = choose(DROP, (*FREE, "tolerance.peak_force=0.01"))
    chosen = {each["effect"] for each in plan.choice["decisions"] if each["in_force"]}
    left = {rung.effect.name for rung in candidates.rungs} - chosen
    full = value_of(share, candidates.plan(candidates.everything()).scene)
    assert abs(value_of(share, plan.scene) - full) <= 0.01 * full
    assert len(left) <= 1  # two would be 1.2 % of 10 N
    assert any("together" in each["why"] for each in plan.choice["decisions"])


def test_an_effect_that_does_nothing_is_left_out_and_the_list_says_so(device):
    share, _ = device
    share["gravity", "True"] = 1.0
    plan, _ = choose(DROP, (*FREE, "tolerance.peak_force=0.01"))
    chosen = [each["effect"] for each in plan.choice["decisions"] if each["in_force"]]
    assert chosen == ["gravity"]
    assert all(each["why"] for each in plan.choice["decisions"])
    named = {each["effect"] for each in plan.choice["decisions"]}
    assert named == {effect.name for effect in EFFECTS}


def test_a_measure_that_the_scene_does_not_have_is_an_error(device):
    with pytest.raises(InputError, match="no such measure"):
        choose(DROP, (*FREE, "tolerance.rendered_stiffness=0.01"))


@pytest.mark.slow
def test_everything_at_once_is_left_alone_where_it_takes_too_long(device, monkeypatch):
    monkeypatch.setattr(choose_effects, "CHECK_S", 0.0)
    plan, _ = choose(DROP, (*FREE, "tolerance.peak_force=0.01"))
    assert "was not run" in plan.choice["verified"][1]


# --- the whole, in circuits -------------------------------------------------------------------------


@pytest.mark.slow
def test_plan_shows_what_would_be_tried_and_runs_nothing(capsys, monkeypatch):
    monkeypatch.setattr("cosim.runner.run", lambda *_, **__: pytest.fail("ran"))
    asked = ["plan", str(DROP), "--set", FREE[0], "--set", FREE[1], "--set", "tolerance.peak_force=0.01"]
    assert main([*asked, "--json"]) == 0
    out = json.loads(capsys.readouterr().out)["plans"][0]
    sizes = [row["size_n"] / row["seconds"] for row in out["candidates"]]
    assert sizes == sorted(sizes, reverse=True)
    assert {row["to_be_run"] for row in out["candidates"]} == {True, False}
    assert main(asked) == 0
    assert "may matter" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.long
def test_a_chosen_run_is_a_scene_of_its_own(tmp_path, capsys):
    out = tmp_path / "out"
    asked = ["run", str(DROP), "--set", FREE[0], "--set", "effects={auto=true, pot_noise='none'}"]
    asked += ["--set", "tolerance.peak_force=0.02", "--set", "duration_s=0.2", "-o", str(out)]
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "effects chosen for a tolerance of peak force 2 %" in printed
    assert "verified: with" in printed
    first = Run.load(out)
    assert first.scene.effects.auto is False
    assert first.plan["choice"]["effects_digest"] == first.provenance["effects_digest"]
    assert main(["run", str(out / "scene.toml"), "-o", str(tmp_path / "again")]) == 0
    again = Run.load(tmp_path / "again")
    assert again.provenance["effects_digest"] == first.provenance["effects_digest"]
    np.testing.assert_array_equal(again.signals["fy"], first.signals["fy"])


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_chosen_effects_meet_the_tolerance_at_a_fraction_of_the_time(name):
    result = compared(name, 2)
    assert max(result.share.values()) <= 1.0
    # without slew, saturation and nonlinearity the circuit is solved by our own loop, without ngspice
    assert min(result.ratios) < 0.25
