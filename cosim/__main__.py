"""``python -m cosim`` and the installed command; Ctrl-C is quiet from the first moment."""

import atexit
import contextlib
import os
import signal
import sys
import threading


def _leave(*_: object) -> None:
    """End at once with one line: nothing has begun yet."""
    with contextlib.suppress(OSError):
        os.write(2, b"cosim: interrupted\n")
    os._exit(130)


def _end(code: int) -> None:
    """End now, after all that is to be done at an exit.

    Python would take half a million objects apart first, which is 30 ms of each command. It does where other
    threads run, or somebody looks on who reports at the end: a debugger, a profiler, a measure of coverage.
    """
    if threading.active_count() > 1 or sys.gettrace() is not None or sys.getprofile() is not None:
        return
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader went away
            stream.flush()
    os._exit(code)


def main() -> int:
    """Run the command line; end with its exit code, or return it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where Ctrl-C is to be ignored
        signal.signal(signal.SIGINT, _leave)  # while Python imports; `cosim.cli.main` takes over
    from cosim.quick_start import collect_seldom, frugal
    from cosim.terminal import open_missing_streams

    open_missing_streams()
    frugal()
    collect_seldom()
    from cosim.cli import main as command_line

    try:
        code = command_line()
    except KeyboardInterrupt:  # between two commands' worth of work: nothing is left half-written
        _leave()
        raise
    if callable(signal.getsignal(signal.SIGINT)):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is said: what is left is to take away our own
    _end(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
