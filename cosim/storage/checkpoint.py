"""Points of a long study, kept on disk as they are finished, so that an interrupted study goes on."""

from __future__ import annotations

import fcntl
import json
import os
import time
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Self, TextIO

from cosim.errors import SimulationError, fail
from cosim.storage.checksums import plain_json
from cosim.storage.field_types import fits
from cosim.storage.staging import disk_errors
from cosim.types import Progress

#: How the first line of a file of points begins.
_HEAD = '{"digest": "'


class Points:
    """Finished points by key.

    While it is open the file is locked: a second process that writes to the same place is refused.

    Parameters
    ----------
    path
        File of JSON lines, the first of them naming `digest`; one of another digest is begun anew. None keeps
        nothing. A line that is damaged is computed again.
    digest
        What the points depend on.
    on_progress
        Called with (points done, points in all, what is computed).

    Attributes
    ----------
    seconds_before
        Seconds spent on the points that were found on disk.
    restored
        How many points were found on disk.

    Raises
    ------
    InputError
        For a file that is not ours, one that another process writes to, and a place that cannot be written.
    """

    def __init__(self, path: Path | None, digest: str = "", on_progress: Progress | None = None) -> None:
        self._known: dict[str, Any] = {}
        self._on_progress = on_progress
        self._done = self._total = 0
        self._stream: TextIO | None = None
        self._path = path
        self.seconds_before = 0.0
        self.restored = 0
        if path is None:
            return
        with disk_errors(path):
            self._stream = path.open("a+", encoding="utf-8", errors="replace", newline="")
            try:
                _lock(self._stream, path)
                self._restore(self._stream, path, digest)
            except BaseException:
                self._stream.close()
                raise

    def _restore(self, stream: TextIO, path: Path, digest: str) -> None:
        """Take over the points of the file, and leave in it no line that was cut off or damaged."""
        stream.seek(0)
        text = stream.read()
        if not (text.startswith(_HEAD) or _HEAD.startswith(text)):
            fail("holds no points of cosim; nothing was changed, choose another folder", file=str(path))
        head, *lines = text.split("\n")
        restored = [_point(line) for line in lines] if _parsed(head) == {"digest": digest} else []
        points = [point for point in restored if point is not None]
        self._known = {key: value for key, value, _ in points}
        self.restored = len(self._known)
        self.seconds_before = sum(seconds for _, _, seconds in points)
        if not points or restored != [*points, None]:  # the last line is the empty one behind the last break
            stream.truncate(0)
            self._write({"digest": digest})
            for point in points:
                self._keep(*point)

    def expect(self, more: int) -> None:
        """Announce `more` points, for the display of progress."""
        self._total += more

    def get(self, key: str, compute: Callable[[], Any], form: Any = Any) -> Any:
        """Return the point `key`, computed unless it is known; its value must be JSON-ready.

        A kept value that is not of the `form` (`field_types`) is not ours: it is computed again.
        Raises whatever `compute` raises; the points before it are kept.
        """
        if self._on_progress is not None:
            self._on_progress(self._done, max(self._total, self._done + 1), key)
        self._done += 1
        if key not in self._known or not fits(self._known[key], form):
            begun = time.perf_counter()
            value = compute()
            self._known[key] = value
            self._keep(key, value, time.perf_counter() - begun)
        return self._known[key]

    def map(
        self, compute: Callable[[Any], Any], arguments: Mapping[str, Any], workers: int | None = None
    ) -> list[Any]:
        """Return ``compute(argument)`` for every key, the known ones from disk, the others in parallel.

        `compute` is a function of a module; values do not depend on the number of workers (default: one for
        each processor). Raises what `compute` raises; finished points are kept.
        """
        self.expect(len(arguments))
        missing = {key: argument for key, argument in arguments.items() if key not in self._known}
        self._done += len(arguments) - len(missing)
        count = min(workers or os.cpu_count() or 1, len(missing))
        if count <= 1:
            for key, argument in missing.items():
                self.get(key, partial(compute, argument))
            return [self._known[key] for key in arguments]
        try:
            self._in_parallel(compute, missing, count)
        except BrokenProcessPool as error:
            raise SimulationError(
                "a process that computes points was ended from outside (too little memory?); finished points "
                "are kept: the same command goes on there"
            ) from error
        return [self._known[key] for key in arguments]

    def _in_parallel(self, compute: Callable[[Any], Any], missing: Mapping[str, Any], count: int) -> None:
        # spawn: a fork would copy the threads of numerical libraries in whatever state they are
        with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
            under_way: dict[Future[Any], str] = {}
            for key, argument in missing.items():
                under_way[pool.submit(_timed, compute, argument)] = key
                if len(under_way) == 1:  # it may compile what the others then find compiled
                    wait(under_way)
            try:
                for future in as_completed(under_way):
                    key = under_way[future]
                    value, seconds = future.result()
                    self._done += 1
                    self._known[key] = value
                    self._keep(key, value, seconds)
                    if self._on_progress is not None:
                        self._on_progress(self._done, self._total, key)
            finally:
                pool.shutdown(wait=False, cancel_futures=True)

    def _keep(self, key: str, value: Any, seconds: float) -> None:
        self._write({"key": key, "value": value, "seconds": seconds, "crc": _crc(key, value, seconds)})

    def _write(self, line: dict[str, Any]) -> None:
        if self._stream is not None and self._path is not None:
            with disk_errors(self._path):
                self._stream.write(json.dumps(line, allow_nan=False) + "\n")
                self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None and self._path is not None:
            with disk_errors(self._path):
                self._stream.close()


def _timed(compute: Callable[[Any], Any], argument: Any) -> tuple[Any, float]:
    """Run in a worker: the value and its seconds."""
    begun = time.perf_counter()
    return compute(argument), time.perf_counter() - begun


def _lock(stream: TextIO, path: Path) -> None:
    """Make sure that no other process writes these points; the lock goes with the stream."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        fail("another process of cosim writes here; choose another folder or wait for it", file=str(path))


def _crc(key: str, value: Any, seconds: float) -> int:
    """Return the check sum of a point, so that a damaged line is not taken for a result."""
    return zlib.crc32(json.dumps([key, value, seconds], allow_nan=False).encode())


def _parsed(line: str) -> Any:
    try:
        return plain_json(line)
    except (ValueError, RecursionError):
        return None


def _point(line: str) -> tuple[str, Any, float] | None:
    """Return key, value and seconds of a line; None for one that was cut off or damaged."""
    match _parsed(line):
        case {"key": str(key), "value": value, "seconds": int() | float() as seconds, "crc": int(crc)}:
            try:
                return (key, value, float(seconds)) if _crc(key, value, seconds) == crc else None
            except ValueError:
                return None
    return None
