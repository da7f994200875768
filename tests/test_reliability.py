"""What goes wrong inside of a run: the parent hears of it, tells it in words, and nothing is left behind."""

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from project import ROOT, Project, lay_out

from cosim import cli
from cosim.errors import SimulationError
from cosim.ngspice.child import call
from cosim.results import Run

VENDOR = ROOT / "tests" / "data" / "ngspice" / "vendor"
LEG = "R11 pot inn {r11}"
LAW = """\
from cosim.loop.userlaw import Command

class Law:
    def control(self, sample):
        {body}
"""
PUSH = """\
class Push:
    def force(self, t, r, v):
        {body}
"""


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return lay_out(tmp_path / "device")


def run(project: Project, *arguments: str) -> int:
    return cli.main(["run", str(project.scene), "-o", str(project.folder / "out"), *arguments])


def failed(project: Project, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run the scene; the simulation fails in words, and nothing is left behind."""
    before = sorted(project.folder.rglob("*"))
    code = run(project, *arguments)
    out, err = capsys.readouterr()
    assert code == 1, err
    assert not out
    assert sorted(project.folder.rglob("*")) == before
    return err


# --- ngspice in trouble ------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("lines", "node"),
    [
        ("B77 z 0 V=time>0.03 ? (v(z)>0.5 ? 0 : 1) : 0\nC77 z 0 1p", "xdiff1.z"),  # has no solution
        ("B77 z 0 I=time>0.03 ? (v(z)>0 ? 1 : -1) : 0\nR77 z 0 1k\nC77 z 0 1p", "xdiff1.z"),  # a step at zero
        ("B77 z 0 V=time>0.03 ? ln(-1) : 0\nR77 z inn 1k", ""),  # not a number
    ],
)
def test_endless_step_cutting_names_deck_node_and_time(
    project: Project, capsys: pytest.CaptureFixture[str], lines: str, node: str
) -> None:
    project.edit("netlists/blocks/diffamp.cir", LEG, f"{LEG}\n{lines}")
    result = failed(project, capsys)
    assert f"{project.folder}/netlists/board2.cir: the time step became too small" in result
    assert node in result
    assert re.search(r"\(at t = 0\.0[3-9]", result.splitlines()[0])


@pytest.mark.few(1)
@pytest.mark.parametrize("over", ["1", "-v(pot)", "v(pot)"])
def test_a_division_by_zero_ends(project: Project, capsys: pytest.CaptureFixture[str], over: str) -> None:
    """ngspice takes 1e-32 for the zero: at a loose tolerance it goes on, and the amplifiers are at 1e34 V."""
    lines = f"B77 z 0 V=time>0.03 ? {over}/(v(pot)-v(pot)) : 0\nR77 z inn 1k"
    project.edit("netlists/blocks/diffamp.cir", LEG, f"{LEG}\n{lines}")
    result = failed(project, capsys)
    assert f"{project.folder}/netlists/board2.cir: " in result
    assert re.search(r"\bxboard\.\S+ is at \S+ V, which no circuit is|the time step became too small", result)
    assert re.search(r"\(at t = 0\.0(29|3)", result)  # the step that vanishes may begin before


@pytest.mark.few(1)
@pytest.mark.parametrize("value", ["1m", "-1k"])
def test_a_runaway_ends(project: Project, capsys: pytest.CaptureFixture[str], value: str) -> None:
    """An input resistor of next to zero or below ruins the spring's gain: ideal rails hold nothing back.

    Below zero the board itself is unstable, which is refused unless it is wanted.
    """
    result = failed(project, capsys, "--set", f"r_diff_in={value}", "--allow-unstable")
    assert "the device ran away" in result
    assert "The closed loop is unstable" in result
    assert "cosim check" in result


def test_a_force_beyond_all_measure_ends(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    project.user_operator(PUSH.format(body="return 1e300, 0.0"))
    assert "the device ran away" in failed(project, capsys)


def applied_here() -> bool:
    """Whether this machine keeps a simulation from starting programs."""
    value: str = call("cosim.commands.version_info:seen_inside", None)[1]
    return "(seccomp)" in value


# --- the process in trouble --------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("import ctypes; ctypes.string_at(0)", "ngspice's process crashed (SIGSEGV)"),
        ("import os; os._exit(3)", "ngspice's process ended with exit code 3"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "crashed (SIGKILL)"),
        ("while True: pass", "the time limit of 3 s is over"),
    ],
)
def test_the_parent_survives(
    project: Project, capsys: pytest.CaptureFixture[str], body: str, words: str
) -> None:
    project.user_law(LAW.format(body=body))
    limit = 3 if "time limit" in words else 300  # a busy machine takes long to start a process
    result = failed(project, capsys, "--set", f"solver.time_limit_s={limit}")
    assert words in result
    assert "board2.cir" in result


def test_a_hang_is_distinguished_from_slow_work(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without progress for a while it hangs, however long the run may take in all."""
    from cosim import runner as runs
    from cosim.plan import resolve
    from cosim.scene import load_scene

    project.user_law(LAW.format(body="time.sleep(1e3) if sample.tick == 2 else None; return Command()"))
    project.edit("law.py", "from", "import time\nfrom")
    monkeypatch.setattr(runs, "_STALL_S", 3.0)
    with pytest.raises(SimulationError, match="no progress for 3 s") as caught:
        runs.run(resolve(load_scene(project.scene)), project.folder / "out")
    assert caught.value.time_s is None or caught.value.time_s <= 0.05
    assert not (project.folder / "out").exists()


def test_killed_parent_leaves_no_child(project: Project) -> None:
    process = project.start("duration_s=5000")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert children
    process.kill()
    process.communicate()
    end = time.monotonic() + 5
    while any(Path(f"/proc/{pid}").exists() for pid in children) and time.monotonic() < end:
        time.sleep(0.02)
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]


