"""Every mistake of the user, end to end: exit code 2, words that help, nothing half-written.

The command line runs in this process where no simulation is reached, which is the same and much faster.
"""

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from project import Project, lay_out

from cosim import cli

LIBRARY = "NGSPICE_LIBRARY_PATH"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return lay_out(tmp_path / "device")


def refused(project: Project, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run the scene; the user's mistake is told and nothing is left behind. Returns what was told."""
    before = sorted(project.folder.rglob("*"))
    code = cli.main(["run", str(project.scene), "-o", str(project.folder / "out"), *arguments])
    out, err = capsys.readouterr()
    assert code == 2, err
    assert not out
    assert "Traceback" not in err
    assert sorted(project.folder.rglob("*")) == before
    return err


TOO_MANY = str([[0.0001 * i, 0.07, 0.154] for i in range(300)])
BOARD = 'board = "netlists/board2.cir"'


# --- the scene ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("period_s = 0.025", "perod_s = 0.025", ["17: computer.perod_s", 'did you mean "period_s"']),
        ("period_s = 0.025", "period_ms = 25", ["scene.toml:17: computer.period_ms", '"period_s" (in s)']),
        ("period_s = 0.025", 'period_s = "25 ms"', ["scene.toml:17: computer.period_s = '25 ms'", "in s"]),
        ("period_s = 0.025", "period_s = 25", ["computer.period_s = 25 s", ">= 1e-06 and <= 10 s"]),
        ("period_s = 0.025", "period_s = true", ["must be a number"]),
        ("period_s = 0.025", "period_s = 0", ["scene.toml:17: computer.period_s = 0 s", ">= 1e-06"]),
        ("period_s = 0.025", "period_s = -0.025", ["computer.period_s = -0.025 s", "allowed: >= 1e-06"]),
        ("period_s = 0.025", "period_s = 1", ["longer than the whole run", "duration_s = 0.1"]),
        ("period_s = 0.025", "period_s = 0.025\nperiod_s = 0.01", ["scene.toml:18: TOML syntax"]),
        ("duration_s = 0.1", "duration_s = -1", ["scene.toml:2: duration_s = -1 s", ">= 1e-09 and"]),
        ("duration_s = 0.1", "duration_s = 1e6", ["duration_s = 1000000.0 s", "<= 100000 s"]),
        ("[0.07, 0.155]", "[0.07, nan]", ["scene.toml:23: wall.point_m[1] = nan m", "finite"]),
        ("[0.07, 0.155]", "[0.07, 5.0]", ["wall.point_m = [0.07, 5.0] m", "links reach 0.2 m"]),
        ("normal = [0.0, 1.0]", "normal = [0.0, 0.0]", ["wall.normal", "zero vector"]),
        ("tip_m = [0.07, 0.154]", "tip_m = [0.3, 0.0]", ["device.start.tip_m = [0.3, 0.0] m", "0 to 0.2 m"]),
        ("masses_kg = [0.1, 0.1]", "masses_kg = [-0.1, 0.1]", ["masses_kg[0] = -0.1 kg", ">= 0"]),
        ("masses_kg = [0.1, 0.1]", "masses_kg = [0.1]", ["lists 1", "2 joints"]),
        ("masses_kg = [0.1, 0.1]", "masses_kg = []", ["lists 0", "2 joints"]),
        (BOARD, 'board = "netlists/bord2.cir"', ["scene.toml:5: device.board", "no such file"]),
        (BOARD, 'board = "netlists/board1.cir"', ["the board has 1 joint(s), the linkage 2"]),
        ("[[0.0, 0.07, 0.154]]", "[]", ["operator.waypoints_s_m", "must not be empty"]),
        ("[[0.0, 0.07, 0.154]]", "[[0.0, 0.07]]", ["waypoints_s_m[0]", "2 values instead of 3"]),
        ("[[0.0, 0.07, 0.154]]", TOO_MANY, ["operator.waypoints_s_m", "256"]),
        ('opamp = "gbw"', 'opamp = "super"', ["effects.opamp = 'super'", "ideal, gbw, full"]),
        ('opamp = "gbw"', 'opamps = "gbw"', ["effects.opamps", '"opamp"']),
        ('[effects]', '[effect]', ["effect", "effects"]),
    ],
)  # fmt: skip
def test_mistakes_in_the_scene(
    project: Project, capsys: pytest.CaptureFixture[str], old: str, new: str, words: list[str]
) -> None:
    project.edit("scene.toml", old, new)
    result = refused(project, capsys)
    assert str(project.scene) in result
    assert all(word in result for word in words), result


