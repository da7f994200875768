"""Scene files: strict, all problems at once, each with its place, unit and range."""

import copy
import math
import pickle
import tomllib
from pathlib import Path

import pytest

from cosim.assets import scenes_folder
from cosim.errors import InputError, Problem, SimulationError, nearest
from cosim.scene import Effects, HandOperator, Level, Method, NoOperator, Scene, load_scene, scene_from_dict

VALID = """\
title = "A test"
duration_s = 2

[device]
board = "board.cir"
linkage = "chain"

[device.chain]
lengths_m = [0.1, 0.1]
masses_kg = [0.1, 0.1]
coms_m = [0.05, 0.05]
inertias_kg_m2 = [8e-5, 8e-5]
stops_rad = [[-2, 2], [0, 3]]

[device.start]
q_rad = [0.6, 1.1]

[device.parts]
opamp = { file = "tl.lib", subckt = "TL072", pins = "1 2 3 4 5", dialect = "pspice" }
vca = "mult2"

[device.values]
R12 = 8200
xdiff1.r1 = "9k"

[computer]
period_s = 0.025
method = "combined"
analog_stiffness_n_per_m = 100
discrete_stiffness_n_per_m = 133

[computer.encoder]
decoding = 4

[wall]
point_m = [0.07, 0.155]
normal = [-1, 1]

[operator]
type = "hand"
waypoints_s_m = [[0, 0.07, 0.155], [1, 0.08, 0.165]]
force_s_n = [[0, 1, -1]]

[effects]
opamp = "gbw"
encoder = true
"""

Folder = Path


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    (tmp_path / "board.cir").write_text("* a board\n")
    (tmp_path / "tl.lib").write_text("* a part\n")
    (tmp_path / "scene.toml").write_text(VALID)
    return tmp_path


def problems_of(folder: Folder, text: str | None = None, overrides: tuple[str, ...] = ()) -> list[Problem]:
    file = folder / "scene.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scene(file, overrides)
    assert caught.value.exit_code == 2
    return list(caught.value.problems)


def only(problems: list[Problem]) -> Problem:
    assert len(problems) == 1, [str(problem) for problem in problems]
    return problems[0]


# --- what a scene holds --------------------------------------------------------------------------


