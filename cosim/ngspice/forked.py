"""A child that is a copy of its parent, and so begins with the modules that its parent has loaded.

A copy has its parent's memory in it, and the environment that its parent began with. So it serves simulations
of our own loops alone: ngspice does not open here (`cosim.ngspice.library`), and nothing of the user's runs.
A `Child` that is asked for either starts a process of its own. A copy is confined as that is.
"""

import contextlib
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn

__all__ = ["Copy", "NeedsNgspice", "is_copy", "possible", "refuse_ngspice"]

_copy = False


class NeedsNgspice(Exception):
    """A copy was asked for what only a process of its own may do.

    It is no `CosimError`: what goes on without a figure that cannot be had must not go on without this one.
    """


def is_copy() -> bool:
    """Whether this process is a copy."""
    return _copy


def refuse_ngspice() -> None:
    """Raise `NeedsNgspice` in a copy."""
    if _copy:
        raise NeedsNgspice("a copy of its parent opens no ngspice")


def possible() -> bool:
    """Whether this process can be copied: on Linux, while it has one thread, counted by the kernel, too."""
    if not sys.platform.startswith("linux") or threading.active_count() > 1:
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


class Copy:
    """A copied process, as `subprocess.Popen` has a started one.

    Parameters
    ----------
    folder
        Of the child: it works in ``work``, and what it prints goes to ``output``.
    env
        Its environment.
    keep
        Descriptor that stays open in it, beside the three of every process.
    serve
        What it does; it does not return.

    Attributes
    ----------
    stdin
        Its standard input.
    """

    def __init__(
        self, folder: Path, env: Mapping[str, str], keep: int, serve: Callable[[], NoReturn]
    ) -> None:
        outlet, inlet = os.pipe()
        self._status: int | None = None
        self._pid = os.fork()
        if self._pid == 0:
            try:
                _become(folder, env, outlet, keep)
                serve()
            finally:
                os._exit(1)
        os.close(outlet)
        self.stdin = os.fdopen(inlet, "wb", buffering=0)

    def kill(self) -> None:
        """End it."""
        if self._status is None:
            os.kill(self._pid, signal.SIGKILL)

    def wait(self) -> int:
        """Wait for its end and return its exit code; below zero, the signal that ended it."""
        if self._status is None:
            self._status = os.waitstatus_to_exitcode(os.waitpid(self._pid, 0)[1])
        return self._status


def _become(folder: Path, env: Mapping[str, str], outlet: int, keep: int) -> None:
    """Take on what a started child has: session, handlers, descriptors, folder, environment, module path."""
    global _copy
    _copy = True
    os.setsid()  # a Ctrl-C at the terminal is the parent's to handle
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    output = os.open(folder / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    for given, number in ((outlet, 0), (output, 1), (output, 2)):
        os.dup2(given, number)
    for number in map(int, os.listdir("/proc/self/fd")):
        if number > 2 and number != keep:
            with contextlib.suppress(OSError):  # that of the list itself
                os.close(number)
    os.chdir(folder / "work")
    os.environ.clear()
    os.environ.update(env)
    sys.path[:] = env["PYTHONPATH"].split(os.pathsep)
    tempfile.tempdir = None  # it was the parent's
