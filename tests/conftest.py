"""Tests compile into the same folder as the program, so that both are warm after the first run."""

import os
import signal

import kept_processes
import pytest

from cosim.numba_cache import cache_folder

os.environ["NUMBA_CACHE_DIR"] = cache_folder()
# results carry the date of their run: for tests that compare bytes all have the same
os.environ.setdefault("SOURCE_DATE_EPOCH", "0")

# a shell's `&` and nohup leave Ctrl-C ignored, which child processes inherit: some tests interrupt theirs
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _processes(request):
    """Keep processes for simulations from one test to the next, but for tests of processes."""
    kept_processes.keep(request.node.get_closest_marker("own_process") is None)
    yield
    kept_processes.keep(False)


def pytest_collection_modifyitems(items):
    """Begin with what takes long: a worker that came to it last would be waited for by all."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
