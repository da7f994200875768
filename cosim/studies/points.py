"""Points of a long study, kept on disk as they are finished, so that an interrupted study goes on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed, wait
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Self, TextIO

from cosim.staging import disk_errors

Progress = Callable[[int, int, str], None]


class Points:
    """Finished points by key.

    Parameters
    ----------
    path
        File of JSON lines, the first of them naming `digest`; one of another digest is begun anew. None keeps
        nothing.
    digest
        What the points depend on.
    on_progress
        Called with (points done, points in all, what is computed).

    Attributes
    ----------
    seconds_before
        Seconds spent on the points that were found on disk.
    """

    def __init__(self, path: Path | None, digest: str = "", on_progress: Progress | None = None) -> None:
        self._known: dict[str, Any] = {}
        self._on_progress = on_progress
        self._done = self._total = 0
        self._stream: TextIO | None = None
        self.seconds_before = 0.0
        if path is None:
            return
        with disk_errors(path):
            lines = _whole_lines(path)
            if lines and lines[0].get("digest") == digest:
                for line in lines[1:]:
                    self._known[line["key"]] = line["value"]
                    self.seconds_before += line["seconds"]
            fresh = not self._known
            self._stream = path.open("w" if fresh else "a", encoding="utf-8")
            if fresh:
                self._write({"digest": digest})

    def expect(self, more: int) -> None:
        """Announce `more` points, for the display of progress."""
        self._total += more

    def get(self, key: str, compute: Callable[[], Any]) -> Any:
        """Return the point `key`, computed unless it is known; its value must be JSON-ready.

        Raises whatever `compute` raises; the points before it are kept.
        """
        if self._on_progress is not None:
            self._on_progress(self._done, max(self._total, self._done + 1), key)
        self._done += 1
        if key not in self._known:
            begun = time.perf_counter()
            value = compute()
            self._known[key] = value
            self._write({"key": key, "value": value, "seconds": time.perf_counter() - begun})
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
                    self._write({"key": key, "value": value, "seconds": seconds})
                    if self._on_progress is not None:
                        self._on_progress(self._done, self._total, key)
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        return [self._known[key] for key in arguments]

    def _write(self, line: dict[str, Any]) -> None:
        if self._stream is not None:
            self._stream.write(json.dumps(line, allow_nan=False) + "\n")
            self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()


def _timed(compute: Callable[[Any], Any], argument: Any) -> tuple[Any, float]:
    """Run in a worker: the value and its seconds."""
    begun = time.perf_counter()
    return compute(argument), time.perf_counter() - begun


def _whole_lines(path: Path) -> list[dict[str, Any]]:
    """Return the lines of the file; one that was cut off by an interruption is taken out of it."""
    if not path.is_file():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    lines = []
    for line in whole.splitlines():
        try:
            lines.append(json.loads(line))
        except ValueError:
            return []
    return lines
