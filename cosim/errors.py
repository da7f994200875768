"""What can go wrong, in words the user can act on.

Every error that leaves the program carries the exit code of the command line: 2 when the user's
input is at fault, 1 when the simulation failed although the input was in order. This module imports
nothing heavy, so that ``cosim --help`` may import it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NoReturn

__all__ = ["CosimError", "InputError", "Problem", "SimulationError", "StorageError", "fail", "nearest"]


#: Characters that help, of a message and of a line printed by ngspice.
_MOST_ECHOED = 600


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with the user's input.

    Attributes
    ----------
    message
        What is wrong, and if possible what to do, as a short sentence without a full stop.
    file
        File that states the value.
    key
        Dotted key of a scene, or the name of a parameter, pin or element of a netlist.
    value
        The refused value as the user wrote it.
    unit
        Unit in which the value is understood.
    allowed
        Range or choices in words, for example ``"> 0"`` or ``"discrete, continuous"``.
    line
        Line number in `file`, counted from 1.

    Examples
    --------
    >>> print(Problem('must be positive', 'a.toml', 'computer.period_s', -1.0, 's', '> 0', 12))
    a.toml:12: computer.period_s = -1.0 s: must be positive (allowed: > 0 s)
    """

    message: str
    file: str | None = None
    key: str | None = None
    value: object = None
    unit: str | None = None
    allowed: str | None = None
    line: int | None = None

    def __str__(self) -> str:
        where = self.file or ""
        if self.line is not None:
            where = f"{where}:{self.line}" if where else f"line {self.line}"
        what = self.key or ""
        if self.value is not None:
            unit = f" {self.unit}" if self.unit else ""
            shown = _shorten(self.value) + unit
            what = f"{what} = {shown}" if what else shown
        text = ": ".join(part for part in (where, what, _cut(self.message)) if part)
        if self.allowed:
            unit = f" {self.unit}" if self.unit else ""
            text += f" (allowed: {self.allowed}{unit})"
        return text

    def as_dict(self) -> dict[str, object]:
        """Return the problem as JSON-ready fields, the empty ones left out."""
        fields = {
            "message": _cut(self.message),
            "file": self.file,
            "line": self.line,
            "key": self.key,
            "value": None if self.value is None else _jsonable(self.value),
            "unit": self.unit,
            "allowed": self.allowed,
        }
        return {name: value for name, value in fields.items() if value is not None}


class CosimError(Exception):
    """Base of every error that the program raises on purpose.

    Examples
    --------
    >>> CosimError('it failed').as_dict()
    {'error': 'CosimError', 'message': 'it failed'}
    """

    @property
    def in_brief(self) -> str:
        """What went wrong in one line, for a row of a table."""
        return (str(self).splitlines() or [type(self).__name__])[0]

    exit_code = 1

    def as_dict(self) -> dict[str, object]:
        """Return the error as a JSON-ready dictionary for ``--json``."""
        return {"error": type(self).__name__, "message": str(self)}


class InputError(CosimError):
    """The user's input is at fault; reports everything that is wrong with it at once.

    Parameters
    ----------
    problems
        One problem, several, or a plain sentence.

    Examples
    --------
    >>> error = InputError(Problem('no such key', key='colour'))
    >>> error.exit_code, str(error), error.problems[0].key
    (2, 'colour: no such key', 'colour')
    """

    exit_code = 2

    def __init__(self, problems: Problem | str | Iterable[Problem]) -> None:
        if isinstance(problems, str):
            problems = (Problem(problems),)
        elif isinstance(problems, Problem):
            problems = (problems,)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__(self.problems)

    @property
    def in_brief(self) -> str:
        """What is wrong, each problem once, without file and key: the table's row names the input."""
        return "; ".join(dict.fromkeys(problem.message for problem in self.problems))

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    def as_dict(self) -> dict[str, object]:
        """Return the error with its problems as a JSON-ready dictionary for ``--json``."""
        return {"error": "InputError", "problems": [problem.as_dict() for problem in self.problems]}


class StorageError(InputError):
    """A place cannot be written: no other input would help, so a series of runs ends here.

    Examples
    --------
    >>> issubclass(StorageError, InputError)
    True
    """


class SimulationError(CosimError):
    """The input was in order, but the simulation did not reach its end.

    Parameters
    ----------
    message
        What happened.
    deck
        Name or path of the netlist that ran.
    time_s
        Simulated time reached [s].
    last_words
        What ngspice printed last.

    Examples
    --------
    >>> str(SimulationError('the device ran away', time_s=0.25)), SimulationError.exit_code
    ('the device ran away (at t = 0.25 s)', 1)
    """

    def __init__(
        self,
        message: str,
        *,
        deck: str | None = None,
        time_s: float | None = None,
        last_words: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.deck = deck
        self.time_s = time_s
        self.last_words = last_words

    def __reduce__(self) -> tuple[Any, ...]:
        # The error crosses the pipe from the child process: keyword arguments are not pickled by themselves.
        return (_rebuild, (self.message, self.deck, self.time_s, self.last_words))

    def __str__(self) -> str:
        text = self.message
        if self.deck is not None:
            text = f"{self.deck}: {text}"
        if self.time_s is not None:
            text += f" (at t = {self.time_s:.9g} s)"
        if self.last_words:
            lines = (f"  {_cut(line)}" for line in self.last_words.splitlines())
            text += "\nngspice said last:\n" + "\n".join(lines)
        return text

    def as_dict(self) -> dict[str, object]:
        """Return the error as a JSON-ready dictionary for ``--json``."""
        return {
            "error": "SimulationError",
            "message": self.message,
            "deck": self.deck,
            "time_s": self.time_s,
            "last_words": self.last_words,
        }


class NoOperatingPoint(InputError):
    """ngspice found no DC operating point although the circuit's structure has one."""


class StepTooSmall(SimulationError):
    """ngspice's steps became endlessly short."""


class Crawl(SimulationError):
    """ngspice takes far more work than was predicted, and still gets on."""


def _rebuild(message: str, deck: str | None, time_s: float | None, last_words: str | None) -> SimulationError:
    return SimulationError(message, deck=deck, time_s=time_s, last_words=last_words)


def fail(message: str, **fields: Any) -> NoReturn:
    """Raise an `InputError` with one `Problem` made of `message` and `fields`."""
    raise InputError(Problem(message, **fields))


def nearest(key: str, allowed: Iterable[str]) -> str | None:
    """Return the allowed name most like `key`, or ``None`` when none is alike.

    Letter case is ignored, as in SPICE.

    Examples
    --------
    >>> nearest('perid_s', ['period_s', 'method'])
    'period_s'
    """
    import difflib

    names = {name.lower(): name for name in allowed}
    close = difflib.get_close_matches(key.lower(), names, n=1, cutoff=0.5)
    return names[close[0]] if close else None


def _shorten(value: object, limit: int = 60) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _jsonable(value: object) -> object:
    if isinstance(value, str):
        return _cut(value)
    return value if isinstance(value, int | bool) else _shorten(value)


def _cut(text: str) -> str:
    """Return text that may echo a line of a file, without the middle of what nobody reads."""
    return text if len(text) <= _MOST_ECHOED else f"{text[: _MOST_ECHOED - 60]} ... {text[-40:]}"
