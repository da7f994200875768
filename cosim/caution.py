"""`Caution`: something in a result that a person should doubt, and what to do about it.

A caution is no error: the run is complete. It is printed on the terminal, stands at the head of the page and
in ``run.json`` under ``warnings``; ``--strict`` turns every caution into an error.

Code that sees reason for doubt calls `warn`, at any depth and in a child process too; code that answers for a
result collects these calls with `collected`, which also passes them on to any collector around it.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any

from typing_extensions import TypedDict

__all__ = [
    "MOST_ALIKE",
    "Caution",
    "CautionFields",
    "Doubt",
    "caution_of",
    "collected",
    "grouped",
    "listening",
    "warn",
]


class Doubt(UserWarning):
    """A `Caution` as a Python warning, for scripts."""


@dataclass(frozen=True)
class Caution:
    """One doubt about a result.

    Attributes
    ----------
    code
        Stable identifier for machines, in kebab case: ``amplifier-clipped``.
    text
        What was seen, with its numbers and units, as a short sentence without a full stop.
    advice
        What to do about it, as a short sentence without a full stop.

    Examples
    --------
    >>> print(Caution('amplifier-clipped', 'x1 clips for 3 ms', 'lower the gain'))
    x1 clips for 3 ms: lower the gain
    """

    code: str
    text: str
    advice: str

    def __str__(self) -> str:
        return f"{self.text}: {self.advice}"

    def as_dict(self) -> dict[str, str]:
        """Return the caution as JSON-ready fields."""
        return {"code": self.code, "text": self.text, "advice": self.advice}


class CautionFields(TypedDict):
    """What `Caution.as_dict` returns."""

    code: str
    text: str
    advice: str


def caution_of(fields: Mapping[str, Any]) -> Caution:
    """Return the caution that `Caution.as_dict` stored."""
    return Caution(str(fields["code"]), str(fields["text"]), str(fields["advice"]))


#: Cautions of one kind that are shown in full: a sweep may have hundreds.
MOST_ALIKE = 3


def grouped(cautions: Sequence[Caution], most: int | None = MOST_ALIKE) -> list[tuple[list[Caution], int]]:
    """Return cautions by kind, for people: the first `most` of each (None: all), and how many more."""
    kinds = (
        [caution for caution in cautions if caution.code == code]
        for code in dict.fromkeys(caution.code for caution in cautions)
    )
    return [(alike[:most], len(alike) - len(alike[:most])) for alike in kinds]


_heard: ContextVar[list[Caution] | None] = ContextVar("heard", default=None)


def listening() -> bool:
    """Whether anything collects what `warn` is given."""
    return _heard.get() is not None


def warn(*cautions: Caution) -> None:
    """Pass cautions to the collector, each once; without a collector they are dropped."""
    heard = _heard.get()
    if heard is not None:
        heard.extend(caution for caution in dict.fromkeys(cautions) if caution not in heard)


@contextmanager
def collected(label: str = "", *, forward: bool = True) -> Iterator[list[Caution]]:
    """Collect what `warn` is given inside the block.

    Parameters
    ----------
    label
        Stands before each text that is passed on, to tell one of several runs from the others.
    forward
        Whether the cautions go to the collector around this block at its end.

    Examples
    --------
    >>> with collected() as heard:
    ...     warn(Caution('odd', 'looks odd', 'look again'))
    >>> [caution.code for caution in heard]
    ['odd']
    """
    heard: list[Caution] = []
    token = _heard.set(heard)
    try:
        yield heard
    finally:
        _heard.reset(token)
        if forward:
            warn(*(replace(each, text=f"{label}: {each.text}") if label else each for each in heard))
