"""Calls by address from compiled code: ngspice's breakpoint setter, and Python where Python is asked for."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import carray, njit, types
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
def _borrowed(typing_context: Any, record: Any) -> Any:
    """Return the same named tuple, its arrays without their reference counts."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        value = args[0]
        for at, kind in enumerate(signature.return_type.types):
            if isinstance(kind, numba_types.Array):
                array = context.make_array(kind)(context, builder, builder.extract_value(value, at))
                array.meminfo = ir.Constant(array.meminfo.type, None)
                array.parent = ir.Constant(array.parent.type, None)
                value = builder.insert_value(value, array._getvalue(), at)
        return value

    return record(record), codegen


# An intrinsic's first parameter is the compiler's own: callers see it without.
#: Tuples of arrays handed from function to function count references at every call: atomic, and dearer than
#: a step. Whoever holds the arrays for the whole call can lend them instead.
borrowed: Any = _borrowed
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
