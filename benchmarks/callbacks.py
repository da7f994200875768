"""What the compiled callbacks of a run cost: every call of the run is logged, then repeated without ngspice.

The log holds each call in order with its arguments, and the values ngspice handed over. Repeating it on a
fresh copy of the state does all the work of the run's callbacks - predictor, linkage, samples, rows, files -
and must end in the same state to the last bit. What the loop itself costs is found with empty callbacks
and subtracted.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from typing import Any
from unittest.mock import patch

import numba
import numpy as np
from llvmlite import ir
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from benchmarks.rig import lockstep
from benchmarks.vectors import vector_value
from cosim.loop.setup import Memory, pack
from cosim.loop.spice import run_spice as simulation
from cosim.ngspice.simulator import Simulator
from cosim.plan import Plan
from mech.numba_calls import doubles_at

_f8, _i4, _i8, _u1 = types.float64, types.int32, types.int64, types.uint8
_DOUBLE, _INT, _LONG = ir.DoubleType(), ir.IntType(32), ir.IntType(64)
#: Columns of the log: callback (0 source, 1 sync, 2 data), time, source's number or location, delta, redo.
_WIDTH = 5
_LOG = np.dtype(
    [
        ("user", "i8"),
        ("source", "i8"),
        ("sync", "i8"),
        ("data", "i8"),
        ("calls", "i8"),
        ("used", "i8"),
        ("values", "i8"),
        ("points", "i8"),
        ("vectors", "i8"),
    ],
    align=True,
)
_log = numba.from_dtype(_LOG)


def _caller(answer: Any, *given: Any) -> Any:
    """Make an intrinsic that calls a C function at an address; integers of 64 bits are pointers."""
    native = {types.float64: _DOUBLE, types.int32: _INT, types.int64: _LONG}

    def call(typing_context: Any, address: Any, arguments: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            function = ir.FunctionType(_INT, [native[kind] for kind in given])
            values = [builder.extract_value(args[1], i) for i in range(len(given))]
            return builder.call(builder.inttoptr(args[0], function.as_pointer()), values)

        return answer(types.int64, types.Tuple(given)), codegen

    return intrinsic(call)


_I, _L, _D = types.int32, types.int64, types.float64
_call_source = _caller(_I, _L, _D, _L, _I, _L)
_call_sync = _caller(_I, _D, _L, _D, _I, _I, _I, _L)
_call_data = _caller(_I, _L, _I, _I, _L)


def _address(typing_context: Any, pointer: Any) -> Any:
    """Integer address of a pointer."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ptrtoint(args[0], _LONG)

    return types.int64(pointer), codegen


address_of: Any = intrinsic(_address)


@njit
def _note(log: Any, kind: float, t: float, which: float, delta: float, redo: float) -> None:
    row = carray(doubles_at(log.calls + 8 * _WIDTH * log.used), (_WIDTH,))
    row[0], row[1], row[2], row[3], row[4] = kind, t, which, delta, redo
    log.used += 1


@cfunc(_i4(types.CPointer(_f8), _f8, types.CPointer(_u1), _i4, types.CPointer(_log)))
def _source(voltage: Any, t: float, name: Any, ident: int, user: Any) -> int:
    log = carray(user, 1)[0]
    digits = carray(name, 3)
    _note(log, 0.0, t, (digits[1] - 48) * 10 + digits[2] - 48, 0.0, 0.0)
    answer: int = _call_source(log.source, (address_of(voltage), t, address_of(name), ident, log.user))
    return answer


@cfunc(_i4(_f8, types.CPointer(_f8), _f8, _i4, _i4, _i4, types.CPointer(_log)))
def _sync(t: float, delta: Any, old: float, redo: int, ident: int, where: int, user: Any) -> int:
    log = carray(user, 1)[0]
    _note(log, 1.0, t, where, delta[0], redo)
    answer: int = _call_sync(log.sync, (t, address_of(delta), old, redo, ident, where, log.user))
    return answer


