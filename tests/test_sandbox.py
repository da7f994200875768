"""What a child process may do, tried from inside."""

import errno
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import container
import pytest

from cosim.errors import SimulationError
from cosim.ngspice import sandbox
from cosim.ngspice.child import call

HERE = Path(__file__).parent
pytestmark = [
    pytest.mark.own_process,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sandbox is Linux's"),
]

NEEDS_LANDLOCK = {
    "a secret file", "a secret by a link", "a secret by /proc", "the parent's environment", "names of users",
    "the user's home", "a list of processes", "a new file", "more in a file", "a shorter file",
    "a new folder", "no more file", "a file moved out", "a device",
    "code that the parent loads", "a folder of such code",
}  # fmt: skip
ATTEMPTS = """
import json, sys, tempfile
sys.path.insert(0, {here!r})
if {inside!r}:
    from container import enter
    refused = enter({inside!r})
    print(json.dumps([refused, open("/proc/self/status").read()]))
from cosim.ngspice.child import call
payload = {{"secret": {secret!r}, "place": {place!r}, "home": {home!r}}}
print(json.dumps(call("sandbox_targets:attempts", payload, time_limit_s=100.0)))
print(json.dumps(call("cosim.commands.version_info:seen_inside", None)))
if {inside!r}:
    from cosim.cli import main
    print(json.dumps(call("sandbox_targets:divider", None)))
    sys.exit(main(["--version", "--verbose"]))
"""


