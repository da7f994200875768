"""A process for simulations serves one test after the other, as it serves the runs of a sweep.

To start one - imports, compiled code, ngspice - takes ten times the computing of a short run. A process goes
on to the next test that asks for one in the same surroundings (environment, module path, folder of scratch
files), if no call in it has failed. A test of processes themselves starts its own: mark it `own_process`.
"""

import tempfile
import threading
import weakref
from pathlib import Path
from typing import Any

from cosim.ngspice import child
from cosim.ngspice.child import Child

#: What a kept process may read besides its own: a test's folders, and the scenes and netlists as shipped.
READABLE = (Path(__file__).resolve().parents[1], Path(tempfile.gettempdir()))
#: Idle processes at most: each holds some 200 MB.
MOST_IDLE = 3
#: Calls to a process end here: ngspice keeps a little of every circuit that it has read.
MOST_TESTS = 100

_start, _leave = Child.start, Child.__exit__


class _Idle:
    """A process between two tests, ended when nobody needs it any more."""

    def __init__(self, of: Child, surroundings: object, tests: int) -> None:
        of._close.detach()  # it outlives the object that started it
        self.surroundings, self.tests = surroundings, tests
        self.process, self.folder, self.receive = of._process, of._folder, of._receive
        self.close = weakref.finalize(self, child._dispose, self.process, self.folder, self.receive)


_idle: list[_Idle] = []


def _surroundings() -> tuple[object, ...]:
    """Return all that a new process takes over from this one."""
    environment = child.environment(Path("its own"))
    main = threading.current_thread() is threading.main_thread()
    return main, tempfile.gettempdir(), *sorted(environment.items())


def _begin(self: Child) -> None:
    if self._started:
        return
    surroundings, tests = _surroundings(), 1
    result = next((each for each in reversed(_idle) if each.surroundings == surroundings), None)
    if result is not None:
        _idle.remove(result)
        if result.process.poll() is None:
            result.close.detach()
            self._process, self._folder, self._receive = result.process, result.folder, result.receive
            self._buffer, self._started = bytearray(), True
            self._close = weakref.finalize(
                self, child._dispose, result.process, result.folder, result.receive
            )
            tests = result.tests + 1
        else:
            result = None
    if result is None:
        asked = self._reads  # what it decides stays the same
        self._reads = tuple(folder.resolve() for folder in (*READABLE, *asked))
        _start(self)
        self._reads = asked
    vars(self)["_kept_for"] = surroundings, tests


def _end(self: Child, *error: Any) -> None:
    surroundings, tests = vars(self).get("_kept_for", (None, 0))
    if surroundings is None or not self.alive or self._buffer or tests >= MOST_TESTS:
        _leave(self, *error)
        return
    _idle.append(_Idle(self, surroundings, tests))
    if len(_idle) > MOST_IDLE:
        _idle.pop(0).close()


def keep(kept: bool) -> None:
    """Take processes from those that are idle from now on, or start each anew."""
    setattr(Child, "start", _begin if kept else _start)  # noqa: B010
    setattr(Child, "__exit__", _end)  # noqa: B010
