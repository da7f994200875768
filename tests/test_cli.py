"""The command line's frame: exit codes, JSON, quick help, values to try."""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cosim import cli
from cosim.assets import scenes_folder
from cosim.commands import command
from cosim.errors import InputError, SimulationError
from cosim.variants import parse_settings, split_values, variants


def test_new_lays_out_a_project(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", str(tmp_path / "dev"), "--joints", "1", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["joints"] == 1
    assert all((tmp_path / "dev" / name).is_file() for name in out["files"])


def test_users_mistake_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", str(tmp_path / "dev"), "--joints", "9"]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err == "cosim new: --joints = 9: is out of range (allowed: 1 to 6)\n"


def test_mistakes_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", str(tmp_path / "dev"), "--joints", "9", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["problems"][0]["key"] == "--joints"


@pytest.mark.parametrize(
    "arguments", [[], ["nonsense"], ["new"], ["new", "x", "--joints", "two"], ["new", "x", "-q"]]
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == 2
    assert "usage" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("bad"), 2, "bad"),
        (SimulationError("stuck", time_s=1.0), 1, "stuck (at t = 1 s)"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_exit_codes(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: str,
) -> None:
    def fails(*_: object) -> None:
        raise error

    monkeypatch.setattr("cosim.newproject.new_project", fails)
    assert cli.main(["new", "x"]) == code
    assert words in capsys.readouterr().err


def test_closed_pipe_is_quiet() -> None:
    command = [sys.executable, "-m", "cosim.cli", "new", "/nowhere", "--joints", "9", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""


@pytest.mark.parametrize("moment", ["cosim.cli", "cosim.scene", "cosim.plan"])
def test_interrupt_while_importing_is_one_line_and_130(moment: str) -> None:
    """Before anything runs there is nothing to tidy up, and nobody wants a traceback of our imports."""
    code = f"""
import os, signal, sys
class Hook:
    def find_spec(name, *rest):
        if name == {moment!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Hook)
from cosim.__main__ import main
sys.argv[1:] = ["plan", {str(scenes_folder() / "drop.toml")!r}]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == cli.EXIT_INTERRUPTED
    assert not done.stdout
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("cosim")
    assert "interrupted" in done.stderr


@pytest.mark.parametrize("becomes", ["ImportError('numpy failed to import')", "SimulationError('stuck')"])
def test_an_interrupt_that_a_library_turns_into_another_error_is_130(becomes: str) -> None:
    """Numpy's C code, interrupted while it is imported, says that it failed to import."""
    code = f"""
import os, signal, sys
import cosim.newproject
from cosim.errors import SimulationError
from cosim.__main__ import main
def interrupted(*_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        raise {becomes} from None
cosim.newproject.new_project = interrupted
sys.argv[1:] = ["new", "x"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        cli.EXIT_INTERRUPTED, "cosim new: interrupted; finished results are whole\n"
    )  # fmt: skip


def test_an_interrupt_when_all_is_said_changes_nothing() -> None:
    """The interpreter's end, with its tidying up, is not torn by a late Ctrl-C."""
    code = """
import atexit, os, signal, sys
from cosim.__main__ import main
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
sys.argv[1:] = ["--version", "--verbose"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "numba", "pydantic", "pyarrow", "matplotlib", "PySpice", "rich", "jinja2")
    code = (
        "import sys, cosim.cli\n"
        "cosim.cli.build_parser().format_help()\n"
        f"print([name for name in {heavy!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_is_quicker_than_three_times_numpy() -> None:
    def best(arguments: list[str]) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    assert best(["-m", "cosim.cli", "--help"]) < 3 * best(["-c", "import numpy"])


# --- --set -------------------------------------------------------------------------------------------


def test_set_tells_scene_from_netlist() -> None:
    settings = parse_settings(
        ["R12=8.2k,10k", "computer.period_s=0.01", "seed=3", "xdiff1.r1=9k", "r_diff_in=1k"]
    )
    assert [setting.is_netlist for setting in settings] == [True, False, False, True, True]
    overrides = ("device.values.R12=10k", "computer.period_s=0.01", "seed=3", "device.values.xdiff1.r1=9k")
    assert variants(settings)[1].overrides == (*overrides, "device.values.r_diff_in=1k")


def test_every_combination_is_tried() -> None:
    tried = variants(parse_settings(["R1=1k,2k", "seed=1,2,3"]))
    assert [variant.label for variant in tried] == [
        f"R1={r} seed={s}" for r in ("1k", "2k") for s in (1, 2, 3)
    ]
    assert [variant.label for variant in variants(())] == [""]


def test_commas_inside_of_values() -> None:
    assert split_values("[0.1, 0.2],[0.3,0.4]") == ["[0.1, 0.2]", "[0.3,0.4]"]
    assert split_values("'a,b', {x=[1,2]}") == ["'a,b'", "{x=[1,2]}"]


@pytest.mark.parametrize("text", ["R12", "R12=", "R12=1k,,2k", "=3", ""])
def test_malformed_settings(text: str) -> None:
    with pytest.raises(InputError, match="must look like"):
        parse_settings([text])


def test_name_set_twice() -> None:
    with pytest.raises(InputError, match="twice"):
        parse_settings(["R12=1k", "R12=2k"])


def test_variants_of_a_scene_are_all_checked_first() -> None:
    parser = argparse.ArgumentParser()
    command.scene_arguments(parser)
    command.out_argument(parser)
    slope = str(scenes_folder() / "slope.toml")
    args = parser.parse_args(
        [slope, "--set", "seed=1,2", "--set", "R12=8.2k", "--model", "spice", "-o", "out"]
    )
    loaded = command.load_variants(args)
    assert [(variant.label, scene.seed) for variant, scene in loaded] == [
        ("seed=1", 1),
        ("seed=2", 2),
    ]
    assert all(
        scene.device.values == {"r12": "8.2k"} and scene.solver.model == "spice" for _, scene in loaded
    )
    with pytest.raises(InputError, match="choices"):
        command.load_variants(parser.parse_args([slope, "--model", "exact"]))
    with pytest.raises(InputError, match=r"computer\.period_s = -1"):
        command.load_variants(parser.parse_args([slope, "--set", "computer.period_s=0.01,-1"]))


def test_a_series_and_a_single_result_do_not_replace_each_other(tmp_path: Path) -> None:
    from cosim.commands.run import _keep_apart

    single, series = tmp_path / "single", tmp_path / "series"
    for folder in (single, series / "r12=8k", series / "r12=9k"):
        folder.mkdir(parents=True)
        (folder / "run.json").write_text("{}")
    _keep_apart(single, series=False)
    _keep_apart(series, series=True)
    with pytest.raises(InputError, match="single run"):
        _keep_apart(single, series=True)
    with pytest.raises(InputError, match="r12=8k, r12=9k"):
        _keep_apart(series, series=False)


@pytest.mark.parametrize("place", ["nowhere/x.cir", "."])
def test_export_looks_at_its_place_before_the_scene_runs(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("cosim.runner.run", pytest.fail)
    assert cli.main(["export", str(scenes_folder() / "drop.toml"), "-o", str(tmp_path / place)]) == 2
    assert "is not a place for a file" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["check", "{scene}"], ["run", "{scene}"], ["new", "x"], ["plan", "{scene}", "--json"]]
)
def test_a_folder_that_has_vanished_is_reported(tmp_path, monkeypatch, capsys, words):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    scene = str(scenes_folder() / "press.toml")
    assert cli.main([word.format(scene=scene) for word in words]) == 2
    printed = capsys.readouterr()
    assert "does not exist any more" in printed.out + printed.err


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_leave_the_result_whole(closed: str, tmp_path: Path) -> None:
    """As a daemon starts it. No file may get a stream's number: what C code prints would land in it."""
    command = f'exec "$0" -m cosim run "$1" --model linear --no-estimate -o "$2" {closed}'
    files = [str(scenes_folder() / "drop.toml"), str(tmp_path / "out")]
    done = subprocess.run(["sh", "-c", command, sys.executable, *files], check=False)
    assert done.returncode == 0
    json.loads((tmp_path / "out/run.json").read_bytes())


FULL = "cosim: the result cannot be printed: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("keys >/dev/full", 1, FULL),
        ("keys --json >/dev/full", 1, FULL),
        ("--version --verbose >/dev/full", 1, FULL),
        ("keys --verbose 2>/dev/full >/dev/null", 0, ""),
        ("keys nonsense 2>/dev/full", 2, ""),
    ],
)
def test_a_full_device_is_one_line(words: str, code: int, message: str) -> None:
    command = ["sh", "-c", f'exec "$0" -m cosim {words}', sys.executable]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, message)