@pytest.mark.parametrize("text", ["", "# nothing\n", "\x00", "{", "title = 1", "[[device]]\n", "\ufeff"])
def test_files_that_are_no_scene(project: Project, capsys: pytest.CaptureFixture[str], text: str) -> None:
    project.scene.write_text(text, encoding="utf-8")
    assert str(project.scene) in refused(project, capsys)


def test_missing_scene_and_a_folder_in_its_place(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    for place, words in (("gone.toml", "no such scene file"), ("netlists", "cannot be read")):
        assert cli.main(["run", str(project.folder / place)]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("R12=zork", "is not a SPICE number"),
        ("R99=1k", "r99 = '1k': no such parameter or element"),
        ("xdiff9.r11=9k", "no instance xdiff9, nearest is xdiff"),
        ("solver.model=linaer", "solver.model = 'linaer': is not one of the choices"),
        ("solver.max_step_s=1e-30", ">= 1e-09"),
        ("measures.names=['peak_forc']", "nearest is peak_force"),
        ("device.parts.opamp=tl07", "nearest is tl072"),
        ("device.parts.opampp=ua741", "device.parts.opampp: no such part or role, nearest is opamp"),
        ("seed=1,1", "same value twice"),
        ("=1", "must look like"),
        ("a.b=1", "unknown key"),
        ("duration_s=1e5", "solver.time_limit_s"),
    ],
)
def test_mistakes_in_set(
    project: Project, capsys: pytest.CaptureFixture[str], setting: str, words: str
) -> None:
    # hours of computation for the last one: 25 ms samples, a step of a microsecond
    extra = ["--set", "solver.max_step_s=1e-6"] if "max_step" not in setting else []
    assert words in refused(project, capsys, "--set", setting, *extra)


def test_a_model_that_cannot_carry_the_effects(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    result = refused(project, capsys, "--model", "ideal")
    assert "ideal" in result
    assert "spice" in result


# --- the netlist -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("missing", "pin"),
    [("imot1 imot2", "imot2"), ("u1 u2", "u2"), ("ksp11 ksp12", "ksp12"), ("+ vcc vee", "vee")],
)
def test_board_without_a_needed_pin(
    project: Project, capsys: pytest.CaptureFixture[str], missing: str, pin: str
) -> None:
    project.edit("netlists/board2.cir", missing, missing.removesuffix(f" {pin}"))
    result = refused(project, capsys)
    assert result.splitlines()[0].endswith(f"board2.cir:49: {pin}: board board2 of 2 joints lacks the pin")