def test_series_after_a_failure_is_possible_again(project: Project) -> None:
    """A failed call ends its process; the next one gets another."""
    with pytest.raises(SimulationError):
        call("os:_exit", 0)
    assert run(project) == 0


# --- a user's own classes ----------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return float('nan'), 0.0", "must be two finite numbers (fx, fy) in N"),
        ("return 1.0", "must be two finite numbers"),
        ("raise ValueError('so it is')", "push.py:3: RuntimeError: push.py:Push.force(t=0, "),
        ("return (0.0, 0.0) if t < 0.05 else (1 / 0, 0.0)", "ZeroDivisionError"),
        ("raise SystemExit", "push.py:3: SystemExit"),
    ],
)
def test_errors_of_a_users_operator(
    project: Project, capsys: pytest.CaptureFixture[str], body: str, words: str
) -> None:
    project.user_operator(PUSH.format(body=body))
    result = failed(project, capsys)
    assert words in result
    assert "Traceback" not in result


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return Command(torque_n_m=[float('nan'), 0.0])", "torque_n_m is not finite at sample 0"),
        ("return Command(stiffness=[1, 2, 3])", "stiffness must fit the shape (2, 2)"),
        ("return Command(torque_n_m='much')", "torque_n_m must fit the shape (2,)"),
        ("return None", "returned None and no"),
        ("raise ValueError('so it is')", "law.py:5: ValueError: so it is"),
        ("return 1 / (sample.tick - 2)", "law.py:5: ZeroDivisionError"),
    ],
)
def test_errors_of_a_users_law(
    project: Project, capsys: pytest.CaptureFixture[str], body: str, words: str
) -> None:
    project.user_law(LAW.format(body=body.replace("return 1 /", "1 /") + "; return Command()"))
    result = failed(project, capsys)
    assert words in result
    assert "law.py" in result
    assert "Traceback" not in result


