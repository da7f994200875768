"""Work in a child process, so that ngspice may crash, exit or hang and the parent lives.

The child starts in a private folder that holds nothing but an empty ``.spiceinit``: ngspice runs the commands
of the first such file it finds in the working folder, else in the user's home (which it takes from the
password file, not from ``HOME``), so ours keeps it from running any other. Its environment is its own, and
the kernel keeps it from all that a simulation does not need (`cosim.ngspice.sandbox`): it writes into its own
folder and the caches, and what it sends back is taken for data (`cosim.ngspice.child_messages`).
"""

import contextlib
import importlib
import json
import os
import pickle
import selectors
import shutil
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from cosim.caution import warn
from cosim.errors import SimulationError
from cosim.ngspice import child_messages
from cosim.ngspice.child_environment import allowed_files, environment
from cosim.ngspice.forked import Copy, NeedsNgspice, possible
from cosim.ngspice.time_limits import MOST_PREPARING_S, Watch
from cosim.ngspice.worker import HEAD, serve
from cosim.quick_start import defer
from cosim.storage.staging import disk_errors, make_scratch

__all__ = ["Child", "call", "on_demand", "start_early"]

PREIMPORT = ("numpy",)
LIBRARY = "PySpice.Spice.NgSpice.Shared"
"""What an early child imports while the parent still prepares, and where it will need ngspice."""

OUTBOX = Path("..") / "out"
"""Where a function in the child leaves files for its caller, from its working folder; see `call`."""

_CPU_SHARE, _CPU_MORE_S = 4.0, MOST_PREPARING_S
"""CPU time of a call: so many times its time limit, for several threads, and imports."""
TIME_LIMIT_S = 600.0
"""Time limit of a call that belongs to no scene: the default of a scene's own [s]."""
_LAST_LINES = 15
"""Lines of the child's output quoted in an error."""


