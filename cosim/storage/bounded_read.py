"""Reading a file whole where that comes to an end: a regular file of bounded size."""

import stat
from pathlib import Path

from cosim.errors import fail

__all__ = ["read_regular"]


def read_regular(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file.

    A pipe would be waited for and a device read for ever, so neither is opened.

    Raises
    ------
    OSError
        If the file is not there or cannot be read.
    InputError
        If it is no regular file, or larger than `most_bytes`.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        fail("cannot be read: it is not a regular file", file=str(path))
    if status.st_size > most_bytes:
        fail("cannot be read: it is too large", file=str(path), value=status.st_size, unit="bytes",
             allowed=f"<= {most_bytes}")  # fmt: skip
    return path.read_bytes()
