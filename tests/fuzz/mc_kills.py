"""Studies of Monte Carlo killed at random instants: the same bytes at the end, and nothing measured twice."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .commands import Defect
from .targets import Project

__all__ = ["kill_studies"]

_SAMPLES, _CHUNK = 400, 5
#: Share of the kills that come after the first samples.
_AT_WORK = 0.67
_MEASURE = "max_penetration"
#: A command that was left alone for so long [s] hangs.
_LIMIT_S = 300.0
_LOCAL = ("parent", "Ctrl-C", "worker")
_CLUSTER = ("scheduler", "cluster's worker")
_DASK = ("--no-dashboard",)


def kill_studies(project: Project, folder: Path, number: int, count: int) -> dict[str, int]:
    """Kill studies at random instants, go on, and compare with one that was never disturbed.

    Every second time what was finished is marked before the study goes on: a mark that is lost was measured
    twice. Scheduler and workers of a cluster are among the victims where `distributed` is installed.

    Returns
    -------
    dict
        How many of each kind were killed before their end, and samples that were kept by then.

    Raises
    ------
    Defect
        For other bytes than those of an undisturbed study, samples measured again, and a command that hangs.
    """
    chance = random.Random(number)
    scene = next(path for path in project.scenes if path.name == "drop.toml")
    words = ["mc", str(scene), "--set", "solver.model=linear", "--set", "duration_s=0.3",
             "--measure", _MEASURE, "-n", str(_SAMPLES), "--chunk", str(_CHUNK)]  # fmt: skip
    begun = time.monotonic()
    process = _start([*words, "--workers", "2"], folder / "whole", folder)
    _until_kept(process, folder / "whole" / "parts")
    first = time.monotonic()
    _until_kept(process, folder / "whole" / "samples.parquet")
    sampling = time.monotonic() - first
    _ended(process, "undisturbed", folder)
    length = time.monotonic() - begun
    truth = (folder / "whole" / "samples.parquet").read_bytes()
    kinds = _LOCAL + (_CLUSTER if find_spec("distributed") else ())
    counts: Counter[str] = Counter()
    for turn in range(count):
        kind, out = kinds[turn % len(kinds)], folder / f"killed{turn}"
        # most of a short command is its start and its page: most kills come while samples are measured
        at_work = kind in _LOCAL and chance.random() < _AT_WORK
        wait_s = chance.uniform(0.0, sampling if at_work else length)
        counts[kind] += (
            _cluster(kind, words, out, folder, wait_s)
            if kind in _CLUSTER
            else _local(kind, words, out, folder, wait_s, at_work=at_work)
        )
        marked = _mark(out) if turn % 2 else {}
        kept = _SAMPLES if (out / "samples.parquet").exists() else len(_parts(out)) * _CHUNK
        counts["samples kept"] += kept
        since = f"the first samples of {sampling:.2f} s" if at_work else f"the start, of {length:.2f} s"
        print(f"  turn {turn}, {kind}, {wait_s:.2f} s after {since}: {kept} samples kept", flush=True)
        # a shard of one is the study without its page
        rest = [*words, "--workers", "2", *(["--shard", "1/1"] if turn % 3 else [])]
        _ended(_start(rest, out, folder), f"turn {turn}, {kind}", folder)
        data = (out / "samples.parquet").read_bytes()
        if not marked and data != truth:
            raise Defect(f"turn {turn}, {kind}: other bytes than an undisturbed study")
        if marked:
            _compare(out, folder / "whole", marked, f"turn {turn}, {kind}")
    return dict(counts)


def _local(kind: str, words: list[str], out: Path, folder: Path, wait_s: float, *, at_work: bool) -> bool:
    """Kill a study on this machine, or one of its workers; return whether it was still at work.

    The time counts from the first samples that are kept, if `at_work`.
    """
    process = _start([*words, "--workers", "2"], out, folder)
    if at_work:
        _until_kept(process, out / "parts")
    with suppress(subprocess.TimeoutExpired):
        process.wait(wait_s)
    if process.poll() is not None:
        return False
    if kind == "worker":
        pool = [pid for pid in _children(process.pid) if _is_template(pid)]  # which copies itself for each
        workers = [pid for template in pool for pid in _children(template)]
        if pool:
            with suppress(ProcessLookupError):  # it was just done
                os.kill(random.Random(wait_s).choice([*pool, *workers]), signal.SIGKILL)
        _ended(process, kind, folder)
        return bool(pool)
    process.send_signal(signal.SIGKILL if kind == "parent" else signal.SIGINT)
    _wait(process, kind)
    if kind == "Ctrl-C" and process.returncode not in (0, 130):  # 0: it came when all was said
        message = (folder / "said").read_text(errors="replace")
        raise Defect(f"{kind}, after {wait_s:.3f} s: exit code {process.returncode}: {message}")
    for _ in range(600):  # workers that outlive their parent end with their chunk
        try:
            os.killpg(process.pid, 0)
        except (ProcessLookupError, PermissionError):
            break
        time.sleep(0.1)
    return True


def _until_kept(process: subprocess.Popen[bytes], place: Path) -> None:
    """Wait for what a study keeps, or its end."""
    while process.poll() is None and not place.exists():
        time.sleep(0.005)


def _children(pid: int) -> list[int]:
    with suppress(OSError):
        return list(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))
    return []


def _is_template(pid: int) -> bool:
    with suppress(OSError):
        return b"forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def _cluster(kind: str, words: list[str], out: Path, folder: Path, wait_s: float) -> bool:
    """Kill the scheduler, or the only worker, of a cluster at work."""
    with _dask() as (address, scheduler, workers, another):
        process = _start([*words, "--cluster", address], out, folder)
        with suppress(subprocess.TimeoutExpired):
            process.wait(wait_s)
        if process.poll() is not None:
            return False
        victim = scheduler if kind == "scheduler" else workers[0]
        victim.kill()
        victim.wait()
        if kind == "scheduler":
            _wait(process, kind)
            if process.returncode == 0 and not (out / "samples.parquet").exists():
                raise Defect("a study without a scheduler ended as if it were done")
        else:
            another()
            _wait(process, kind)
            message = (folder / "output").read_text(errors="replace")
            # a study that begins between two workers says so at once
            between = process.returncode == 2 and "the scheduler has no workers" in message
            if process.returncode and not between:
                raise Defect(f"{kind}: exit code {process.returncode}: {message}")
    return True


@contextmanager
def _dask() -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]], object]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    processes: list[subprocess.Popen[bytes]] = []

    def started(*command: str) -> subprocess.Popen[bytes]:
        processes.append(
            subprocess.Popen([sys.executable, "-m", *command], stdin=subprocess.DEVNULL,
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        )  # fmt: skip
        return processes[-1]

    def worker() -> subprocess.Popen[bytes]:
        return started("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", *_DASK)

    try:
        scheduler = started("distributed.cli.dask_scheduler", "--host", address, "--no-jupyter", *_DASK)
        workers = [worker()]
        _until_up(address)
        yield address, scheduler, workers, worker
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def _until_up(address: str) -> None:
    from importlib import import_module

    distributed = import_module("distributed")
    with distributed.Client(address, timeout=_LIMIT_S) as client:
        client.wait_for_workers(1, timeout=_LIMIT_S)


def _start(words: list[str], out: Path, folder: Path) -> subprocess.Popen[bytes]:
    with (folder / "output").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "cosim", *words, "-o", str(out)], cwd=folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=log, env={**os.environ, "TMPDIR": str(folder)},
            start_new_session=True,
        )  # fmt: skip


def _wait(process: subprocess.Popen[bytes], what: str) -> None:
    try:
        process.wait(_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        raise Defect(f"{what}: still runs after {_LIMIT_S:g} s") from None


def _ended(process: subprocess.Popen[bytes], what: str, folder: Path) -> None:
    """Wait for a command that is to succeed."""
    _wait(process, what)
    if process.returncode:
        message = (folder / "output").read_text(errors="replace")
        raise Defect(f"{what}: exit code {process.returncode}: {message}")


def _parts(out: Path) -> list[Path]:
    return sorted((out / "parts").glob("*.parquet"))


def _mark(out: Path) -> dict[int, int]:
    """Move the last digit of every finished sample; return first sample -> count of each part."""
    marked = {}
    for part in _parts(out):
        try:
            table = pq.read_table(part)
        except (OSError, pa.ArrowException):  # half written: it is to be measured again
            continue
        column = np.nextafter(table[_MEASURE].to_numpy(), np.inf)
        place = table.schema.get_field_index(_MEASURE)
        pq.write_table(table.set_column(place, table.schema.field(place), pa.array(column)), part)
        marked[table["sample"][0].as_py()] = len(table)
    return marked


def _compare(out: Path, undisturbed: Path, marked: dict[int, int], what: str) -> None:
    result, truth = (pq.read_table(at / "samples.parquet")[_MEASURE].to_numpy() for at in (out, undisturbed))
    wanted = truth.copy()
    for first, count in marked.items():
        wanted[first : first + count] = np.nextafter(truth[first : first + count], np.inf)
    if not np.array_equal(result, wanted):
        again = [k for k in np.flatnonzero(result != wanted) if result[k] == truth[k]]
        raise Defect(f"{what}: samples measured again: {again}, others differ: {np.sum(result != wanted)}")
