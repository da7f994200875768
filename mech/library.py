"""Libraries of compiled code, as Python calls them. Nothing is compiled here, and no compiler imported."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mech.kinds import ArrayOf, table
from mech.library_files import file_of, library_of, ready, unpack

__all__ = ["Callback", "Entry", "callback", "entry", "inner", "load", "symbol"]


def inner(function: Any) -> Any:
    """Return what stands for a function that compiled code alone calls."""

    @functools.wraps(function)
    def refuse(*arguments: Any) -> Any:
        raise TypeError(f"{function.__module__}.{function.__name__} is called by compiled code alone")

    return refuse


def entry(*kinds: Any, result: Any = None, how: Any = None) -> Callable[[Any], Entry]:
    """Mark a function that Python calls (`mech.compiled`); `result`: kind of what it returns, or several."""
    return lambda function: Entry(function, kinds, result)


def callback(*kinds: Any) -> Callable[[Any], Callback]:
    """Mark a function that C calls, and nobody else."""
    return Callback


class Callback:
    """A compiled function that C calls."""

    def __init__(self, function: Any) -> None:
        self._name = (library_of(function.__module__), function.__module__, function.__name__)

    @functools.cached_property
    def address(self) -> int:
        """Where it is."""
        return _address(*self._name)


class Entry:
    """A compiled function that Python calls.

    Raises
    ------
    TypeError
        When an argument is of another kind than it takes.
    MemoryError
        When the compiled code had no memory.
    """

    def __init__(self, function: Any, kinds: Sequence[Any], result: Any) -> None:
        functools.update_wrapper(self, function)
        self._kinds, self._result = kinds, result
        self._name = (library_of(function.__module__), function.__module__, function.__name__)

    def __call__(self, *arguments: Any) -> Any:
        """Call it."""
        words: list[Any] = []
        kept: list[Any] = []
        for kind, argument in zip(self._kinds, arguments, strict=True):
            _lower(kind, argument, words, kept)
        if self._result is None:
            if self._function(*words, 0):
                raise MemoryError(self._name[2])
            return None
        several = isinstance(self._result, tuple)
        kind = self._result[0] if several else self._result
        out = (
            (ctypes.c_double if kind is float else ctypes.c_int64) * (len(self._result) if several else 1)
        )()
        if self._function(*words, ctypes.addressof(out)):
            raise MemoryError(self._name[2])
        return tuple(out) if several else kind(out[0])

    @functools.cached_property
    def _function(self) -> Any:
        numbers: list[Any] = []
        for kind in self._kinds:
            count = kind.dimensions + 1 if isinstance(kind, ArrayOf) else 2 if kind is complex else 1
            numbers += [ctypes.c_double if kind in (float, complex) else ctypes.c_int64] * count
        # callbacks into Python need the interpreter, which the call keeps
        return ctypes.PYFUNCTYPE(ctypes.c_int32, *numbers, ctypes.c_int64)(_address(*self._name))


def _lower(kind: Any, argument: Any, words: list[Any], kept: list[Any]) -> None:
    """Append an argument as numbers and addresses; `kept` holds what must live until the call returns."""
    if kind is float or kind is int or kind is bool:
        words.append(kind(argument))
    elif kind is complex:
        words += [argument.real, argument.imag]
    elif isinstance(kind, ArrayOf):
        if (
            argument.dtype != kind.element
            or argument.ndim != kind.dimensions
            or not argument.flags.c_contiguous
        ):
            raise TypeError(f"not a contiguous array of {kind.dimensions} dimensions of {kind.element}")
        words += [argument.__array_interface__["data"][0], *argument.shape]
    elif isinstance(kind, np.dtype):
        if argument.dtype != kind or argument.shape:
            raise TypeError("not one record of the structured type")
        # as an array: a record's own interface describes all its fields, which takes a millisecond
        words.append(argument.reshape(1).ctypes.data)
    else:
        kept.append(table(argument))
        words.append(kept[-1].ctypes.data)


def symbol(module: str, name: str) -> str:
    """Return the name under which a library offers a function."""
    return f"{module}.{name}"


@functools.cache
def _engine() -> Any:
    """Return what loads object code: a part of LLVM that compiles nothing here."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    llvm.add_symbol("numba_ldexp", ctypes.cast(ctypes.CDLL(None).ldexp, ctypes.c_void_p).value)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


@functools.cache
def _loaded(package: str) -> Any:
    """Return the engine once it holds a package's library, which is built where it is not there."""
    import llvmlite.binding as llvm

    code = unpack(file_of(package))
    if code is None:
        ready()
        code = unpack(file_of(package))
    if code is None:
        raise RuntimeError(f"{file_of(package)} was removed while it was read")
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def load(package: str) -> None:
    """Load a package's library now, where it is there: a process that waits has the time."""
    if unpack(file_of(package)) is not None:
        _loaded(package)


def _address(package: str, module: str, name: str) -> int:
    return int(_loaded(package).get_function_address(symbol(module, name)))