@pytest.fixture(autouse=True)
def targets_on_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def world() -> Iterator[Path]:
    """A folder that a plain user reaches: pytest closes its own to others at each start of another pytest."""
    with tempfile.TemporaryDirectory(prefix="world", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def _python_of(who: dict[str, Any]) -> tuple[str, str]:
    """Return a Python that this user can start, and its modules: root's own may lie in a closed home."""
    modules = os.pathsep.join([str(HERE.parent), *(entry for entry in sys.path if entry)])
    for python in (sys.executable, f"/usr/bin/python{sys.version_info.major}.{sys.version_info.minor}"):
        try:
            subprocess.run(
                [python, "-c", "import numba, cosim"], env={"PYTHONPATH": modules, "HOME": "/nowhere"},
                check=True, capture_output=True, **who,
            )  # fmt: skip
        except (OSError, subprocess.CalledProcessError):
            continue
        return python, modules
    pytest.skip("a plain user cannot start a Python with this program's libraries")


def _attempt(base: Path, user: str, inside: str = "") -> list[str]:
    """Return what a process of this user prints, inside of a filter of `container` or not.

    'plain' is nobody where the tests run as root: no privileges, no namespaces.
    """
    secret, home = base / "secret", base / "home"
    secret.write_text("the secret")
    home.mkdir()
    names = {"secret": str(secret), "place": str(base), "home": str(home)}
    who: dict[str, Any] = {}
    if user == "plain":
        for path in (base, secret, home):
            os.chown(path, 65534, 65534)
        who = {"user": 65534, "group": 65534, "extra_groups": []}
    python, path = _python_of(who)
    environment = {"PATH": os.environ["PATH"], "HOME": str(home), "PYTHONPATH": path, "TMPDIR": str(base)}
    done = subprocess.run(
        [python, "-c", ATTEMPTS.format(here=str(HERE), inside=inside, **names)],
        env=environment, cwd=base, capture_output=True, text=True, check=False, **who,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def _all_refused(base: Path, answers: dict[str, str], reason: str) -> None:
    if "Landlock " in reason:
        assert (base / "secret").read_text() == "the secret"
        assert not list(base.glob("owned*"))
    expected = {name for name in answers if "Landlock " in reason or name not in NEEDS_LANDLOCK}
    assert {name: answers[name] for name in sorted(expected)} == {
        name: "PermissionError" for name in sorted(expected)
    }


@pytest.mark.few(1)
@pytest.mark.parametrize("user", ["as we are", "plain"])
def test_a_simulation_reaches_nothing_else(world: Path, user: str) -> None:
    """As the user of the tests, and where that is root as nobody."""
    if user == "plain" and os.geteuid() != 0:
        pytest.skip("the tests run as a plain user already")
    result, (_, answer) = map(json.loads, _attempt(world, user))
    if "seccomp" not in answer:
        pytest.skip("this machine filters no system calls")
    _all_refused(world, result, answer)


@pytest.mark.few(2)
@pytest.mark.skipif(not container.SUPPORTED, reason="the numbers of calls are of x86_64 and aarch64")
@pytest.mark.parametrize("kind", container.KINDS)
def test_a_container_weakens_nothing(world: Path, kind: str) -> None:
    """A plain user and root below what Docker's default profile refuses; user namespaces forbidden.

    The engine itself is not here: its filter of calls is, with the capabilities it leaves, and for good.
    """
    root = kind == "docker, root"
    if root and os.geteuid() != 0:
        pytest.skip("the tests run as a plain user")
    user = "plain" if os.geteuid() == 0 and not root else "as we are"
    first, *rest = _attempt(world, user, kind)
    answers, status = json.loads(first)
    fields = dict(row.split(":", 1) for row in status.splitlines() if ":" in row)
    left = container.ROOTS_CAPABILITIES if root else 0
    assert (int(fields["CapEff"], 16) | int(fields["CapPrm"], 16)) & ~left == 0
    assert fields["NoNewPrivs"].strip() == "1"
    assert fields["Seccomp"].strip() == "2"
    docker = kind != "no user namespaces"
    assert answers["a user namespace"] == answers["a process in one"] == errno.EPERM
    assert answers["clone3"] == errno.ENOSYS
    assert answers["the same personality"] == 0
    if docker:
        assert answers["a key"] == answers["another personality"] == errno.EPERM

    result, (_, answer), volts = map(json.loads, rest[:3])
    assert "no programs, processes or sockets (seccomp)" in answer
    _all_refused(world, result, answer)
    assert volts == pytest.approx(2.5, rel=1e-9)  # ngspice works
    (value,) = (row for row in rest[3:] if row.startswith("sandbox"))
    assert value.split(maxsplit=1)[1] == answer
    if kind == "older docker":
        assert answers["version of Landlock"] == errno.EPERM
        assert "files NOT limited: no Landlock" in value
    else:
        assert ("only listed files (Landlock" in value) == (answers["version of Landlock"] == 0)


def test_a_simulation_does_what_it_needs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("A_SECRET_TOKEN", "x")
    monkeypatch.setenv("SPICE_LIB_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONSTARTUP", str(tmp_path / "x.py"))
    seen = call("sandbox_targets:allowed", None, collect=tmp_path)
    assert seen["threads"] == [1]
    assert (tmp_path / "rows").read_text() == "1"
    environment = seen["environment"]
    assert not {"A_SECRET_TOKEN", "PYTHONSTARTUP", "USER", "LOGNAME"} & set(environment)
    assert not [name for name in environment if name.startswith("SPICE")]
    assert environment["HOME"] != os.environ.get("HOME")
    for state in seen["states"]:  # of every thread: none was started before
        fields = dict(row.split(":", 1) for row in state.splitlines() if ":" in row)
        assert fields["NoNewPrivs"].strip() == "1"
        assert fields["Seccomp"].strip() == "2"


def test_limits_of_resources() -> None:
    result = call("sandbox_targets:limits", None, time_limit_s=10.0)
    assert result["RLIMIT_CORE"] == [0, 0] or result["RLIMIT_CORE"] == (0, 0)
    assert (
        0 < result["RLIMIT_CPU"][0] <= 10 * 4 + 600 + 30
    )  # its share, imports and compilations, and what it took to start
    assert 0 < result["RLIMIT_DATA"][0] <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 0 < result["RLIMIT_FSIZE"][0] <= 64 << 30
    with pytest.raises(SimulationError, match="MemoryError"):
        call("sandbox_targets:eat_memory", None)
    with pytest.raises(SimulationError, match="File too large"):
        call("sandbox_targets:grow_file", None)


def test_trust_lifts_the_refusals_and_not_the_sandbox(tmp_path: Path) -> None:
    result = call("sandbox_targets:trusted", None, collect=tmp_path)
    assert "was here" in result
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("name", ["evil", "foreign"])
def test_what_a_child_sends_is_data(tmp_path: Path, name: str) -> None:
    """A pickle could call anything in the parent, which is in no sandbox."""
    with pytest.raises(SimulationError, match="may not send"):
        call(f"sandbox_targets:{name}", None)
    assert not (tmp_path / "owned").exists()


def test_a_link_that_a_child_leaves_is_not_collected(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("the secret")
    (tmp_path / "results").mkdir()
    with pytest.raises(SimulationError, match="not a regular file"):
        call("sandbox_targets:leave_link", str(tmp_path / "secret"), collect=tmp_path / "results")
    assert not list((tmp_path / "results").iterdir())


def test_a_kernel_that_gives_less_is_reported() -> None:
    """Where Landlock or the filter is missing, the other holds, and the words say so."""
    code = (
        "from cosim.ngspice import sandbox\n"
        "sandbox._landlock_version = lambda libc: -1\n"
        "print(sandbox.confine([], []))\n"
        "import socket\n"
        "try: socket.socket()\n"
        "except PermissionError: print('no sockets')\n"
        "open('/etc/passwd').close()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "files NOT limited: no Landlock" in done.stdout
    assert "no sockets" in done.stdout
    assert str(sandbox.Status(False, 0)).count("NOT") == 2


def test_the_filter_knows_both_architectures() -> None:
    """Each program ends with leave to go on, and no jump leaves it."""
    import struct

    for machine in ("x86_64", "aarch64"):
        steps = list(struct.iter_unpack("=HBBI", sandbox._program(machine, 1234)))
        assert steps[-1] == (0x06, 0, 0, 0x7FFF0000)
        for place, (code, then, otherwise, _) in enumerate(steps):
            if code & 0x07 == 0x05:
                assert place + 1 + max(then, otherwise) < len(steps)
