"""Chunks of samples on a cluster: the workers write them into the study's folder, which all of them see.

A task is a chunk, and what comes back is a receipt. Few are in flight, and each is let go of at once: the
scheduler keeps nothing, and no finished chunk is measured again when a worker dies.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from importlib import import_module
from typing import Any

from cosim.errors import CosimError, fail
from cosim.tolerance.worker_pool import Chunk, Lost

__all__ = ["clustered"]

Maker = Callable[[], Callable[[Chunk], Any]]

#: Chunks in flight: for each worker, and in all.
_EACH, _MOST = 2, 200
#: A scheduler that does not answer for this long [s] counts as gone.
_PATIENCE_S = 10
#: How long [s] a study without workers waits for the next one: a batch system may start one.
_NEXT_S = 60
#: Between two attempts to send the work [s].
_PAUSE_S = 0.2

#: Measurers of a worker's process by study, each made once.
_made: dict[str, Callable[[Chunk], Any]] = {}


def _measure(make: Maker, study: str, chunk: Chunk) -> Any:
    """Measure a chunk in a worker's process."""
    if study not in _made:
        _made.clear()
        _made[study] = make()
    try:
        return _made[study](chunk)
    except CosimError as error:
        return error


def _answer(future: Any, killed: type[Exception]) -> Any:
    """Return what a task returned, or that it has killed its workers."""
    try:
        return future.result()
    except killed as error:
        return error


def _sent(client: Any, make: Maker, address: str) -> Any:
    """Send the maker of the work to all workers; if they die meanwhile, to the next ones.

    Raises
    ------
    InputError
        Where no worker comes, or the scheduler is gone.
    """
    end = time.monotonic() + _NEXT_S
    while True:
        try:
            client.wait_for_workers(1, timeout=max(end - time.monotonic(), 1.0))
            return client.scatter(make, broadcast=True)
        # the scheduler's KeyError: a worker that took the work and died before that was noted
        except (OSError, TimeoutError, CancelledError, KeyError) as error:
            if client.status != "running" or time.monotonic() >= end:
                fail(
                    f"scheduler or workers are gone ({type(error).__name__}); what was measured is kept: "
                    "the same command goes on",
                    key="--cluster", value=address,
                )  # fmt: skip
        time.sleep(_PAUSE_S)


def clustered(make: Maker, study: str, chunks: Iterator[Chunk], address: str) -> Iterator[tuple[Chunk, Any]]:
    """Yield each chunk with what its work returned, as they are finished; see `cosim.tolerance.worker_pool`.

    Parameters
    ----------
    make
        Makes what measures; it is sent to each worker once.
    study
        Names what it makes, and where.
    address
        Of a `distributed` scheduler: ``tcp://host:8786``.

    Raises
    ------
    InputError
        Without the extra ``cluster``, and where no scheduler answers or no worker is there.
    CosimError
        What the work raised.
    """
    try:
        distributed = import_module("distributed")
    except ImportError as error:
        reason = "needs the package `distributed`"
        if error.name != "distributed":  # it is there, and something that it needs is not
            reason = f"`distributed` cannot be loaded ({error})"
        fail(f"{reason}: pip install 'cosim[cluster]'", key="--cluster", value=address)
    try:
        client = distributed.Client(address, timeout=_PATIENCE_S)
    except (OSError, TimeoutError, ValueError) as error:
        fail(f"no scheduler answers: {error}", key="--cluster", value=address, allowed="tcp://HOST:PORT")
    with client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        if not workers:
            fail("the scheduler has no workers", key="--cluster", value=address)
        kept = _sent(client, make, address)
        waiting, flying = deque[Chunk](), dict[Any, Chunk]()
        while True:
            while len(flying) < min(_EACH * workers, _MOST):
                chunk = waiting.popleft() if waiting else next(chunks, None)
                if chunk is None:
                    break
                flying[client.submit(_measure, kept, study, chunk, pure=False)] = chunk
            if not flying:
                return
            try:
                done = distributed.wait(list(flying), return_when="FIRST_COMPLETED").done
                ended = [(future, _answer(future, distributed.KilledWorker)) for future in done]
            except CancelledError:  # gone with the scheduler, or the last worker that had work or answer
                waiting.extend(flying.values())
                flying.clear()
                kept = _sent(client, make, address)
                continue
            for future, answer in ended:
                chunk = flying.pop(future)
                future.release()
                if isinstance(answer, CosimError):
                    raise answer
                if not isinstance(answer, distributed.KilledWorker):
                    yield chunk, answer
                elif chunk.count > 1:
                    waiting.extend(chunk.halves())
                elif not chunk.again:
                    waiting.append(Chunk(chunk.first, 1, again=True))
                else:
                    yield chunk, Lost("took its worker with it twice")
