"""The child process: whatever happens in it, the parent hears of it and lives."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.circuits.extraction.alter import Way
from cosim.circuits.extraction.swing import SwingFrom
from cosim.errors import InputError, SimulationError
from cosim.ngspice.child import Child, call, start_early
from cosim.ngspice.child_messages import read, written
from cosim.ngspice.time_limits import MOST_PREPARING_S, Watch

pytestmark = pytest.mark.own_process
HERE = Path(__file__).parent
PROJECT = Path(__file__).parent / "data" / "ngspice" / "project"


@pytest.fixture(autouse=True)
def targets_on_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Let the child import the targets, keep its folders where we can count them, and see none left."""
    import tempfile

    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield
    assert not list(tmp_path.glob("cosim-*"))


def run(name: str, payload: object = None, **limits: Any) -> Any:
    return call(f"ngspice_targets:{name}", payload, **limits)


def gone(pid: int, within_s: float = 3.0) -> bool:
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


def test_a_payload_goes_and_comes_back_whole() -> None:
    payload = {"a": np.arange(300_000.0), "text": "µ"}  # larger than any pipe
    back = run("echo", payload)
    assert np.array_equal(back["a"], payload["a"])
    assert back["text"] == "µ"


def test_the_parent_works_once_the_child_has_its_request(tmp_path: Path) -> None:
    """The child waits for what the parent makes meanwhile: each waited for the other, were it made behind."""
    made = tmp_path / "made"
    calls: list[int] = []

    def make() -> None:
        calls.append(1)
        made.touch()

    assert run("await_file", str(made), reads=[tmp_path], meanwhile=make, time_limit_s=20.0)
    assert calls == [1]

    def fail() -> None:
        raise ZeroDivisionError("the very words")

    with pytest.raises(ZeroDivisionError, match="the very words"):
        run("echo", 1, meanwhile=fail)


def test_private_folder_and_home() -> None:
    result = run("where")
    assert result["files"] == [".spiceinit"]
    assert result["home"] != os.environ["HOME"]
    assert not Path(result["cwd"]).exists()
    assert gone(result["pid"])


def test_simulation_in_a_child() -> None:
    assert run("simulate", "t\nV1 a 0 3\nR1 a 0 1k\n")["a"][0] == 3.0


def test_errors_of_the_input_keep_their_kind_and_traceback() -> None:
    with pytest.raises(InputError, match="the user's fault") as caught:
        run("fail_on_input")
    assert "fail_on_input" in "".join(caught.value.__notes__)
    with pytest.raises(InputError, match="unknown parameter"):
        run("simulate", "t\nV1 a 0 3\nR1 a 0 1k zork=1\n")


def test_other_exceptions_keep_their_traceback() -> None:
    with pytest.raises(SimulationError, match="the very words") as caught:
        run("fail_plainly", deck="board.cir")
    assert "fail_plainly" in str(caught.value)
    assert "ZeroDivisionError" in str(caught.value)
    assert caught.value.deck == "board.cir"


def test_segmentation_fault() -> None:
    with pytest.raises(SimulationError, match="SIGSEGV") as caught:
        run("segfault", deck="board.cir")
    assert caught.value.time_s == 0.125
    assert "Fatal Python error" not in (caught.value.last_words or "")  # our stack is not ngspice's words
    assert "File " not in (caught.value.last_words or "")


def test_ngspices_own_segmentation_fault() -> None:
    """`dc 0 external` crashes ngspice before version 41; later ones take 0 V for the operating point."""
    try:
        vectors = run("simulate", "t\nV1 a 0 dc 0 external\nR1 a 0 1k\n")
    except SimulationError as error:
        assert "SIGSEGV" in str(error)  # noqa: PT017
    else:
        assert vectors["a"] == 0.0


def test_exit() -> None:
    with pytest.raises(SimulationError, match="exit code 3"):
        run("leave")


def test_deck_that_makes_ngspice_give_up() -> None:
    with pytest.raises(InputError, match=r"Undefined parameter \[rx\]"):
        run("simulate", "t\nR1 a 0 {rx}\nV1 a 0 1\n")
    rows = [
        "t",
        ".param r_x={2*r_y}",
        ".subckt foo a b",
        "R1 a b {r_x}",
        ".ends",
        "X1 c 0 foo",
        "V1 c 0 1",
        "",
    ]
    with pytest.raises(InputError, match=r"Undefined parameter \[r_y\].*\.param r_x={2\*r_y}"):
        run("simulate", "\n".join(rows))
    rows[3] = "R1 a b {2*r_z}"
    with pytest.raises(InputError, match=r"Undefined parameter \[r_z\].*R1 a b {2\*r_z}"):
        run("simulate", "\n".join([*rows[:1], *rows[2:]]))
    with pytest.raises(InputError, match="nomodel"):
        run("simulate", "t\nQ1 a b 0 nomodel\nV1 a 0 1\n")


