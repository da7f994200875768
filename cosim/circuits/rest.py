"""A board at rest where ngspice finds no operating point as it stands: what a run is helped with as well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from cosim.errors import NoOperatingPoint

__all__ = ["STEPPING", "at_rest"]

#: ngspice's older stepping, in equal steps, and the conductance that stays across every junction [S].
STEPPING = ".options gminsteps=20 srcsteps=20 gmin=1e-10"

T = TypeVar("T")


def at_rest(attempt: Callable[[Sequence[str]], T]) -> tuple[T, str]:
    """Return what `attempt` makes of a deck's further lines, none if possible, and what they do in words.

    Raises
    ------
    NoOperatingPoint
        The first one, where they do not help.
    """
    try:
        return attempt(()), ""
    except NoOperatingPoint as first:
        try:
            return attempt((STEPPING,)), "operating point found with gmin and source stepping, gmin = 1e-10 S"
        except NoOperatingPoint:
            raise first from None
