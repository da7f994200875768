"""The child's side of `cosim.ngspice.child`: waits for requests, runs them, reports.

Imports little before a request comes, and on the command line takes modules to import meanwhile:
``python -m cosim.ngspice.worker <descriptor> <die with parent: 0 or 1> <its files, in JSON> [module ...]``.
"""

import importlib
import json
import os
import pickle
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from queue import SimpleQueue
from typing import Any, NoReturn

from cosim.caution import collected
from cosim.errors import CosimError
from cosim.ngspice import sandbox
from cosim.ngspice.child_messages import written
from cosim.ngspice.forked import NeedsNgspice
from cosim.quick_start import collect_seldom, defer

__all__ = ["HEAD", "main", "serve"]

HEAD = struct.Struct("<Q")
"""Every message on the pipes is its length followed by a pickle."""

_PACE_S = 0.05
"""Progress is passed on at most this often."""

_PULSE_S = 1.0
"""While modules are imported or compiled, the parent hears so often that the work goes on."""

_sending = threading.Lock()


def _send(descriptor: int, message: tuple[str, Any]) -> None:
    body = written(message)
    view = memoryview(HEAD.pack(len(body)) + body)
    with _sending:
        while view:
            view = view[os.write(descriptor, view) :]


_MENTIONED_S = 0.05
"""An import or a compilation that took longer is told at its end, as the time limit does not count it."""


class _Preparing:
    """Imports and compilations: no simulation, and on a slow machine longer than one is waited for.

    Attributes
    ----------
    under_way : how many, one within the other
    tell : called where the parent should hear of them
    """

    def __init__(self) -> None:
        self.under_way, self._since, self._done_s = 0, 0.0, 0.0
        self.tell: Callable[[], None] | None = None

    @property
    def total_s(self) -> float:
        """Time that all of them have taken so far [s]."""
        return self._done_s + (time.monotonic() - self._since if self.under_way else 0.0)

    def begin(self) -> None:
        """Note that one begins."""
        if not self.under_way:
            self._since = time.monotonic()
        self.under_way += 1

    def end(self) -> None:
        """Note that one ends; the parent hears of the outermost."""
        took = time.monotonic() - self._since
        self.under_way -= 1
        if not self.under_way:
            self._done_s += took
            if took > _MENTIONED_S and self.tell is not None:
                self.tell()

    def message(self) -> tuple[str, Any]:
        """Return what the parent hears."""
        return "progress", {"stage": "compile", "preparing_s": self.total_s}


_preparing = _Preparing()


def _pulse(descriptor: int) -> NoReturn:
    """Show the parent that an import or a compilation goes on."""
    while True:
        time.sleep(_PULSE_S)
        if _preparing.under_way > 0:
            _send(descriptor, _preparing.message())


def _import(name: str) -> Any:
    """Import a module."""
    _preparing.begin()
    try:
        return importlib.import_module(name)
    finally:
        _preparing.end()


def _receive(requests: "SimpleQueue[bytes]") -> NoReturn:
    """Read requests from standard input; when the parent closes it or dies, this process ends at once."""
    stream = os.fdopen(0, "rb", buffering=0, closefd=False)
    buffer = bytearray()
    while chunk := stream.read(1 << 20):
        buffer += chunk
        while len(buffer) >= HEAD.size:
            end = HEAD.size + HEAD.unpack_from(buffer)[0]
            if len(buffer) < end:
                break
            requests.put(bytes(buffer[HEAD.size : end]))
            del buffer[:end]
    import shutil

    shutil.rmtree(os.path.dirname(os.getcwd()), ignore_errors=True)
    os._exit(0)


def _die_with_parent() -> None:
    """Ask Linux for a signal when the parent's thread ends, even while compiled code holds this process."""
    if sys.platform.startswith("linux"):
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _serve(descriptor: int, request: bytes) -> None:
    last = 0.0

    def report(progress: dict[str, Any]) -> None:
        """Tell the parent that the work goes on; a ``time_s`` in it must grow to count as progress."""
        nonlocal last
        now = time.monotonic()
        if now - last >= _PACE_S:
            last = now
            _send(descriptor, ("progress", progress))

    try:
        target, payload, cpu_s = pickle.loads(request)
        sandbox.limit_cpu(cpu_s)
        module, _, name = target.partition(":")
        function = getattr(_import(module), name)
        _send(descriptor, ("progress", {}))  # imports may have taken long
        with collected() as cautions:
            try:
                result = function(pickle.loads(payload), report)
            finally:  # a doubt may be what explains an error
                _send(descriptor, ("cautions", tuple(cautions)))
        _send(descriptor, ("result", result))
    except BaseException as error:  # whatever it is, the parent must hear of it
        text = traceback.format_exc()
        kept = error if isinstance(error, CosimError | NeedsNgspice) else None
        _send(descriptor, ("error", (kept, f"{type(error).__name__}: {error}", text)))


def main() -> NoReturn:
    """Serve requests until the parent goes, as the command line says."""
    collect_seldom()
    descriptor, dies, allowed, *modules = sys.argv[1:]
    serve(int(descriptor), json.loads(allowed), modules, dies_with_parent=dies == "1")


def serve(
    descriptor: int, allowed: Mapping[str, list[str]], modules: Sequence[str], *, dies_with_parent: bool
) -> NoReturn:
    """Serve requests until the parent goes, with answers to a descriptor.

    Parameters
    ----------
    allowed
        What `sandbox.confine` takes.
    modules
        Imported before the first request is looked at.
    """
    import faulthandler

    faulthandler.enable(all_threads=False)
    if dies_with_parent:
        _die_with_parent()
    sandbox.confine(**allowed)  # before any thread, and before anything of a netlist
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_receive, args=(requests,), daemon=True).start()
    _preparing.tell = lambda: _send(descriptor, _preparing.message())
    threading.Thread(target=_pulse, args=(descriptor,), daemon=True).start()
    if modules:
        defer()
    for module in modules:
        try:
            _import(module)
        except Exception:  # the request will fail for the same reason, and be heard
            break
    while True:
        _serve(descriptor, requests.get())


if __name__ == "__main__":
    main()