def test_endless_loop_meets_the_stall_limit() -> None:
    start = time.monotonic()
    with pytest.raises(SimulationError, match=r"no progress for 0\.4 s; last reported t = 0\.25 s"):
        run("spin", stall_limit_s=0.4)
    assert time.monotonic() - start < 5


def test_time_that_stands_still_is_no_progress() -> None:
    with pytest.raises(SimulationError, match=r"last reported t = 0\.5 s"):
        run("standstill", stall_limit_s=0.4)


def test_slow_but_steady_work_is_left_alone() -> None:
    seen: list[float] = []
    assert run("steady", stall_limit_s=0.4, on_progress=lambda p: seen.append(p["time_s"])) == 7
    assert seen == sorted(seen)
    assert len(seen) > 5


@pytest.mark.slow
def test_a_long_import_is_no_stall() -> None:
    """It takes 3 s; callbacks compile at import, on a slow machine for longer than a run may stall."""
    assert call("slow_import:done", 5, stall_limit_s=2.0) == 5
    with start_early("slow_import") as child:
        assert call("slow_import:done", 6, stall_limit_s=2.0, child=child) == 6


@pytest.mark.slow
def test_a_long_import_does_not_count_against_the_time_limit() -> None:
    """It takes 3 s; a first run compiles for a minute, whatever limit its scene has."""
    assert call("slow_import:done", 5, time_limit_s=2.0) == 5
    with start_early("slow_import") as child:
        assert call("slow_import:done", 6, time_limit_s=2.0, child=child) == 6
        with pytest.raises(SimulationError, match="time limit of 2 s"):  # what was imported is used up
            call("ngspice_targets:spin", None, time_limit_s=2.0, child=child)


def test_compiling_extends_the_time_limit_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("cosim.ngspice.time_limits.time.monotonic", lambda: now[0])
    watch = Watch(10.0, None, prepared_s=5.0)  # 5 s of it before this call
    for busy, at in ((6.0, 101.0), (80.0, 175.0)):
        now[0] = at
        watch.beat({"stage": "compile", "preparing_s": busy})
        watch.check()
    assert watch.patience_s() == pytest.approx(10.0 + 75.0 - 75.0)
    now[0] = 184.9
    watch.check()
    now[0] = 185.0
    with pytest.raises(TimeoutError, match="time limit of 10 s"):
        watch.check()


def test_what_compiles_for_ever_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("cosim.ngspice.time_limits.time.monotonic", lambda: now[0])
    watch = Watch(10.0, None)
    now[0] = MOST_PREPARING_S + 10.0
    watch.beat({"preparing_s": now[0]})
    with pytest.raises(TimeoutError):
        watch.check()


def test_time_limit() -> None:
    with pytest.raises(SimulationError, match=r"time limit of 0\.5 s"):
        run("standstill", time_limit_s=0.5)


def test_an_unknown_function() -> None:
    with pytest.raises(SimulationError, match="nosuch"):
        run("nosuch")
    with pytest.raises(SimulationError, match="no_such_module"):
        call("no_such_module:f", None)


def test_a_result_that_does_not_pickle() -> None:
    with pytest.raises(SimulationError, match="pickle"):
        run("unpicklable")


def test_an_early_child_serves_many_calls_and_closes() -> None:
    with start_early("ngspice_targets") as child:
        for volt in (1.0, 2.0):
            back = call("ngspice_targets:simulate", f"t\nV1 a 0 {volt}\nR1 a 0 1k\n", child=child)
            assert back["a"][0] == volt
        pid = run("where", child=child)["pid"]
    assert gone(pid)
    with pytest.raises(SimulationError, match="closed"):
        child.call("ngspice_targets:echo", 1)


@pytest.mark.parametrize("failing", ["segfault", "fail_on_input"])
def test_a_child_that_a_failure_has_ended_does_not_fail_the_next_call(failing: str) -> None:
    with start_early("ngspice_targets") as child:
        with pytest.raises((SimulationError, InputError)):
            call(f"ngspice_targets:{failing}", child=child, payload=None)
        assert not child.alive
        assert call("ngspice_targets:echo", 7, child=child) == 7


def test_an_early_child_that_is_forgotten_goes() -> None:
    child = Child()
    pid = child.call("ngspice_targets:where", None)["pid"]
    del child
    assert gone(pid)


