"""The ngspice shared library behind a small face: load a deck, run commands, read vectors, attach callbacks.

This is the only module that touches PySpice. PySpice finds and opens the library and declares its C
interface; its callbacks are replaced by our own, because they are Python functions called once per source
and Newton iteration, lose exceptions, and take harmless notes for errors.

The library keeps its state in globals: one circuit at a time, one simulator per process. Whoever needs
isolation (every run does) goes through `cosim.ngspice.child`.
"""

import contextlib
import ctypes.util
import math
import os
import re
import sys
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError, Problem, SimulationError, nearest
from cosim.ngspice.words import is_error, load_problems, operating_point_problem, worth_quoting

if TYPE_CHECKING:
    from cosim.ngspice.lines import Line

__all__ = ["OLDEST_VERSION", "Simulator"]

OLDEST_VERSION = 39
"""Oldest ngspice whose shared library was tested."""

_BEHAVIOUR = re.compile(r"^\*@\s*ngbehavior=(\w+)\s*$", re.MULTILINE)
_REFERENCE = re.compile(r"Reference value\s*:\s*(\S+)")
_HISTORY = 1000
"""Commands after which ngspice is told to forget them; it keeps every one otherwise."""

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


class _Library:
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
        self.api = self._open(Opened)
        self.lines: list[str] = []
        self.recent: deque[str] = deque(maxlen=20)
        self.failure: BaseException | None = None
        self.exited = False
        self.on_time: Callable[[float], None] | None = None
        self.init: Init | None = None
        self.vectors: list[Any] = []
        self.names: list[str] = []
        # kept alive here: ngspice holds bare pointers
        self._text = ffi.callback("SendChar", self._on_text)
        self._exit = ffi.callback("ControlledExit", self._on_exit)
        self._no_data = ffi.callback("SendData", lambda data, count, ident, user: 0)
        self._init = ffi.callback("SendInitData", self._on_init)
        self._thread = ffi.callback("BGThreadRunning", lambda running, ident, user: 0)
        self._no_source = ffi.callback("GetVSRCData", self._on_unanswered)
        self._no_sync = ffi.callback("GetSyncData", lambda time, delta, old, redo, ident, loc, user: 0)
        self._kept: list[Any] = []
        self.attach(None, None, None, None, None)
        self.version = self._version()

    @staticmethod
    def _open(opened: Any) -> Any:
        tried = _candidates()
        if "NGSPICE_LIBRARY_PATH" not in os.environ:
            found = ctypes.util.find_library("ngspice") if sys.platform != "linux" else None
            tried += [found] if found else []
        for name in tried:
            opened.LIBRARY_PATH = name
            # PySpice wants the C locale for numbers, and sets it; a missing library shows as OSError
            with contextlib.suppress(OSError):
                return opened()._ngspice_shared
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
    ) -> None:
        """Hand callbacks to ngspice; what is ``None`` gets a harmless default, never a null pointer.

        A null pointer at the first call would switch a service off for good (data) or be called later
        (sync, sources).
        """
        ffi = self.ffi
        self.init = init
        self._kept = []
        voltage = self._source(source)
        pointer = ffi.NULL if user is None else ffi.cast("void *", user)
        rows = self._no_data if data is None else ffi.cast("SendData *", data)
        self.api.ngSpice_Init(self._text, ffi.NULL, self._exit, rows, self._init, self._thread, pointer)
        self.api.ngSpice_Init_Sync(
            voltage, ffi.cast("GetISRCData *", voltage), self._sync(sync), ffi.NULL, pointer
        )

    def _source(self, source: int | Source | None) -> Any:
        if source is None:
            return self._no_source
        if not callable(source):
            return self.ffi.cast("GetVSRCData *", source)

        def answer(value: Any, time: float, name: Any, ident: int, user: Any) -> int:
            try:
                value[0] = source(self.ffi.string(name).decode().lower(), time)
            except BaseException as error:  # cffi would print and forget it
                self.failure = self.failure or error
                value[0] = 0.0
            return 0

        self._kept.append(self.ffi.callback("GetVSRCData", answer))
        return self._kept[-1]

    def _sync(self, sync: int | Sync | None) -> Any:
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
            return 0

        self._kept.append(self.ffi.callback("GetSyncData", answer))
        return self._kept[-1]

    def stop(self) -> None:
        """Ask the running analysis to stop at its next point; safe inside a callback."""
        self.api.ngSpice_Command(b"stop when time > -1")

    def _on_text(self, message: Any, ident: int, user: Any) -> int:
        text = self.ffi.string(message).decode("utf-8", "replace")
        reference = _REFERENCE.search(text)
        if reference:
            try:
                if self.on_time is not None:
                    self.on_time(float(reference[1]))
            except BaseException as error:
                self.failure = self.failure or error
                self.stop()
            return 0
        if text in self.lines[-2:]:  # a failing B-source repeats itself thousands of times
            return 0
        if len(self.lines) < _MOST_LINES:
            self.lines.append(text)
        if worth_quoting(text):
            self.recent.append(text.partition(" ")[2])
        return 0

    def _on_exit(self, status: int, immediate: bool, quitting: bool, ident: int, user: Any) -> int:
        self.exited = True
        return status

    def _on_init(self, info: Any, ident: int, user: Any) -> int:
        try:
            ffi = self.ffi
            self.vectors = [info.vecs[i].pdvec for i in range(info.veccount)]
            self.names = [ffi.string(info.vecs[i].vecname).decode().lower() for i in range(info.veccount)]
            if self.init is not None:
                self.init(list(self.names))
        except BaseException as error:
            self.failure = self.failure or error
            self.stop()
        return 0

    def _on_unanswered(self, value: Any, time: float, name: Any, ident: int, user: Any) -> int:
        source = self.ffi.string(name).decode()
        self.failure = self.failure or SimulationError(f"nothing answers the external source {source}")
        value[0] = 0.0
        return 0


