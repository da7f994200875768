"""Calls by address from compiled code: ngspice's breakpoint setter, and Python where Python is asked for."""

from __future__ import annotations

from llvmlite import ir
from numba import carray, njit, types
from numba.core import types as numba_types
from numba.extending import intrinsic


@intrinsic
def call_plain(typing_context, address):
    """Call the C function `void f(void)` at an integer address."""

    def codegen(context, builder, signature, args):
        function = ir.FunctionType(ir.VoidType(), [])
        builder.call(builder.inttoptr(args[0], function.as_pointer()), [])
        return context.get_dummy_value()

    return types.void(numba_types.int64), codegen


@intrinsic
def call_with_time(typing_context, address, time):
    """Call the C function `int f(double)` at an integer address."""

    def codegen(context, builder, signature, args):
        function = ir.FunctionType(ir.IntType(32), [ir.DoubleType()])
        return builder.call(builder.inttoptr(args[0], function.as_pointer()), [args[1]])

    return types.int32(numba_types.int64, numba_types.float64), codegen


@intrinsic
def doubles_at(typing_context, address):
    """Pointer to doubles at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], context.get_value_type(types.CPointer(types.float64)))

    return types.CPointer(types.float64)(numba_types.int64), codegen


@intrinsic
def words_at(typing_context, address):
    """Pointer to 64-bit integers at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], context.get_value_type(types.CPointer(types.int64)))

    return types.CPointer(types.int64)(numba_types.int64), codegen


@njit(cache=True, inline="always")
def vector_value(vectors, index):
    """The real value of ngspice's `vecvalues[index]` (name pointer, real, imaginary, flags)."""
    entry = carray(words_at(vectors), (index + 1,))[index]
    return carray(doubles_at(entry), (2,))[1]
