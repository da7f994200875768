"""Compiled functions as numba sees them, where libraries are built: marks, and calls by address."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba.core.cgutils
import numpy as np
from llvmlite import ir
from numba import carray, from_dtype, njit, types
from numba.core import types as numba_types
from numba.extending import intrinsic

from mech.kinds import ArrayOf, PointerTo
from mech.numba_tables import element_type, kind_of, lent

__all__ = [
    "EXPORTS",
    "Export",
    "call_force",
    "call_plain",
    "call_with_time",
    "callback",
    "carray",
    "doubles_at",
    "entry",
    "inner",
    "inner_inlined",
    "inner_spliced",
    "kind_of",
    "lent",
    "record_at",
    "words_at",
]

_ALONE: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
#: Stated, because numba lets what is first met in a function copied so be copied so as well: with all that it
#: calls, and depending on the order of calls.
inner: Any = njit(forceinline=False, **_ALONE)
#: The same, copied by LLVM to where it is called.
inner_inlined: Any = njit(forceinline=True, **_ALONE)
#: The same, copied before types are inferred.
inner_spliced: Any = njit(inline="always", forceinline=False, **_ALONE)


class Export(NamedTuple):
    """A compiled function that a library offers under its name."""

    name: str
    module: str
    compiled: Any
    signature: Any


#: What the libraries of the modules imported so far will offer.
EXPORTS: list[Export] = []


def entry(*kinds: Any, result: Any = None, how: Any = None) -> Callable[[Any], Any]:
    """Mark a function that Python calls; compiled code calls it as any other.

    The library offers it with arguments that are numbers or addresses: arrays with their lengths, and
    at the end where the result goes.
    """

    def mark(function: Any) -> Any:
        compiled = (how or inner)(function)
        names, argument_types, values = [], [], []
        space: dict[str, Any] = {
            "carray": carray, "record_at": record_at, "lent": lent, "function": compiled
        }  # fmt: skip
        for i, kind in enumerate(kinds):
            place, more = f"a{i}", []
            if kind is float or kind is int or kind is bool:
                values.append(f"{place} != 0" if kind is bool else place)
            elif kind is complex:
                more = [f"{place}i"]
                values.append(f"complex({place}, {place}i)")
            elif isinstance(kind, ArrayOf):
                more = [f"{place}n{k}" for k in range(kind.dimensions)]
                space[f"k{i}"] = element_type(kind.element)
                values.append(f"carray(record_at({place}, k{i}), ({', '.join(more)},))")
            elif isinstance(kind, np.dtype):
                space[f"k{i}"] = from_dtype(kind)
                values.append(f"carray(record_at({place}, k{i}), 1)[0]")
            else:
                space[f"k{i}"] = kind_of(kind)
                values.append(f"lent({place}, k{i})")
            names += [place, *more]
            number = types.float64 if kind in (float, complex) else types.int64
            argument_types += [number] * (1 + len(more))
        call = f"function({', '.join(values)})"
        results = result if isinstance(result, tuple) else (result,) if result is not None else ()
        body = call
        if results:
            space["number"] = types.float64 if results[0] is float else types.int64
            targets = ", ".join(f"out[{k}]" for k in range(len(results)))
            body = f"out = carray(record_at(place, number), {len(results)})\n    {targets} = {call}"
        exec(f"def export({', '.join([*names, 'place'])}):\n    {body}\n", space)
        signature = types.void(*argument_types, types.int64)
        EXPORTS.append(Export(function.__name__, function.__module__, inner(space["export"]), signature))
        return compiled

    return mark


def callback(*kinds: Any) -> Callable[[Any], Any]:
    """Mark a function ``int f(...)`` that C calls, and nobody else."""
    signature = types.int32(
        *(
            types.CPointer(element_type(kind.element))
            if isinstance(kind, PointerTo)
            else types.float64 if kind is float else from_dtype(np.dtype(kind))
            for kind in kinds
        )
    )  # fmt: skip

    def mark(function: Any) -> Any:
        compiled = inner(function)
        EXPORTS.append(Export(function.__name__, function.__module__, compiled, signature))
        return compiled

    return mark


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
def _call_force(typing_context: Any, address: Any, t: Any, x: Any, y: Any, vx: Any, vy: Any) -> Any:
    """Call ``void f(double t, x, y, vx, vy, double force[2])`` at an address; return the two forces."""
    pair = types.UniTuple(types.float64, 2)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        function = ir.FunctionType(ir.VoidType(), [double] * 5 + [double.as_pointer()])
        force = numba.core.cgutils.alloca_once(builder, double, size=2)
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [*args[1:], force])
        values = [builder.load(numba.core.cgutils.gep_inbounds(builder, force, i)) for i in range(2)]
        return context.make_tuple(builder, pair, values)

    return pair(numba_types.int64, *([numba_types.float64] * 5)), codegen


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
    """Pointer to records, or numbers, of the type `kind` at an integer address."""
    pointer = types.CPointer(kind.instance_type)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(pointer))

    return pointer(numba_types.int64, kind), codegen


# An intrinsic's first parameter is the compiler's own: callers see it without.
record_at: Any = _record_at
call_plain: Any = _call_plain
call_with_time: Any = _call_with_time
call_force: Any = _call_force
doubles_at: Any = _doubles_at
words_at: Any = _words_at