def test_a_users_operator_does_what_the_compiled_one_does(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hand's spring and damper about a point, written in Python; its mass rides on the fingertip."""
    assert run(project) == 0
    compiled = Run.load(project.folder / "out")
    project.user_operator(
        "class Push:\n"
        "    mass_kg = 0.554\n"
        "    def force(self, t, r, v):\n"
        "        return -135 * (r[0] - 0.07) - 6.45 * v[0], -135 * (r[1] - 0.154) - 6.45 * v[1]\n"
    )
    assert cli.main(["plan", str(project.scene)]) == 0
    assert "push.py:Push runs in Python, about three times per time point" in capsys.readouterr().out
    assert run(project, "-o", str(project.folder / "mine")) == 0
    assert "runs in Python" in capsys.readouterr().out
    mine = Run.load(project.folder / "mine")
    # the same arithmetic in another order of operations; kinks of the tables are the only other difference
    assert np.allclose(mine.signals["y"][-1], compiled.signals["y"][-1], rtol=0, atol=1e-9)
    assert abs(compiled.signals["y"][-1] - compiled.signals["y"][0]) > 1e-5


def test_a_users_law_runs_end_to_end(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    project.user_law(LAW.format(body="return Command(torque_n_m=[0.01 * sample.tick, 0.0])"))
    assert cli.main(["plan", str(project.scene)]) == 0
    assert "law.py:Law runs in Python, once per sample" in capsys.readouterr().out
    assert run(project) == 0
    samples = Run.load(project.folder / "out").samples
    assert np.array_equal(samples["cmd_nm1"], 0.01 * samples["tick"])


# --- what a netlist may not do -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "lines",
    [
        ".control\nshell touch {mark}\n.endc",
        "shell touch {mark}",
        ".write {mark}",
        "A1 %v([a1]) fs\n.model fs filesource (file=\"{mark}\")",
        "codemodel {mark}",
        ".include '../../../../../../etc/passwd'",
        ".include '{outside}'",
        ".lib '{outside}' data",
    ],
)  # fmt: skip
def test_unsafe_netlists_are_refused_and_nothing_is_executed(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: str
) -> None:
    mark, outside = tmp_path / "mark", tmp_path / "outside.cir"
    outside.write_text(".lib data\n.param harmless=1\n.endl data\n")
    text = lines.format(mark=mark, outside=outside)
    project.edit("netlists/blocks/diffamp.cir", ".subckt diffamp", f"{text}\n.subckt diffamp")
    assert run(project) == 2
    err = capsys.readouterr().err
    assert "diffamp.cir:" in err
    assert "--trust allows it" in err
    assert not mark.exists()
    assert not (project.folder / "out").exists()


def test_trust_lifts_the_refusals_and_not_the_sandbox(project: Project, tmp_path: Path) -> None:
    """The control block is handed on and runs; its program does not, where the kernel filters calls."""
    mark, outside = tmp_path / "mark", tmp_path / "outside.cir"
    outside.write_text(".param harmless=1\n")
    lines = f".include '{outside}'\n.control\nshell touch {mark}\n.endc\n"
    project.edit("netlists/blocks/diffamp.cir", ".subckt diffamp", f"{lines}.subckt diffamp")
    assert run(project) == 2
    assert run(project, "--trust") == 0
    assert mark.exists() is not applied_here()


@pytest.mark.own_process
def test_spiceinit_of_the_user_is_not_read(
    project: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path, project.folder, project.folder / "netlists"):
        (folder / ".spiceinit").write_text(f"shell touch {tmp_path}/mark\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SPICE_USERINIT_DIR", str(tmp_path))
    monkeypatch.chdir(project.folder)
    assert run(project) == 0
    assert not (tmp_path / "mark").exists()


# --- vendor models and recorded nodes ----------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "part",
    [
        'opamp = { file = "boyle.lib", subckt = "TL072", pins = "1 2 3 4 5" }',
        'tl072 = { file = "pspice.lib", subckt = "OPA_PS", pins = "IN+ IN- V+ V- OUT", dialect = "pspice" }',
        'opamp = "ua741"',
    ],
)
def test_a_vendors_model_runs_a_whole_scene(project: Project, part: str) -> None:
    """JFETs, diodes and POLY sources in place of every op-amp: the slope is traced as before."""
    for model in ("boyle.lib", "pspice.lib"):
        shutil.copy(VENDOR / model, project.folder)
    slope = (ROOT / "scenes" / "slope.toml").read_text(encoding="utf-8")
    project.scene.write_text(slope.replace("../netlists", "netlists"), encoding="utf-8")
    assert run(project) == 0
    ours = Run.load(project.folder / "out").measures
    project.scene.write_text(project.scene.read_text() + f"\n[device.parts]\n{part}\n", encoding="utf-8")
    assert run(project) == 0
    theirs = Run.load(project.folder / "out").measures
    # At 1 to 3 MHz and gains of 2e5 the op-amps are far above the hand's few hertz: 1 % is left for the
    # output resistance of 50 to 125 Ohm against loads of 10 kOhm.
    for name in ("rendered_stiffness", "steady_penetration", "peak_current"):
        assert theirs[name]["value"] == pytest.approx(ours[name]["value"], rel=0.01), name


