"""Tables and sections of the page of a Monte Carlo study, those of further models included."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cosim.catalogue import UNITS
from cosim.tolerance.border_strata import STRATA
from cosim.tolerance.intervals import Estimate
from cosim.units import quantity
from reports.page import Picture

if TYPE_CHECKING:
    from cosim.tolerance.model_levels import Levels
    from cosim.tolerance.random_variables import Component
    from cosim.tolerance.rare_study import Rare

__all__ = ["Section", "Table", "percent", "rare_failures", "two_models", "value"]


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes
    ----------
    numbers, codes
        Columns aligned to the right, and those of commands, which are shown as they are typed.
    stacked
        On a narrow screen its cells stand below one another: nobody scrolls along a command.
    """

    title: str
    head: list[str]
    rows: list[list[str]]
    note: str = ""
    file: str = ""
    numbers: set[int] = field(default_factory=set)
    codes: frozenset[int] = frozenset()
    stacked: bool = False


@dataclass(frozen=True)
class Section:
    """A part of the page, as the template of studies takes it."""

    name: str
    title: str
    notes: tuple[str, ...]
    pictures: list[Picture]
    tables: list[Table]
    price: str = ""
    judges: tuple[()] = ()
    link: tuple[str, str] | None = None


def two_models(levels: "Levels") -> Section:
    """Return the section on what a cheaper model adds to the study."""
    rows = []
    for name, each in levels.moments.items():
        unit, pilot = UNITS.get(name, ""), each.pilot
        mean = Estimate(each.mean, each.mean_low, each.mean_high, "")
        spread = Estimate(each.spread, each.spread_low, each.spread_high, "")
        rows.append(
            [
                name, value(mean, unit), value(spread, unit), f"{pilot.correlation:.5f}",
                f"{pilot.of_squares:.5f}", f"{pilot.cost_ratio:.3g}", str(each.dear), str(each.cheap),
                "-" if each.word else f"{pilot.gain():.3g}",
            ]
        )  # fmt: skip
    head = ["measure", "mean", "standard deviation", "correlation", "of the squares", "cost ratio",
            f"samples on {levels.dear}", f"samples on {levels.cheap}", "variance times cost"]  # fmt: skip
    note = (
        f"Samples on {levels.dear}, corrected by many on {levels.cheap} with a factor from a pilot that is "
        "left out. Variance times cost is that of the mean, relative to plain sampling, at the best split."
    )
    tables = [Table("Mean and standard deviation", head, rows, note, stacked=True)]
    if levels.yields:
        rows = [
            [
                text, percent(each.passing),
                *(f"{100 * w:.4g} %: {f} of {n}"
                  for w, f, n in zip(each.weights, each.failed, each.counted, strict=True)),
                f"{each.correlation:.4f}" if math.isfinite(each.correlation) else "no failure",
            ]
            for text, each in levels.yields.items()
        ]  # fmt: skip
        head = [
            "specification",
            "yield",
            *(f"stratum that {name}" if name != "border" else "border" for name in STRATA),
            "correlation",
        ]
        by = " and ".join(dict.fromkeys(each.by for each in levels.yields.values()))
        note = (
            f"Strata by what {by} says: their weight, and how many of their samples on "
            f"{levels.dear} failed. The interval holds an exact bound of all strata and the weights' error; "
            "its ends share the error so that it is expected to be shortest."
        )
        tables.append(Table("Yield by strata", head, rows, note, stacked=True))
    words = tuple(f"{name}: {each.word}." for name, each in levels.moments.items() if each.word)
    words += tuple(f"{text}: {each.word}." for text, each in levels.yields.items() if each.word)
    return Section("levels", "Two models", words, [], tables)


def rare_failures(rare: "Rare", components: Sequence["Component"]) -> Section:
    """Return how rare failures are, and which device fails first; `components` tell units and design."""
    rate = f"{rare.rate.value:.3g} ({rare.rate.low:.3g} to {rare.rate.high:.3g})"
    distance = f"{rare.distance:.3g}" if math.isfinite(rare.distance) else "none found"
    rows = [
        [
            rate, str(rare.samples), f"{rare.effective:.1f}", distance, f"{rare.first_order:.3g}",
            str(rare.places), str(rare.evaluations),
        ]
    ]  # fmt: skip
    head = ["failing share", f"samples on {rare.model}", "effective", "distance [sd]", "first order",
            "places", f"devices on {rare.cheap}"]  # fmt: skip
    note = (
        f"Failures are searched on {rare.cheap} and counted on {rare.model} by importance sampling about the "
        "places found; first order: as if the border were a plane at the nearest one."
    )
    tables = [Table("How often a device fails", head, rows, note, stacked=True)]
    if rare.device:
        of = {each.key: each for each in components}
        table = [
            [key, quantity(number, of[key].unit, 6), quantity(of[key].nominal, of[key].unit, 6),
             _change(number, of[key].nominal)]
            for key, number in rare.device.items()
        ]  # fmt: skip
        head = ["component", "value", "as designed", "change"]
        note = "What deviates most, by its own distribution, comes first; all else is near its design."
        tables.append(Table("The most probable failing device", head, table, note, stacked=True))
    return Section("rare", "Rare failures", (f"{rare.word}.",) if rare.word else (), [], tables)


def _change(number: float, nominal: float) -> str:
    return f"{100.0 * (number / nominal - 1.0):+.3g} %" if nominal else "-"


def value(of: "Estimate", unit: str) -> str:
    """Return an estimate of a measure with its interval, in as many digits as tell the ends apart."""
    halves = [abs(end - of.value) for end in (of.low, of.high) if math.isfinite(end)]
    half = min((each for each in halves if each > 0.0), default=0.0)
    apart = math.ceil(math.log10(abs(of.value) / half)) + 1 if half and of.value else 0
    digits = min(max(apart, 4), 12)
    middle = quantity(of.value, unit, max(digits, 5))
    suffix = middle.partition(" ")[2]
    ends = (quantity(end, unit, digits) if math.isfinite(end) else "not known" for end in (of.low, of.high))
    low, high = (end.removesuffix(f" {suffix}") if suffix else end for end in ends)
    return f"{middle} ({low} to {high})"


def percent(of: "Estimate") -> str:
    """Return a share with its interval."""
    return f"{100 * of.value:.4g} % ({100 * of.low:.4g} to {100 * of.high:.4g})"
