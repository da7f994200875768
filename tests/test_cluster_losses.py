"""Workers of a cluster that die at an awkward instant, by a scheduler made up for it."""

from collections.abc import Callable
from concurrent.futures import CancelledError
from types import SimpleNamespace
from typing import Any

import pytest

import cosim.tolerance.cluster as cluster
from cosim.errors import InputError
from cosim.tolerance.cluster import clustered
from cosim.tolerance.worker_pool import Chunk

ADDRESS = "tcp://127.0.0.1:8786"
CHUNKS = [Chunk(first, 3) for first in range(0, 15, 3)]


class Client:
    """A scheduler with one worker; `scattering` and `results` raise what is in them, one a call."""

    def __init__(self, scattering: list[Exception], results: list[Exception]) -> None:
        self.scattering, self.results, self.status = scattering, results, "running"

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": {"one": {}}}

    def wait_for_workers(self, n_workers: int, timeout: float) -> None:
        pass

    def scatter(self, data: Any, broadcast: bool) -> Any:
        if self.scattering:
            raise self.scattering.pop(0)
        return data

    def submit(self, function: Callable[..., Any], *words: Any, pure: bool) -> "Future":
        return Future(self, lambda: function(*words))


class Future:
    """A task that ran; its answer may be lost."""

    def __init__(self, client: Client, task: Callable[[], Any]) -> None:
        self.client, self.task = client, task

    def result(self) -> Any:
        if self.client.results:
            raise self.client.results.pop(0)
        return self.task()

    def exception(self) -> None:
        return None

    def release(self) -> None:
        pass


class KilledWorker(Exception):
    """As `distributed` names it."""


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Callable[[Client], list[tuple[Chunk, Any]]]:
    def measured(client: Client) -> list[tuple[Chunk, Any]]:
        distributed = SimpleNamespace(
            Client=lambda address, timeout: client,
            wait=lambda flying, return_when: SimpleNamespace(done=flying[:1]),
            KilledWorker=KilledWorker,
        )
        monkeypatch.setattr(cluster, "import_module", lambda name: distributed)
        return list(clustered(lambda: lambda chunk: chunk.first, "study", iter(CHUNKS), ADDRESS))

    monkeypatch.setattr(cluster, "_made", {})
    return measured


@pytest.mark.parametrize("error", [OSError("in scatter"), TimeoutError(), KeyError("tcp://gone")])
def test_a_worker_that_dies_while_the_work_is_sent(study, error) -> None:
    """The next one gets it: a scheduler answers a lost connection, or by the name that it no longer knows."""
    assert study(Client([error], [])) == [(chunk, chunk.first) for chunk in CHUNKS]


@pytest.mark.parametrize(
    ("missing", "reason"), [("distributed", "needs the package"), ("dask", r"cannot be loaded \(no dask\)")]
)
def test_a_package_that_is_there_but_cannot_be_loaded_says_what_it_lacks(
    missing, reason, monkeypatch
) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(f"no {missing}", name=missing)

    monkeypatch.setattr(cluster, "import_module", absent)
    with pytest.raises(InputError, match=reason):
        list(clustered(lambda: lambda chunk: chunk.first, "study", iter(CHUNKS), ADDRESS))


def test_a_worker_that_dies_with_its_answer(study) -> None:
    got = study(Client([], [CancelledError()]))
    assert sorted(first for _, first in got) == [chunk.first for chunk in CHUNKS]


def test_a_chunk_that_kills_its_worker_is_tried_sample_by_sample(study) -> None:
    got = study(Client([], [KilledWorker()]))
    assert sorted((chunk.first, chunk.count) for chunk, _ in got) == [
        (0, 1), (1, 1), (2, 1), (3, 3), (6, 3), (9, 3), (12, 3),
    ]  # fmt: skip


def test_a_scheduler_that_is_gone_is_reported_at_once(study) -> None:
    client = Client([OSError("connection closed")], [])
    client.status = "connecting"
    with pytest.raises(InputError, match="the same command goes on"):
        study(client)
