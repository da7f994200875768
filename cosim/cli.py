"""The command line: ``cosim COMMAND ...``.

Exit codes: 0 on success, 1 when a simulation failed, 2 for the user's mistake, 130 after Ctrl-C.
Nothing heavy is imported before a command runs, so that ``cosim --help`` answers at once.
"""

import argparse
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from types import FrameType
from typing import Any, TextIO

from cosim import __version__
from cosim.caution import Caution, collected
from cosim.commands import verbosity
from cosim.commands.command import Command, caution_lines
from cosim.errors import CosimError, fail
from cosim.storage.staging import writable_folder
from cosim.terminal import print_remark, printable

EXIT_FAILURE = 1
EXIT_REFUSED = 2
EXIT_INTERRUPTED = 130


SHELLS = ("bash", "zsh", "tcsh")

#: Commands in the order of the help; `cosim.commands` has a module for each.
NAMES = (
    "check", "plan", "run", "report", "effects", "compare", "sweep", "accuracy", "hard-cases", "mc", "verify",
    "stability", "noise", "device", "export", "keys", "nodes", "new", "docs", "warm",
)  # fmt: skip


def commands(names: Sequence[str] = NAMES) -> list[Command]:
    """Return the commands of these names, loading their modules."""
    modules = (f"cosim.commands.{name.replace('-', '_')}" for name in names)
    return [importlib.import_module(module).COMMAND for module in modules]


def build_parser(names: Sequence[str] = NAMES) -> argparse.ArgumentParser:
    """Return the parser with all commands, or with those of some names."""
    parser = argparse.ArgumentParser(
        prog="cosim",
        description="Circuit-level co-simulation of haptic devices: ngspice in lockstep with a linkage.",
    )
    parser.add_argument("--version", action="version", version=f"cosim {__version__}")
    parser.add_argument(
        "--verbose", action="store_true", help="with --version: libraries, and what the sandbox can do here"
    )
    parser.add_argument(
        "--completion", choices=SHELLS, help="print what makes this shell complete commands and options"
    )
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in commands(names):
        sub = subparsers.add_parser(command.name, help=command.help, description=command.help)
        command.arguments(sub)
        sub.add_argument("--json", action="store_true", help="print the result as JSON")
        sub.add_argument(
            "--strict",
            action="store_true",
            help="exit with 2 if there is a warning; finished results are kept",
        )
        how = sub.add_mutually_exclusive_group()
        how.add_argument("--quiet", action="store_true", help="no bars and remarks: the result, and errors")
        how.add_argument(
            "--verbose", action="store_true", help="say each step, and every warning, terminal or not"
        )
        sub.set_defaults(run=command.run, exit_code=command.exit_code)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    if threading.current_thread() is threading.main_thread():
        # a batch system's or `timeout`'s request to end is obeyed like a Ctrl-C: nothing is left half-written
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    words = sys.argv[1:] if argv is None else list(argv)
    if sorted(words) == ["--verbose", "--version"]:
        return _about()
    if words[:1] == ["--completion"] and words[1:] in [[shell] for shell in SHELLS]:
        import shtab

        return _printed(0, shtab.complete(build_parser(), shell=words[1]), sys.stdout)
    named = words[:1] if words[:1] in [[name] for name in NAMES] else NAMES  # the help shows all
    args = build_parser(named).parse_args(words)
    verbosity.choose(quiet=args.quiet, verbose=args.verbose)
    interrupts = _Interrupts()
    if threading.current_thread() is threading.main_thread():
        if callable(signal.getsignal(signal.SIGINT)):  # from here on there is something to tidy up
            signal.signal(signal.SIGINT, interrupts)
        signal.signal(signal.SIGTERM, interrupts)
    return _printed(*_outcome(args, interrupts))


class _Interrupts:
    """Handles Ctrl-C, and remembers it: what was at work then may make another error of it.

    A library in C whose import is interrupted says that it could not be imported.
    """

    def __init__(self) -> None:
        self.seen = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        signal.default_int_handler(number, frame)


def _printed(code: int, text: str, stream: TextIO) -> int:
    """Print what a command has to say; return its exit code."""
    try:
        print(printable(text), file=stream, flush=True)
    except OSError as error:
        # a reader that went away, for example `head`, needs no word
        if stream is not sys.stderr and not isinstance(error, BrokenPipeError):
            print_remark(f"cosim: the result cannot be printed: {error.strerror}")
        # Python must not complain again when it flushes at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return code or EXIT_FAILURE
    return code


def _about() -> int:
    """Print versions and which parts of the sandbox this system offers; return the exit code."""
    from cosim.commands.version_info import about

    try:
        text = about()
    except CosimError as error:
        return _printed(error.exit_code, f"cosim --version: {error}", sys.stderr)
    return _printed(0, text, sys.stdout)


def _granted(args: argparse.Namespace) -> AbstractContextManager[None]:
    """Let netlists include files of the folders that ``--include`` names."""
    if not getattr(args, "include", None):
        return nullcontext()
    from cosim.ngspice.flatten import including

    return including(args.include)


def _outcome(args: argparse.Namespace, interrupts: _Interrupts) -> tuple[int, str, TextIO]:
    """Run the command; return exit code, what to print and where."""
    message = f"cosim {args.command}: interrupted; finished results are whole"
    with collected() as cautions:
        try:
            _check_folder()
            if getattr(args, "out", None):
                writable_folder(args.out)  # before anything long is done for it
            with _granted(args):
                result, text = args.run(args)
        except CosimError as error:
            if interrupts.seen:
                return EXIT_INTERRUPTED, message, sys.stderr
            if args.json:
                return error.exit_code, _json(error.as_dict() | _as_dict(cautions)), sys.stdout
            lines = [f"cosim {args.command}: {error}", *caution_lines(cautions)]
            return error.exit_code, "\n".join(lines), sys.stderr
        except KeyboardInterrupt:
            return EXIT_INTERRUPTED, message, sys.stderr
        except Exception:
            if not interrupts.seen:
                raise
            return EXIT_INTERRUPTED, message, sys.stderr
    code = args.exit_code(args, result)
    if args.strict and cautions:
        code = EXIT_REFUSED
        count = f"{len(cautions)} warning{'s' if len(cautions) > 1 else ''}"
        print_remark(f"cosim {args.command}: {count} with --strict; finished results are kept")
    if args.json:
        return code, _json(result | _as_dict(cautions)), sys.stdout
    return code, "\n".join([text, *caution_lines(cautions)]), sys.stdout


def _as_dict(cautions: Sequence[Caution]) -> dict[str, Any]:
    return {"warnings": [caution.as_dict() for caution in cautions]}


def _check_folder() -> None:
    """Refuse to work in a folder that was removed: no relative path means anything there."""
    try:
        os.getcwd()
    except OSError:
        fail("the folder that you are in does not exist any more; change to another one")


def _json(value: dict[str, Any]) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)


if __name__ == "__main__":
    sys.exit(main())