@cfunc(_i4(types.CPointer(_i8), _i4, _i4, types.CPointer(_log)))
def _data(data: Any, count: int, ident: int, user: Any) -> int:
    log = carray(user, 1)[0]
    _note(log, 2.0, 0.0, 0.0, 0.0, 0.0)
    log.vectors = count
    row = carray(doubles_at(log.values + 8 * count * log.points), (count,))
    entries = carray(data, (2,))[1]
    for i in range(count):
        row[i] = vector_value(entries, i)
    log.points += 1
    answer: int = _call_data(log.data, (address_of(data), count, ident, log.user))
    return answer


@cfunc(_i4(types.CPointer(_f8), _f8, types.CPointer(_u1), _i4, types.CPointer(_u1)))
def _no_source(voltage: Any, t: float, name: Any, ident: int, user: Any) -> int:
    return 0


#: End of the analysis [s] that `NO_SYNC` takes part in: ngspice 44 cuts a step beyond it just short of it,
#: then finds its step too small.
END = np.array([np.inf])
_END_AT = END.ctypes.data


@cfunc(_i4(_f8, types.CPointer(_f8), _f8, _i4, _i4, _i4, types.CPointer(_u1)))
def _no_sync(t: float, delta: Any, old: float, redo: int, ident: int, where: int, user: Any) -> int:
    end, step = carray(doubles_at(_END_AT), (1,))[0], carray(delta, (1,))
    if t < end < t + step[0]:
        step[0] = end - t
        while t + step[0] > end:  # the sum is rounded
            step[0] *= 1.0 - 2.3e-16
    return 0


@cfunc(_i4(types.CPointer(_i8), _i4, _i4, types.CPointer(_u1)))
def _no_data(data: Any, count: int, ident: int, user: Any) -> int:
    return 0


#: Addresses of empty callbacks, for runs that need none: the simulator's own defaults are Python.
NO_SYNC, NO_DATA = _no_sync.address, _no_data.address


@cfunc(_i4(_f8))
def _no_breakpoint(t: float) -> int:
    return 1


@njit
def _repeat(
    calls: Any,
    values: Any,
    entries: Any,
    all_address: int,
    names: Any,
    source: int,
    sync: int,
    data: int,
    user: int,
) -> float:
    """Make all calls of a log again. `entries` [vectors, 4] are ngspice's vecvalues as doubles."""
    slot = np.zeros(1)
    slot_address = slot.ctypes.data
    point = 0
    total = 0.0
    for k in range(len(calls)):
        kind = calls[k, 0]
        if kind == 0.0:
            name = names.ctypes.data + 4 * np.int64(calls[k, 2])
            _call_source(source, (slot_address, calls[k, 1], name, np.int32(0), user))
            total += slot[0]
        elif kind == 1.0:
            slot[0] = calls[k, 3]
            where, redo = np.int32(calls[k, 2]), np.int32(calls[k, 4])
            _call_sync(sync, (calls[k, 1], slot_address, 0.0, redo, np.int32(0), where, user))
            total += slot[0]
        else:
            for i in range(len(entries)):
                entries[i, 1] = values[point, i]
            point += 1
            _call_data(data, (all_address, np.int32(len(entries)), np.int32(0), user))
    return total