def call(
    target: str,
    payload: object,
    *,
    time_limit_s: float | None = TIME_LIMIT_S,
    stall_limit_s: float | None = None,
    on_progress: Callable[[Mapping[str, Any]], None] | None = None,
    deck: str | None = None,
    child: "Child | None" = None,
    reads: Sequence[Path] = (),
    collect: Path | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> Any:
    """Run a function in a child process and return what it returns.

    Parameters
    ----------
    target
        ``"package.module:function"``. The function gets the payload and ``report``, a function that takes a
        dictionary with the progress: ``{"time_s": simulated time, ...}``.
    payload
        Anything that pickles; paths in it absolute, since the child works in a folder of its own.
    time_limit_s
        The child is ended when the call takes longer [s], imports and compilations apart; what belongs to a
        scene has the scene's limit.
    stall_limit_s
        The child is ended when for this long [s] it reported nothing, or the same ``time_s`` again and again.
    on_progress
        Called with every report that comes through (at most 20 a second).
    deck
        Name of the deck for errors.
    child
        A child started by `start_early`; it stays alive for more calls unless this one fails. One that has
        ended in an earlier call, or may not read what this one needs, is replaced by a process for this call
        alone.
    reads
        Folders that the function reads besides Python's modules and its own: those of a user's Python files.
    collect
        Folder to which the files go that the function leaves in `OUTBOX`.
    meanwhile
        Called once the child has its request: what this process can do without the answer. It should be
        short, for the limits are not looked at until it returns.

    Raises
    ------
    CosimError
        What the function raised, if it is one.
    SimulationError
        For any other exception (with its traceback), a crash, an exit, the time limit or the stall limit.
    """
    if child is not None and reads:  # Python of the user's
        child.be_no_copy()
    kept = child is not None and child.alive and child.reads_all(reads)
    with contextlib.nullcontext(child) if child is not None and kept else Child(reads=reads) as chosen:
        return chosen.call(
            target,
            payload,
            time_limit_s=time_limit_s,
            stall_limit_s=stall_limit_s,
            on_progress=on_progress,
            deck=deck,
            collect=collect,
            meanwhile=meanwhile,
        )


def start_early(
    *modules: str, reads: Sequence[Path] = (), library: bool = True, shared: Sequence[str] = ()
) -> "Child":
    """Start a child now that imports `PREIMPORT` and `modules` while the parent does something else.

    With `shared`, modules that both need are loaded first and the child is a `Copy` where it can be one: for
    what most likely needs no ngspice.
    """
    copies = bool(shared) and possible()
    for name in shared if copies else ():
        importlib.import_module(name)
    child = Child((*PREIMPORT, *([LIBRARY] if library else []), *modules), reads, copies=copies)
    child.start()
    defer()  # meanwhile the parent loads its own modules
    return child


def on_demand() -> "Child":
    """Return a child that starts with its first call, for work whose answers may all be cached."""
    defer()
    return Child((*PREIMPORT, LIBRARY))


class Child:
    """A child process that serves calls one after the other; it starts with the first, or by `start`.

    Parameters
    ----------
    modules
        Modules it imports before the first call.
    reads
        Folders that it may read besides Python's modules and its own.
    copies
        Whether to copy this process, until something is asked for that a copy may not do.
    """

    def __init__(
        self, modules: Sequence[str] = (), reads: Sequence[Path] = (), *, copies: bool = False
    ) -> None:
        self._copies = copies
        self._modules, self._reads = tuple(modules), tuple(folder.resolve() for folder in reads)
        self._started = self._closed = False
        self._preparing_s = 0.0

    def start(self) -> None:
        """Start the process, unless it runs."""
        if self._started:
            return
        folder = make_scratch("ngspice")
        receive, send = os.pipe()
        try:
            work = folder / "work"
            work.mkdir()
            for name in ("home", "tmp", "out"):
                (folder / name).mkdir()
            (work / ".spiceinit").write_text("* empty: keeps ngspice from looking further\n")
            process = self._copied(folder, send) if self._copies else self._begun(folder, send)
        except BaseException:
            os.close(receive)
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            os.close(send)
        self._process, self._folder, self._receive = process, folder, receive
        self._buffer = bytearray()
        self._close = weakref.finalize(self, _dispose, process, folder, receive)
        self._started = True

    def _begun(self, folder: Path, send: int) -> "subprocess.Popen[bytes]":
        env = environment(folder)
        with open(folder / "output", "wb") as output:
            return subprocess.Popen(
                _command(send, self._modules, allowed_files(folder, env, self._reads)),
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=output,
                cwd=folder / "work",
                env=env,
                pass_fds=(send,),
                start_new_session=True,  # a Ctrl-C at the terminal is the parent's to handle
            )

    def _copied(self, folder: Path, send: int) -> Copy:
        env = environment(folder)
        allowed = allowed_files(folder, env, ())
        served = partial(serve, send, allowed, self._modules, dies_with_parent=True)
        return Copy(folder, env, send, served)

    def be_no_copy(self) -> None:
        """Let a process of its own take the place of a copy."""
        if self._copies and self._started:
            self._close()
            self._started, self._preparing_s = False, 0.0
        self._copies = False

    def call(
        self,
        target: str,
        payload: object,
        *,
        time_limit_s: float | None = None,
        stall_limit_s: float | None = None,
        on_progress: Callable[[Mapping[str, Any]], None] | None = None,
        deck: str | None = None,
        collect: Path | None = None,
        meanwhile: Callable[[], object] | None = None,
    ) -> Any:
        """Run a function in this child; see `call`."""
        if self._closed:
            raise SimulationError("the child process was closed", deck=deck)
        self.start()
        self._empty_outbox()
        cpu_s = None if time_limit_s is None else _CPU_SHARE * time_limit_s + _CPU_MORE_S
        body = pickle.dumps((target, pickle.dumps(payload, protocol=5), cpu_s), protocol=5)
        watch = Watch(time_limit_s, stall_limit_s, self._preparing_s)
        try:
            for kind, content in self._messages(HEAD.pack(len(body)) + body, watch, meanwhile):
                if kind == "result":
                    if collect is not None:
                        self._collect(collect)
                    return content
                if kind == "error" and isinstance(content[0], NeedsNgspice):
                    self.be_no_copy()
                    return self.call(
                        target, payload, time_limit_s=time_limit_s, stall_limit_s=stall_limit_s,
                        on_progress=on_progress, deck=deck, collect=collect,
                    )  # fmt: skip
                if kind == "error":
                    raise _raised(*content, deck=deck, watch=watch)
                if kind == "cautions":
                    warn(*content)
                    continue
                watch.beat(content)
                self._preparing_s = watch.preparing_s
                if content and "preparing_s" not in content and on_progress is not None:
                    on_progress(content)
            raise self._ended(deck, watch)
        except TimeoutError as timeout:
            words = self._last_words()
            self.close()
            raise SimulationError(str(timeout), deck=deck, time_s=watch.time_s, last_words=words) from None
        except BaseException:
            self.close()
            raise

    @property
    def alive(self) -> bool:
        """Whether it takes calls: it was not closed, and no call has failed."""
        return not self._closed

    def reads_all(self, folders: Sequence[Path]) -> bool:
        """Whether it may read all these folders."""
        return all(any(f.resolve().is_relative_to(mine) for mine in self._reads) for f in folders)

    def _empty_outbox(self) -> None:
        for left in (self._folder / "out").iterdir():
            left.unlink()

    def _collect(self, target: Path) -> None:
        """Move what the child has left to a folder; it may lie on another disk."""
        for file in sorted((self._folder / "out").iterdir()):
            if file.is_symlink() or not file.is_file():
                raise SimulationError(f"the child process has left {file.name}, which is not a regular file")
            with disk_errors(target):
                shutil.move(file, target / file.name)

    def close(self) -> None:
        """End the child and remove its folder."""
        self._closed = True
        if self._started:
            self._close()

    def __enter__(self) -> "Child":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self.close()

    def _messages(self, request: bytes, watch: Watch, meanwhile: Callable[[], object] | None = None) -> Any:
        """Send the request and yield messages until the child closes its pipe.

        Sends and receives at the same time: a child that still imports does not read, and while a long
        request is being sent its death and the limits must be noticed.
        """
        assert self._process.stdin is not None
        inlet = self._process.stdin.fileno()
        view = memoryview(request)
        os.set_blocking(inlet, False)
        with selectors.DefaultSelector() as selector:
            selector.register(self._receive, selectors.EVENT_READ)
            selector.register(inlet, selectors.EVENT_WRITE)
            while True:
                ready = selector.select(watch.patience_s())
                for key, _ in ready:
                    if key.fd == inlet:
                        try:
                            view = view[os.write(inlet, view[:65536]) :]
                        except BrokenPipeError:
                            view = view[:0]
                        if not view:
                            selector.unregister(inlet)
                            if meanwhile is not None:
                                meanwhile()
                    else:
                        chunk = os.read(self._receive, 1 << 20)
                        if not chunk:
                            return
                        self._buffer += chunk
                        yield from self._complete()
                watch.check()

    def _complete(self) -> Any:
        while len(self._buffer) >= HEAD.size:
            end = HEAD.size + HEAD.unpack_from(self._buffer)[0]
            if len(self._buffer) < end:
                return
            body = bytes(memoryview(self._buffer)[HEAD.size : end])
            del self._buffer[:end]
            yield child_messages.read(body)

    def _ended(self, deck: str | None, watch: Watch) -> SimulationError:
        """Describe how the child ended without a result."""
        status = self._process.wait()
        if status < 0:
            try:
                name = signal.Signals(-status).name
            except ValueError:
                name = f"signal {-status}"
            what = f"ngspice's process crashed ({name})"
        else:
            what = f"ngspice's process ended with exit code {status} before it had a result"
        return SimulationError(what, deck=deck, time_s=watch.time_s, last_words=self._last_words())

    def _last_words(self) -> str:
        try:
            output = (self._folder / "output").read_bytes()[-8000:].decode("utf-8", "replace")
        except OSError:
            return ""
        words, _, _ = output.partition(
            "Fatal Python error:"
        )  # what follows is our stack, not ngspice's words
        return "\n".join(words.splitlines()[-_LAST_LINES:])


def _command(descriptor: int, modules: Sequence[str], allowed: Mapping[str, list[str]]) -> list[str]:
    # the signal on the parent's death comes when the starting *thread* ends: ask for it only in the main one
    main_thread = threading.current_thread() is threading.main_thread()
    # -P: nothing is imported from the child's working folder
    start = [sys.executable, "-P", "-m", "cosim.ngspice.worker", str(descriptor), str(int(main_thread))]
    return [*start, json.dumps(allowed), *modules]


def _raised(
    error: Exception | None, message: str, trace: str, *, deck: str | None, watch: Watch
) -> Exception:
    if error is not None:
        error.add_note("In the child process:\n" + trace)
        return error
    return SimulationError(message, deck=deck, time_s=watch.time_s, last_words=trace)


def _dispose(process: "subprocess.Popen[bytes] | Copy", folder: Path, receive: int) -> None:
    """End the child, which keeps nothing that it would have to finish, and remove its folder."""
    os.close(receive)
    if process.stdin is not None:
        process.stdin.close()
    process.kill()
    process.wait()
    shutil.rmtree(folder, ignore_errors=True)
