"""The summary in words: what was run, what it felt like, what it cost, with the numbers that matter."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.units import quantity
from reports.formatting import ratio, share
from reports.view import Amplifier, View

__all__ = ["Tile", "summary", "tiles"]

_METHODS = {
    "discrete": "the computer alone displays the wall",
    "continuous": "the analog circuit alone displays the wall",
    "combined": "computer and analog circuit display the wall together",
    "joint_pd": "each joint is held by its own spring, without the coupling between joints",
}
_OPERATORS = {
    "none": "nobody touches it",
    "mass": "a point mass is fixed to the tip",
    "hand": "a hand (mass, damper, spring about an intended path) holds the tip",
    "python": "an operator written in Python holds the tip",
}


@dataclass(frozen=True)
class Tile:
    """One number at the head of the page."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class _Feel:
    """What the operator met while the computer held the contact."""

    depth_m: float
    mean_n: float
    peak_n: float
    drag: float | None


def _feel(view: View) -> _Feel | None:
    if view.place is None or view.force is None or not view.contact.any():
        return None
    tangential, normal = view.force
    # Means over time, not over points: the solver's points crowd behind every sample.
    span = np.diff(view.time)
    touching = view.contact[:-1]
    held = float(span[touching].sum())
    if held <= 0.0:
        return None
    push = float((span * 0.5 * (normal[1:] + normal[:-1]))[touching].sum()) / held
    across = float((span * 0.5 * np.abs(tangential[1:] + tangential[:-1]))[touching].sum()) / held
    # The run's own measures come first, so that the words and the table cannot differ.
    deepest, mean, peak = (
        _measure(view, name) for name in ("max_penetration", "mean_normal_force", "peak_normal_force")
    )
    return _Feel(
        depth_m=float(-view.place[1].min()) if deepest is None else deepest,
        mean_n=push if mean is None else mean,
        peak_n=float(normal[view.contact].max()) if peak is None else peak,
        drag=across / abs(push) if abs(push) > 1e-9 and not view.straight else None,
    )


def _closure(view: View) -> tuple[float, float | None] | None:
    """Return the residual of the ledger [J] and its share of the energy turned over, as stated."""
    residual = _first(view.run.ledger, "residual_j")
    return (abs(residual), _first(view.run.ledger, "closure")) if residual is not None else None


def _first(table: Mapping[str, Any], *names: str) -> float | None:
    """Return the first of `names` that `table` holds as a number."""
    for name in names:
        value = table.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    return None


def _measure(view: View, name: str) -> float | None:
    return _first(view.run.measures.get(name, {}), "value")


def _price(view: View) -> tuple[float, float, float] | None:
    """Return points, wall time [s] and time per point [s]."""
    points = _first(view.run.stats, "points") or float(view.time.size)
    wall = _first(view.run.stats, "wall_s")
    return (points, wall, wall / points) if wall is not None and points > 0 else None


def _error(view: View) -> float | None:
    """Return the largest error of the coupling in one step [rad]: angle predicted against integrated."""
    return _first(view.run.stats, "defect_max_rad")


def summary(view: View) -> list[str]:
    """Return the sentences of the summary; each part of the run that is absent leaves its sentence out."""
    parts = [_what(view), _wall(view), _stiffness(view), _room(view), _energy(view), _cost(view)]
    return [part for part in parts if part]


def _what(view: View) -> str:
    method = view.scene_at("computer", "method")
    who = view.scene_at("operator", "type", default="none")
    words = f"{quantity(view.end_s, 's')} were simulated"
    if view.joints:
        words += f" with {view.joints} joint{'s' if view.joints > 1 else ''}"
    if view.period_s is not None:
        words += f", the computer sampling every {quantity(view.period_s, 's')}"
    words += "."
    if method in _METHODS:
        words += f" Method {method}: {_METHODS[method]}; {_OPERATORS.get(who, 'somebody holds the tip')}."
    model = view.plan.get("model")
    return words + (f" Circuit model: {model}." if isinstance(model, str) else "")


