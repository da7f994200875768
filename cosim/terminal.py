"""Where text is printed and what may be: streams that are closed or full, sequences that steer a terminal."""

import os
import re
import sys
from contextlib import suppress

__all__ = ["open_missing_streams", "print_remark", "printable"]

# control characters but for tab and line feed, separators of lines and paragraphs, and turns of direction
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return text with every steering character written out, as JSON does.

    Examples
    --------
    >>> printable('red'), len(printable(chr(27)))  # six characters that say which one it was
    ('red', 6)
    """
    return _STEERING.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def open_missing_streams() -> None:
    """Give standard streams that the caller closed (``>&-``, some daemons) the null device.

    Otherwise the next file that is opened takes the stream's number, and what C code prints lands in it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)


def print_remark(text: str) -> None:
    """Print on standard error what no result depends on; no error where nothing can be printed."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)
