"""The opened ngspice library and the callbacks it always has: text, exit, vectors, and safe defaults.

PySpice finds and opens the library and declares its C interface; this is the only module that touches it.
Its callbacks are replaced by our own, because they are Python functions called once per source and Newton
iteration, lose exceptions, and take harmless notes for errors.
"""

import ctypes.util
import math
import os
import re
import sys
import warnings
from collections import deque
from collections.abc import Callable
from typing import Any

from cffi import CDefError

from cosim.errors import InputError, SimulationError
from cosim.ngspice.forked import refuse_ngspice
from cosim.ngspice.messages import worth_quoting

__all__ = ["OLDEST_VERSION", "STOP_COMMAND", "Init", "Library", "Source", "Sync", "opened"]

OLDEST_VERSION = 39
"""Oldest ngspice whose shared library was tested."""

STOP_COMMAND = b"stop when time > -1\0"
"""What a compiled callback passes to `Simulator.command_address` to stop the analysis at its next point."""

_REFERENCE = re.compile(r"Reference value\s*:\s*(\S+)")
_MOST_LINES = 20_000
"""Lines of one command's output that are kept; the last words are kept apart."""

Source = Callable[[str, float], float]
Sync = Callable[[float, float, float, int, int], float | None]
Init = Callable[[list[str]], None]


def _candidates() -> list[str]:
    """Return names under which the shared library may be found, the likeliest first."""
    named = os.environ.get("NGSPICE_LIBRARY_PATH")
    if named:
        return [named]
    if sys.platform == "darwin":
        return ["libngspice.0.dylib", "libngspice.dylib", "/opt/homebrew/lib/libngspice.dylib"]
    if sys.platform == "win32":
        return ["ngspice.dll"]
    return ["libngspice.so.0", "libngspice.so"]


