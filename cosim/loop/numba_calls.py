"""Calls by address from compiled code: ngspice's breakpoint setter, and Python where Python is asked for."""

from __future__ import annotations

import functools
import typing
from typing import Any

import numba.core.cgutils
import numpy as np
from llvmlite import ir
from numba import carray, from_dtype, njit, types
from numba.core import types as numba_types
from numba.extending import intrinsic


@intrinsic
def _call_plain(typing_context: Any, address: Any) -> Any:
    """Call the C function `void f(void)` at an integer address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = ir.FunctionType(ir.VoidType(), [])
        builder.call(builder.inttoptr(args[0], function.as_pointer()), [])
        return context.get_dummy_value()

    return types.void(numba_types.int64), codegen


@intrinsic
def _call_with_time(typing_context: Any, address: Any, time: Any) -> Any:
    """Call the C function `int f(double)` at an integer address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = ir.FunctionType(ir.IntType(32), [ir.DoubleType()])
        return builder.call(builder.inttoptr(args[0], function.as_pointer()), [args[1]])

    return types.int32(numba_types.int64, numba_types.float64), codegen


@intrinsic
def _doubles_at(typing_context: Any, address: Any) -> Any:
    """Pointer to doubles at an integer address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(types.CPointer(types.float64)))

    return types.CPointer(types.float64)(numba_types.int64), codegen


@intrinsic
def _words_at(typing_context: Any, address: Any) -> Any:
    """Pointer to 64-bit integers at an integer address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(types.CPointer(types.int64)))

    return types.CPointer(types.int64)(numba_types.int64), codegen


@intrinsic
def _record_at(typing_context: Any, address: Any, kind: Any) -> Any:
    """Pointer to a record of the type `kind` at an integer address."""
    pointer = types.CPointer(kind.instance_type)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(pointer))

    return pointer(numba_types.int64, kind), codegen


@intrinsic
def _lent(typing_context: Any, address: Any, kind: Any) -> Any:
    """Build the named tuple of the type `kind` from its table (`table`) at an integer address."""
    result = kind.instance_type

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        table = builder.inttoptr(args[0], word.as_pointer())
        at = 0

        def next_word() -> Any:
            nonlocal at
            at += 1
            return builder.load(builder.gep(table, [ir.Constant(word, at - 1)]))

        values = []
        for item in result.types:
            first = next_word()
            if isinstance(item, numba_types.Float):
                values.append(builder.bitcast(first, ir.DoubleType()))
            elif isinstance(item, numba_types.Integer):
                values.append(first)
            else:
                array = context.make_array(item)(context, builder)
                lengths = [next_word() for _ in range(item.ndim)]
                size = context.get_abi_sizeof(context.get_data_type(item.dtype))
                stride = ir.Constant(word, size)
                strides: list[Any] = []
                for length in reversed(lengths):
                    strides.insert(0, stride)
                    stride = builder.mul(stride, length)
                array.data = builder.inttoptr(first, array.data.type)
                array.shape = numba.core.cgutils.pack_array(builder, lengths)
                array.strides = numba.core.cgutils.pack_array(builder, strides)
                array.itemsize = ir.Constant(word, size)
                count = ir.Constant(word, 1)
                for length in lengths:
                    count = builder.mul(count, length)
                array.nitems = count
                array.meminfo = ir.Constant(array.meminfo.type, None)
                array.parent = ir.Constant(array.parent.type, None)
                values.append(array._getvalue())
        return context.make_tuple(builder, result, values)

    return result(numba_types.int64, kind), codegen


def kind_of(cls: Any) -> Any:
    """Return numba's type of a named tuple of numbers and `Annotated[NDArray[...], dimensions]`."""
    found = []
    for hint in typing.get_type_hints(cls, include_extras=True).values():
        if hint in (int, float):
            found.append(types.int64 if hint is int else types.float64)
        else:
            array, dimensions = typing.get_args(hint)
            found.append(types.Array(from_dtype(np.dtype(_element(array))), dimensions, "C"))
    return types.NamedTuple(found, cls)


def _element(hint: Any) -> type[np.generic]:
    """Return the scalar type that `NDArray[...]` names.

    How deep it lies is numpy's own affair: `ndarray[shape, dtype[float64]]` where the alias is expanded,
    `NDArray[float64]` where it is one of the language (Python 3.12 with numpy 2.5).
    """
    waiting = [hint]
    for part in waiting:
        if isinstance(part, type) and issubclass(part, np.generic):
            return part
        waiting += typing.get_args(part)
    raise TypeError(f"{hint} names no element of an array")


def table(record: Any) -> Any:
    """Return a named tuple of numbers and arrays as 64-bit words: numbers, addresses and lengths.

    Compiled code gets a tuple of arrays field by field, at half a microsecond each; of a table it gets one
    address (`lent`). The tuple must live as long as the table is used.
    """
    words: list[int] = []
    kind: Any = type(record)
    floats = _floats(kind)
    for name, value in zip(record._fields, record, strict=True):
        if isinstance(value, np.ndarray):
            if not value.flags.c_contiguous:
                raise ValueError("only contiguous arrays have an address and lengths")
            words += [value.ctypes.data, *value.shape]
        elif name in floats:
            words.append(int(np.float64(value).view(np.int64)))
        else:
            words.append(int(value))
    return np.array(words, np.int64)


@functools.cache
def _floats(cls: Any) -> frozenset[str]:
    """Return the names of a named tuple's numbers that are no integers."""
    return frozenset(name for name, hint in typing.get_type_hints(cls).items() if hint is float)


# An intrinsic's first parameter is the compiler's own: callers see it without.
#: Lent arrays carry no reference counts: counting at every call is atomic, and costs more than a step.
lent: Any = _lent
record_at: Any = _record_at
call_plain: Any = _call_plain
call_with_time: Any = _call_with_time
doubles_at: Any = _doubles_at
words_at: Any = _words_at


@njit(cache=True, inline="always")
def vector_value(vectors: Any, index: int) -> float:
    """Read the real value of ngspice's `vecvalues[index]` (name pointer, real, imaginary, flags)."""
    entry = carray(words_at(vectors), (index + 1,))[index]
    value: float = carray(doubles_at(entry), (2,))[1]
    return value


@njit(cache=True, error_model="numpy")
def name_hash(letters: Any, count: int) -> int:
    """Return a number for the first `count` letters of a name, or for those before its end."""
    found = 0
    for i in range(count):
        if letters[i] == 0:
            break
        found = (found * 257 + letters[i]) % 9007199254740881  # the largest prime below 2^53
    return found
