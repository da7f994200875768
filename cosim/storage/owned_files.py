"""Our files in a folder that may hold others: only what we wrote, and nobody changed since, is replaced."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from cosim.errors import fail
from cosim.storage.checksums import MANIFEST, coming, listed, write_manifest
from cosim.storage.staging import disk_errors, folder_beside, writable_folder

__all__ = ["manifest_of", "own_file", "refuse_foreign", "write_file", "write_files"]

#: Of a file's name: the list beside it and its temporary folder have longer ones, and 255 bytes is the most.
_LONGEST = 200


def manifest_of(product: str) -> str:
    """Return the name of the file that lists what one product, for example ``sweep``, left in a folder."""
    return f".cosim-{product}.json"


def refuse_foreign(folder: Path, names: Iterable[str], manifest: str = MANIFEST) -> None:
    """Refuse a folder in which one of the files to write is somebody else's, before long work is done for it.

    Raises
    ------
    InputError
        Naming the file in the way.
    """
    foreign = sorted(
        name for name in set(names) - listed(folder, manifest) if _holds_something(folder / name)
    )
    if foreign:
        fail(
            "is in the way, and cosim has not written it as it is now: nothing was changed; choose another "
            "folder (--out), or move it away",
            file=str(folder / foreign[0]),
        )


def write_files(folder: Path, content: Mapping[str, bytes], manifest: str = MANIFEST) -> None:
    """Write files (relative path -> bytes), the last one last; those of an earlier call go with it.

    All is written to a temporary folder first. What is to be there is listed before it appears and what was
    there until the end, so that a kill in between leaves nothing that a later call would not know as its own.

    Raises
    ------
    InputError
        As `refuse_foreign`.
    StorageError
        When the folder cannot be written; nothing half-written is left.
    """
    refuse_foreign(folder, content, manifest)
    before = listed(folder, manifest)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with folder_beside(folder / manifest) as fresh:
            for name, data in content.items():
                (fresh / name).parent.mkdir(parents=True, exist_ok=True)
                (fresh / name).write_bytes(data)
            write_manifest(fresh, content, manifest)
            os.replace(fresh / manifest, folder / coming(manifest))
            for name in content:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(fresh / name, folder / name)
            os.replace(folder / coming(manifest), folder / manifest)
            for name in before - {*content, manifest}:
                (folder / name).unlink(missing_ok=True)


def own_file(path: str | os.PathLike[str]) -> None:
    """Refuse to write a single file that could not be written, or that would replace what is not ours.

    Ours is what the list beside it (``.NAME.cosim.json``) proves to be as `write_file` left it: nothing in
    the file itself is trusted. A file without content may be replaced.

    Raises
    ------
    InputError
        Naming what is in the way.
    """
    file = Path(os.path.realpath(path))
    writable_folder(file.parent)
    if not os.path.isdir(file.parent):
        fail("is not a place for a file: there is no such folder", file=os.fspath(file.parent))
    if len(os.fsencode(file.name)) > _LONGEST:
        fail("is too long a name", file=os.fspath(path), allowed=f"at most {_LONGEST} bytes")
    if not os.path.lexists(file):
        return
    if not os.path.isfile(file):
        fail("is not a place for a file: it is something else", file=os.fspath(path))
    if _holds_something(file) and file.name not in listed(file.parent, _list_of(file)):
        fail(
            "exists, and cosim has not written it as it is now: nothing was changed; choose another name, or "
            "move it away",
            file=os.fspath(path),
        )


def write_file(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a single file whole, and a list beside it that proves it to be ours.

    Raises
    ------
    InputError
        As `own_file`.
    StorageError
        When it cannot be written; an earlier file is as it was.
    """
    own_file(path)
    file = Path(os.path.realpath(path))
    write_files(file.parent, {file.name: data}, _list_of(file))


def _holds_something(file: Path) -> bool:
    """Whether something is there that could be lost: anything but a file without content."""
    return os.path.lexists(file) and not (os.path.isfile(file) and not file.stat().st_size)


def _list_of(file: Path) -> str:
    return f".{file.name}.cosim.json"
