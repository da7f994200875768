"""The user's own classes: loaded from a file, their prints kept, their errors reported as theirs.

They run in the simulation's process, under all that guards it, and are trusted as any Python file is.
"""

from __future__ import annotations

import io
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from cosim.errors import InputError, Problem, SimulationError, nearest
from mech.userfile import load_file

__all__ = ["PrintCapture", "in_users_words", "load_class"]

#: Lines of ``print()`` that are kept, and characters of each: a law is called thousands of times.
_MOST_LINES, _MOST_CHARACTERS = 1000, 500


class PrintCapture(io.TextIOBase):
    """What user's code prints, line by line; the first lines are kept, the others counted."""

    def __init__(self) -> None:
        self._kept: list[str] = []
        self._begun = ""
        self._more = 0

    def write(self, text: str) -> int:
        """Take text as a file does."""
        *complete, self._begun = (self._begun + text).split("\n")
        room = _MOST_LINES - len(self._kept)
        self._kept += [line[:_MOST_CHARACTERS] for line in complete[:room]]
        self._more += max(len(complete) - room, 0)
        self._begun = self._begun[:_MOST_CHARACTERS]
        return len(text)

    @property
    def lines(self) -> list[str]:
        """The lines so far, and how many more there were."""
        more = [f"... and {self._more} more lines"] if self._more else []
        return [*self._kept, *([self._begun] if self._begun else []), *more]

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen to what is printed inside the block."""
        with redirect_stdout(self):
            yield


def load_class(
    where: str, scene: Path | None, *, key: str, what: str, method: str, printed: PrintCapture
) -> Any:
    """Make one object of the class `file.py:Class`, the file relative to the scene.

    Parameters
    ----------
    key, what, method
        Where the scene names it, what it is in words, and the method that it must have, as a person calls it.
    printed
        Captures what the file prints.

    Raises
    ------
    InputError
        When the file or the class is missing, cannot be made, or lacks the method.
    """

    def refuse(why: str) -> InputError:
        return InputError([Problem(why, file=None if scene is None else str(scene), key=key, value=where)])

    file, _, name = where.rpartition(":")
    path = Path(file) if scene is None else scene.parent / file
    if not file or not name:
        raise refuse(f"{what} is named as 'file.py:Class'")
    if not os.path.isfile(path):
        raise refuse(f"there is no file {path}")
    try:
        with printed.listening():
            module = load_file(path)
            kind = getattr(module, name, None)
            if not isinstance(kind, type):
                near = nearest(name, [key for key, value in vars(module).items() if isinstance(value, type)])
                raise refuse("the file has no such class" + (f", nearest is {near}" if near else ""))
            made = kind()
    except (Exception, SystemExit) as error:
        if isinstance(error, InputError):
            raise
        raise refuse(_words(error)) from error
    if not callable(getattr(made, method.partition("(")[0], None)):
        raise refuse(f"the class {name} has no method {method}")
    return made


def in_users_words(
    where: str, error: BaseException, time_s: float | None = None, output: PrintCapture | None = None
) -> SimulationError:
    """Return the error of a run that a user's class ended: its own words, and the line of its file."""
    if isinstance(error, SimulationError):
        return error
    lines = [
        (frame.filename, frame.lineno)
        for cause in (error.__cause__, error)
        for frame in traceback.extract_tb(cause.__traceback__ if cause is not None else None)
        if frame.filename == where.rpartition(":")[0]
    ]
    place = f"{lines[-1][0]}:{lines[-1][1]}" if lines else where
    printed = f"; it printed last: {output.lines[-1]}" if output is not None and output.lines else ""
    return SimulationError(f"{place}: {_words(error)}{printed}", time_s=time_s)


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