_library: _Library | None = None


class Simulator:
    """One circuit in ngspice.

    A second `Simulator` in the same process takes over the library; the first one's circuit is gone.

    Parameters
    ----------
    on_time
        Called about four times a second of computation with the simulated time [s] (or the frequency)
        reached. What it raises stops the analysis and is raised by `command`.

    Raises
    ------
    InputError
        If libngspice is missing or older than `OLDEST_VERSION`.
    """

    def __init__(self, on_time: Callable[[float], None] | None = None) -> None:
        global _library
        if _library is None:
            _library = _Library()
        self._library = _library
        self._library.attach(None, None, None, None, None)
        self._library.on_time = on_time
        self._commands = 0
        self._deck: str | None = None
        self._loaded = False
        self.notes: deque[str] = deque(maxlen=1000)
        self._run("set nomoremode")

    @property
    def version(self) -> int:
        """Major version of ngspice."""
        return self._library.version

    def load(self, text: str, lines: "Sequence[Line]" = (), name: str | None = None) -> list[str]:
        """Load a flat deck in place of the one before.

        Parameters
        ----------
        text
            The deck; its first line is the title. A line ``*@ ngbehavior=psa`` selects ngspice's
            compatibility mode for the whole deck.
        lines
            Where the first lines of `text` come from (`Deck.lines`), so that ngspice's complaints name the
            user's file and line.
        name
            Name of the deck in errors.

        Returns
        -------
        list of str
            What ngspice printed, notes and warnings included.

        Raises
        ------
        InputError
            With ngspice's own words, when it does not accept the deck.
        """
        self._deck = name
        self._clear()
        behaviour = _BEHAVIOUR.search(text)
        self._run(f"set ngbehavior={behaviour[1]}" if behaviour else "unset ngbehavior")
        ffi, library = self._library.ffi, self._library
        rows = text.splitlines()
        if not any(row.strip().lower() == ".end" for row in rows):
            rows.append(".end")
        kept = [ffi.new("char[]", row.encode()) for row in rows]
        library.lines.clear()
        status = library.api.ngSpice_Circ(ffi.new("char *[]", [*kept, ffi.NULL]))
        said = self._said()
        if library.exited or status or any(is_error(line) for line in library.lines):
            raise InputError(load_problems(said, rows, lines))
        self._loaded = True
        self.notes.extend(said)
        return said

    def command(self, command: str) -> list[str]:
        """Run one ngspice command.

        Returns
        -------
        list of str
            The lines it printed on standard output; standard error's notes go to `notes`.

        Raises
        ------
        SimulationError
            With ngspice's own words, when it complains or the analysis was aborted.
        InputError
            When the circuit has no DC operating point or a floating node.
        BaseException
            What a Python callback raised during the command.
        """
        if not command.strip() or "\n" in command:
            raise ValueError(f"not one ngspice command: {command!r}")
        return self._run(command)

    def vector(self, name: str) -> NDArray[np.float64] | NDArray[np.complex128]:
        """Return a copy of a vector of the current plot (or of ``plot.name``).

        Raises
        ------
        InputError
            When there is no such vector.
        SimulationError
            When a value is not finite.
        """
        ffi, api = self._library.ffi, self._library.api
        self._alive()
        self._library.lines.clear()
        info = api.ngGet_Vec_Info(name.encode())
        if info == ffi.NULL:
            near = nearest(name, self.vector_names())
            hint = f"; nearest is {near}" if near else ""
            raise InputError(Problem(f"ngspice has no such vector{hint}", key=name))
        count = info.v_length
        values: NDArray[np.float64] | NDArray[np.complex128]
        if info.v_flags & 1:
            values = np.frombuffer(ffi.buffer(info.v_realdata, 8 * count), np.float64).copy()
        else:
            values = np.frombuffer(ffi.buffer(info.v_compdata, 16 * count), np.complex128).copy()
        if not np.isfinite(values).all():
            where = int(np.flatnonzero(~np.isfinite(values))[0])
            raise SimulationError(f"{name} is not a number at point {where} of {count}", deck=self._deck)
        return values

    def constant(self, name: str) -> float:
        """Return a design constant that the deck states by ``.csparam``."""
        return float(np.real(self.vector(f"const.{name.lower()}")[0]))

    def vector_names(self) -> list[str]:
        """Return the names of the vectors of the current plot, in lower case."""
        ffi, api = self._library.ffi, self._library.api
        rows = api.ngSpice_AllVecs(api.ngSpice_CurPlot())
        names: list[str] = []
        while rows != ffi.NULL and rows[len(names)] != ffi.NULL:
            names.append(ffi.string(rows[len(names)]).decode().lower())
        return names

    def attach(
        self,
        *,
        data: int | None = None,
        init: Init | None = None,
        source: int | Source | None = None,
        sync: int | Sync | None = None,
        user: int | None = None,
    ) -> None:
        """Set the callbacks of all later analyses; may be called before or after `load`.

        Whoever passes an address keeps the function and the memory at `user` alive.

        Parameters
        ----------
        data
            Address of a C function ``int (vecvaluesall *, int count, int ident, void *user)``, called at
            every accepted point.
        init
            Called with the vectors' names (lower case, in the order `data` gets them) before an analysis.
        source
            Address of ``int (double *value, double time, char *name, int ident, void *user)`` for voltage
            and current sources marked ``external``, or a Python function ``(name, time) -> value``.
        sync
            Address of ``int (double time, double *delta, double old, int redo, int ident, int loc, void
            *user)``, or a Python function ``(time, delta, old, redo, loc)`` returning a new delta or
            ``None``. What a Python function raises stops the analysis and is raised by `command`.
        user
            Address handed to every callback; ngspice has only one such pointer.
        """
        self._alive()
        self._library.attach(data, init, source, sync, user)

    def set_breakpoint_address(self) -> int:
        """Return the address of the C function ``bool ngSpice_SetBkpt(double time)``."""
        return self._address(self._library.api.ngSpice_SetBkpt)

    def command_address(self) -> int:
        """Return the address of ``int ngSpice_Command(char *)``, by which a callback stops a run."""
        return self._address(self._library.api.ngSpice_Command)

    def set_breakpoint(self, time_s: float) -> None:
        """Make the running or the next transient analysis land exactly on `time_s`."""
        if not math.isfinite(time_s) or not self._library.api.ngSpice_SetBkpt(time_s):
            raise SimulationError(f"ngspice refused the breakpoint {time_s!r}", deck=self._deck)

    def stop(self) -> None:
        """Stop the running analysis at its next point; for use inside callbacks.

        A compiled callback does the same by calling `command_address` with ``STOP_COMMAND``.
        """
        self._library.stop()

    def length_addresses(self) -> NDArray[np.int64]:
        """Return the addresses of the C ints that hold the length of each vector of the running analysis.

        ngspice keeps every point of every vector to the end of a run. A callback that writes 1 through these
        addresses now and then keeps its memory constant; `vector` then returns only the last points. Valid
        from `init` to the end of the analysis. The place of the field in ngspice's private structure is
        checked against what is known of a fresh vector; where it does not fit, the array is empty.
        """
        ffi = self._library.ffi
        addresses = [int(ffi.cast("intptr_t", vector)) for vector in self._library.vectors]
        for address, name in zip(addresses, self._library.names, strict=True):
            here = ffi.cast("char *", address)
            label = ffi.cast("char **", here)[0]
            if label == ffi.NULL or ffi.string(label).decode("utf-8", "replace").lower() != name:
                return np.empty(0, np.int64)
            length, allocated = ffi.cast("int *", here + _LENGTH_OFFSET)[0:2]
            if not 0 <= length <= allocated:
                return np.empty(0, np.int64)
        return np.array([address + _LENGTH_OFFSET for address in addresses], np.int64)

    def truncate_vectors(self) -> bool:
        """Forget all points of the running analysis but the last; ``False`` where that is not possible."""
        addresses = self.length_addresses()
        for address in addresses:
            field = self._library.ffi.cast("int *", int(address))
            field[0] = min(field[0], 1)
        return addresses.size > 0

    def _address(self, function: Any) -> int:
        return int(self._library.ffi.cast("intptr_t", function))

    def _said(self) -> list[str]:
        """Return the lines printed since the last command without the name of their stream."""
        return [line.partition(" ")[2] for line in self._library.lines]

    def _alive(self) -> None:
        if self._library.exited:
            raise SimulationError(
                "ngspice gave up on an earlier deck; this process cannot go on", deck=self._deck
            )

    def _clear(self) -> None:
        if self._loaded:
            self._loaded = False
            self._run("destroy all")
            self._run("remcirc")

    def _run(self, command: str) -> list[str]:
        self._alive()
        library = self._library
        self._commands += 1
        if self._commands % _HISTORY == 0:
            library.api.ngSpice_Command(library.ffi.NULL)
        library.lines.clear()
        library.recent.clear()
        library.failure = None
        status = library.api.ngSpice_Command(command.encode())
        if library.failure is not None:
            failure, library.failure = library.failure, None
            library.api.ngSpice_Command(b"delete all")
            raise failure
        floating = operating_point_problem(self._said())
        if floating:
            raise InputError(Problem(floating, file=self._deck))
        if library.exited or status or any(is_error(line) for line in library.lines):
            words = "\n".join(library.recent)
            raise SimulationError(
                f"ngspice could not carry out '{command}'", deck=self._deck, last_words=words
            )
        self.notes.extend(line.partition(" ")[2] for line in library.lines if line.startswith("stderr"))
        return [line.partition(" ")[2] for line in library.lines if not line.startswith("stderr")]


STOP_COMMAND = b"stop when time > -1\0"
"""What a compiled callback passes to `Simulator.command_address` to stop the analysis."""

_LENGTH_OFFSET = 56
"""Offset of ``v_length`` in ``struct dvec`` of ngspice 39 (src/include/ngspice/dvec.h), 64-bit."""
