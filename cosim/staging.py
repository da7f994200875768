"""Output folders that appear whole or not at all."""

import errno
import hashlib
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from cosim.errors import InputError, Problem, fail

_TURNS = 20
"""How often a place is tried that other processes write to as well."""


@contextmanager
def disk_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the file system refuses into an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(Problem(f"cannot be written: {reason}", file=os.fspath(path))) from error


def _label() -> str:
    """Return this machine's mark in the names of temporary folders; a shared disk has several machines."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):  # another user's, or no number of a process
        return True
    return True


class Staging:
    """A temporary folder beside `target` that takes its place when it is complete.

    Made before a simulation starts, it also tells early that the place cannot be written. Its name tells
    machine and process (``.<target>.<machine>-<pid>.<random>``): what a killed process of this machine left
    for the same target is removed.

    Parameters
    ----------
    target
        Folder that shall appear.
    marker
        File that a folder of this kind contains. An existing target is replaced only when it is empty
        or has this file: a folder of the user's own is never deleted. Without a marker only an empty
        target is replaced.

    Attributes
    ----------
    path
        The temporary folder.
    """

    def __init__(self, target: str | os.PathLike[str], marker: str | None = None) -> None:
        self.target = Path(os.path.abspath(target))
        self._marker = marker
        self._refuse_foreign()
        with disk_errors(self.target):
            self.target.parent.mkdir(parents=True, exist_ok=True)
            self._sweep()
            self.path = self._beside()
            # mkdtemp makes it private; a result is as public as the user's other files.
            umask = os.umask(0)
            os.umask(umask)
            self.path.chmod(0o777 & ~umask)

    def _beside(self) -> Path:
        prefix = f".{self.target.name}.{_label()}-{os.getpid()}."
        return Path(tempfile.mkdtemp(prefix=prefix, dir=self.target.parent))

    def _sweep(self) -> None:
        """Remove what processes that are gone left for this target; a kill leaves no time to."""
        form = re.compile(rf"\.{re.escape(self.target.name)}\.{_label()}-([1-9]\d*)\.[a-z0-9_]{{8}}")
        for entry in list(self.target.parent.iterdir()):
            match = form.fullmatch(entry.name)
            if match and entry.is_dir() and not entry.is_symlink() and not _lives(int(match[1])):
                shutil.rmtree(entry, ignore_errors=True)

    def _refuse_foreign(self) -> None:
        with disk_errors(self.target):
            if not os.path.lexists(self.target):
                return
            if not self.target.is_dir():
                fail("exists and is not a folder", file=str(self.target))
            if not any(self.target.iterdir()):
                return
            if self._marker is None:
                fail("exists and is not empty; nothing was changed", file=str(self.target))
            if not (self.target / self._marker).is_file():
                fail(
                    f"is not empty and holds no {self._marker}; choose another folder", file=str(self.target)
                )

    def publish(self) -> None:
        """Give the folder its final name, in place of an earlier result.

        Another process that publishes to the same place at the same moment may come in between: then this
        one tries again, and the last one stays.
        """
        for turn in range(_TURNS):
            self._refuse_foreign()
            with disk_errors(self.target):
                try:
                    self.path.rename(self.target)  # replaces an empty folder, too
                    return
                except OSError as error:
                    if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or turn == _TURNS - 1:
                        raise
                self._step_aside()

    def _step_aside(self) -> None:
        """Remove the earlier result by way of a new name: a folder that is not empty is not renamed over."""
        old = self._beside()
        try:
            self.target.rename(old)
        except FileNotFoundError:  # another process was quicker
            pass
        shutil.rmtree(old, ignore_errors=True)

    def discard(self) -> None:
        """Remove the temporary folder if it is still there."""
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()
