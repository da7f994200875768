"""Addresses of what Python lends to compiled code."""

from __future__ import annotations

import ctypes
from typing import Any

__all__ = ["address_of"]


def address_of(callback: Any) -> int:
    """Return the address of a ctypes callback, which must live as long as it may be called.

    `ctypes.cast` would have the callback refer to itself: all that it holds, matrices of a run among it,
    would wait for a collection of garbage, and fill the memory of a process that runs thousands of circuits.
    """
    return int(ctypes.c_void_p.from_buffer(callback).value or 0)
