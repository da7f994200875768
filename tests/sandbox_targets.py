"""What a simulation never does, tried from inside a child process."""

import ctypes
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from cosim.ngspice.child import OUTBOX


def _spawn() -> None:
    os.posix_spawn("/bin/true", ["true"], {})


def _system() -> None:
    if os.system("touch ../out/owned") != 0:
        raise PermissionError("no shell")


def _memory() -> None:
    descriptor = os.memfd_create("program")
    os.write(descriptor, Path("/bin/true").read_bytes())
    os.execve(descriptor, ["true"], {})


def _trace() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.ptrace(16, os.getppid(), None, None) != 0:  # PTRACE_ATTACH
        raise PermissionError(ctypes.get_errno())
    os.waitpid(os.getppid(), 0x40000000)  # __WALL
    libc.ptrace(17, os.getppid(), None, None)  # PTRACE_DETACH: a test that fails shall not hang


def _fork(make: Callable[[], int | None] = os.fork) -> None:
    """Make a process, which ends at once: a test that fails leaves none behind."""
    me = os.getpid()
    make()
    if os.getpid() != me:
        os._exit(0)


def _call(x86: int, arm: int, *arguments: Any) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    number = x86 if os.uname().machine == "x86_64" else arm
    if libc.syscall(number, *arguments) < 0:
        raise PermissionError(ctypes.get_errno())


def _by_link(secret: str) -> None:
    os.symlink(secret, OUTBOX / "link")
    Path(OUTBOX / "link").read_bytes()


def attempts(payload: dict[str, str], report: Any) -> dict[str, str]:
    """Try everything; return what came of it: ``done`` or the kind of error."""
    secret, place = payload["secret"], Path(payload["place"])
    tried: dict[str, Callable[[], object]] = {
        "run a program": lambda: subprocess.run(["/bin/true"], check=True),
        "spawn": _spawn,
        "a shell": _system,
        "a program in memory": _memory,
        "fork": _fork,
        # on AArch64: clone with CLONE_VFORK | CLONE_VM
        "vfork": lambda: _fork(lambda: _call(58, 220, 0x4111, 0, 0, 0, 0)),
        "clone": lambda: _fork(lambda: _call(56, 220, signal.SIGCHLD, 0, 0, 0, 0)),
        "a TCP socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM),
        "a UDP socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM),
        "a local socket": lambda: socket.socket(socket.AF_UNIX),
        "a pair of sockets": socket.socketpair,
        "io_uring": lambda: _call(425, 425, 1, 0),
        "a signal to the parent": lambda: os.kill(os.getppid(), 0),
        "tracing the parent": _trace,
        "limits of the parent": lambda: _call(302, 261, os.getppid(), 7, 0, 0),
        "a namespace": lambda: _call(272, 97, 0x10000000),
        "a mount": lambda: _call(165, 40, 0, 0, 0, 0, 0),
        "a secret file": lambda: Path(secret).read_bytes(),
        "a secret by a link": lambda: _by_link(secret),
        "a secret by /proc": lambda: Path(f"/proc/{os.getppid()}/root{secret}").read_bytes(),
        "the parent's environment": lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
        "names of users": lambda: Path("/etc/passwd").read_bytes(),
        "the user's home": lambda: os.listdir(payload["home"]),
        "a list of processes": lambda: os.listdir("/proc"),
        "a new file": lambda: (place / "owned").write_text("x"),
        "more in a file": lambda: open(secret, "a").close(),
        "a shorter file": lambda: os.truncate(secret, 0),
        "a new folder": lambda: (place / "owned.d").mkdir(),
        "no more file": lambda: os.unlink(secret),
        "a file moved out": lambda: _moved(place),
        "code that the parent loads": lambda: _code_of_the_parent("owned.nbi"),
        "a folder of such code": lambda: _code_of_the_parent("owned/owned.nbi"),
        "other rights": lambda: os.chmod(secret, 0o777),
        "a device": lambda: os.mknod(OUTBOX / "null", 0o020666, os.makedev(1, 3)),
    }
    by_name = {}
    for name, try_it in tried.items():
        try:
            try_it()
            by_name[name] = "done"
        except OSError as error:
            by_name[name] = type(error).__name__
    return by_name


def _code_of_the_parent(name: str) -> None:
    file = Path(os.environ["COSIM_LIBRARIES"]) / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("x")


def _moved(place: Path) -> None:
    (OUTBOX / "mine").write_text("x")
    os.rename(OUTBOX / "mine", place / "owned")


def allowed(payload: Any, report: Any) -> dict[str, Any]:
    """What a simulation does, and what its process is."""
    import importlib

    (OUTBOX / "rows").write_text("1")
    importlib.import_module("scipy.optimize")
    seen: list[int] = []
    thread = threading.Thread(target=lambda: seen.append(1))
    thread.start()
    thread.join()
    cache = Path(os.environ["XDG_CACHE_HOME"]) / "cosim" / "circuits"
    (cache / "probe").write_text("x")
    (cache / "probe").unlink()
    states = []
    for task in os.listdir("/proc/self/task"):
        with suppress(FileNotFoundError):  # a thread that was joined may be listed a moment longer
            states.append(Path(f"/proc/self/task/{task}/status").read_text())
    return {"threads": seen, "environment": dict(os.environ), "states": states}


def limits(payload: Any, report: Any) -> dict[str, tuple[int, int]]:
    import resource

    names = ("RLIMIT_CPU", "RLIMIT_DATA", "RLIMIT_FSIZE", "RLIMIT_CORE")
    return {name: resource.getrlimit(getattr(resource, name)) for name in names}


def trusted(payload: None, report: Any) -> list[str]:
    """Load a deck whose control block its user trusts."""
    from cosim.ngspice.lines import Line
    from cosim.ngspice.simulator import Simulator

    rows = ["t", "R1 a 0 1k", "V1 a 0 1", ".control", "shell touch ../out/owned", "echo was here", ".endc"]
    simulator = Simulator()
    simulator.load("\n".join(rows), [Line(row, trusted=row == ".control") for row in rows])
    return list(simulator.notes)


def divider(payload: None, report: Any) -> float:
    """Return the voltage in the middle of 5 V over two equal resistors."""
    from cosim.ngspice.simulator import Simulator

    simulator = Simulator()
    simulator.load("t\nV1 a 0 5\nR1 a b 1k\nR2 b 0 1k\n.end\n")
    simulator.command("op")
    return float(simulator.vector("b")[0])


class Evil:
    """A pickle that calls something."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("owned",)


def evil(payload: Any, report: Any) -> Any:
    return {"a": [Evil()]}


class Foreign:
    """A class of no package of ours."""


def foreign(payload: Any, report: Any) -> Any:
    return Foreign()


def leave_link(payload: str, report: Any) -> None:
    os.symlink(payload, OUTBOX / "signals.raw")


def eat_memory(payload: Any, report: Any) -> int:
    import resource

    most = resource.getrlimit(resource.RLIMIT_DATA)[0]
    return len(bytearray(most + (1 << 20)))


def grow_file(payload: Any, report: Any) -> None:
    import resource

    most = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    with open(OUTBOX / "rows", "wb") as file:
        file.seek(most)
        file.write(b"x")
