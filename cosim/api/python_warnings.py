"""Cautions as warnings of Python's own, where nobody collects them."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from cosim.caution import Doubt, collected, listening

__all__ = ["doubts"]


@contextmanager
def doubts() -> Iterator[None]:
    """Turn cautions into Python's warnings where nobody else collects them."""
    with collected() as heard:
        yield
    if not listening():
        for caution in heard:
            warnings.warn(str(caution), Doubt, stacklevel=4)
