"""What compiled functions take: kinds of arguments, and tuples of arrays lent to compiled code."""

from __future__ import annotations

import functools
import typing
from collections.abc import Hashable
from typing import Any, NamedTuple, cast

import numpy as np

__all__ = ["ArrayOf", "PointerTo", "element_of", "fields_of", "matrix", "table", "vector"]


class ArrayOf(NamedTuple):
    """A contiguous array: the type of its elements, a structured one too, and its number of dimensions."""

    element: Any
    dimensions: int


class PointerTo(NamedTuple):
    """A C pointer to elements of a type."""

    element: Any


vector = ArrayOf(np.float64, 1)
matrix = ArrayOf(np.float64, 2)


@functools.cache
def fields_of(cls: Hashable) -> tuple[Any, ...]:
    """Return the kinds of a named tuple's fields: ``int``, ``float``, or an `ArrayOf`.

    Arrays are ``Annotated[NDArray[...], dimensions]``.
    """
    kinds: list[Any] = []
    for hint in typing.get_type_hints(cls, include_extras=True).values():
        if hint in (int, float):
            kinds.append(hint)
        else:
            array, dimensions = typing.get_args(hint)
            kinds.append(ArrayOf(element_of(array), dimensions))
    return tuple(kinds)


def element_of(hint: Any) -> type[np.generic]:
    """Return the scalar type that `NDArray[...]` names.

    How deep it lies is numpy's own affair: `ndarray[shape, dtype[float64]]` where the alias is expanded,
    `NDArray[float64]` where it is one of the language (Python 3.12 with numpy 2.5).

    Raises
    ------
    TypeError
        When it names none.
    """
    waiting = [hint]
    for part in waiting:
        if isinstance(part, type) and issubclass(part, np.generic):
            return part
        waiting += typing.get_args(part)
    raise TypeError(f"{hint} names no element of an array")


def table(record: Any) -> Any:
    """Return a named tuple of numbers and arrays as 64-bit words: numbers, addresses and lengths.

    Of a table compiled code gets one address (`mech.numba_tables.lent`). The tuple must live as long as
    the table is used.

    Raises
    ------
    ValueError
        When an array is not contiguous.
    TypeError
        When an array is of another kind than its field: an address carries no types.
    """
    words: list[int] = []
    for kind, value in zip(fields_of(cast(Hashable, type(record))), record, strict=True):
        if isinstance(value, np.ndarray):
            if not value.flags.c_contiguous:
                raise ValueError("only contiguous arrays have an address and lengths")
            if (value.dtype, value.ndim) != (np.dtype(kind.element), kind.dimensions):
                raise TypeError(f"{value.ndim} dimensions of {value.dtype} are lent as {kind}")
            words += [value.ctypes.data, *value.shape]
        elif kind is float:
            words.append(int(np.float64(value).view(np.int64)))
        else:
            words.append(int(value))
    return np.array(words, np.int64)
