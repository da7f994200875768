"""Types that many modules name."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Complex", "Measures", "Progress", "Record", "Report"]

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
#: One element of a structured array, as compiled code sees it: numba's records have no type of Python's.
Record: TypeAlias = Any
#: Measures of a run by name: 'value', 'unit', 'text', and 'error' where it is known.
Measures: TypeAlias = Mapping[str, Mapping[str, Any]]
#: What a function in the child process calls to tell how far it is.
Report: TypeAlias = Callable[[dict[str, Any]], None]
#: What long work calls to tell how far it is: what is done, of how many, and what comes next.
Progress: TypeAlias = Callable[[int, int, str], None]