LEG = "R11 pot inn {r11}"


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("R11 pot", ["needs two nodes"]),
        ("B11 pot inn V=v(pot)*(", ["is not closed"]),
        ("R11 pot inn {r11*}", ["Expression err: r11*"]),
        ("R11 pot inn {r99}", ["Undefined parameter [r99]"]),
        ("R11 pot inn zork", ["unknown parameter (zork)"]),
        ("Q11 pot inn 0 nomodel", ["could not find a valid modelname", "nomodel"]),
        ("X11 pot inn nosuch", ["subcircuit 'nosuch' is not defined"]),
        ("R12 pot inn {r11}", ["element R12 is defined again"]),
    ],
)  # fmt: skip
def test_netlist_syntax_gives_ngspices_words_and_the_users_line(
    project: Project, capsys: pytest.CaptureFixture[str], line: str, words: list[str]
) -> None:
    project.edit("netlists/blocks/diffamp.cir", LEG, line)
    result = refused(project, capsys)
    row = 7 if line.startswith("R12") else 6
    assert f"{project.folder}/netlists/blocks/diffamp.cir:{row}: " in result
    assert line in result or row == 7
    assert all(word in result for word in words), result


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            "C77 adrift 0 1n\nC78 adrift inn 1n",
            "floating node: xboard.xdiff[12].adrift has no DC path to ground",
        ),
        ("V77 held 0 1\nV78 held 0 2", "no DC operating point: loop of voltage sources"),
        # no row in ngspice's matrix: it takes the current's number for the voltage and says nothing
        ("I77 0 adrift 1m", "diffamp.cir:7: .*floating node: xboard.xdiff[12].adrift"),
        ("I77 inn adrift 1m\nI78 adrift 0 1m", "floating node: xboard.xdiff[12].adrift has no DC path"),
        # an element touches it, yet no current finds a way to ground
        ("I77 0 adrift 1m\nC77 adrift 0 1n", "floating node: xboard.xdiff[12].adrift.* has no DC path"),
        ("I77 0 adrift 1m\nR77 adrift a2 1k", "floating node: xboard.xdiff[12].adrift has no DC path"),
        ("G77 0 adrift inn 0 1m", "floating node: xboard.xdiff[12].adrift has no DC path"),
        ("L77 held 0 1m\nV77 held 0 1", "no DC operating point: loop of voltage sources"),
    ],
)
def test_hard_case_41_no_operating_point_and_floating_node(
    project: Project, capsys: pytest.CaptureFixture[str], lines: str, words: str
) -> None:
    project.edit("netlists/blocks/diffamp.cir", LEG, f"{LEG}\n{lines}")
    result = refused(project, capsys)
    assert re.search(words, result), result
    assert "board2.cir: " in result or "diffamp.cir:7: " in result


@pytest.mark.parametrize(
    ("name", "element"), [("r_sum_spring", "rsp11 of board2"), ("xdiff1.r11", "r11 of diffamp")]
)
def test_a_resistor_of_zero_is_a_slip(
    project: Project, capsys: pytest.CaptureFixture[str], name: str, element: str
) -> None:
    """ngspice would silently take 1 mOhm, a gain of ten millions."""
    result = refused(project, capsys, "--set", f"{name}=0")
    assert f"{name} = '0': makes {element} a resistor of 0 Ohm" in result


