"""What a command prints beside its result: ``--quiet``, ``--verbose``, and whether on a terminal."""

import sys
from enum import Enum

from cosim.terminal import print_remark

__all__ = ["Manner", "bars", "choose", "remark", "verbose"]


class Manner(Enum):
    """What goes to standard error beside errors."""

    QUIET = "nothing"
    USUAL = "bars and remarks where a terminal shows them"
    VERBOSE = "remarks everywhere, and every caution in full"


_manner = Manner.USUAL


def choose(*, quiet: bool, verbose: bool) -> None:
    """Set the manner from a command line."""
    global _manner
    _manner = Manner.QUIET if quiet else Manner.VERBOSE if verbose else Manner.USUAL


def bars() -> bool:
    """Whether to show a progress bar: on a terminal, without --quiet."""
    return _manner is not Manner.QUIET and sys.stderr.isatty()


def verbose() -> bool:
    """Whether to report every step: --verbose."""
    return _manner is Manner.VERBOSE


def remark(text: str, *, detail: bool = False) -> None:
    """Print a remark on standard error; a `detail` only on a terminal or with --verbose."""
    wanted = verbose() or not detail or bars()
    if _manner is not Manner.QUIET and wanted:
        print_remark(text)
