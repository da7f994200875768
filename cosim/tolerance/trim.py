"""Trimming: a resistor of each device is set until a measure is what it should be, as production would."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from cosim.catalogue import ALL_NAMES, NAMES, find
from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.lines import number
from cosim.scene import Scene
from cosim.tolerance.missing import Missing, Reasons
from cosim.tolerance.monte_carlo import Measurer
from cosim.types import Array

__all__ = ["Trim", "Trimmed", "trims"]

_FORM = re.compile(r"(\w+)\s+to\s+(\S+)\s*(.*)")
#: Settings are looked for within this ratio of the nominal value.
_RANGE = 3.0
#: A device is trimmed when its measure is within this share of the target.
_CLOSE = 1e-4
_ROUNDS = 8
#: Measures that are never negative: sizes, shares of time, numbers of samples, and the stiffness of a wall.
_NOT_NEGATIVE = frozenset(
    {"peak_force", "contact_share", "rendered_stiffness", "tangential_ratio",
     "force_ripple", "peak_current", "rated_share", "over_rated", "heat", "dac_saturations",
     "unreachable_samples", "k_max", "force_noise"}
)  # fmt: skip


@dataclass(frozen=True)
class Trim:
    """A resistor, and what is set with it: `measure` to `target`, in its unit."""

    resistor: str
    measure: str
    target: float


def trims(scene: Scene) -> tuple[Trim, ...]:
    """Return what ``[tolerance] trim`` asks for.

    Raises
    ------
    InputError
        For what is not ``"NAME to VALUE UNIT"``, an unknown measure, a wrong unit, a sign that it never has.
    """
    out, problems = [], []
    for name, text in scene.tolerance.trim.items():
        match = _FORM.fullmatch(text.strip())
        value = number(match[2]) if match else None
        reason, allowed = "", '"rendered_stiffness to 100 N/m"'
        if match is None or value is None or value == 0.0 or not np.isfinite(value):
            reason = "is not a trim"
        elif (measure := find(match[1])) is None:
            near = nearest(match[1], NAMES)
            reason, allowed = "no such measure" + (f"; nearest is {near}" if near else ""), ALL_NAMES
        elif match[3] and match[3] != measure.unit:
            reason, allowed = "is not the measure's unit", measure.unit or "no unit"
        elif value < 0.0 and measure.name in _NOT_NEGATIVE:
            reason, allowed = f"{measure.name} is never negative", f"> 0 {measure.unit}".rstrip()
        if reason:
            file = str(scene.file) if scene.file else None
            problems.append(Problem(reason, file, f"tolerance.trim.{name}", text, allowed=allowed))
        elif match is not None and value is not None:
            out.append(Trim(name.lower(), match[1], value))
    if problems:
        raise InputError(problems)
    return tuple(out)


class Trimmed:
    """Measures devices after each of them was trimmed.

    Parameters
    ----------
    batch
        Measures devices; its keys are those of `columns` and others.
    names
        Its measures.
    trim
        What is set.
    columns
        Places of the resistor's keys among the columns of the values: they are set together, by one ratio.
    """

    def __init__(self, batch: Measurer, names: tuple[str, ...], trim: Trim, columns: tuple[int, ...]) -> None:
        self._batch, self._trim, self._columns = batch, trim, columns
        self._place = names.index(trim.measure)
        self._names = names
        self.failures: Missing = {}

    def measures(self, values: Array) -> Array:
        """Return the measures after trimming; a device that cannot be trimmed has none.

        The logarithm of the ratio is found by the secant method, all devices together; where a setting leaves
        nothing to trim by, half of that step is tried.
        """
        n = len(values)
        old, new = np.zeros(n), np.full(n, 0.02)
        rows = self._at(values, old)
        left_old = rows[:, self._place] / self._trim.target - 1.0
        best_left, best_rows = left_old.copy(), rows.copy()
        missing: dict[int, Reasons] = dict(self._batch.failures)
        for _ in range(_ROUNDS):
            rows = self._at(values, new)
            left = rows[:, self._place] / self._trim.target - 1.0
            known = np.isfinite(left)
            better = known & ~(np.abs(left) >= np.abs(best_left))
            best_left[better], best_rows[better] = left[better], rows[better]
            for k in np.flatnonzero(better).tolist():
                missing[k] = self._batch.failures.get(k, {})
            if not np.any(np.abs(best_left) > 0.01 * _CLOSE):
                break
            slope = (left - left_old) / np.where(new == old, 1.0, new - old)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.where(slope != 0.0, -left / slope, 0.0)
            further = np.clip(new + np.nan_to_num(step), -np.log(_RANGE), np.log(_RANGE))
            half = 0.5 * (old + new)
            old, left_old = np.where(known, new, old), np.where(known, left, left_old)
            new = np.where(known, further, half)
        for k in np.flatnonzero(~(np.abs(best_left) <= _CLOSE)).tolist():
            reason = f"{self._trim.resistor} does not bring {self._trim.measure} to {self._trim.target:g}"
            why = missing.get(k, {}).get(self._trim.measure)
            missing[k] = dict.fromkeys(self._names, f"{reason}: {why}" if why else reason)
            best_rows[k] = np.nan
        self.failures = {k: each for k, each in missing.items() if each}
        return best_rows

    def _at(self, values: Array, ratio: Array) -> Array:
        moved = values.copy()
        moved[:, list(self._columns)] *= np.exp(ratio)[:, None]
        return self._batch.measures(moved)
