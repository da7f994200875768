"""Processes that work through chunks of samples; one that dies is replaced, and the others go on."""

from __future__ import annotations

import gc
import multiprocessing.forkserver
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from cosim.errors import CosimError
from cosim.quick_start import FRUGAL, collect_seldom, defer
from cosim.storage.staging import make_scratch

__all__ = ["Chunk", "Lost", "cores", "pooled", "prepare_pool"]

#: What a worker needs loaded for a study: a second of imports.
_LOADED = "cosim.tolerance.worker_modules"
#: Where the template's socket lies.
_scratch: Path | None = None
#: Keeps these modules from starting threads, which no process copies: OpenBLAS, and the memory of Arrow.
_ONE_THREAD = {**FRUGAL, "JE_ARROW_MALLOC_CONF": "background_thread:false"}

#: Makes what works in a process: called once there, then its result with each chunk.
Maker = Callable[[], Callable[["Chunk"], Any]]


@dataclass(frozen=True)
class Chunk:
    """Samples `first` to ``first + count - 1``; `again`: they took a process with them before."""

    first: int
    count: int
    again: bool = False

    def halves(self) -> list[Chunk]:
        """Return its samples as chunks of one: one of them is to blame."""
        return [Chunk(k, 1, self.again) for k in range(self.first, self.first + self.count)]


@dataclass(frozen=True)
class Lost:
    """What comes back of a sample that took two processes with it."""

    why: str


class _Worker:
    def __init__(self, make: Maker) -> None:
        context: Any = get_context("forkserver" if prepare_pool() else "spawn")
        self.pipe, theirs = context.Pipe()
        # a daemon: Ctrl-C may come before the pool knows of it, and an interpreter waits for others
        self.process: BaseProcess = context.Process(
            target=_serve, args=(theirs, make, dict(os.environ)), daemon=True
        )
        # a Ctrl-C waits: it would leave a process half started here, and a traceback of its imports there
        with _interrupts_held(), suppress(BrokenPipeError):  # it died while it started: its pipe says so
            self.process.start()
        theirs.close()
        self.chunk: Chunk | None = None

    def give(self, chunk: Chunk) -> None:
        self.chunk = chunk
        with suppress(BrokenPipeError):  # it died idle: what it would have answered ends likewise
            self.pipe.send(chunk)

    def close(self) -> None:
        """End the process."""
        self.pipe.close()
        if self.process.pid is None:
            return
        self.process.join(2.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Let Ctrl-C wait; processes that are started meanwhile are spared it."""
    if threading.current_thread() is not threading.main_thread():  # which alone is told of it
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def prepare_pool() -> bool:
    """Start the process, if there is none yet, that loads what workers need and then copies itself for each.

    It loads while this one goes on, has one thread, and ends with this process. Modules are looked for where
    they are here, and not in the folder that we happen to be in. (A fork of this very process would copy the
    threads of numerical libraries.)

    Returns
    -------
    bool
        Whether it is there; not where the system has none, or the path of its socket would be too long.
    """
    if sys.platform != "linux":
        return False
    get_context("forkserver").set_forkserver_preload([_LOADED])
    paths = [path for path in sys.path if path]
    variables = {"PYTHONPATH": os.pathsep.join(paths), "PYTHONSAFEPATH": "1", **_ONE_THREAD}
    with _interrupts_held(), _environment(variables):
        try:
            with _socket_in_scratch(), _module_path(paths):
                multiprocessing.forkserver.ensure_running()
        except OSError:
            return False
    return True


@contextmanager
def _socket_in_scratch() -> Iterator[None]:
    """Let the template's socket lie in a folder of ours: the next process removes it after a kill."""
    global _scratch
    if _scratch is None or not _scratch.is_dir():
        _scratch = make_scratch("pool")
        # behind the socket's own end, which has the priority -100
        Finalize(None, shutil.rmtree, (_scratch, True), exitpriority=-200)
    before, tempfile.tempdir = tempfile.tempdir, str(_scratch)
    try:
        yield
    finally:
        tempfile.tempdir = before


@contextmanager
def _module_path(paths: list[str]) -> Iterator[None]:
    """Let the template look for modules in these folders: newer Pythons hand it ours as they stand."""
    before = list(sys.path)
    sys.path[:] = paths
    try:
        yield
    finally:
        sys.path[:] = before


@contextmanager
def _environment(more: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in more}
    os.environ.update(more)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(pipe: Connection, make: Maker, environment: Mapping[str, str]) -> None:
    """Work until the parent closes its end, or is gone; `environment` is the parent's, as it is now."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    os.environ.clear()
    os.environ.update(environment)
    tempfile.tempdir = None  # of an environment before
    collect_seldom()
    defer()
    try:
        work = make()
        while True:
            chunk = pipe.recv()
            try:
                answer: Any = work(chunk)
            except CosimError as error:
                answer = error
            pipe.send(answer)
            gc.collect(1)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def pooled(
    make: Maker, chunks: Sequence[Chunk] | Iterator[Chunk], workers: int
) -> Iterator[tuple[Chunk, Any]]:
    """Yield each chunk with what its work returned, as they are finished.

    A chunk whose process died is done again sample by sample; a sample that takes a second process with it
    comes back as `Lost`.

    Raises
    ------
    CosimError
        What the work raised.
    """
    source, waiting = iter(chunks), deque[Chunk]()
    pool: list[_Worker] = []

    def following() -> Chunk | None:
        return waiting.popleft() if waiting else next(source, None)

    try:
        while True:
            for worker in pool:
                if worker.chunk is None and (chunk := following()) is not None:
                    worker.give(chunk)
            while len(pool) < workers and (chunk := following()) is not None:
                pool.append(_Worker(make))
                pool[-1].give(chunk)
            busy = [worker for worker in pool if worker.chunk is not None]
            if not busy:
                return
            ready = wait([worker.pipe for worker in busy])
            for worker in [each for each in busy if each.pipe in ready]:
                chunk = worker.chunk
                assert chunk is not None
                try:
                    answer = worker.pipe.recv()
                except (EOFError, OSError):
                    pool.remove(worker)
                    worker.close()
                    if chunk.count > 1:
                        waiting.extend(chunk.halves())
                    elif not chunk.again:
                        waiting.append(Chunk(chunk.first, 1, again=True))
                    else:
                        yield chunk, Lost(_ended(worker.process))
                    continue
                worker.chunk = None
                if isinstance(answer, CosimError):
                    raise answer
                yield chunk, answer
    finally:
        for worker in pool:
            worker.close()


def _ended(process: BaseProcess) -> str:
    code = process.exitcode
    how = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    return f"took its process with it twice ({how})"


def cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