def test_design_constants_must_be_stated_and_positive(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "kt = 0.0: a design constant must be positive" in refused(project, capsys, "--set", "kt=0")
    project.edit("netlists/board2.cir", ".csparam i_rated={i_rated}", "")
    assert "no design constant 'i_rated'" in refused(project, capsys)


def test_unknown_node_gives_the_nearest_of_the_board(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    result = refused(project, capsys, "--set", "record.nodes=['xboard.xdiff1.innn', 'xboard.xdiff1.inn']")
    assert result.rstrip().endswith(
        "'xboard.xdiff1.innn': the board has no such node; nearest is xboard.xdiff1.inn"
    )


# --- a user's own classes ----------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("class Push: pass", "force"),
        ("class Pusch: pass", "it has Pusch"),
        ("import no_such_module", "No module named 'no_such_module'"),
        ("raise SystemExit", "SystemExit"),
        ("class Push:\n  mass_kg = -1\n  def force(self, t, r, v): return 0, 0", "mass_kg = -1"),
    ],
)
def test_operator_file_that_does_not_fit(
    project: Project, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    project.user_operator(text)
    result = refused(project, capsys)
    assert words in result
    assert f"{project.scene}: operator" in result


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("class Law: pass", "no method control"),
        ("class Lav: pass", "nearest is Lav"),
        ("import no_such_module", "No module named 'no_such_module'"),
        ("raise SystemExit", "SystemExit"),
    ],
)
def test_law_file_that_does_not_fit(
    project: Project, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    project.user_law(text)
    result = refused(project, capsys)
    assert words in result
    assert f"{project.scene}: computer.law" in result


# --- places ------------------------------------------------------------------------------------------


def test_output_in_the_way(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    (project.folder / "out").write_text("mine")
    assert "out: exists and is not a folder" in refused(project, capsys)
    (project.folder / "out").unlink()
    (project.folder / "out").mkdir()
    (project.folder / "out" / "mine.txt").write_text("mine")
    assert "choose another folder" in refused(project, capsys)
    assert (project.folder / "out" / "mine.txt").read_text() == "mine"


@pytest.fixture
def small_disk(project: Project, request: pytest.FixtureRequest) -> Iterator[Path]:
    disk = project.folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", request.param, "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("only root may mount a small disk")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize(
    ("small_disk", "words"),
    [("ro,size=1m", "Read-only file system"), ("size=100k", "No space left on device")],
    indirect=["small_disk"],
)
def test_disk_that_is_full_or_read_only(
    project: Project, capsys: pytest.CaptureFixture[str], small_disk: Path, words: str
) -> None:
    # 10 s leave 3 MB while they are streamed
    arguments = ["run", str(project.scene), "-o", str(small_disk / "out"), "--set", "duration_s=10"]
    assert cli.main(arguments) == 2
    err = capsys.readouterr().err
    assert words in err
    assert str(small_disk) in err
    assert not list(small_disk.iterdir())


# --- ngspice's library -------------------------------------------------------------------------------


def test_library_missing(
    project: Project, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LIBRARY, "/nowhere/libngspice.so")
    result = refused(project, capsys)
    assert "libngspice was not found (tried /nowhere/libngspice.so)" in result
    assert "apt-get install" in result


def test_library_that_is_none_and_one_too_old(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import _ctypes  # any shared library will do

    monkeypatch.setenv(LIBRARY, _ctypes.__file__)
    assert "is not the shared library of ngspice" in refused(project, capsys)
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler to make a library that calls itself ngspice 26")
    (tmp_path / "old.c").write_text(OLD_LIBRARY)
    old = tmp_path / "libngspice_old.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", old, tmp_path / "old.c"], check=True)
    monkeypatch.setenv(LIBRARY, str(old))
    assert "libngspice is version 26; 39 or newer is needed" in refused(project, capsys)


OLD_LIBRARY = """
typedef int (*text)(char *, int, void *);
int ngSpice_Init(text say, void *b, void *c, void *d, void *e, void *f, void *user)
{ say("stdout ** ngspice-26 shared library", 0, user); return 0; }
int ngSpice_Init_Sync(void *a, void *b, void *c, void *d, void *e) { return 0; }
int ngSpice_Command(char *c) { return 0; }
"""


# --- Ctrl-C ------------------------------------------------------------------------------------------


def interrupted(project: Project, setting: str, after: int, how: signal.Signals) -> subprocess.Popen[str]:
    """Start runs in a process of their own, and interrupt the one behind `after` finished ones."""
    process = project.start(setting, after)
    process.send_signal(how)
    return process


@pytest.mark.few(1)
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_leaves_nothing_half_written_and_no_child(project: Project, how: signal.Signals) -> None:
    process = interrupted(project, "duration_s=5000", 0, how)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    out, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted" in err
    assert "Traceback" not in err
    assert not out
    assert [path.name for path in sorted(project.folder.iterdir())] == ["netlists", "scene.toml"]
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]


def test_interrupt_in_a_series_keeps_what_is_finished(project: Project) -> None:
    process = interrupted(project, "duration_s=0.1,5000", 1, signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert [path.name for path in (project.folder / "out").iterdir()] == ["duration_s=0.1"]
    from cosim.results import Run

    assert Run.load(project.folder / "out" / "duration_s=0.1").signals["time"][-1] == pytest.approx(0.1)
