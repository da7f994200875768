"""Named tuples that are lent to compiled code: their fields, whatever form numpy's alias has."""

import types
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from mech.kinds import ArrayOf, fields_of, table

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
