"""ngspice behind a small face: load a deck, run commands, read vectors, attach callbacks.

The library keeps its state in globals: one circuit at a time, one simulator per process. For
isolation, which every run needs, use `cosim.ngspice.child`.
"""

import contextlib
import re
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import CosimError, InputError, SimulationError, StepTooSmall, fail, nearest
from cosim.ngspice.aliases import Aliases
from cosim.ngspice.allowed_commands import end_and_aim_s, spelled
from cosim.ngspice.dcpath import has_dc_path, in_voltage_loop
from cosim.ngspice.gate import admit
from cosim.ngspice.library import OLDEST_VERSION, STOP_COMMAND, Init, Source, Sync, opened
from cosim.ngspice.lines import Line
from cosim.ngspice.messages import (
    is_error,
    load_problems,
    operating_point_problem,
    step_problem,
    without_number,
)

__all__ = ["OLDEST_VERSION", "STOP_COMMAND", "Simulator"]

_CSPARAM = re.compile(r"^\s*\.csparam\s+([^\s=]+)", re.MULTILINE | re.IGNORECASE)
_STOP = re.compile(r"^\s*(\d+)\s+stop\b", re.IGNORECASE)
_HISTORY = 1000
"""Commands after which ngspice must forget them: it would keep every one."""

_LENGTH_OFFSET = 56
"""Offset of ``v_length`` in ``struct dvec`` of ngspice 39 (src/include/ngspice/dvec.h), 64-bit."""