class Library:
    """The opened library and the text, exit and default source callbacks; one per process."""

    def __init__(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from PySpice.Spice.NgSpice.Shared import NgSpiceShared, ffi

        class Opened(NgSpiceShared):  # type: ignore[misc]  # PySpice carries no types
            """PySpice's simulator without its own callbacks."""

            def _init_ngspice(self, send_data: bool) -> None:
                """Leave the initialisation to us: PySpice's would switch off what we need."""

        self.ffi = ffi
        self.api = self._open(Opened, ffi)
        self.echo = "COSIM_NGSPICE_ECHO" in os.environ
        self.lines: list[str] = []
        self.recent: deque[str] = deque(maxlen=20)
        self.failure: BaseException | None = None
        self.exited = False
        self.loaded = False
        self.end_s = self.aim_s = math.inf  # of the transient analysis that runs, and of its last step
        self._stop_waits = False  # for the next step: ngspice 47 takes no command while it prints
        self._compiled_steps = False
        self.restore: Callable[[str], str] = str
        self.on_time: Callable[[float], None] | None = None
        self.init: Init | None = None
        self.vectors: list[Any] = []
        self.names: list[str] = []
        # kept alive here: ngspice holds bare pointers
        self._text = ffi.callback("SendChar", self._on_text)
        self._exit = ffi.callback("ControlledExit", self._on_exit)
        self._nobody = ffi.new("long long *", 0)  # user memory without a run: its first word is zero
        self._data: int | None = None  # address of the data callback that ngspice was initialised with
        self._stays = False
        self._no_data = ffi.callback("SendData", lambda data, count, ident, user: 0)
        self._init = ffi.callback("SendInitData", self._on_init)
        self._thread = ffi.callback("BGThreadRunning", lambda running, ident, user: 0)
        self._no_source = ffi.callback("GetVSRCData", self._on_unanswered)
        self._no_sync = ffi.callback("GetSyncData", self._on_step)
        self._kept: list[Any] = []
        self.attach(None, None, None, None, None)
        self.version = self._version()

    @staticmethod
    def _open(opened: Any, ffi: Any) -> Any:
        tried = _candidates()
        if "NGSPICE_LIBRARY_PATH" not in os.environ:
            path = ctypes.util.find_library("ngspice") if sys.platform != "linux" else None
            tried += [path] if path else []
        for name in tried:
            # first without PySpice, which declares its functions before it looks, and can once
            try:
                there = ctypes.CDLL(name)
            except OSError:
                continue
            if not hasattr(there, "ngSpice_Init_Sync"):
                raise InputError(f"{name} is not the shared library of ngspice")
            opened.LIBRARY_PATH = name
            try:
                try:
                    return opened()._ngspice_shared  # sets the C locale for numbers, as ngspice wants it
                except CDefError:  # in one of thousands of processes the interface is declared by then
                    return _declared(ffi, name)
            except OSError as error:
                raise InputError(f"{name} cannot be opened by PySpice: {error}") from error
        raise InputError(
            "libngspice was not found (tried "
            + ", ".join(tried)
            + "). Install it (Debian, Ubuntu: apt-get install libngspice0; macOS: brew install libngspice) "
            "or set NGSPICE_LIBRARY_PATH to the library's file"
        )

    def _version(self) -> int:
        """Return the major version that the library's greeting states."""
        match = next((m for line in self.lines if (m := re.search(r"ngspice-(\d+)", line))), None)
        version = int(match[1]) if match else 0
        if version < OLDEST_VERSION:
            raise InputError(
                f"libngspice is version {version or 'unknown'}; {OLDEST_VERSION} or newer is needed"
            )
        return version

    def attach(
        self,
        data: int | None,
        init: Init | None,
        source: int | Source | None,
        sync: int | Sync | None,
        user: int | None,
        stays: bool = False,
    ) -> None:
        """Hand callbacks to ngspice; what is ``None`` gets a harmless default, never a null pointer.

        A null pointer at the first call would switch a service off for good (data) or be called later
        (sync, sources). Initialising ngspice again loads its code models again, which makes every later
        point slower (0.2 us each time on 39): a data callback that `stays` is kept where a later call names
        none, and knows it by the zero in the first word of its user memory.
        """
        ffi = self.ffi
        self.init = init
        self._kept = []
        voltage = self._source(source)
        pointer = self._nobody if user is None else ffi.cast("void *", user)
        wanted = self._data if data is None and self._stays else data or 0
        if wanted != self._data:
            rows = ffi.cast("SendData *", wanted) if wanted else self._no_data
            self._data, self._stays = wanted, stays
            self.api.ngSpice_Init(self._text, ffi.NULL, self._exit, rows, self._init, self._thread, pointer)
        self._stop_waits = False
        self._sources, self._user = voltage, pointer
        self._attach_steps(self._sync(sync))

    def _attach_steps(self, steps: Any) -> None:
        currents = self.ffi.cast("GetISRCData *", self._sources)
        self.api.ngSpice_Init_Sync(self._sources, currents, steps, self.ffi.NULL, self._user)

    def _source(self, source: int | Source | None) -> Any:
        if source is None:
            return self._no_source
        if not callable(source):
            return self.ffi.cast("GetVSRCData *", source)

        def answer(value: Any, time: float, name: Any, ident: int, user: Any) -> int:
            try:
                value[0] = source(self.restore(self.ffi.string(name).decode().lower()), time)
            except BaseException as error:  # cffi would print and forget it
                self.failure = self.failure or error
                value[0] = 0.0
            return 0

        self._kept.append(self.ffi.callback("GetVSRCData", answer))
        return self._kept[-1]

    def _sync(self, sync: int | Sync | None) -> Any:
        self._compiled_steps = sync is not None and not callable(sync)
        if sync is None:
            return self._no_sync
        if not callable(sync):
            return self.ffi.cast("GetSyncData *", sync)

        def answer(time: float, delta: Any, old: float, redo: int, ident: int, loc: int, user: Any) -> int:
            if self.failure is None:
                try:
                    wanted = sync(time, delta[0], old, redo, loc)
                    if wanted is not None:
                        delta[0] = wanted
                except BaseException as error:
                    self.failure = error
                    self.stop()
            return self._on_step(time, delta, old, redo, ident, loc, user)

        self._kept.append(self.ffi.callback("GetSyncData", answer))
        return self._kept[-1]

    def _on_step(
        self, time: float, delta: Any, old: float, redo: int, ident: int, loc: int, user: Any
    ) -> int:
        """Let no step pass the end of the analysis.

        With a step callback attached, ngspice 44 cuts such a step to 1.1 of its least step short of the end,
        and then stops with "timestep too small", since nothing is left. A step to the very end is not cut,
        nor one that ends less than its least step before it, which ngspice takes for the end.
        """
        if self._stop_waits:
            self._stop_waits = False
            self.stop()
        if time < self.end_s < time + delta[0]:
            left = self.aim_s - time
            while time + left > self.end_s:  # the sum is rounded
                left = math.nextafter(left, 0.0)
            if left > 0.0:
                delta[0] = left
        return 0

    def stop(self) -> None:
        """Ask the running analysis to stop at its next point; safe inside a callback."""
        self.api.ngSpice_Command(STOP_COMMAND)

    def _stop_at_next_step(self) -> None:
        """Stop from where no command is taken; compiled steps, which cannot tell it, end with this one."""
        self._stop_waits = True
        if self._compiled_steps:
            self._attach_steps(self._no_sync)

    def _on_text(self, message: Any, ident: int, user: Any) -> int:
        text = self.ffi.string(message).decode("utf-8", "replace")
        reference = _REFERENCE.search(text)
        if reference:
            try:
                if self.on_time is not None:
                    self.on_time(float(reference[1]))
            except BaseException as error:
                self.failure = self.failure or error
                self._stop_at_next_step()
            return 0
        text = self.restore(text)
        if text in self.lines[-2:]:  # a failing B-source repeats itself thousands of times
            return 0
        if len(self.lines) < _MOST_LINES:
            self.lines.append(text)
        if worth_quoting(text):
            self.recent.append(text.partition(" ")[2])
            if self.echo:  # a child's last output must outlive it
                os.write(2, text.partition(" ")[2].encode() + b"\n")
        return 0

    def _on_exit(self, status: int, immediate: bool, quitting: bool, ident: int, user: Any) -> int:
        self.exited = True
        return status

    def _on_init(self, info: Any, ident: int, user: Any) -> int:
        self.vectors, self.names = [], []
        if self.init is None:  # never asked for
            return 0
        try:
            ffi = self.ffi
            self.vectors = [info.vecs[i].pdvec for i in range(info.veccount)]
            self.names = [ffi.string(info.vecs[i].vecname).decode().lower() for i in range(info.veccount)]
            if self.init is not None:
                self.init([self.restore(name) for name in self.names])
        except BaseException as error:
            self.failure = self.failure or error
            self.stop()
        return 0

    def _on_unanswered(self, value: Any, time: float, name: Any, ident: int, user: Any) -> int:
        source = self.restore(self.ffi.string(name).decode())
        self.failure = self.failure or SimulationError(f"nothing answers the external source {source}")
        value[0] = 0.0
        return 0


def _declared(ffi: Any, name: str) -> Any:
    """Open the library by an interface that was declared before; PySpice declares it, then opens.

    Raises
    ------
    CDefError
        Where the declaration was not finished.
    """
    api = ffi.dlopen(name)
    if not hasattr(api, "ngSpice_SetBkpt"):  # the last one
        raise CDefError("the interface of ngspice was declared in part only")
    return api


_library: Library | None = None
_refused: Exception | None = None  # why it is missing: a process looks for it once


def opened() -> Library:
    """Return the library of this process, opened at the first call.

    Raises
    ------
    InputError
        If it is missing or older than `OLDEST_VERSION`; every later call says so too, as of any other error:
        PySpice declares its functions once, and a second try would fail for that reason alone.
    """
    global _library, _refused
    refuse_ngspice()
    if isinstance(_refused, InputError):
        raise InputError(_refused.problems)
    if _refused is not None:
        raise RuntimeError(
            f"ngspice could not be opened: {type(_refused).__name__}: {_refused}"
        ) from _refused
    if _library is None:
        try:
            _library = Library()
        except Exception as error:
            _refused = error
            raise
    return _library
