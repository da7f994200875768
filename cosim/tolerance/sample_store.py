"""Measured samples on disk: parts as they are finished, and one Parquet file when all are there.

The file's bytes depend on the samples alone, not on the processes, the order or the chunks.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from typing_extensions import TypedDict

from cosim.errors import fail
from cosim.storage.checksums import plain_json
from cosim.storage.field_types import fits
from cosim.storage.staging import atomic_file, disk_errors, sweep_folder
from cosim.tolerance.missing import Missing, Reasons, reasons_of, text_of
from cosim.types import Array

__all__ = ["LEVELS", "SAMPLES", "Samples", "is_named"]


SAMPLES, STUDY, PARTS = "samples.parquet", "study.json", "parts"
#: Folder within a study's own for what was measured beside its samples: other models, other points.
LEVELS = "levels"
_PART = re.compile(r"(\d{12})-(\d+)\.parquet")
#: Column that says which measures a sample lacks, and why: `text_of`.
_MISSING = "missing"
#: Samples of a group of rows in the file.
_GROUP = 1 << 16
#: A bit that flips on disk is found: pages have a CRC, which older files lack.
_CHECKED: dict[str, Any] = {"write_page_checksum": True}


class _About(TypedDict):
    """The form of the file that names a study."""

    digest: str
    names: list[str]
    first: int
    last: int


class Samples:
    """The samples of one study in a folder.

    Parameters
    ----------
    folder
        Made where it is not there.
    digest
        Names the study: all that its samples depend on.
    names
        Measures.
    first, last
        Samples that are wanted here: all, or those of a shard.
    made
        Whether the study is there, and its samples are only read: nothing is written.

    Raises
    ------
    InputError
        For a folder that holds another study or samples without one, or that cannot be written.
    """

    def __init__(
        self, folder: Path, digest: str, names: Sequence[str], first: int, last: int, *, made: bool = False
    ) -> None:
        self.folder, self.digest, self.names = folder, digest, tuple(names)
        self.first, self.last = first, last
        self._parts = folder / PARTS
        self._seen: dict[tuple[Any, ...], bool] = {}
        self._tidy = False
        about = self._about = {"digest": digest, "names": list(names), "first": first, "last": last}
        if made:
            self._check_made()
            return
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            known = _read(folder / STUDY)
            if known is not None and known != about and not self._vacant(known):
                self._refuse()
            if os.path.lexists(folder / SAMPLES) and (known is None or not self._complete()):
                fail(
                    "is not what a study of this folder has written: nothing was changed; choose another "
                    "folder with -o, or move it away",
                    file=str(folder / SAMPLES),
                )
            if known != about:
                with atomic_file(folder / STUDY) as file:
                    file.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")

    def _check_made(self) -> None:
        """Refuse a folder whose samples are not those that its study wrote."""
        known = _read(self.folder / STUDY)
        if known is not None and known != self._about:
            fail("holds another study than its record tells", file=str(self.folder))
        samples = self.folder / SAMPLES
        if os.path.lexists(samples) and (known is None or not self._complete()):
            fail(
                "is damaged, or not what the study of this folder wrote; to have it measured again, move it "
                "away and repeat the study's command",
                file=str(samples),
            )

    def _refuse(self) -> NoReturn:
        fail("holds another study; choose another folder with -o, or remove it", file=str(self.folder))

    def _vacant(self, known: dict[str, Any]) -> bool:
        """Whether the folder has only the name of a study that kept nothing: refused, or ended too early."""
        if not fits(known, _About) or any(
            os.path.lexists(self.folder / name) for name in (SAMPLES, PARTS, LEVELS)
        ):
            return False
        with self.study_file.open("rb") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:  # it has only just begun
                return False
        return True

    def check_name(self) -> None:
        """Refuse a folder that another process has meanwhile given to another study."""
        if _read(self.study_file) != self._about:
            self._refuse()

    @property
    def study_file(self) -> Path:
        """The file that names the study."""
        return self.folder / STUDY

    def keep(self, first: int, table: Array, missing: Missing) -> None:
        """Keep measures (n, measures) of samples from `first` on, with row -> measure -> why it has none."""
        words = [text_of(missing.get(k, {})) for k in range(len(table))]
        columns: dict[str, Any] = {"sample": np.arange(first, first + len(table), dtype=np.int64)}
        columns |= {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(self.names)}
        rows = pa.table(columns | {_MISSING: pa.array(words, pa.string())}, schema=self._schema())
        place = self._parts / f"{first:012d}-{len(table)}.parquet"
        with disk_errors(self.folder):
            self._parts.mkdir(exist_ok=True)
            if not self._tidy:  # not each time: there may be ten thousand parts to look through
                sweep_folder(self._parts)
                self._tidy = True
            with atomic_file(place, tidy=False) as file:
                pq.write_table(rows, file, **_CHECKED)

    def _schema(self) -> pa.Schema:
        measures = [(name, pa.float64()) for name in self.names]
        return pa.schema([("sample", pa.int64()), *measures, (_MISSING, pa.string())])

    def done(self) -> list[tuple[int, int]]:
        """Return which samples are there, as (first, behind the last) in order; damaged ones are not."""
        if self._complete():
            return [(self.first, self.last)]
        spans: list[tuple[int, int]] = []
        for first, count, _ in self._listed():
            if spans and first <= spans[-1][1]:
                spans[-1] = spans[-1][0], max(spans[-1][1], first + count)
            else:
                spans.append((first, first + count))
        return spans

    def missing(self) -> list[tuple[int, int]]:
        """Return which samples are not there, as (first, behind the last) in order."""
        at, gaps = self.first, []
        for first, behind in self.done():
            if first > at:
                gaps.append((at, first))
            at = max(at, behind)
        return [*gaps, (at, self.last)] if at < self.last else gaps

    def finish(self) -> Path:
        """Write the file of all samples, and take the parts away."""
        target = self.folder / SAMPLES
        if not self._complete():
            with (
                disk_errors(self.folder),
                atomic_file(target) as file,
                pq.ParquetWriter(file, self._schema(), **_CHECKED) as writer,
            ):
                for table in _regrouped(self._ordered()):
                    writer.write_table(table, row_group_size=_GROUP)
        with disk_errors(self.folder):
            if self._parts.is_dir():
                sweep_folder(self._parts)
            for path in self._parts.iterdir() if self._parts.is_dir() else ():
                if _PART.fullmatch(path.name) and not path.is_symlink():
                    path.unlink()
            with suppress(OSError):  # somebody else's file is in it
                self._parts.rmdir()
        return target

    def take(self, other: Path) -> None:
        """Take over the samples of another folder of the same study: a shard's."""
        known = _read(other / STUDY)
        if known is None or known.get("digest") != self.digest or not fits(known, _About):
            fail("holds no samples of this study", file=str(other))
        first, last = known["first"], known["last"]
        if not (self.first <= first < last <= self.last and known["names"] == list(self.names)):
            fail("holds no samples of this study", file=str(other))
        source = Samples(other, self.digest, self.names, first, last, made=True)
        samples = source.folder / SAMPLES
        tables: Iterator[Any] = (
            (pa.Table.from_batches([batch]) for batch in _opened(samples).iter_batches(_GROUP))
            if samples.exists()
            else source._ordered()
        )
        for table in tables:
            first = table["sample"][0].as_py()
            place = self._parts / f"{first:012d}-{len(table)}.parquet"
            with disk_errors(self.folder):
                self._parts.mkdir(exist_ok=True)
                with atomic_file(place) as file:
                    pq.write_table(table.cast(self._schema()), file, **_CHECKED)

    def _ordered(self) -> Iterator[Any]:
        """Yield the parts in order, no sample twice."""
        at = self.first
        for first, count, path in self._listed():
            if first + count > at:
                yield _opened(path).read().slice(max(at - first, 0))
                at = first + count

    def _listed(self) -> list[tuple[int, int, Path]]:
        files = []
        for path in self._parts.iterdir() if self._parts.is_dir() else ():
            match = _PART.fullmatch(path.name)
            if match is None:
                continue
            first, count = int(match[1]), int(match[2])
            if self.first <= first < first + count <= self.last and self._sound(path, first, count):
                files.append((first, count, path))
        return sorted(files, key=lambda part: (part[0], -part[1]))

    def _complete(self) -> bool:
        """Whether the file of all samples is there and sound."""
        return self._sound(self.folder / SAMPLES, self.first, self.last - self.first)

    def _sound(self, path: Path, first: int, count: int) -> bool:
        """Whether a file holds these samples in order.

        A file that is damaged or foreign does not: its samples are measured again. A file is checked once,
        until it changes.
        """
        try:
            about = path.stat()
            seen = (path, about.st_size, about.st_mtime_ns, first, count)
            if seen not in self._seen:
                self._seen[seen] = not path.is_symlink() and self._holds(_opened(path), first, count)
        except (OSError, pa.ArrowException, UnicodeDecodeError):
            return False
        return self._seen[seen]

    def _holds(self, file: pq.ParquetFile, first: int, count: int) -> bool:
        if file.metadata.num_rows != count or not file.schema_arrow.equals(self._schema()):
            return False
        at = first
        for group in range(file.num_row_groups):
            rows = file.read_row_group(group)
            if any(column.null_count for column in rows.columns):
                return False
            if not np.array_equal(rows["sample"].to_numpy(), np.arange(at, at + len(rows))):
                return False
            if any(np.isinf(rows[name].to_numpy()).any() for name in self.names):  # lacking ones are NaN
                return False
            at += len(rows)
        return at == first + count

    def read(self) -> tuple[Array, dict[int, Reasons]]:
        """Return all measures (n, measures) of a finished study, and sample -> measure -> why it has none."""
        table = _opened(self.folder / SAMPLES).read()
        measures = np.stack([table[name].to_numpy() for name in self.names], axis=1)
        words = table[_MISSING].to_pylist()
        return measures, {self.first + k: reasons_of(text) for k, text in enumerate(words) if text}


def _opened(path: Path) -> pq.ParquetFile:
    """Open a file whose pages are held against their checksums as they are read."""
    return pq.ParquetFile(path, page_checksum_verification=True)


def is_named(folder: Path) -> bool:
    """Whether a folder is one of samples: of a study, finished or not, or of a shard."""
    return fits(_read(folder / STUDY), _About)


def _regrouped(tables: Iterator[Any]) -> Iterator[Any]:
    """Yield tables of `_GROUP` rows each, whatever comes in."""
    held: list[Any] = []
    count = 0
    for table in tables:
        held.append(table)
        count += len(table)
        while count >= _GROUP:
            joined = pa.concat_tables(held).combine_chunks()
            yield joined.slice(0, _GROUP).combine_chunks()
            held, count = [joined.slice(_GROUP)], count - _GROUP
    if count:
        yield pa.concat_tables(held).combine_chunks()


def _read(path: Path) -> dict[str, Any] | None:
    try:
        known = plain_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        return {}
    return known if isinstance(known, dict) else {}
