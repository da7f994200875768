"""ngspice's vectors as the benchmarks' own callbacks read them."""

from typing import Any

from numba import carray, njit

from mech.numba_calls import doubles_at, words_at


@njit(inline="always")
def vector_value(vectors: Any, index: int) -> float:
    """Read the real value of ngspice's `vecvalues[index]` (name pointer, real, imaginary, flags)."""
    at = carray(words_at(vectors), (index + 1,))[index]
    value: float = carray(doubles_at(at), (2,))[1]
    return value
