"""Output folders and files that appear whole or not at all."""

import errno
import hashlib
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from cosim.errors import Problem, StorageError, fail

_TURNS = 20
"""How often a place is tried that other processes write to as well."""


@contextmanager
def disk_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the file system refuses into a `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise StorageError(Problem(f"cannot be written: {reason}", file=os.fspath(path))) from error


@contextmanager
def atomic_file(path: str | os.PathLike[str], *, tidy: bool = True) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it at the end of the block.

    A failure, a full disk or a kill leaves an earlier file as it was; what killed processes of this machine
    left beside it is removed, unless `tidy` says that somebody else does so: that looks at the whole folder.

    Raises
    ------
    StorageError
        When the folder cannot be written, or `path` is no regular file.
    """
    target = Path(os.path.realpath(path))
    with disk_errors(path):
        if os.path.exists(target) and not os.path.isfile(target):
            fail("is not a regular file", file=os.fspath(path))
        if tidy:
            _sweep(target)
        handle, name = tempfile.mkstemp(prefix=_prefix(target), suffix=target.suffix, dir=target.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            temporary.chmod(target.stat().st_mode & 0o777 if os.path.exists(target) else 0o666 & ~_umask())
            yield temporary
            temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def _prefix(target: Path) -> str:
    """Return how names of temporary things beside `target` begin: they tell machine and process."""
    return f".{target.name}.{_label()}-{os.getpid()}."


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


@contextmanager
def folder_beside(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a new folder beside `target`, for files on their way; removed at the end of the block.

    What killed processes of this machine left for the same target is removed, too.
    """
    target = Path(os.path.abspath(target))
    _sweep(target)
    folder = Path(tempfile.mkdtemp(prefix=_prefix(target), dir=target.parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def writable_folder(path: str | os.PathLike[str]) -> None:
    """Refuse a folder that could not be written or made, before long work is done for it.

    Raises
    ------
    InputError
        Naming what is in the way.
    """
    place = Path(os.path.abspath(path))
    while not os.path.lexists(place):
        place = place.parent
    if not os.path.isdir(place):
        fail("exists and is not a folder", file=str(place))
    with disk_errors(path):
        handle, name = tempfile.mkstemp(prefix=_prefix(place), dir=place)
        os.close(handle)
        os.unlink(name)


@contextmanager
def scratch_folder(purpose: str) -> Iterator[Path]:
    """Yield a folder in the system's place for temporary files, and remove it at the end of the block.

    Raises
    ------
    StorageError
        When it cannot be made.
    """
    folder = make_scratch(purpose)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def make_scratch(purpose: str) -> Path:
    """Return a new folder among the system's temporary files, for the caller to remove.

    Its name tells machine and process: what killed processes of this machine left is removed first.
    """
    place = Path(tempfile.gettempdir())
    with disk_errors(f"{place} (the folder for temporary files, TMPDIR)"):
        _sweep_killed(place, r"cosim-[a-z]+\.")
        return Path(tempfile.mkdtemp(prefix=f"cosim-{purpose}.{_label()}-{os.getpid()}.", dir=place))


def sweep_folder(folder: str | os.PathLike[str]) -> None:
    """Remove the temporary files that killed processes of this machine left in a folder, whatever for."""
    with disk_errors(folder):
        _sweep_killed(Path(folder), r"\..+\.", r"\.[a-z]+")


def _sweep(target: Path) -> None:
    """Remove what killed processes left beside `target`."""
    _sweep_killed(target.parent, rf"\.{re.escape(target.name)}\.", re.escape(target.suffix))


def _sweep_killed(place: Path, before: str, ending: str = "") -> None:
    """Remove our own temporary files and folders of processes that are gone; a kill leaves no time to."""
    form = re.compile(rf"{before}{_label()}-([1-9]\d*)\.[a-z0-9_]{{8}}(?:{ending})?")
    for entry in list(place.iterdir()):
        match = form.fullmatch(entry.name)
        if match is None or entry.is_symlink() or _lives(int(match[1])):
            continue
        if os.path.isdir(entry):
            shutil.rmtree(entry, ignore_errors=True)
        else:
            with suppress(PermissionError):  # another user's, in a folder for everybody
                entry.unlink(missing_ok=True)


def _files(folder: Path) -> set[str]:
    """Return the relative paths of all that is in a folder and is no folder."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_symlink() or not os.path.isdir(path)
    }


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


def require_ours(target: str | os.PathLike[str], ours: Callable[[Path], Collection[str]] | None) -> None:
    """Refuse a place for a folder that holds anything but what we wrote; see `Staging` for `ours`.

    Raises
    ------
    InputError
        Naming the first file in the way.
    """
    folder = Path(os.path.abspath(target))
    with disk_errors(folder):
        if not os.path.lexists(folder):
            return
        if not os.path.isdir(folder):
            fail("exists and is not a folder", file=str(folder))
        if not any(folder.iterdir()):
            return
        if ours is None:
            fail("exists and is not empty; nothing was changed", file=str(folder))
        foreign = sorted(_files(folder) - set(ours(folder)))
    if foreign:
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        fail(
            f"holds {foreign[0]}{more}, which no run has written as it is now: nothing was changed; "
            "choose another folder, or move it away",
            file=str(folder),
        )


class Staging:
    """A temporary folder beside `target` that takes its place when it is complete.

    Made before a simulation starts, it also tells early that the place cannot be written. Its name tells
    machine and process (``.<target>.<machine>-<pid>.<random>``): what a killed process of this machine left
    for the same target is removed.

    Parameters
    ----------
    target
        Folder that shall appear.
    ours
        Tells, of an existing target, the relative paths of the files that we wrote and nobody has changed
        since. A target is replaced only when it holds no other: nothing of the user's is ever deleted.
        Without it only an empty target is replaced.

    Attributes
    ----------
    path
        The temporary folder.
    """

    def __init__(
        self, target: str | os.PathLike[str], ours: Callable[[Path], Collection[str]] | None = None
    ) -> None:
        self.target = Path(os.path.abspath(target))
        self._ours = ours
        require_ours(self.target, self._ours)
        with disk_errors(self.target):
            self.target.parent.mkdir(parents=True, exist_ok=True)
            _sweep(self.target)
            self.path = self._beside()
            # mkdtemp makes it private; a result is as public as the user's other files.
            self.path.chmod(0o777 & ~_umask())

    def _beside(self) -> Path:
        return Path(tempfile.mkdtemp(prefix=_prefix(self.target), dir=self.target.parent))

    def publish(self) -> None:
        """Give the folder its final name, in place of an earlier result.

        Another process that publishes to the same place at the same moment may come in between: then this
        one tries again, and the last one stays.
        """
        for turn in range(_TURNS):
            require_ours(self.target, self._ours)
            with disk_errors(self.target):
                try:
                    self.path.rename(self.target)  # replaces an empty folder, too
                    return
                except OSError as error:
                    if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or turn == _TURNS - 1:
                        raise
                self._step_aside()

    def _step_aside(self) -> None:
        """Remove the earlier result by way of a new name: a folder that is not empty is not renamed over.

        Only files that are proven to be ours are removed. One that was put there in this very moment stays.
        """
        assert self._ours is not None  # a target that is not empty was refused
        old = self._beside()
        try:
            self.target.rename(old)
        except FileNotFoundError:  # another process was quicker
            pass
        for name in self._ours(old):
            (old / name).unlink(missing_ok=True)
        for folder in sorted((path for path in old.rglob("*") if os.path.isdir(path)), reverse=True):
            with suppress(OSError):
                folder.rmdir()
        try:
            old.rmdir()
        except OSError:
            fail("a file was put there while the run ended; it was moved aside", file=str(old))

    def discard(self) -> None:
        """Remove the temporary folder if it is still there."""
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()
