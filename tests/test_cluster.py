"""A study on a cluster: a real scheduler and two workers, as processes of their own on loopback."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from engine_jobs import job

from cosim.errors import InputError
from cosim.tolerance.engine import run

N = 203


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@pytest.mark.slow
def test_the_same_bytes_on_a_cluster_and_one_worker_killed(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[cluster]'")
    address = f"tcp://127.0.0.1:{free_port()}"
    path = os.pathsep.join([str(Path(__file__).parent), *(p for p in sys.path if p)])
    env = {**os.environ, "PYTHONPATH": path, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}

    def started(*words: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", *words], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    scheduler = ["distributed.cli.dask_scheduler", "--host", address, "--no-dashboard", "--no-jupyter"]
    worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes = [started(*scheduler)]
    try:
        processes += [started(*worker), started(*worker)]
        truth = run(job(tmp_path / "truth", N), tmp_path / "truth" / "mc", workers=1)
        deadline = time.monotonic() + 90.0
        while True:
            try:
                result = run(job(tmp_path / "far", N), tmp_path / "far" / "mc", chunk=7, cluster=address)
                break
            except InputError:  # they are not up yet
                assert time.monotonic() < deadline
                time.sleep(0.5)
        assert (result.folder / "samples.parquet").read_bytes() == (
            truth.folder / "samples.parquet"
        ).read_bytes()
        processes[1].kill()
        processes[1].wait()
        less = run(job(tmp_path / "less", N), tmp_path / "less" / "mc", chunk=7, cluster=address)
        assert (less.folder / "samples.parquet").read_bytes() == (
            truth.folder / "samples.parquet"
        ).read_bytes()
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def test_a_cluster_that_is_not_there_is_told(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(InputError, match=r"pip install|no scheduler answers"):
        run(job(tmp_path, 5), tmp_path / "mc", cluster=address)
    # nothing is lost: the same study goes on here
    assert len(run(job(tmp_path, 5), tmp_path / "mc", workers=1).read()[0]) == 5
