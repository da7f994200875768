"""Our files in a folder that may hold others: only what we wrote, and nobody changed since, is replaced."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from cosim.errors import fail
from cosim.seal import MANIFEST, coming, listed, write_manifest
from cosim.staging import disk_errors, folder_beside

__all__ = ["manifest_of", "refuse_foreign", "write_files"]


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
    foreign = sorted(name for name in set(names) - listed(folder, manifest) if os.path.lexists(folder / name))
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
