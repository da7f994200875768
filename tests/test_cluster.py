"""A study on a cluster: a real scheduler and two workers, as processes of their own on loopback."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from engine_jobs import job

from cosim.errors import InputError
from cosim.tolerance.engine import run

N = 203


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


class Cluster:
    """A scheduler and workers as processes of their own; all end with the block."""

    def __init__(self, workers: int) -> None:
        self.address = f"tcp://127.0.0.1:{free_port()}"
        path = os.pathsep.join([str(Path(__file__).parent), *(p for p in sys.path if p)])
        self._env = {**os.environ, "PYTHONPATH": path, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
        self._processes: list[subprocess.Popen[bytes]] = []
        quiet = ("--no-dashboard", "--no-jupyter")
        self.scheduler = self._started("distributed.cli.dask_scheduler", "--host", self.address, *quiet)
        self.workers = [self.worker() for _ in range(workers)]

    def _started(self, *words: str) -> subprocess.Popen[bytes]:
        self._processes.append(
            subprocess.Popen(
                [sys.executable, "-m", *words], env=self._env, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )  # fmt: skip
        return self._processes[-1]

    def worker(self) -> subprocess.Popen[bytes]:
        words = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        return self._started("distributed.cli.dask_worker", self.address, *words)

    def __enter__(self) -> "Cluster":
        from importlib import import_module

        with import_module("distributed").Client(self.address, timeout=120) as client:
            client.wait_for_workers(len(self.workers), timeout=120)
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._processes):
            process.kill()
            process.wait()


def samples(folder: Path) -> bytes:
    return (folder / "mc" / "samples.parquet").read_bytes()


@pytest.mark.slow
def test_the_same_bytes_on_a_cluster_and_one_worker_killed(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[cluster]'")
    run(job(tmp_path / "truth", N), tmp_path / "truth" / "mc", workers=1)
    with Cluster(2) as cluster:
        run(job(tmp_path / "far", N), tmp_path / "far" / "mc", chunk=7, cluster=cluster.address)
        assert samples(tmp_path / "far") == samples(tmp_path / "truth")
        cluster.workers[0].kill()
        cluster.workers[0].wait()
        run(job(tmp_path / "less", N), tmp_path / "less" / "mc", chunk=7, cluster=cluster.address)
        assert samples(tmp_path / "less") == samples(tmp_path / "truth")


@pytest.mark.slow
def test_the_only_worker_killed_at_nine_tenths_leaves_what_it_finished(tmp_path: Path) -> None:
    """Another one measures the rest; at most the chunks in flight are measured twice."""
    pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[cluster]'")
    run(job(tmp_path / "truth", N), tmp_path / "truth" / "mc", workers=1)
    folder, chunk = tmp_path / "far", 7
    with Cluster(1) as cluster:
        killed: list[int] = []

        def watch(done: int, of: int, _: str) -> None:
            if done >= 0.9 * of and not killed:
                killed.append(done)
                cluster.workers[0].kill()
                cluster.workers[0].wait()
                cluster.worker()

        run(
            job(folder, N, slow_s=0.01),
            folder / "mc",
            chunk=chunk,
            cluster=cluster.address,
            on_progress=watch,
        )
    assert samples(folder) == samples(tmp_path / "truth")
    counts = np.zeros(N, int)
    for line in (folder / "log").read_text().splitlines():
        first, count = map(int, line.split())
        counts[first : first + count] += 1
    assert counts.min() == 1
    assert (counts > 1).sum() <= 2 * chunk


@pytest.mark.slow
def test_a_scheduler_that_dies_is_reported_and_what_was_measured_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[cluster]'")
    run(job(tmp_path / "truth", N), tmp_path / "truth" / "mc", workers=1)
    folder = tmp_path / "far"
    with Cluster(1) as cluster:

        def watch(done: int, of: int, _: str) -> None:
            if done >= of // 2 and cluster.scheduler.poll() is None:
                cluster.scheduler.kill()
                cluster.scheduler.wait()

        slow = job(folder, N, slow_s=0.01)
        with pytest.raises(InputError, match="the same command goes on"):
            run(slow, folder / "mc", chunk=7, cluster=cluster.address, on_progress=watch)
    run(job(folder, N), folder / "mc", workers=1)
    assert samples(folder) == samples(tmp_path / "truth")
    lines = (folder / "log").read_text().splitlines()
    assert sum(int(line.split()[1]) for line in lines) < 1.2 * N  # the first half was not measured again


def resident_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.slow
def test_the_scheduler_keeps_nothing_of_ten_thousand_chunks(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[cluster]'")
    with Cluster(2) as cluster:
        seen: list[float] = []

        def watch(done: int, of: int, _: str) -> None:
            if done % 500 == 0:
                seen.append(resident_mb(cluster.scheduler.pid))

        run(job(tmp_path, 10_000), tmp_path / "mc", chunk=1, cluster=cluster.address, on_progress=watch)
    print([round(mb, 1) for mb in seen])
    assert seen[-1] - seen[0] <= 50.0


def test_a_cluster_that_is_not_there_is_reported(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(InputError, match=r"pip install|no scheduler answers"):
        run(job(tmp_path, 5), tmp_path / "mc", cluster=address)
    # nothing is lost: the same study goes on here
    assert len(run(job(tmp_path, 5), tmp_path / "mc", workers=1).read()[0]) == 5
