"""Build libraries: the object code of all that a package's modules offer, from one module of LLVM.

``python -P -m mech.build PACKAGE ...`` in a process whose environment says
``COSIM_BUILDS_LIBRARIES=1``.

numba compiles function by function, and each with copies of all that it calls: it optimises the innermost
ones some fifty times. Here functions are only translated, then joined, optimised and turned into machine
code once. What is built depends on the sources alone, not on the order of calls.
"""

from __future__ import annotations

import fcntl
import gc
import importlib
import os
import sys
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import codegen, cpu
from numba.core.registry import cpu_target

from mech.library import symbol
from mech.library_files import file_of, folder, library_of, modules_of, pack, unpack
from mech.numba_calls import EXPORTS, Export

#: Memory of arrays inside compiled functions, as numba counts references to it: count, destructor and
#: what it gets, data, size, allocator. Nothing here has a destructor. Without memory the answer is null, of
#: which numba makes an error, and an entry a MemoryError.
_MEMORY = """
declare i8* @malloc(i64)
declare void @free(i8*)

define i8* @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) {
  %wide = zext i32 %align to i64
  %more = add i64 %size, %wide
  %all = add i64 %more, 48
  %block = call i8* @malloc(i64 %all)
  %none = icmp eq i8* %block, null
  br i1 %none, label %out, label %there
out:
  ret i8* null
there:
  %words = bitcast i8* %block to i64*
  store i64 1, i64* %words
  %dtor = getelementptr i64, i64* %words, i64 1
  store i64 0, i64* %dtor
  %info = getelementptr i64, i64* %words, i64 2
  store i64 0, i64* %info
  %start = ptrtoint i8* %block to i64
  %behind = add i64 %start, 47
  %top = add i64 %behind, %wide
  %rest = urem i64 %top, %wide
  %data = sub i64 %top, %rest
  %place = getelementptr i64, i64* %words, i64 3
  store i64 %data, i64* %place
  %length = getelementptr i64, i64* %words, i64 4
  store i64 %size, i64* %length
  %allocator = getelementptr i64, i64* %words, i64 5
  store i64 0, i64* %allocator
  ret i8* %block
}

define void @NRT_MemInfo_call_dtor(i8* %block) {
  call void @free(i8* %block)
  ret void
}

define i8* @NRT_Allocate(i64 %size) {
  %block = call i8* @malloc(i64 %size)
  ret i8* %block
}

define void @NRT_Free(i8* %block) {
  call void @free(i8* %block)
  ret void
}
"""
#: What C's own library has of what a library may call; `mech.library` lends the last one.
_CALLED = frozenset(
    ("malloc", "free", "memset", "memcpy", "memmove", "sin", "cos", "sincos", "tan", "atan2", "hypot", "exp",
     "expm1", "log", "log1p", "pow", "sqrt", "tanh", "floor", "fmod", "numba_ldexp")
)  # fmt: skip
#: What numba's context keeps for as long as functions are known by it.
_standing_in: list[Any] = []


def _translate_only() -> None:
    """Let numba stop where it would optimise, emit and load each function on its own."""

    def executable(context: Any, library: Any, descriptor: Any, environment: Any) -> Any:
        _standing_in.append([])
        return _standing_in[-1].append  # functions are known by what stands here: each needs its own

    def finalize(library: Any) -> None:
        library._finalized = True

    cpu.CPUContext.get_executable = executable
    codegen.CPUCodeLibrary.finalize = finalize


def _translated(export: Export) -> Any:
    """Return numba's result for an export: its library and descriptor."""
    export.compiled.compile(export.signature)
    (result,) = (each for each in export.compiled.overloads.values() if each.signature == export.signature)
    return result


def _offered(context: Any, export: Export, result: Any) -> ir.Module:
    """Return a module with the C function of an export: it returns a status, or a callback's own result."""
    module = context.create_module(f"offer.{export.name}")
    descriptor, convention = result.fndesc, context.call_conv
    target = ir.Function(
        module,
        convention.get_function_type(descriptor.restype, descriptor.argtypes),
        descriptor.llvm_func_name,
    )
    arguments = [context.get_value_type(each) for each in descriptor.argtypes]
    function = ir.Function(
        module, ir.FunctionType(ir.IntType(32), arguments), symbol(export.module, export.name)
    )
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    status, out = convention.call_function(
        builder, target, descriptor.restype, descriptor.argtypes, function.args
    )
    if descriptor.restype == types.none:
        builder.ret(builder.zext(status.is_error, ir.IntType(32)))
    else:  # C asks for no status: what can fail here is memory alone
        with builder.if_then(status.is_error, likely=False):
            builder.call(ir.Function(module, ir.FunctionType(ir.VoidType(), []), "llvm.trap"), [])
        builder.ret(out)
    return module


def _callers_first(libraries: list[Any]) -> list[Any]:
    """Return numba's libraries and all that they call, each before what it calls."""
    order: list[Any] = []
    seen: set[int] = set()

    def visit(library: Any) -> None:
        if id(library) in seen:
            return
        seen.add(id(library))
        for each in library._linking_libraries:
            visit(each)
        order.append(library)

    for library in libraries:
        visit(library)
    return order[::-1]


def _object_code(package: str, exports: list[Export]) -> bytes:
    """Return the object code of a package that offers these functions."""
    context = cpu_target.target_context
    results = [_translated(each) for each in exports]
    joined = context.codegen().create_library(package)
    whole = joined._final_module
    for export, result in zip(exports, results, strict=True):
        joined.add_ir_module(_offered(context, export, result))
    for library in _callers_first([each.library for each in results]):
        whole.link_in(library._final_module.clone())
    whole.link_in(llvm.parse_assembly(_MEMORY))
    offered = {symbol(each.module, each.name) for each in exports}
    for number, function in enumerate(whole.functions):
        if not function.is_declaration and function.name not in offered:
            function.linkage = "internal"
            function.name = f"inner{number}"  # numba's names count what was compiled before
    for number, value in enumerate(whole.global_variables):
        if not value.is_declaration:
            value.name = f"value{number}"
    codegen.CPUCodeLibrary._optimize_final_module(joined)
    whole.verify()
    strange = {each.name for each in whole.functions if each.is_declaration} - _CALLED
    if strange := {name for name in strange if not name.startswith("llvm.")}:
        raise RuntimeError(f"{package} calls what is not there when it is loaded: {sorted(strange)}")
    return bytes(joined._codegen._tm.emit_object(whole))


def main(packages: list[str]) -> None:
    """Build the libraries of packages, each once where several processes want it.

    All in one process: most functions belong to several libraries, and are translated once.
    """
    gc.disable()  # millions of objects, most of which stay: a tenth of the time
    _translate_only()
    with open(folder() / f"{packages[-1]}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        missing = [package for package in packages if unpack(file_of(package)) is None]
        for package in missing:
            for name in modules_of(package):
                importlib.import_module(name)
        for package in missing:
            exports = [each for each in EXPORTS if library_of(each.module) == package]
            file = file_of(package)
            whole = Path(f"{file}.{os.getpid()}")
            whole.write_bytes(pack(_object_code(package, exports)))
            whole.replace(file)


if __name__ == "__main__":
    main(sys.argv[1:])
