"""Specifications: what a measure must be for a device to pass."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.catalogue import ALL_NAMES, NAMES, UNITS, find
from cosim.errors import InputError, Problem, nearest
from cosim.measures import PREFIXES
from cosim.ngspice.lines import number
from cosim.units import pretty

__all__ = ["Spec", "parse_specs"]

_FORM = re.compile(r"\s*(\w+)\s*(in|<=|>=|<|>)\s*(.+?)\s*")
_NUMBER = re.compile(r"[-+]?[\d.]+(?:e[-+]?\d+)?(meg|[tgkmunpf])?", re.IGNORECASE)
_ALLOWED = '"NAME in 95..105", "NAME > 500", "NAME <= 0.05 N", "NAME <= 50 mN"'


@dataclass(frozen=True)
class Spec:
    """Limits of a measure in its unit; infinite where it has none."""

    measure: str
    low: float = -math.inf
    high: float = math.inf

    def passed(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which values pass; what could not be measured does not."""
        return np.asarray((values >= self.low) & (values <= self.high))

    @property
    def text(self) -> str:
        """As it is written."""
        unit = f" {UNITS.get(self.measure, '')}".rstrip()
        if math.isinf(self.low):
            return f"{self.measure} <= {self.high:g}{unit}"
        if math.isinf(self.high):
            return f"{self.measure} >= {self.low:g}{unit}"
        return f"{self.measure} in {self.low:g}..{self.high:g}{unit}"


def parse_specs(texts: Iterable[str]) -> tuple[Spec, ...]:
    """Read ``--spec``: ``rendered_stiffness in 95..105``, ``k_max > 500``; several of a measure meet.

    Raises
    ------
    InputError
        With all that is wrong: form, measure, unit, an empty range.
    """
    specs: dict[str, Spec] = {}
    problems = []
    for text in texts:
        made = _parsed(text)
        if isinstance(made, Problem):
            problems.append(made)
            continue
        old = specs.get(made.measure, Spec(made.measure))
        both = Spec(made.measure, max(old.low, made.low), min(old.high, made.high))
        if both.low >= both.high:
            problems.append(Problem("is an empty range: nothing can pass", key="--spec", value=text))
        specs[made.measure] = both
    if problems:
        raise InputError(problems)
    return tuple(specs.values())


def _parsed(text: str) -> Spec | Problem:
    match = _FORM.fullmatch(text)
    if match is None:
        return Problem("is not a specification", key="--spec", value=text, allowed=_ALLOWED)
    name, sign, written = match[1], match[2], match[3]
    of = find(name)
    if of is None:
        near = nearest(name, NAMES)
        reason = "no such measure" + (f"; nearest is {near}" if near else "")
        return Problem(reason, key="--spec", value=text, allowed=ALL_NAMES)
    unit = of.unit
    written, scale = _without_unit(written, unit)
    ends = [_number(part, scale) for part in (written.split("..") if sign == "in" else [written])]
    if len(ends) != (2 if sign == "in" else 1) or any(end is None for end in ends):
        which = f"in {unit}" if unit else "without a unit"
        reason = f"is not a specification of a measure {which}"
        return Problem(reason, key="--spec", value=text, allowed=_ALLOWED)
    low, high = ends[0], ends[-1]
    assert low is not None
    assert high is not None
    if sign == "in":
        return Spec(name, low, high)
    return Spec(name, low=low) if sign.startswith(">") else Spec(name, high=high)


def _without_unit(written: str, unit: str) -> tuple[str, float]:
    """Return what stands before the unit, and the factor of the unit's prefix: 20 mm is 20 and 1e-3."""
    shown = pretty(unit)  # as results are printed
    if not unit or not written.endswith((unit, shown)):
        return written, 1.0
    head = written.removesuffix(unit if written.endswith(unit) else shown)
    if head[-1:] in PREFIXES and "^" not in unit and not head.lower().endswith("meg"):
        return head[:-1].strip(), PREFIXES[head[-1]]
    return head.strip(), 1.0


def _number(text: str, scale: float) -> float | None:
    """Return a number times `scale`, that of its unit; one with a scale of SPICE's (0.5k) has its own."""
    match = _NUMBER.fullmatch(text.strip())
    value = number(text) if match is not None else None
    if match is None or value is None or not math.isfinite(value):
        return None  # 1e999 limits nothing
    return value if match[1] else scale * value
