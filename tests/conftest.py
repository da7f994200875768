"""Tests compile into the same folder as the program, so that both are warm after the first run."""

import os
import signal
from collections import defaultdict
from zlib import crc32

import kept_processes
import pytest

# a module that is first imported while a test has replaced a function elsewhere would keep the replacement
import cosim.api.batches
import cosim.api.queries
import cosim.api.simulation
import cosim.api.verification
import cosim.comparisons.effects_ledger
import cosim.comparisons.sweep  # noqa: F401
from mech import library_files

# a test with caches of its own must not compile for a minute
os.environ.setdefault(library_files.FOLDER, str(library_files.folder()))

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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave of the tests marked `few` as many as they say, and begin with what takes long.

    The cases that stay are spread evenly over a test's own, from one that its name chooses: so different
    tests keep different circuit models. A worker that came to a long test last would be waited for by all.
    """
    cases = defaultdict(list)
    for item in items:
        if (few := item.get_closest_marker("few")) is not None:
            cases[item.nodeid.partition("[")[0], *few.args].append(item)
    for (name, kept), of in cases.items():
        of.sort(key=lambda item: item.nodeid)  # in whatever order they come
        first, every = crc32(name.encode()) % len(of), len(of) / kept
        stay = {(first + int(k * every)) % len(of) for k in range(kept)}
        for k, item in enumerate(of):
            if k not in stay:
                item.add_marker("slow")
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
