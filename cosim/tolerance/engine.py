"""The engine of a Monte Carlo: samples in chunks, by several processes, kept as they are finished.

A sample depends on the study and on its number alone, not on the process that measures it, the chunk or the
attempt: an interrupted study resumes where it was, and ends with the same bytes.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cosim.errors import fail
from cosim.storage.staging import disk_errors
from cosim.tolerance.cluster import clustered
from cosim.tolerance.missing import Missing
from cosim.tolerance.monte_carlo import Engine
from cosim.tolerance.sample_store import LEVELS, Samples
from cosim.tolerance.worker_pool import Chunk, Lost, cores, pooled, prepare_pool
from cosim.types import Array, Progress

__all__ = ["LEVELS", "Job", "Processes", "Work", "merge", "run", "shard"]


#: What a chunk should take [s]: long enough for its receipt to cost nothing.
_CHUNK_S = 2.0
_MOST_TOGETHER = 4096
#: After this long [s] the cost of a sample is known; with this much work left [s] further processes pay.
_PATIENCE_S, _WORTH_S = 3.0, 10.0


#: Measures samples (first, count): measures (count, measures), and row -> measure -> why it has none.
Work = Callable[[int, int], tuple[Array, Missing]]


@dataclass(frozen=True)
class Job:
    """A study as its processes know it; it is sent to each.

    Attributes
    ----------
    digest
        Names all that its samples depend on.
    names
        Measures.
    n
        Samples.
    make
        Called once in each process: what measures.
    """

    digest: str
    names: tuple[str, ...]
    n: int
    make: Callable[[], Work]


@dataclass(frozen=True)
class _Maker:
    """Makes what measures chunks of a job and keeps them in a folder, in a process of the pool."""

    job: Job
    folder: Path
    first: int
    last: int

    def __call__(self) -> Callable[[Chunk], float]:
        work, job = self.job.make(), self.job
        samples = Samples(self.folder, job.digest, job.names, self.first, self.last)

        def measured(chunk: Chunk) -> float:
            begun = time.perf_counter()
            table, failed = work(chunk.first, chunk.count)
            samples.keep(chunk.first, table, failed)
            return time.perf_counter() - begun

        return measured


def run(
    job: Job,
    folder: Path,
    *,
    workers: int | None = None,
    chunk: int | None = None,
    part: tuple[int, int] = (1, 1),
    cluster: str | None = None,
    on_progress: Progress | None = None,
) -> Samples:
    """Measure all samples of a study, or of a shard of it, that are not there yet.

    Parameters
    ----------
    folder
        Keeps the samples.
    workers
        Processes; 1 is this one. By default one for each processor, where a study takes so long that their
        start pays.
    chunk
        Samples that are measured together; as many as take some seconds by default.
    part
        (i, n): the i-th of n shards, i from 1.
    cluster
        Address of a scheduler whose workers measure instead; they must see the folder.

    Raises
    ------
    InputError
        For a folder that holds another study, or in which another process works.
    """
    first, last = shard(job.n, part)
    samples = Samples(folder, job.digest, job.names, first, last)
    with _alone(samples):
        if cluster is None and (workers is None or workers == 1):
            _here(_Maker(job, folder, first, last), samples, _Sizes(chunk), workers is None, on_progress)
        if samples.missing():
            _pooled(job, samples, workers or cores(), _Sizes(chunk), on_progress, cluster)
        if cluster is not None and samples.missing():
            fail("the cluster's workers do not write into this folder: it must be one that all of them see",
                 file=str(folder))  # fmt: skip
        samples.finish()
    return samples


def _here(
    make: _Maker, samples: Samples, sizes: _Sizes, hand_over: bool, on_progress: Progress | None
) -> None:
    """Measure in this process: to the end, or until it shows that others are worth their start."""
    missing, total = samples.missing(), samples.last - samples.first
    left = sum(behind - begin for begin, behind in missing)
    if not left:
        return
    measure, begun, count = make(), time.perf_counter(), 0
    for chunk in sizes.chunks(missing, 1):
        sizes.took(chunk.count, measure(chunk))
        count += chunk.count
        if on_progress is not None:
            on_progress(total - left + count, total, "samples")
        taken = time.perf_counter() - begun
        if hand_over and (left - count) * taken / count > _WORTH_S and cores() > 1:
            prepare_pool()
            if taken > _PATIENCE_S:
                return


def _pooled(
    job: Job,
    samples: Samples,
    workers: int,
    sizes: _Sizes,
    on_progress: Progress | None,
    cluster: str | None,
) -> None:
    missing, total = samples.missing(), samples.last - samples.first
    left = sum(behind - begin for begin, behind in missing)
    count, done = min(workers, left), total - left
    maker = _Maker(job, samples.folder.resolve(), samples.first, samples.last)
    chunks = sizes.chunks(missing, count)
    answers = (
        clustered(maker, f"{job.digest} {maker.folder}", chunks, cluster)
        if cluster
        else pooled(maker, chunks, count)
    )
    for finished, answer in answers:
        if isinstance(answer, Lost):
            lacking = np.full((1, len(job.names)), np.nan)
            samples.keep(finished.first, lacking, {0: dict.fromkeys(job.names, f"the sample {answer.why}")})
        else:
            sizes.took(finished.count, answer)
        done += finished.count
        if on_progress is not None:
            on_progress(done, total, "samples")


@dataclass(frozen=True)
class Processes:
    """How the engine measures: see `run`; `shards` are folders to be merged."""

    folder: Path
    workers: int | None = None
    chunk: int | None = None
    shards: tuple[Path, ...] = ()
    cluster: str | None = None

    def beside(self, name: str) -> Processes:
        """Return the same for samples that are kept in a folder within."""
        return replace(self, folder=self.folder / LEVELS / name, shards=())

    def of(self, job: Job) -> Engine:
        """Return what measures a job."""

        def engine(on_progress: Progress | None) -> tuple[Array, Missing]:
            if self.shards:
                return merge(job, self.folder, self.shards).read()
            return self.measured(job, on_progress)

        return engine

    def measured(self, job: Job, on_progress: Progress | None = None) -> tuple[Array, Missing]:
        """Measure what of a job is not there yet; return all of it."""
        rows = run(
            job, self.folder, workers=self.workers, chunk=self.chunk, cluster=self.cluster,
            on_progress=on_progress,
        )  # fmt: skip
        return rows.read()


def shard(n: int, part: tuple[int, int]) -> tuple[int, int]:
    """Return the samples of the i-th of so many shards, as (first, behind the last).

    Raises
    ------
    InputError
        For a shard that does not exist.
    """
    i, of = part
    if not 1 <= i <= of or of > n:
        allowed = f"1/{of} to {of}/{of}" if 1 <= of <= n else f"I/N with I <= N <= {n}, the samples"
        fail("is not a shard of the study", key="--shard", value=f"{i}/{of}", allowed=allowed)
    return (i - 1) * n // of, i * n // of


def merge(job: Job, folder: Path, shards: Sequence[Path]) -> Samples:
    """Put shards together.

    Raises
    ------
    InputError
        For a folder of another study, and where samples are missing.
    """
    samples = Samples(folder, job.digest, job.names, 0, job.n)
    with _alone(samples):
        for each in shards:
            samples.take(each)
        gaps = samples.missing()
        if gaps:
            some = ", ".join(f"{first} to {behind - 1}" for first, behind in gaps[:3])
            fail(f"samples are missing: {some}", key="--merge", value=" ".join(map(str, shards)))
        samples.finish()
    return samples


class _Sizes:
    """How many samples a chunk has: asked for, or as many as take some seconds."""

    def __init__(self, asked: int | None) -> None:
        self._asked, self._now = asked, asked or 1

    def took(self, count: int, seconds: float) -> None:
        """Learn from a chunk."""
        if self._asked is None:
            wanted = int(count * _CHUNK_S / max(seconds, 1e-3))
            self._now = min(max(wanted, 1), 4 * max(count, self._now), _MOST_TOGETHER)

    def chunks(self, missing: Sequence[tuple[int, int]], workers: int) -> Iterator[Chunk]:
        """Yield chunks; near the end they shrink, so that no process waits for another."""
        left = sum(behind - first for first, behind in missing)
        for first, behind in missing:
            at = first
            while at < behind:
                size = self._now if self._asked else max(min(self._now, left // (2 * workers)), 1)
                count = min(size, behind - at)
                yield Chunk(at, count)
                at += count
                left -= count


@contextmanager
def _alone(samples: Samples) -> Iterator[None]:
    """Make sure that no other process works in the folder; the lock goes with this one."""
    with disk_errors(samples.folder), samples.study_file.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fail(
                "another process of cosim works here: wait, or choose another folder",
                file=str(samples.folder),
            )
        samples.check_name()
        yield
