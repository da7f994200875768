"""Dialects of SPICE in which files are written: what they mean by the same characters."""

from collections.abc import Iterable
from enum import StrEnum

__all__ = ["Dialect"]


class Dialect(StrEnum):
    """The SPICE that a file was written for."""

    NGSPICE = "ngspice"
    PSPICE = "pspice"
    LTSPICE = "ltspice"

    @property
    def dollar_is_letter(self) -> bool:
        """Whether ``$`` is a letter like any other and not the start of a comment."""
        return self is not Dialect.NGSPICE

    @property
    def lib_includes(self) -> bool:
        """Whether ``.lib FILE`` includes a file; elsewhere it opens a section of that name."""
        return self is not Dialect.NGSPICE

    @property
    def reads_rkm(self) -> bool:
        """Whether the scale may stand in place of the decimal point: ``2k7`` is 2.7k."""
        return self is Dialect.LTSPICE

    @staticmethod
    def behaviour(dialects: Iterable["Dialect"]) -> str | None:
        """Return ngspice's ``ngbehavior`` for a deck with parts in these dialects; ``None`` for its own.

        The mode holds for a whole deck; LTspice's (``ltpsa``) reads all that PSpice's (``psa``) does.
        """
        known = set(dialects)
        if Dialect.LTSPICE in known:
            return "ltpsa"
        return "psa" if Dialect.PSPICE in known else None