def test_recorded_nodes_are_signals_and_ngspice_reads_them(project: Project, tmp_path: Path) -> None:
    nodes = ["xboard.xdiff1.inn", "XBOARD.X1", "xboard.x1", "imot1", "time", "vcc"]
    assert run(project, "--set", f"record.nodes={nodes}") == 0
    result = Run.load(project.folder / "out")
    names = list(result.signals)
    assert len(names) == len(set(names))
    assert {"xboard.xdiff1.inn", "xboard.x1", "vcc"} <= set(names)
    assert np.all(result.signals["vcc"] == 15.0)
    # the difference amplifier amplifies the volts between u and the potentiometer by 16.9
    u, pot = result.signals["u1"], result.signals["q1"] * 3.37034
    late = result.signals["time"] > 0.01
    assert np.allclose(result.signals["xboard.x1"][late], 16.9 * (u - pot)[late], rtol=0.02, atol=5e-3)
    program = shutil.which("ngspice")
    if program is None:
        pytest.skip("the ngspice program is not installed")
    script = tmp_path / "read.cir"
    script.write_text(
        "* reads a result\n.control\n"
        "load signals.raw\n"
        "print length(time) 'xboard.x1'[length(time)-1]\n.endc\n.end\n"
    )
    output = subprocess.run(  # in its folder: `load` takes no path with a blank
        [program, "-n", "-b", str(script)], cwd=project.folder / "out", capture_output=True, text=True,
        check=False, timeout=30,
    ).stdout  # fmt: skip
    assert f"length(time) = {len(result.signals['time']):.6e}" in output
    assert f"{result.signals['xboard.x1'][-1]:.6e}" in output


# --- odd but in order --------------------------------------------------------------------------------


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "settings",
    [
        ["duration_s=0.101"],  # no multiple of the period
        ["duration_s=0.025"],  # one period: the last tick is the end
        ["computer.period_s=0.03"],
        ["effects.delay=true", "computer.delay_periods=5"],  # longer than the run
        ["effects.delay=true", "computer.delay_fraction=1e-15"],
        ["effects.dac_skew=true", "computer.dac.skew_s=1e-12"],
        ["computer.dac.settling_s=0.5"],  # longer than the run
        ["wall.point_m=[0.07, 0.154]"],  # through the start point
        ["wall.point_m=[0.07, 0.18]"],  # deep inside from the start
        ["operator.force_s_n=[]"],
        ["operator.force_s_n=[[90.0, 0.0, 0.0]]"],
        ["device.start.tip_m=[0.2, 0.0]"],  # stretched
        ["effects.driver=current", "effects.opamp=full", "effects.driver_level=full"],
    ],
)
def test_odd_scenes_run_to_their_end(project: Project, settings: list[str]) -> None:
    assert run(project, *(word for setting in settings for word in ("--set", setting))) == 0
    result = Run.load(project.folder / "out")
    assert result.signals["time"][-1] == pytest.approx(result.scene.duration_s, abs=1e-12)
    period, duration = result.scene.computer.period_s, result.scene.duration_s
    # a sample at the very end would change nothing any more
    ticks = [tick for tick in range(200) if tick * period < duration * (1 - 1e-12)]
    assert result.samples["tick"].tolist() == ticks
    for name in result.signals:
        assert np.isfinite(result.signals[name]).all(), name


@pytest.mark.slow
def test_a_place_with_an_awkward_name(tmp_path: Path) -> None:
    project = lay_out(tmp_path / "Zeit µ ünï 日本 $x 'q \"r")
    assert run(project) == 0
    assert cli.main(["report", str(project.folder / "out")]) == 0
    assert (project.folder / "out" / "report" / "report.html").is_file()


@pytest.mark.slow
def test_several_runs_into_one_place_leave_one_whole_result(project: Project) -> None:
    command = [sys.executable, "-m", "cosim.cli", "run", "scene.toml", "-o", "out"]
    running = [
        subprocess.Popen(command, cwd=project.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(3)
    ]
    for process in running:
        _, err = process.communicate(timeout=60)
        assert process.returncode in (0, 2), err  # beaten by another in the instant of the exchange
        assert b"Traceback" not in err
    assert sorted(path.name for path in project.folder.iterdir()) == ["netlists", "out", "scene.toml"]
    assert Run.load(project.folder / "out").signals["time"][-1] == pytest.approx(0.1)


def test_values_alike_in_their_folders_names_do_not_overwrite_each_other(project: Project) -> None:
    assert run(project, "--set", "title='a b','a_b','a-b'") == 0
    assert len(list((project.folder / "out").glob("*/run.json"))) == 3


@pytest.mark.few(1)
@pytest.mark.long
@pytest.mark.parametrize("joints", [1, 3, 6])
def test_new_boards_run_without_an_edit(tmp_path: Path, joints: int) -> None:
    folder = tmp_path / "device"
    assert cli.main(["new", str(folder), "--joints", str(joints)]) == 0
    scene = min((folder / "scenes").glob("*.toml"))
    assert cli.main(["run", str(scene), "-o", str(folder / "out"), "--set", "duration_s=0.2"]) == 0
    assert Run.load(folder / "out").scene.joints == joints