_NO_LAST_RESORT = "optran 1 1 1 0 0 0"
"""Keeps ngspice from its last resort where it finds no operating point: a transient from zero, which may
never end (nothing can interrupt it), and if it fails the next analysis crashes. Others are tried instead."""


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
        self._library = opened()
        self._library.attach(None, None, None, None, None)
        self._library.on_time = on_time
        self._aliases = Aliases()
        self._library.restore = self._aliases.restore
        self._commands = 0
        self._deck: str | None = None
        self._rows: list[str] = []
        self._constants: list[str] = []
        self.notes: deque[str] = deque(maxlen=1000)
        self._run("set nomoremode")
        self._run(_NO_LAST_RESORT)

    @property
    def version(self) -> int:
        """Major version of ngspice."""
        return self._library.version

    def load(self, text: str, lines: Sequence[Line] = (), name: str | None = None) -> list[str]:
        """Load a flat deck in place of the one before.

        Parameters
        ----------
        text
            The deck; its first line is the title. A line ``*@ ngbehavior=psa`` selects ngspice's
            compatibility mode for the whole deck. It is judged, and its names get aliases, by
            `cosim.ngspice.gate.admit`; vectors and commands are asked for by the deck's own names.
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
            When it holds what no deck may, or, in ngspice's words, when ngspice does not accept it.
        """
        self._deck = name
        written = text.rstrip("\n").split("\n")
        deck = admit(written, lines)
        self._clear()
        self._aliases = deck.aliases
        library = self._library
        library.restore = deck.aliases.restore
        self._run(f"set ngbehavior={deck.behaviour}" if deck.behaviour else "unset ngbehavior")
        self._run("setplot const")  # where `.csparam` lines land: ngspice writes them to the current plot
        ffi = library.ffi
        self._rows = written
        kept = [ffi.new("char[]", row.encode()) for row in deck.rows]
        library.lines.clear()
        status = library.api.ngSpice_Circ(ffi.new("char *[]", [*kept, ffi.NULL]))
        output = self._output()
        if library.exited or status or any(is_error(line) for line in library.lines):
            raise InputError(load_problems(output, written, lines))
        library.loaded = True
        self._constants = [name.lower() for name in _CSPARAM.findall(text)]
        self.notes.extend(output)
        return output

    def command(self, command: str) -> list[str]:
        """Run one of the ngspice commands that `allowed_commands` lists, with the deck's own names.

        Returns
        -------
        list of str
            The lines it printed on standard output; standard error's notes go to `notes`.

        Raises
        ------
        SimulationError
            With ngspice's own words, when it complains or the analysis was aborted.
        InputError
            When the circuit has no DC operating point, a floating node, or no element of that name.
        ValueError
            For what is not one of these commands.
        BaseException
            What a Python callback raised during the command.
        """
        return self._run(spelled(command, self._aliases), command)

    def vector(self, name: str) -> NDArray[np.float64] | NDArray[np.complex128]:
        """Return a copy of a vector of the current plot (or of ``plot.name``).

        Raises
        ------
        InputError
            When there is no such vector.
        SimulationError
            When a value is not finite.
        """
        values = self._peek(name).copy()
        self._refuse_non_numbers(values, [name])
        return values

    def vectors(self, names: Sequence[str]) -> NDArray[np.complex128]:
        """Return vectors of one length as columns; see `vector`."""
        values = np.stack([self._peek(name) for name in names], axis=1).astype(complex)
        self._refuse_non_numbers(values, names)
        return values

    def _peek(self, name: str) -> NDArray[Any]:
        """Return a vector in ngspice's own memory, gone with the next command."""
        ffi, api = self._library.ffi, self._library.api
        self._alive()
        self._library.lines.clear()
        alias = self._aliases.vector(name)
        info = ffi.NULL if alias is None else api.ngGet_Vec_Info(alias.encode())
        if info == ffi.NULL:
            near = nearest(name, self.vector_names())
            hint = f"; nearest is {near}" if near else ""
            fail(f"ngspice has no such vector{hint}", key=name)
        count = info.v_length
        if info.v_flags & 1:
            return np.frombuffer(ffi.buffer(info.v_realdata, 8 * count), np.float64)
        return np.frombuffer(ffi.buffer(info.v_compdata, 16 * count), np.complex128)

    def _refuse_non_numbers(self, values: NDArray[Any], names: Sequence[str]) -> None:
        if not np.isfinite(values).all():
            where = np.argwhere(~np.isfinite(values))[0]
            name = names[where[1]] if len(where) > 1 else names[0]
            place = f"at point {where[0]} of {len(values)}"
            raise SimulationError(
                f"{name} is not a number {place}{without_number(self._rows)}", deck=self._deck
            )

    def constant(self, name: str) -> float:
        """Return a design constant that the deck states by ``.csparam``.

        Raises
        ------
        InputError
            When the deck states no such constant.
        """
        if name.lower() not in self._constants:  # ngspice would still know that of an earlier deck
            near = nearest(name, self._constants)
            hint = f", nearest is {near}" if near else ""
            fail(f"the board states no such .csparam{hint}", file=self._deck, key=name)
        return float(np.real(self.vector(f"const.{name.lower()}")[0]))

    def constants(self) -> dict[str, float]:
        """Return every design constant that the deck states by ``.csparam`` as a finite number."""
        values = {}
        for name in self._constants:
            with contextlib.suppress(CosimError):
                values[name] = self.constant(name)
        return values

    def vector_names(self) -> list[str]:
        """Return the names of the vectors of the current plot, in lower case."""
        ffi, api = self._library.ffi, self._library.api
        rows = api.ngSpice_AllVecs(api.ngSpice_CurPlot())
        names: list[str] = []
        while rows != ffi.NULL and rows[len(names)] != ffi.NULL:
            names.append(self._aliases.restore(ffi.string(rows[len(names)]).decode().lower()))
        return names

    def called(self, element: str) -> str:
        """Return what ngspice calls an element of the deck: so a compiled callback hears of a source.

        Raises
        ------
        InputError
            When the deck has no such element.
        """
        path = self._aliases.element_path(element)
        if path is None:
            fail("the circuit has no such element", file=self._deck, key=element)
        return path

    def attach(
        self,
        *,
        data: int | None = None,
        init: Init | None = None,
        source: int | Source | None = None,
        sync: int | Sync | None = None,
        user: int | None = None,
        data_stays: bool = False,
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
        data_stays
            `data` stays in the library, also for a later `Simulator` or where a later `attach` names none:
            it lives as long as the process and returns at once when the first 8 bytes at `user` are zero,
            as they are when no `user` is given. Changing `data` slows ngspice down a little each time.
        """
        self._alive()
        self._library.attach(data, init, source, sync, user, data_stays)

    def set_breakpoint_address(self) -> int:
        """Return the address of the C function ``bool ngSpice_SetBkpt(double time)``."""
        return self._address(self._library.api.ngSpice_SetBkpt)

    def command_address(self) -> int:
        """Return the address of ``int ngSpice_Command(char *)``, by which a callback stops a run."""
        return self._address(self._library.api.ngSpice_Command)

    def stop(self) -> None:
        """Stop the running analysis at its next point; for use inside callbacks.

        A compiled callback does the same by calling `command_address` with `STOP_COMMAND`.
        """
        self._library.stop()

    def length_addresses(self) -> NDArray[np.int64]:
        """Return the addresses of the C ints that hold the length of each vector of the running analysis.

        ngspice keeps every point of every vector to the end of a run. A callback that writes 1 through these
        addresses now and then keeps its memory constant; `vector` returns nothing afterwards. Valid
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

    def _output(self) -> list[str]:
        """Return the lines printed since the last command without the name of their stream."""
        return [line.partition(" ")[2] for line in self._library.lines]

    def _alive(self) -> None:
        if self._library.exited:
            raise SimulationError(
                "ngspice gave up on an earlier deck; this process cannot go on", deck=self._deck
            )

    def _clear(self) -> None:
        if self._library.loaded:  # by whichever simulator; every old plot would slow each point of a run
            self._library.loaded = False
            self._run("delete all")  # what `.save` and `stop` have set: it would stay in force
            self._run("destroy all")
            self._run("remcirc")

    def _run(self, command: str, shown: str | None = None) -> list[str]:
        """Run a command as it is; errors name it as it was `shown`."""
        self._alive()
        library = self._library
        self._commands += 1
        if self._commands % _HISTORY == 0:
            library.api.ngSpice_Command(library.ffi.NULL)
        library.lines.clear()
        library.recent.clear()
        library.failure = None
        library.end_s, library.aim_s = end_and_aim_s(command)
        status = library.api.ngSpice_Command(command.encode())
        if library.failure is not None:
            failure, library.failure = library.failure, None
            self._forget_stops()
            raise failure
        if not (library.lines or status or library.exited):
            return []
        output = self._output()
        problem = self._without_operating_point(output)
        if problem is not None:
            raise problem
        if library.exited or status or any(is_error(line) for line in library.lines):
            words = "\n".join(library.recent)
            self._forget_stops()
            short = step_problem(output)
            if short is not None:
                raise StepTooSmall(short[0], deck=self._deck, time_s=short[1], last_words=words)
            what = f"ngspice could not carry out '{shown or command}'"
            raise SimulationError(what, deck=self._deck, last_words=words)
        rows = list(library.lines)
        self.notes.extend(row.partition(" ")[2] for row in rows if row.startswith("stderr"))
        return [row.partition(" ")[2] for row in rows if not row.startswith("stderr")]

    def _without_operating_point(self, output: list[str]) -> CosimError | None:
        if any(row.endswith("simulation interrupted") for row in output):
            return None  # a stopped analysis may repeat an error of an earlier one
        return operating_point_problem(
            output,
            lambda node: has_dc_path(self._rows, node),
            lambda element: in_voltage_loop(self._rows, element),
            file=self._deck,
        )

    def _forget_stops(self) -> None:
        """Remove the stop conditions, or the next analysis would stop as well."""
        library = self._library
        if library.exited:
            return
        library.lines.clear()
        library.api.ngSpice_Command(b"status")
        for line in self._output():
            match = _STOP.match(line)
            if match:
                library.api.ngSpice_Command(f"delete {match[1]}".encode())
