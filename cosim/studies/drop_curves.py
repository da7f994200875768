"""Curves of the drop test, and verdicts from them on Figs 13 and 14."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from cosim.scene import Scene
from cosim.scene.parameters import Field, Variation
from cosim.scene.quantities import Period
from cosim.studies.study import Verdict

__all__ = ["REFINED", "Family", "Limits", "compared", "curve", "slope", "verdicts"]

#: Bisections of the last step of the scan.
REFINED = 6
#: What 2c/T leaves out for small b T/m, and a drop that gives up early, as a share of what a damper adds.
_SMALL = 0.1


class Family(Variation):
    """One curve; its own periods and phases, if any, replace the study's."""

    kind: Literal["curve", "sensitivity"] = "curve"
    periods_s: tuple[Period, ...] = ()
    phases: int | None = Field(default=None, ge=1, le=1024)


Limits = Mapping[tuple[str, float], Mapping[str, Any]]


def curve(limits: Limits, name: str, key: str = "first_n_per_m") -> dict[float, float]:
    """Return a curve: limit by period, where there is one."""
    return {period: row[key] for (other, period), row in limits.items() if other == name and row[key]}


def compared(limits: Limits, first: str, other: str) -> list[float]:
    """Return the periods, shortest first, at which two curves have limits dropped and exact."""
    keys = ("first_n_per_m", "exact_n_per_m")
    return sorted(
        set.intersection(*(set(curve(limits, name, key)) for name in (first, other) for key in keys))
    )


def slope(values: Mapping[float, float]) -> float:
    """Log-log slope of a limit over the period."""
    return float(np.polyfit(np.log(list(values)), np.log(list(values.values())), 1)[0])


def verdicts(
    limits: Limits, families: Sequence[Family], scenes: Mapping[str, Scene], ideal: Mapping[str, float],
    shown: Mapping[str, Mapping[float, float]], ratio: float,
) -> list[Verdict]:  # fmt: skip
    """Judge F13a on every curve, F13b, F13c and F14 on those that add a spring or damper to the first.

    Parameters
    ----------
    limits, families, scenes
        What every curve gave.
    ideal
        What a damper adds to the exact limit with an ideal circuit [N/m], by curve.
    shown
        Stiffness that is displayed at the limit [N/m], by curve and period.
    ratio
        Step of the scan; its last bisection leaves the limit open by this to the power 2^-6.
    """
    out = []
    first = families[0].name
    base = curve(limits, first)
    for family in families:
        values = curve(limits, family.name)
        sharp_at = curve(limits, family.name, "exact_n_per_m")
        exact = {period: sharp_at[period] for period in values if period in sharp_at}
        if family.kind != "curve":
            continue
        if len(values) < 3 or len(exact) < 3:
            out.append(_without_border(family.name, values, exact))
            continue
        computer = scenes[family.name].computer
        spring, damper = computer.analog_stiffness_n_per_m, computer.analog_damping_n_s_per_m
        shared = sorted(base.keys() & values.keys())
        if not spring and not damper:
            seen, theory = slope(values), slope(exact)
            steep = family.name != first or abs(seen + 1.0) <= 0.15
            out.append(
                Verdict(
                    "F13a", f"the limit goes with one over the period: {family.name}",
                    "log-log slope -1.0 +- 0.15, and of the exact limit +- 0.05" if family.name == first
                    else "log-log slope of the exact limit +- 0.05",
                    f"slope {seen:.3f}; of the exact limit {theory:.3f}",
                    steep and abs(seen - theory) <= 0.05, own=family.name != first,
                )
            )  # fmt: skip
        if spring and shared:
            drift = {period: values[period] / base[period] - 1.0 for period in shared}
            short = [abs(drift[period]) for period in shared if period <= 0.0101]
            text = ", ".join(f"{100 * drift[p]:+.1f} % at {1e3 * p:.3g} ms" for p in shared)
            out.append(
                Verdict("F13b", f"the discrete limit is 'almost identical': {family.name}",
                        "within 3 % for periods up to 10 ms", text, max(short) <= 0.03 if short else None)
            )  # fmt: skip
            out.append(_adds_up(family.name, spring, {p: (values[p], shown[family.name][p]) for p in shared}))
        both = compared(limits, first, family.name)
        if damper and both:
            period = both[0]
            exact_gain, gain = (
                limits[family.name, period][key] - limits[first, period][key]
                for key in ("exact_n_per_m", "first_n_per_m")
            )
            open_by = (ratio ** (0.5**REFINED) - 1.0) * (values[period] + base[period])
            wanted = 2.0 * damper / period
            out.append(
                Verdict(
                    "F14", f"analog damping raises the limit: {family.name}",
                    f"by twice the damping over the period, {wanted:.4g} N/m at {1e3 * period:.3g} ms with "
                    f"an ideal circuit; dropped as "
                    "the exact limit with its own differentiator",
                    f"{ideal[family.name]:+.4g} N/m with an ideal circuit; with its own differentiator "
                    f"{exact_gain:+.4g} exact, {gain:+.4g} +- {open_by:.2g} dropped "
                    f"({100 * gain / base[period]:+.3g} %)",
                    abs(ideal[family.name] / wanted - 1.0) <= _SMALL
                    and abs(gain - exact_gain) <= _SMALL * abs(exact_gain) + open_by,
                )
            )  # fmt: skip
    return out


def _without_border(name: str, values: Mapping[float, float], exact: Mapping[float, float]) -> Verdict:
    """Judge a curve with too few limits for linear theory by what it does have."""
    if len(values) < 3:
        seen = f"a limit at {len(values)} periods only" if values else "no limit at any period"
    else:
        seen = f"drops rest up to a stiffness of log-log slope {slope(values):.3f}"
    if len(exact) < len(values) or not values:
        seen += "; linear theory knows no limit: nothing is damped but by friction, if at all"
    return Verdict(
        "F13a",
        f"the limit goes with one over the period: {name}",
        "three limits and those of linear theory",
        seen,
        None,
        own=True,
    )


def _adds_up(name: str, spring: float, limits: Mapping[float, tuple[float, float]]) -> Verdict:
    """Judge F13c: what is shown at the limit against the limit and the spring, by period."""
    off = max(abs(shown / (limit + spring) - 1.0) for limit, shown in limits.values())
    text = ", ".join(f"{shown:.4g} at {1e3 * p:.3g} ms" for p, (_, shown) in limits.items())
    return Verdict(
        "F13c", f"displayed is the limit + {spring:g} N/m: {name}", "within 1 %, by law and circuit together",
        f"{text} N/m, {100 * off:.2g} % off at most", off <= 0.01,
    )  # fmt: skip
