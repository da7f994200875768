"""``python -m cosim`` and the installed command; Ctrl-C is quiet from the first moment."""

import gc
import os
import signal
import sys


def _leave(*_: object) -> None:
    """End at once with one line: nothing has begun yet."""
    os.write(sys.stderr.fileno(), b"cosim: interrupted\n")
    os._exit(130)


def main() -> int:
    """Run the command line; return its exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where Ctrl-C is to be ignored
        signal.signal(signal.SIGINT, _leave)  # while Python imports; `cosim.cli.main` takes over
    from cosim.quick_start import collect_seldom, frugal

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
    gc.freeze()  # ending, Python would look through half a million objects for garbage: 60 ms
    return code


if __name__ == "__main__":
    sys.exit(main())
