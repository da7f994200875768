"""Cautions as Python warnings, unless a caller collects them."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from cosim.caution import Doubt, collected, listening

__all__ = ["doubts"]


@contextmanager
def doubts() -> Iterator[None]:
    """Turn cautions into Python warnings unless an outer block collects them."""
    with collected() as heard:
        yield
    if not listening():
        for caution in heard:
            warnings.warn(str(caution), Doubt, stacklevel=4)
