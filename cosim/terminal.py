"""Text that may be printed: what comes from files may hold sequences that steer a terminal."""

import re

__all__ = ["printable"]

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
