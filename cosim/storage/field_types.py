"""Whether data from a file of results has the form that its readers rely on.

Who writes a result can seal and number what they like: a check sum tells damage, not a stranger's hand. So
what is read back is held against a form, in Python's own types: ``dict[str, float]``, a `TypedDict`, ...
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cosim.errors import fail

__all__ = ["check", "fits", "made", "misfit", "prepare", "refuse_code", "used"]


def misfit(value: Any, form: Any) -> tuple[str, str] | None:
    """Return where a value from JSON is not of a form, and what should be there; None where it is.

    Nothing is converted: a number is no text, and a truth value no number.

    Examples
    --------
    >>> misfit({'a': 1.0, 'b': [2, 'x']}, dict[str, float])
    ('b', 'Input should be a valid number')
    """
    try:
        _adapter(form).validate_python(value, strict=True)
    except ValidationError as error:
        return _first(error)
    return None


def prepare(form: Any) -> None:
    """Build the check of a form, for a process that waits."""
    _adapter(form)


def refuse_code(named: Iterable[str], file: str, *, trust: bool) -> None:
    """Refuse a result whose scene names Python: it may be a stranger's, and nobody has read it here.

    Raises
    ------
    InputError
        Where anything is named and the user does not trust it.
    """
    if (strange := sorted(named)) and not trust:
        fail(
            "its scene names Python, which would run: read it, then give --trust", file=file, value=strange[0]
        )


def fits(value: Any, form: Any) -> bool:
    """Whether a value from JSON is of a form; see `misfit`."""
    return misfit(value, form) is None


def check(value: Any, form: Any, file: str) -> None:
    """Refuse a value that is not of a form.

    Raises
    ------
    InputError
        Naming file, place in it, and what should be there.
    """
    reason = misfit(value, form)
    if reason is not None:
        where, why = reason
        fail("does not hold what a result holds there", file=file, key=where or None, allowed=why)


def made(value: Any, form: Any, file: str) -> Any:
    """Return what a value from JSON stands for: dataclasses of objects, tuples of lists.

    Raises
    ------
    InputError
        As `check`.
    """
    try:
        return _adapter(form).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        where, why = _first(error)
        fail("does not hold what a result holds there", file=file, key=where or None, allowed=why)


@contextmanager
def used(file: str, stored: bool = True) -> Iterator[None]:
    """Take an error of a computation that uses what a file holds for one of the file, where it was `stored`.

    For data whose form only the computation itself knows: a table of a study, a point of it. What is computed
    anew (`stored` false) may not fail so, and is shown as the defect that it is.

    Raises
    ------
    InputError
        Naming the file; the cause is kept.
    """
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        if not stored:
            raise
        why = f"{type(error).__name__}: {error}"[:200]
        fail(f"holds what cannot be used ({why}); remove it to compute it again", file=file)


def _first(error: ValidationError) -> tuple[str, str]:
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    return ".".join(map(str, first["loc"]))[:200], str(first["msg"])[:200]


@cache
def _adapter(form: Any) -> TypeAdapter[Any]:
    return TypeAdapter(form)
