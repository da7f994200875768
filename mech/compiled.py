"""How compiled functions are marked.

An `inner` function is called by compiled code alone, an `entry` by Python, too, and a `callback` by C. One
process builds libraries of object code from them (`mech.build`): it alone imports numba, and sees the
functions as numba does. Every other process loads the libraries (`mech.library`), where Python reaches the
entries and nothing else.

What an entry takes is stated by kinds: ``int``, ``float``, ``complex``, ``bool``; a structured dtype for
one record of it; `vector` and `matrix` for contiguous float64 arrays, `ArrayOf` for others; a named tuple
of numbers and arrays (`mech.kinds.table`). A callback also takes `PointerTo` and ``numpy.int32``.
"""

from __future__ import annotations

import os
from typing import Any

from mech.kinds import ArrayOf, PointerTo, matrix, vector

__all__ = [
    "BUILDING",
    "ArrayOf",
    "PointerTo",
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
    "matrix",
    "record_at",
    "vector",
    "words_at",
]

#: Whether this process builds libraries.
BUILDING = os.environ.get("COSIM_BUILDS_LIBRARIES") == "1"

if BUILDING:
    from mech.numba_calls import (
        call_force,
        call_plain,
        call_with_time,
        callback,
        carray,
        doubles_at,
        entry,
        inner,
        inner_inlined,
        inner_spliced,
        kind_of,
        lent,
        record_at,
        words_at,
    )
else:
    from mech.library import callback, entry, inner

    inner_inlined = inner_spliced = inner
    # what compiled functions call: nobody looks at it here
    call_force = call_plain = call_with_time = carray = doubles_at = lent = record_at = words_at = None

    def kind_of(cls: Any) -> Any:
        """Return None: the compiler's type of a record is asked for where libraries are built."""
        return None
