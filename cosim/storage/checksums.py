"""Check sums of what a run or a study leaves behind.

A result that was cut, damaged or edited since it was written is refused, not shown. The sums are no
signature: whoever writes a result can seal what they like.
"""

import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

from cosim.errors import InputError, fail

__all__ = [
    "MANIFEST",
    "check_files",
    "coming",
    "file_sums",
    "intact",
    "listed",
    "plain_json",
    "read_object",
    "read_sealed",
    "sealed",
    "write_manifest",
]

_SEAL = "seal"
#: Names the files of a page, so that they and no others are replaced with it.
MANIFEST = ".cosim-files.json"
_MANIFEST_FORM = 1


def file_sums(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of those of the files that are in `folder`."""
    return {name: _sum(folder / name) for name in names if os.path.isfile(folder / name)}


def check_files(folder: Path, sums: Mapping[str, str]) -> None:
    """Raise an `InputError` for the first file that is missing or not what `sums` says."""
    for name, expected in sums.items():
        file = folder / name
        if PurePosixPath(name).name != name or not os.path.isfile(file):
            fail("is missing: the result is not whole", file=str(file))
        if _sum(file) != expected:
            fail("is damaged: its content is not what the run has written", file=str(file))


def intact(folder: Path, sums: Any) -> set[str]:
    """Return the names among `sums` whose files in `folder` are what they were when they were written.

    What they name is replaced and deleted: a name that leads out of the folder is none of ours, whoever has
    listed it.
    """
    if not isinstance(sums, Mapping):
        return set()
    return {
        name
        for name, expected in sums.items()
        if _stays_inside(folder, name) and os.path.isfile(folder / name) and _sum(folder / name) == expected
    }


def _stays_inside(folder: Path, name: str) -> bool:
    """Whether a relative path is a file's in a folder, by itself and by the links on its way."""
    path = PurePosixPath(name)
    if path.is_absolute() or not path.name or "\0" in name or str(path) != name or ".." in path.parts:
        return False
    return (folder / name).parent.resolve().is_relative_to(folder.resolve())


def write_manifest(folder: Path, names: Iterable[str], manifest: str = MANIFEST) -> None:
    """Note that files (relative paths) in `folder` are ours, in a file beside them."""
    record = sealed({"format": _MANIFEST_FORM, "files": file_sums(folder, names)})
    (folder / manifest).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def listed(folder: Path, manifest: str = MANIFEST) -> set[str]:
    """Return the relative paths that a manifest proves to be ours and unchanged, itself among them.

    A call that was killed while it replaced files leaves a second one, of what was to come.
    """
    ours = set()
    for name in (manifest, coming(manifest)):
        try:
            record = read_sealed(folder / name, _MANIFEST_FORM)
        except InputError:  # none, or one that proves nothing
            continue
        ours |= {name, *intact(folder, record.get("files"))}
    return ours


def coming(manifest: str) -> str:
    """Return the name of the manifest of files that are being put in place."""
    return f"{manifest}.new"


def sealed(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a JSON-ready record with the check sum of its content."""
    return {**record, _SEAL: _content_sum(record)}


def read_object(file: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises
    ------
    InputError
        When it cannot be read, is no object, is nested deeper than anything of ours, or holds a number that
        is not finite or text that is none.
    """
    try:
        value = plain_json(file.read_text(encoding="utf-8"))
    except OSError as error:
        fail(f"cannot be read: {error.strerror or error}", file=str(file))
    except RecursionError:
        fail("cannot be read: it is nested too deeply", file=str(file))
    except ValueError as error:
        fail(f"cannot be read: {error}", file=str(file))
    if not isinstance(value, dict):
        fail("is not a JSON object", file=str(file))
    return value


def read_sealed(file: Path, *forms: int) -> dict[str, Any]:
    """Read a sealed record of one of `forms`; its seal is taken off.

    Raises
    ------
    InputError
        As `read_object`; for a record of another version, and one that was changed since it was written.
    """
    record = read_object(file)
    if record.get("format") not in forms:
        fail("was written by another version of cosim: run the scene again", file=str(file))
    seal = record.pop(_SEAL, None)
    if seal != _content_sum(record):
        fail("is damaged: its content is not what was written", file=str(file))
    return record


def _sum(file: Path) -> str:
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        fail(f"cannot be read: {error.strerror or error}", file=str(file))


def _content_sum(record: Mapping[str, Any]) -> str:
    # JSON keeps every digit of a number and the order of keys: what is read back gives the same text
    return hashlib.sha256(json.dumps(record, allow_nan=False).encode()).hexdigest()


#: Levels of lists and objects in what we write are fewer, and so are the digits of whole numbers.
_DEEPEST, _LARGEST = 40, 1 << 64


def plain_json(text: str) -> Any:
    """Parse JSON of ours: what could not be computed with, printed or written again is refused.

    Raises
    ------
    ValueError
        For text that is no JSON, and for JSON that no file of ours has.
    RecursionError
        For text that the parser itself cannot follow.
    """
    value = json.loads(text, parse_constant=_no_number)
    level = [value]
    for _ in range(_DEEPEST):
        inner = []
        for each in level:
            if isinstance(each, dict):
                inner += [*each, *each.values()]
            elif isinstance(each, list):
                inner += each
            elif isinstance(each, str):
                each.encode()  # half of a pair of surrogates is no character
            elif isinstance(each, float) and not math.isfinite(each):
                _no_number(str(each))
            elif isinstance(each, int) and abs(each) > _LARGEST:
                raise ValueError(f"{str(each)[:20]}... is too large a number")
        level = inner
        if not level:
            return value
    raise ValueError("it is nested too deeply")


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a finite number")