class CallLog:
    """All callbacks of one run of a plan, ready to be repeated.

    Parameters
    ----------
    plan
        A scene without noise or a Python law.
    points
        Room for so many time points.
    """

    def __init__(self, plan: Plan, points: int = 20_000) -> None:
        calls, values = np.zeros((points * 60, _WIDTH)), np.zeros(points * 128)
        log = np.zeros(1, _LOG)
        log["calls"], log["values"] = calls.ctypes.data, values.ctypes.data
        memories: list[Memory] = []

        def packed(*given: Any, **named: Any) -> Memory:
            memories.append(pack(*given, **named))
            return memories[-1]

        def begun() -> None:
            self.before = memories[0].state.copy()

        class Logging(Simulator):
            """Puts the log between ngspice and the callbacks of a run."""

            def attach(self, **given: Any) -> None:
                if not isinstance(given.get("data"), int):
                    return super().attach(**given)
                for name in ("source", "sync", "data", "user"):
                    log[name] = given[name]
                wanted = given["init"]

                def init(names: list[str]) -> None:
                    wanted(names)
                    begun()

                super().attach(
                    data=_data.address,
                    init=init,
                    source=_source.address,
                    sync=_sync.address,
                    user=log.ctypes.data,
                )

        with patch.object(simulation, "Simulator", Logging), patch.object(simulation, "pack", packed):
            lockstep(plan)
        self.memory = memories[0]
        self.after = self.memory.state.copy()
        used, width = int(log["used"][0]), int(log["vectors"][0])
        self.points = int(log["points"][0])
        if used > len(calls) or self.points * width > len(values):
            raise RuntimeError("the log was too short for the run")
        self.calls = calls[:used].copy()
        self.values: NDArray[np.float64] = values[: self.points * width].reshape(-1, width).copy()
        self.targets = [int(log[name][0]) for name in ("source", "sync", "data")]
        self._build(width)
        self._sink = tempfile.TemporaryFile()
        self._drain = ctypes.CFUNCTYPE(None)(self._write)

    def _write(self) -> None:
        """Write the buffers to a file, as the run's recorder does."""
        state = self.memory.state[0]
        self._sink.seek(0)
        for buffer, kind in ((self.memory.rows, "rows"), (self.memory.samples, "samples")):
            self._sink.write(buffer[: state[kind]["used"]].data)
            state[kind]["used"] = 0

    def _build(self, width: int) -> None:
        """Lay out ngspice's `vecvaluesall` {count, index, vecvalues **} and the sources' names."""
        self._entries = np.zeros((width, 4))
        pointers = self._entries.ctypes.data + self._entries.strides[0] * np.arange(width)
        self._pointers = pointers.astype(np.int64)
        self._all = np.array([width, self._pointers.ctypes.data], np.int64)
        text = b"".join(f"v{k:02d}\0".encode() for k in range(100))
        self._names = np.frombuffer(text, np.uint8).copy()

    def seconds(self, *, empty: bool = False) -> float:
        """Repeat all calls and return the time [s]; with `empty` callbacks, what the loop costs."""
        state = self.memory.state
        state[:] = self.before
        state["breakpoint_address"] = _no_breakpoint.address
        state["drain_address"] = ctypes.cast(self._drain, ctypes.c_void_p).value
        nothing = (_no_source.address, _no_sync.address, _no_data.address)
        begun = time.perf_counter()
        _repeat(
            self.calls,
            self.values,
            self._entries,
            self._all.ctypes.data,
            self._names,
            *(nothing if empty else self.targets),
            state.ctypes.data,
        )
        elapsed = time.perf_counter() - begun
        if not empty:
            self._check()
        return elapsed

    def _check(self) -> None:
        """Make sure that the same work was done: the state ends where that of the run ended."""
        ended, wanted = self.memory.state[0], self.after[0]
        pairs = {name: (ended[name], wanted[name]) for name in ("t", "q", "v", "a", "points", "defect_sum")}
        pairs["tick"] = (ended["clock"]["tick"], wanted["clock"]["tick"])
        for name, (got, run) in pairs.items():
            if not np.array_equal(got, run):
                raise RuntimeError(f"the repeated calls ended elsewhere: {name}")

    def parts(self) -> dict[str, int]:
        """Count the calls of each callback."""
        kinds = self.calls[:, 0]
        return {
            "source": int((kinds == 0).sum()),
            "synchronise": int((kinds == 1).sum()),
            "accepted": int((kinds == 2).sum()),
        }