def _wall(view: View) -> str:
    if view.place is None:
        return "" if view.wall else "There is no wall in this scene."
    feel = _feel(view)
    if feel is None:
        return "The wall was not touched."
    words = (
        f"In contact the tip sinks at most {quantity(feel.depth_m, 'm')} into the wall and feels "
        f"{quantity(feel.mean_n, 'N')} along the normal on average, {quantity(feel.peak_n, 'N')} at the peak."
    )
    if feel.drag is not None:
        words += (
            f" Along the wall it feels {share(feel.drag)} of that (mean |F_t| over mean F_n of the whole "
            "contact, damping and inertia of the device included; the measure tangential_ratio is that of "
            "the means in the last fifth of the run, where drags of both signs cancel)."
        )
    return words


def _stiffness(view: View) -> str:
    rendered, asked = _measure(view, "rendered_stiffness"), view.stiffness
    if rendered is None:
        return ""
    words = f"In the last fifth of the run the motors' force over the depth is {quantity(rendered, 'N/m', 4)}"
    if asked > 0.0:
        words += f" where {quantity(asked, 'N/m', 4)} was asked for ({100 * (rendered / asked - 1.0):+.2g} %)"
    return words + "."


def _part(amplifier: Amplifier) -> str:
    return f" ({amplifier.part})" if amplifier.part else ""


def _room(view: View) -> str:
    words = []
    if view.amplifiers:
        first = view.amplifiers[0]
        left = first.swing_v - first.peak_v
        if left > 0:
            words.append(
                f"{first.name}{_part(first)} would clip first: it takes {quantity(first.peak_v, 'V')} of "
                f"its {quantity(first.swing_v, 'V')} swing, {quantity(left, 'V')} are left."
            )
        else:
            clipped = [amplifier.name for amplifier in view.amplifiers if amplifier.used >= 1.0]
            words.append(f"Amplifiers at their limit: {', '.join(clipped[:5])}, {first.name} first.")
    names = [f"imot{joint + 1}" for joint in range(view.joints)]
    rated = view.constant("i_rated")
    if names and view.has(*names) and rated:
        peak = max(float(np.abs(view.signal(name)).max()) for name in names)
        words.append(
            f"The largest motor current is {quantity(peak, 'A')}, {share(peak / rated)} of the rated one."
        )
    saturated = view.sampled("saturated")
    if saturated.size and saturated.any():
        words.append(
            f"A DAC was at the end of its range at {int((saturated > 0).sum())} of {saturated.size} samples."
        )
    return " ".join(words)


def _energy(view: View) -> str:
    closure = _closure(view)
    if closure is None:
        return ""
    residual, relative = closure
    words = f"The energy ledger closes to {quantity(residual, 'J')}"
    return words + (f" ({ratio(relative)} of the energy turned over)." if relative is not None else ".")


def _cost(view: View) -> str:
    price = _price(view)
    if price is None:
        return ""
    points, wall, each = price
    words = (
        f"It took {points:.0f} points and {quantity(wall, 's')} of wall time, {quantity(each, 's')} a point"
    )
    if view.end_s > 0.0:
        words += f", {wall / view.end_s:.2g} s for a simulated second"
    total = _first(view.run.stats, "total_s")
    if total is not None:
        words += f" ({quantity(total, 's')} with start and saving)"
    error = _error(view)
    if error is not None:
        words += f"; the coupling's largest error in a step is {quantity(error, 'rad', 2)}"
    return words + "."


def tiles(view: View) -> list[Tile]:
    """Return the numbers at the head of the page, as far as the run has them."""
    out = []
    feel = _feel(view)
    if feel is not None:
        out.append(Tile("deepest", quantity(feel.depth_m, "m"), "into the wall"))
        out.append(
            Tile("normal force", quantity(feel.mean_n, "N"), f"mean; peak {quantity(feel.peak_n, 'N')}")
        )
        if feel.drag is not None:
            out.append(Tile("tangential drag", share(feel.drag), "of the normal force, whole contact"))
    if view.amplifiers:
        first = view.amplifiers[0]
        left = first.swing_v - first.peak_v
        value = f"{quantity(left, 'V', 2)} left" if left > 0 else "clips"
        out.append(Tile("least headroom", value, first.name))
    closure = _closure(view)
    if closure is not None:
        residual, relative = closure
        note = f"left over, {ratio(relative)} of what moved" if relative is not None else "left over"
        out.append(Tile("energy ledger", quantity(residual, "J", 2), note))
    price = _price(view)
    if price is not None:
        points, wall, each = price
        out.append(Tile("cost", f"{quantity(wall, 's')}", f"{points:.0f} points, {quantity(each, 's')} each"))
    return out
