"""How functions are compiled that only compiled code calls.

Without the wrappers through which Python would call them: a fifth of all that is compiled. Python that calls
one ends in a crash, so `tests/test_compiled.py` sees to it that none does.
"""

from typing import Any

from numba import njit

__all__ = ["inner", "inner_inlined"]

_ALONE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inner: Any = njit(cache=True, error_model="numpy", **_ALONE)
#: The same, copied by LLVM to where it is called.
inner_inlined: Any = njit(cache=True, error_model="numpy", forceinline=True, **_ALONE)
