"""Validation of parameters: all problems are raised at once; NaN fails every test."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Checker", "ParameterError", "Refusal", "vector"]


class Refusal(NamedTuple):
    """One refused parameter: its name, the value given, what is allowed."""

    name: str
    value: object
    allowed: str

    def __str__(self) -> str:
        return f"{self.name} = {self.value!r}: must be {self.allowed}"


class ParameterError(ValueError):
    """One or more parameters are refused; `problems` holds them all."""

    def __init__(self, problems: Iterable[Refusal]) -> None:
        self.problems: tuple[Refusal, ...] = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type["ParameterError"], tuple[tuple[Refusal, ...]]]:
        return (ParameterError, (self.problems,))


class Checker:
    """Collects refusals while a set of parameters is read; `done` raises them together."""

    def __init__(self) -> None:
        self.problems: list[Refusal] = []

    def refuse(self, name: str, value: object, allowed: str) -> None:
        """Note one refusal."""
        self.problems.append(Refusal(name, value, allowed))

    def number(
        self, name: str, value: object, *, above: float | None = None, least: float | None = None
    ) -> float:
        """Return `value` as a float that is finite, > `above` and >= `least`."""
        number = _float(value)
        good = math.isfinite(number)
        good = good and (above is None or number > above) and (least is None or number >= least)
        if not good:
            self.refuse(name, value, _range(above, least))
            return 1.0  # a harmless stand-in: `done` raises before anyone sees it
        return number

    def numbers(
        self,
        name: str,
        value: object,
        count: int,
        *,
        above: float | None = None,
        least: float | None = None,
        spread: bool = True,
    ) -> tuple[float, ...]:
        """Return `count` floats; with `spread` a single number stands for all."""
        if spread and isinstance(value, int | float | np.number):
            value = [value] * count
        if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str) or len(value) != count:
            many = "one number or " if spread else ""
            self.refuse(name, value, f"{many}{count} numbers, each {_range(above, least)}")
            return (1.0,) * count
        return tuple(
            self.number(f"{name}[{i}]", item, above=above, least=least) for i, item in enumerate(value)
        )

    def table(self, name: str, value: object, columns: str, most: int) -> tuple[tuple[float, ...], ...]:
        """Return rows of finite numbers whose first column, time, increases."""
        width = len(columns.split(","))
        try:
            rows = [tuple(_float(item) for item in row) for row in value]  # type: ignore[attr-defined]
        except TypeError:
            self.refuse(name, value, f"rows of ({columns})")
            return ()
        if len(rows) > most:
            self.refuse(name, f"{len(rows)} rows", f"at most {most} rows of ({columns})")
            return ()
        for i, row in enumerate(rows):
            if len(row) != width or not all(math.isfinite(item) for item in row):
                self.refuse(f"{name}[{i}]", row, f"{width} finite numbers ({columns})")
                return ()
            if i and not row[0] > rows[i - 1][0]:
                self.refuse(f"{name}[{i}]", row, f"later than the row before it, t = {rows[i - 1][0]:g} s")
                return ()
        return tuple(rows)

    def done(self) -> None:
        """Raise `ParameterError` if anything was refused."""
        if self.problems:
            raise ParameterError(self.problems)


def vector(name: str, value: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return a fresh contiguous float array of `count` finite numbers, or raise `ParameterError`."""
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not np.all(np.isfinite(array)):
        raise ParameterError([Refusal(name, value, f"{count} finite numbers")])
    return array


def _float(value: object) -> float:
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return float(value)
    return math.nan


def _range(above: float | None, least: float | None) -> str:
    if above is not None:
        return f"a finite number > {above:g}"
    if least is not None:
        return f"a finite number >= {least:g}"
    return "a finite number"
