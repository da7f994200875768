"""Named tuples that are lent to compiled code: their fields, whatever form numpy's alias has."""

import types
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numba import njit
from numba import types as numba_types
from numpy.typing import NDArray

from mech.kinds import ArrayOf, fields_of, table
from mech.numba_calls import inner, inner_inlined, kind_of, lent

# What `NDArray[x]` is: expanded (numpy up to 2.4, and any numpy on Python 3.11), or an alias of the language
EXPANDED: Any = lambda element: np.ndarray[tuple[Any, ...], np.dtype[element]]  # noqa: E731
ALIAS: Any = lambda element: types.GenericAlias(list, (element,))  # noqa: E731
OURS: Any = lambda element: NDArray[element]  # noqa: E731


@pytest.mark.parametrize("form", [EXPANDED, ALIAS, OURS])
@pytest.mark.parametrize("element", [np.float64, np.int64, np.complex128])
@pytest.mark.parametrize("dimensions", [1, 3])
def test_the_element_of_an_array_is_found_in_every_form_of_numpys_alias(
    form: Any, element: Any, dimensions: int
) -> None:
    record = NamedTuple("record", [("count", int), ("data", Annotated[form(element), dimensions])])  # noqa: UP014
    assert fields_of(record) == (int, ArrayOf(element, dimensions))


def test_an_array_of_nothing_is_refused() -> None:
    record = NamedTuple("record", [("data", Annotated[list[str], 1])])  # noqa: UP014
    with pytest.raises(TypeError, match="names no element"):
        fields_of(record)


def test_a_table_has_numbers_addresses_and_lengths_in_order() -> None:
    data = np.arange(6.0).reshape(2, 3)
    fields = [("count", int), ("share", float), ("data", Annotated[NDArray[np.float64], 2])]
    record = NamedTuple("record", fields)
    words = table(record(7, 0.5, data))
    assert words[0] == 7
    assert words[1:2].view(np.float64)[0] == 0.5
    assert list(words[2:]) == [data.ctypes.data, 2, 3]
    # a float's place keeps its meaning where a whole number stands in it
    assert table(record(7, 2, data))[1:2].view(np.float64)[0] == 2.0
    with pytest.raises(ValueError, match="contiguous"):
        table(record(7, 0.5, data.T))
    # broken once: without the check the 32 bits of each number are read as half of one
    for other in (data.astype(np.float32), data.ravel(), data.astype(int)):
        with pytest.raises(TypeError, match="are lent as"):
            table(record(7, 0.5, other))


def test_compiled_code_reads_each_field_of_a_table_where_it_stands() -> None:
    names = ("count", "share", "data", "whole", "roots")
    kinds = (
        int,
        float,
        *(Annotated[NDArray[each], n] for each, n in ((np.float64, 2), (np.int64, 1), (np.complex128, 1))),
    )
    record = NamedTuple("record", list(zip(names, kinds, strict=True)))
    values = record(7, 0.5, np.arange(6.0).reshape(2, 3), np.array([3, 4]), np.array([1 + 2j, 3.0]))
    kind = kind_of(record)

    @njit
    def read(address: int) -> Any:
        t = lent(address, kind)
        t.whole[0] += 10
        return t.count, t.share, t.data[1, 2], t.data.shape, t.whole[-1], t.roots[0], t.data[1].sum()

    words = table(values)
    assert read(words.ctypes.data) == (7, 0.5, 5.0, (2, 3), 4, 1 + 2j, 12.0)
    assert values.whole[0] == 13  # lent, not copied
    # two tuples of one name are two tables
    other = kind_of(NamedTuple("record", [("share", float)]))
    assert other != kind
    assert kind_of(record) == kind


def test_only_what_says_so_is_copied_to_its_callers() -> None:
    """numba hands `forceinline` on to what is first met in a function that has it: half of a library."""

    @inner
    def called(x: float) -> float:
        return x + 1.0

    @inner_inlined
    def copied(x: float) -> float:
        return float(called(x))

    @inner
    def outer(x: float) -> float:
        return float(copied(x))

    outer.compile((numba_types.float64,))
    forced = [("alwaysinline" in code) for each in (called, copied) for code in each.inspect_llvm().values()]
    assert forced == [False, True]