def test_what_progress_raises_ends_the_child() -> None:
    def refuse(progress: Any) -> None:
        raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        run("steady", on_progress=refuse)


def test_calls_from_several_threads() -> None:
    """Each has its own child; the signal on the parent's death is bound to the thread that started it."""
    results: list[Any] = []
    threads = [threading.Thread(target=lambda i=i: results.append(run("echo", i))) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(results) == [0, 1, 2]


PARENT = """
import sys, tempfile
sys.path.insert(0, {here!r})
tempfile.tempdir = {folder!r}
from cosim.ngspice.child import call
try:
    call("ngspice_targets:sleep", None)
except KeyboardInterrupt:
    print("interrupted")
    raise SystemExit(130)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
def test_the_child_goes_with_its_parent(tmp_path: Path, how: signal.Signals) -> None:
    folder = tmp_path / "folders"
    folder.mkdir()
    code = PARENT.format(here=str(HERE), folder=str(folder))
    root = str(HERE.parent)
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": root},
        start_new_session=True,
    ) as parent:
        end = time.monotonic() + 20
        while not (marker := next(folder.glob("*/out/marker"), None)) or " " not in marker.read_text():
            assert time.monotonic() < end
            time.sleep(0.02)
        pid, cwd = marker.read_text().split(" ", 1)
        os.killpg(parent.pid, how)  # as a terminal does on Ctrl-C
        result, _ = parent.communicate(timeout=10)
    assert gone(int(pid))
    if how is signal.SIGINT:
        assert result == b"interrupted\n"
        assert parent.returncode == 130
        assert not Path(cwd).exists()
        assert not list(folder.iterdir())


@pytest.fixture
def marker() -> Iterator[Path]:
    """A file that must not appear, in a path without a blank: ngspice's `shell` takes no other."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        yield Path(folder) / "owned"


def test_no_spiceinit_of_the_user_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, marker: Path
) -> None:
    """Neither one in the working folder nor one in HOME, nor one that the environment points to."""
    for folder in ("here", "home", "init"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / ".spiceinit").write_text(f"shell touch {marker}\nset ngbehavior=hsa\n")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("SPICE_USERINIT_DIR", str(tmp_path / "init"))
    run("simulate", "t\nV1 a 0 3\nR1 a 0 1k\n")
    assert not marker.exists()
    # the test means something: without the private folder the file is read
    subprocess.run(
        [sys.executable, "-c", "from cosim.ngspice.simulator import Simulator; Simulator()"],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)},
        check=True,
        capture_output=True,
    )
    assert marker.exists()


def test_members_of_enumerations_travel_by_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 3.11.2, which Debian 12 has, pickles them by `getattr`, and that no child may send."""
    monkeypatch.setattr(Enum, "__reduce_ex__", lambda self, p: (getattr, (type(self), self.name)))
    assert read(written({"from": SwingFrom.SUPPLIES, "by": [Way.DECK]})) == {
        "from": SwingFrom.SUPPLIES, "by": [Way.DECK],
    }  # fmt: skip


def simulator_with(**environment: str) -> "subprocess.CompletedProcess[str]":
    code = (
        "import cosim.ngspice.library as l\n"
        "import os\n"
        "l.OLDEST_VERSION = int(os.environ.get('OLDEST', l.OLDEST_VERSION))\n"
        "from cosim.ngspice.simulator import Simulator\n"
        "from cosim.errors import InputError\n"
        "try:\n    Simulator()\nexcept InputError as error:\n    print(error)\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(HERE.parent), **environment},
        capture_output=True,
        text=True,
        check=True,
    )


def test_missing_library_is_reported_with_the_remedy(tmp_path: Path) -> None:
    output = simulator_with(NGSPICE_LIBRARY_PATH=str(tmp_path / "none.so")).stdout
    assert "libngspice was not found" in output
    assert "none.so" in output
    assert "apt-get install" in output
    (tmp_path / "text.so").write_text("no library at all")
    assert "libngspice was not found" in simulator_with(NGSPICE_LIBRARY_PATH=str(tmp_path / "text.so")).stdout


def test_a_library_that_is_too_old_is_refused() -> None:
    output = simulator_with(OLDEST="99").stdout
    assert "99 or newer is needed" in output


def test_no_room_for_the_childs_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(InputError, match="folder for temporary files"):
        run("echo")


def test_starting_a_child_is_cheap() -> None:
    """A bare child is a Python interpreter and little more: no numpy, no PySpice, no numba."""
    loaded = set(run("modules"))
    assert not loaded & {"numpy", "PySpice", "numba", "cffi", "scipy"}