def test_values_units_and_defaults(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml")
    assert scene.computer.period_s == 0.025
    assert scene.computer.method is Method.COMBINED
    assert scene.effects.opamp is Level.GBW
    assert scene.joints == 2
    assert isinstance(scene.operator, HandOperator)
    assert scene.operator.mass_kg == 0.554
    assert scene.device.board == folder / "board.cir"
    assert scene.device.values == {"r12": "8200", "xdiff1.r1": "9k"}
    assert scene.device.chain is not None
    assert scene.device.chain.viscous_n_m_s == (0.0, 0.0)
    assert scene.start_speed_rad_per_s == (0.0, 0.0)


def test_every_default_effect_is_the_null_form() -> None:
    for name, value in Effects().model_dump().items():
        assert value in (False, "ideal", "none") or (name, value) == ("driver", "voltage")


def test_scene_is_frozen(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml")
    with pytest.raises(ValueError, match="frozen"):
        scene.computer.period_s = 1.0  # type: ignore[misc]


def test_normals_have_length_one_and_stay_as_they_are_when_stored(folder: Folder) -> None:
    wall = load_scene(folder / "scene.toml").wall
    assert wall is not None
    assert math.hypot(*wall.normal) == pytest.approx(1.0, abs=1e-15)  # one rounding
    scene = load_scene(folder / "scene.toml")
    for _ in range(3):
        again = scene_from_dict(scene.as_dict())
        assert again.as_dict() == scene.as_dict()
        scene = again


def test_toml_of_a_scene_loads_to_the_same_content(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml")
    (folder / "again.toml").write_text(scene.to_toml())
    again = load_scene(folder / "again.toml")
    assert again.as_dict() == scene.as_dict()
    assert again.digest() == scene.digest()


def test_toml_keeps_awkward_text(folder: Folder) -> None:
    title = 'Überhang "45°"\\ \t \x7f'
    scene = load_scene(folder / "scene.toml").model_copy(update={"title": title})
    assert tomllib.loads(scene.to_toml())["title"] == title


def test_digest_follows_the_content_and_not_the_place(
    folder: Folder, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for file in folder.iterdir():
        (elsewhere / file.name).write_bytes(file.read_bytes())
    here = load_scene(folder / "scene.toml").digest()
    assert load_scene(elsewhere / "scene.toml").digest() == here
    assert load_scene(folder / "scene.toml", ["seed=2"]).digest() != here


def test_scene_crosses_a_process_boundary(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml")
    again = pickle.loads(pickle.dumps(scene))
    assert again.as_dict() == scene.as_dict()
    assert again.file == scene.file


def test_stored_scene_needs_no_files(folder: Folder) -> None:
    stored = load_scene(folder / "scene.toml").as_dict()
    (folder / "board.cir").unlink()
    assert scene_from_dict(stored).as_dict() == stored


# --- extends and overrides -----------------------------------------------------------------------


def test_extends_merges_tables_and_keeps_each_files_paths(folder: Folder) -> None:
    sub = folder / "variants"
    sub.mkdir()
    (sub / "v.toml").write_text('extends = "../scene.toml"\n[computer]\nperiod_s = 0.01\n')
    scene = load_scene(sub / "v.toml")
    assert scene.computer.period_s == 0.01
    assert scene.computer.analog_stiffness_n_per_m == 100
    assert scene.device.board == folder / "board.cir"


def test_extends_only_once(folder: Folder) -> None:
    (folder / "b.toml").write_text('extends = "scene.toml"\n')
    (folder / "c.toml").write_text('extends = "b.toml"\n')
    with pytest.raises(InputError) as caught:
        load_scene(folder / "c.toml")
    problem = only(list(caught.value.problems))
    assert problem.file == str(folder / "b.toml")
    assert problem.line == 1


@pytest.mark.parametrize("written", ['"nowhere.toml"', "3"])
def test_extends_must_name_a_file(folder: Folder, written: str) -> None:
    problem = only(problems_of(folder, f"title = 'x'\nextends = {written}\n"))
    assert problem.key == "extends"
    assert problem.line == 2


def test_problem_in_the_extended_file_names_that_file(folder: Folder) -> None:
    (folder / "scene.toml").write_text(VALID.replace("period_s = 0.025", "period_s = -1"))
    (folder / "v.toml").write_text('extends = "scene.toml"\ntitle = "v"\n')
    with pytest.raises(InputError) as caught:
        load_scene(folder / "v.toml")
    problem = only(list(caught.value.problems))
    assert problem.file == str(folder / "scene.toml")
    assert problem.line == VALID.splitlines().index("period_s = 0.025") + 1


def test_another_operator_replaces_the_table(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml", ["operator.type=none"])
    assert isinstance(scene.operator, NoOperator)


def test_another_way_of_stating_the_pose_replaces_the_first(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml", ["device.start.tip_m=[0.05, 0.1]", "device.start.elbow=-1"])
    assert scene.device.start.q_rad is None
    assert scene.device.start.elbow == -1


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("computer.method=discrete", "discrete"),
        ('computer.method="discrete"', "discrete"),
        ("computer.method = 'discrete' ", "discrete"),
    ],
)
def test_bare_words_are_text(folder: Folder, override: str, value: str) -> None:
    scene = load_scene(folder / "scene.toml", [override, "computer.analog_stiffness_n_per_m=0"])
    assert scene.computer.method == value


def test_netlist_values_come_by_override(folder: Folder) -> None:
    scene = load_scene(folder / "scene.toml", ["device.values.R12=9.1k", "device.values.xdiff1.r1=10"])
    assert scene.device.values == {"r12": "9.1k", "xdiff1.r1": "10"}


@pytest.mark.parametrize("text", ["computer.period_s", "=3", "", "a b=3", "a=1\nb=2", "extends=x.toml"])
def test_malformed_overrides(folder: Folder, text: str) -> None:
    assert only(problems_of(folder, overrides=(text,))).file == "override"


# --- one problem at a time: bad input -------------------------------------------------------------

BAD_VALUES = [
    ("computer.period_s=0", "computer.period_s", "s", ">= 1e-06"),
    ("computer.period_s=-0.01", "computer.period_s", "s", ">= 1e-06"),
    ("computer.period_s=25", "computer.period_s", "s", "<= 10"),
    ("computer.period_s=nan", "computer.period_s", "s", ">= 1e-06"),
    ("duration_s=inf", "duration_s", "s", ">= 1e-09"),
    ("device.chain.masses_kg=[0.1, -0.1]", "device.chain.masses_kg[1]", "kg", ">= 0"),
    ("device.chain.lengths_m=[0.1, nan]", "device.chain.lengths_m[1]", "m", ">= 1e-06"),
    ("computer.delay_fraction=1.0", "computer.delay_fraction", None, "< 1"),
    ("computer.encoder.decoding=3", "computer.encoder.decoding", None, "1, 2, 4"),
    ("computer.encoder.decoding=true", "computer.encoder.decoding", None, "1, 2, 4"),
    ("computer.encoder.pulses_per_rev=500.0", "computer.encoder.pulses_per_rev", None, ">= 1"),
    ("effects.opamp=gbv", "effects.opamp", None, "ideal, gbw, full"),
    ("operator.type=hnd", "operator.type", None, "none, mass, hand, python"),
    ("operator.mass_kg=-1", "operator.mass_kg", "kg", ">= 0"),
    ("solver.rtol=0", "solver.rtol", None, ">= 1e-12"),
    ("solver.rtol=1e-320", "solver.rtol", None, ">= 1e-12"),
]


@pytest.mark.parametrize(("override", "key", "unit", "allowed"), BAD_VALUES)
def test_problem_names_key_unit_and_range(
    folder: Folder, override: str, key: str, unit: str | None, allowed: str
) -> None:
    problem = only(problems_of(folder, overrides=(override,)))
    assert problem.key == key
    assert problem.unit == unit
    assert allowed in (problem.allowed or "")
    assert problem.value is not None


def test_wrong_unit_in_a_value_says_what_to_write(folder: Folder) -> None:
    problem = only(problems_of(folder, overrides=("computer.period_s=25ms",)))
    assert "bare number, in s" in problem.message


def test_wrong_unit_in_a_key_finds_the_right_one(folder: Folder) -> None:
    problems = problems_of(folder, VALID.replace("period_s = 0.025", "period_ms = 25"))
    assert any('did you mean "period_s" (in s)?' in problem.message for problem in problems)
    assert any(problem.key == "computer.period_s" and "required" in problem.message for problem in problems)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("duraton_s", "duration_s"),
        ("devcie.board", "device"),
        ("device.chain.lenghts_m", "lengths_m"),
        ("effects.op_amp", "opamp"),
        ("operator.mas_kg", "mass_kg"),
        ("device.parts.opamp.subcircuit", "subckt"),
        ("wall.norm", "normal"),
    ],
)
def test_unknown_key_gives_the_nearest(folder: Folder, wrong: str, right: str) -> None:
    problem = only(problems_of(folder, overrides=(f"{wrong}=1",)))
    assert f'did you mean "{right}"' in problem.message


def test_unknown_key_unlike_any_lists_the_keys(folder: Folder) -> None:
    problem = only(problems_of(folder, overrides=("wall.qqqq=1",)))
    assert problem.allowed == "point_m, normal"


CROSS = [
    ("device.chain.masses_kg=[0.1]", "device.chain.masses_kg", "2 joints"),
    ("device.chain.stops_rad=[[0, 1]]", "device.chain.stops_rad", "2 joints"),
    ("device.chain.stops_rad=[[-1, 1], [2, 2]]", "device.chain.stops_rad[1]", "below"),
    ("device.chain.stops_rad=[[-1, 1], [2, 3]]", "device.start.q_rad[1]", "end stop"),
    ("device.chain.coms_m=[0.05, 0.2]", "device.chain.coms_m[1]", "beyond"),
    ("device.start.q_rad=[0.1, 0.2, 0.3]", "device.start.q_rad", "2 joints"),
    ("device.start.v_rad_per_s=[1]", "device.start.v_rad_per_s", "2 joints"),
    ("device.start.tip_m=[0.3, 0]", "device.start.tip_m", "out of reach"),
    ("wall.point_m=[-0.2, 0.2]", "wall.point_m", "out of reach"),
    ("wall.point_m=[0.2, -0.2]", "wall.point_m", "out of reach"),
    ("wall.normal=[0, 0]", "wall.normal", "zero vector"),
    ("duration_s=0.01", "computer.period_s", "longer than the whole run"),
    ("computer.method=discrete", "computer.analog_stiffness_n_per_m", "does not display"),
    ("computer.analog_stiffness_n_per_m=0", "computer.analog_stiffness_n_per_m", "needs"),
    (
        "computer.joint_stiffness_n_m_per_rad=[1, 1]",
        "computer.joint_stiffness_n_m_per_rad",
        "does not display",
    ),
    ("device.linkage=slider", "device.chain", "does not use"),
    ("device.board=nowhere.cir", "device.board", "no such file"),
    ("device.parts.opamp.file=nowhere.lib", "device.parts.opamp.file", "no such file"),
    ("operator.waypoints_s_m=[[1, 0, 0], [1, 0, 0]]", "operator.waypoints_s_m[1]", "increase"),
    ("operator={type='python', file='nowhere.py:Hand'}", "operator.file", "no such file"),
    ("operator={type='python', file='hand.py'}", "operator.file", "class"),
    ("computer.law='law.txt:Law'", "computer.law", "class"),
]


@pytest.mark.parametrize(("override", "key", "words"), CROSS)
def test_problems_between_keys(folder: Folder, override: str, key: str, words: str) -> None:
    problems = problems_of(folder, overrides=(override,))
    assert any(problem.key == key and words in problem.message for problem in problems), problems


def test_inner_reach_of_unequal_links(folder: Folder) -> None:
    overrides = ("device.chain.lengths_m=[0.15, 0.05]", "device.start.tip_m=[0.05, 0]")
    assert only(problems_of(folder, overrides=overrides)).key == "device.start.tip_m"


def test_pose_stated_twice_or_not_at_all(folder: Folder) -> None:
    twice = VALID.replace("q_rad = [0.6, 1.1]", "q_rad = [0.6, 1.1]\ntip_m = [0.1, 0.1]")
    assert "not both" in only(problems_of(folder, twice)).message
    assert only(problems_of(folder, VALID.replace("q_rad = [0.6, 1.1]", ""))).key == "device.start"


def test_joint_pd_needs_something_to_derive_its_gains_from(folder: Folder) -> None:
    none = (
        "computer.method=joint_pd",
        "computer.analog_stiffness_n_per_m=0",
        "computer.discrete_stiffness_n_per_m=0",
    )
    assert only(problems_of(folder, overrides=none)).key == "computer.joint_stiffness_n_m_per_rad"
    load_scene(folder / "scene.toml", (*none, "computer.joint_stiffness_n_m_per_rad=[1, 2]"))


def test_slider_beside_its_line_and_along_the_wall() -> None:
    drop = scenes_folder() / "drop.toml"
    with pytest.raises(InputError, match="beside its line"):
        load_scene(drop, ["device.start.tip_m=[0.01, 0.01]"])
    with pytest.raises(InputError, match="never meets it"):
        load_scene(drop, ["wall.normal=[1, 0]"])


# --- all at once, and nothing but InputError --------------------------------------------------------


def test_all_problems_at_once(folder: Folder) -> None:
    text = (
        VALID.replace("duration_s = 2", "duraton_s = 2")
        .replace("0.1, 0.1]\ncoms_m", "0.1, -0.1]\ncoms_m")
        .replace("stops_rad = [[-2, 2]", "stops_rad = [[2, -2]")
        .replace('"combined"', '"combind"')
        .replace("board.cir", "bord.cir")
        .replace("normal = [-1, 1]", "normal = [0, 0]")
    )
    keys = [problem.key for problem in problems_of(folder, text)]
    expected = {
        "duraton_s",
        "duration_s",
        "device.chain.masses_kg[1]",
        "device.chain.stops_rad[0]",
        "computer.method",
        "device.board",
        "wall.normal",
    }
    assert set(keys) == expected
    assert len(keys) == len(expected)


def test_problems_come_in_the_order_of_the_file(folder: Folder) -> None:
    problems = problems_of(
        folder, VALID.replace("= 100", "= -1").replace("= 133", "= 'x'").replace("= 2\n", "= 0\n")
    )
    lines = [problem.line or 0 for problem in problems]
    assert lines == sorted(lines)
    assert all(lines)


def leaves(value: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(value, dict):
        return [path, *(leaf for key, item in value.items() for leaf in leaves(item, (*path, key)))]
    if isinstance(value, list):
        return [path, *(leaf for i, item in enumerate(value) for leaf in leaves(item, (*path, i)))]
    return [path]


NONSENSE = [math.nan, math.inf, -1e99, -1, 2.5, "x", "", True, [], {}, {"a": 1}, [[]], [1, 2, 3]]


@pytest.mark.slow
def test_no_replacement_of_a_value_gets_past_the_problems(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any value put in any place gives a scene or problems with a place: never another exception."""
    resolved = load_scene(folder / "scene.toml").as_dict()
    current: dict[str, object] = {}
    monkeypatch.setattr("cosim.scene.layers.tomllib.loads", lambda _text: copy.deepcopy(current["data"]))
    for path in leaves(resolved)[1:]:
        for value in NONSENSE:
            data = copy.deepcopy(resolved)
            place = data
            for part in path[:-1]:
                place = place[part]
            place[path[-1]] = value
            current["data"] = data
            assert _problems_or_finite(folder / "scene.toml"), (path, value)


def _problems_or_finite(file: Path) -> bool:
    try:
        scene = load_scene(file)
    except InputError as error:
        return bool(str(error)) and all(p.key and p.file and p.message for p in error.problems)
    return all(math.isfinite(number) for number in _numbers(scene.as_dict()) if isinstance(number, float))


def _numbers(value: object) -> list[object]:
    if isinstance(value, dict):
        return [n for item in value.values() for n in _numbers(item)]
    if isinstance(value, list):
        return [n for item in value for n in _numbers(item)]
    return [value]


# --- files -----------------------------------------------------------------------------------------


def test_toml_syntax_names_the_line(folder: Folder) -> None:
    problem = only(problems_of(folder, "title = 'x'\nduration_s == 2\n"))
    assert problem.line == 2
    assert problem.file == str(folder / "scene.toml")


def test_toml_cut_short_names_the_line(folder: Folder) -> None:
    assert only(problems_of(folder, 'title = "x"\nnames = [1,\n')).line == 2


def test_missing_folder_and_binary_scene_files(folder: Folder) -> None:
    for path in (folder / "nowhere.toml", folder):
        with pytest.raises(InputError) as caught:
            load_scene(path)
        assert only(list(caught.value.problems)).file == str(path)
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        load_scene(folder / "binary.toml")


@pytest.mark.parametrize("file", sorted(scenes_folder().glob("*.toml")), ids=lambda file: file.stem)
def test_shipped_scenes_load(file: Path) -> None:
    assert isinstance(load_scene(file), Scene)


def test_slope_stays_inside_the_reach_and_starts_outside_the_wall() -> None:
    scene = load_scene(scenes_folder() / "slope.toml")
    assert isinstance(scene.operator, HandOperator)
    assert scene.wall is not None
    (px, py), (nx, ny) = scene.wall.point_m, scene.wall.normal
    heights = [(x - px) * nx + (y - py) * ny for _, x, y in scene.operator.waypoints_s_m]
    # Coordinates are written to 10 micrometres.
    assert heights[0] == pytest.approx(0.010, abs=1e-5)
    assert heights[-1] == pytest.approx(0.0, abs=1e-5)
    (_, ax, ay), (_, bx, by) = scene.operator.waypoints_s_m[-2:]
    assert math.hypot(bx - ax, by - ay) == pytest.approx(0.060, abs=2e-5)
    # 90 % of the reach leaves the second joint bent by 0.9 rad, far from the singular pose.
    assert all(math.hypot(x, y) <= 0.9 * 0.2 for _, x, y in scene.operator.waypoints_s_m)


# --- the errors themselves ---------------------------------------------------------------------------


def test_nearest_ignores_case_and_refuses_the_unlike() -> None:
    assert nearest("r12", ["R12", "R21"]) == "R12"
    assert nearest("qqqq", ["R12"]) is None


def test_errors_cross_a_process_boundary() -> None:
    error = SimulationError(
        "timestep too small", deck="board2.cir", time_s=0.25, last_words="doAnalyses: TRAN"
    )
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert "board2.cir" in str(again)
    assert "t = 0.25 s" in str(again)
    bad = InputError([Problem("is out of range", key="a", value=-1.0, unit="s", allowed="> 0")])
    assert pickle.loads(pickle.dumps(bad)).problems == bad.problems
