"""What compiled code reads of ngspice's own memory: values of vectors, and names of sources."""

from typing import Any

import numpy as np

from mech.compiled import ArrayOf, carray, doubles_at, entry, inner_spliced, words_at


@inner_spliced
def vector_value(vectors: Any, index: int) -> float:
    """Read the real value of ngspice's `vecvalues[index]` (name pointer, real, imaginary, flags)."""
    at = carray(words_at(vectors), (index + 1,))[index]
    value: float = carray(doubles_at(at), (2,))[1]
    return value


@entry(ArrayOf(np.uint8, 1), int, result=int)
def name_hash(letters: Any, count: int) -> int:
    """Return a number for the first `count` letters of a name, or for those before its end."""
    number = 0
    for i in range(count):
        if letters[i] == 0:
            break
        number = (number * 257 + letters[i]) % 9007199254740881  # the largest prime below 2^53
    return number
