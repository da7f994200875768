"""Measured samples on disk: parts as they are finished, and one Parquet file when all are there.

The file's bytes depend on the samples alone: not on who measured which, in what order or how many at a time.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from cosim.errors import fail
from cosim.staging import disk_errors, whole_file

__all__ = ["SAMPLES", "Samples"]

Array = NDArray[np.float64]

SAMPLES, STUDY, PARTS = "samples.parquet", "study.json", "parts"
_PART = re.compile(r"(\d{12})-(\d+)\.parquet")
#: Samples of a group of rows in the file.
_GROUP = 1 << 16


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

    Raises
    ------
    InputError
        For a folder that holds another study, or that cannot be written.
    """

    def __init__(self, folder: Path, digest: str, names: Sequence[str], first: int, last: int) -> None:
        self.folder, self.digest, self.names = folder, digest, tuple(names)
        self.first, self.last = first, last
        self._parts = folder / PARTS
        about = {"digest": digest, "names": list(names), "first": first, "last": last}
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            known = _read(folder / STUDY)
            if known is not None and known != about:
                fail("holds another study; choose another folder with -o, or remove it", file=str(folder))
            if known is None:
                with whole_file(folder / STUDY) as file:
                    file.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")

    @property
    def study_file(self) -> Path:
        """The file that names the study."""
        return self.folder / STUDY

    def keep(self, first: int, table: Array, failed: Mapping[int, str]) -> None:
        """Keep measures (n, measures) of samples from `first` on, with row -> why it has none."""
        words = [failed.get(k, "") for k in range(len(table))]
        columns: dict[str, Any] = {"sample": np.arange(first, first + len(table), dtype=np.int64)}
        columns |= {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(self.names)}
        rows = pa.table(columns | {"failed": pa.array(words, pa.string())}, schema=self._schema())
        place = self._parts / f"{first:012d}-{len(table)}.parquet"
        with disk_errors(self.folder):
            self._parts.mkdir(exist_ok=True)
            with whole_file(place) as file:
                pq.write_table(rows, file)

    def _schema(self) -> pa.Schema:
        measures = [(name, pa.float64()) for name in self.names]
        return pa.schema([("sample", pa.int64()), *measures, ("failed", pa.string())])

    def done(self) -> list[tuple[int, int]]:
        """Return which samples are there, as (first, behind the last) in order; damaged parts are removed."""
        if (self.folder / SAMPLES).exists() and _rows(self.folder / SAMPLES) == self.last - self.first:
            return [(self.first, self.last)]
        found: list[tuple[int, int]] = []
        for first, count, path in self._listed():
            if _rows(path) != count:
                path.unlink()
            elif found and first <= found[-1][1]:
                found[-1] = found[-1][0], max(found[-1][1], first + count)
            else:
                found.append((first, first + count))
        return found

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
        if not (target.exists() and _rows(target) == self.last - self.first):
            with (
                disk_errors(self.folder),
                whole_file(target) as file,
                pq.ParquetWriter(file, self._schema()) as writer,
            ):
                for table in _regrouped(self._ordered()):
                    writer.write_table(table, row_group_size=_GROUP)
        with disk_errors(self.folder):
            shutil.rmtree(self._parts, ignore_errors=True)
        return target

    def take(self, other: Path) -> None:
        """Take over the samples of another folder of the same study: a shard's."""
        known = _read(other / STUDY)
        if known is None or known.get("digest") != self.digest:
            fail("holds no samples of this study", file=str(other))
        source = Samples(other, self.digest, self.names, int(known["first"]), int(known["last"]))
        whole = source.folder / SAMPLES
        tables: Iterator[Any] = (
            (pa.Table.from_batches([batch]) for batch in pq.ParquetFile(whole).iter_batches(_GROUP))
            if whole.exists()
            else source._ordered()
        )
        for table in tables:
            first = table["sample"][0].as_py()
            place = self._parts / f"{first:012d}-{len(table)}.parquet"
            with disk_errors(self.folder):
                self._parts.mkdir(exist_ok=True)
                with whole_file(place) as file:
                    pq.write_table(table.cast(self._schema()), file)

    def _ordered(self) -> Iterator[Any]:
        """Yield the parts in order, no sample twice."""
        at = self.first
        for first, count, path in self._listed():
            if first + count > at:
                yield pq.read_table(path, schema=self._schema()).slice(max(at - first, 0))
                at = first + count

    def _listed(self) -> list[tuple[int, int, Path]]:
        found = []
        for path in self._parts.iterdir() if self._parts.is_dir() else ():
            match = _PART.fullmatch(path.name)
            if match is not None:
                found.append((int(match[1]), int(match[2]), path))
        return sorted(found, key=lambda part: (part[0], -part[1]))

    def read(self) -> tuple[Array, dict[int, str]]:
        """Return all measures (n, measures) of a finished study, and sample -> why it failed."""
        table = pq.read_table(self.folder / SAMPLES)
        measures = np.stack([table[name].to_numpy() for name in self.names], axis=1)
        words = table["failed"].to_pylist()
        return measures, {self.first + k: why for k, why in enumerate(words) if why}


def _regrouped(tables: Iterator[Any]) -> Iterator[Any]:
    """Yield tables of `_GROUP` rows each, whatever comes in."""
    held: list[Any] = []
    count = 0
    for table in tables:
        held.append(table)
        count += len(table)
        while count >= _GROUP:
            whole = pa.concat_tables(held).combine_chunks()
            yield whole.slice(0, _GROUP).combine_chunks()
            held, count = [whole.slice(_GROUP)], count - _GROUP
    if count:
        yield pa.concat_tables(held).combine_chunks()


def _rows(path: Path) -> int:
    """Return the number of rows of a file; -1 for one that is damaged or not there."""
    try:
        return int(pq.read_metadata(path).num_rows)
    except (OSError, pa.ArrowInvalid):
        return -1


def _read(path: Path) -> dict[str, Any] | None:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}
