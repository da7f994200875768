"""Measures: the figures a designer asks of a run, each with unit and words."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.catalogue import ALL_NAMES, MEASURES, NAMES, UNITS, find
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import InputError, Problem, nearest
from cosim.loop.dac_channels import channels
from cosim.scene import PotNoise, Scene
from cosim.scene.tolerance_table import CLASSES
from cosim.signal_statistics import Trace, changes, together
from cosim.units import pretty, quantity

Signals = Mapping[str, NDArray[np.float64]]
#: How far short of its stated limit an amplifier stops that saturates softly.
AT_LIMIT = 0.995
#: The share of a run, at its end, over which steady figures are averaged.
STEADY = 0.2
#: Measures that depend on when the tip was in the wall.
_OF_CONTACT = frozenset(
    {"contact_share", "peak_normal_force", "mean_normal_force", "steady_penetration", "steady_normal_force",
     "steady_tangential_force", "rendered_stiffness", "tangential_ratio", "force_ripple"}
)  # fmt: skip


def wall_frame(scene: Scene, signals: Signals) -> dict[str, NDArray[np.float64]]:
    """Return penetration and place along the wall [m], and forces [N] in the wall's frame.

    'normal' and 'tangent': of the device on the operator; 'push': of the motors, along the normal.

    Normal n points to the free side, tangent t = (n_y, -n_x); penetration is positive inside the wall.
    """
    assert scene.wall is not None
    (px, py), (nx, ny) = scene.wall.point_m, scene.wall.normal
    dx, dy = signals["x"] - px, signals["y"] - py
    fx, fy = -signals["fx"], -signals["fy"]
    push = signals["fmx"] * nx + signals["fmy"] * ny
    return {
        "push": push,
        "penetration": -(dx * nx + dy * ny),
        "along": dx * ny - dy * nx,
        "normal": fx * nx + fy * ny,
        "tangent": fx * ny - fy * nx,
    }


def time_mean(t: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Mean of a signal over unequal steps."""
    span = float(t[-1] - t[0])
    return float(np.trapezoid(y, t) / span) if span > 0 else float(y[-1])


def headroom(amplifiers: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Amplifiers by headroom, the smallest first: the first clips first."""
    return sorted((a for a in amplifiers if a["swing_v"]), key=lambda a: float(a["headroom"]))


def standard(
    scene: Scene,
    constants: DesignConstants,
    signals: Signals,
    samples: Signals,
    amplifiers: list[dict[str, Any]],
    ledger: Mapping[str, Any],
    names: Collection[str] = NAMES,
) -> dict[str, dict[str, Any]]:
    """Every measure that applies to the scene, of those that are wanted: name -> {value, unit, text}."""
    out: dict[str, dict[str, Any]] = {}

    def add(name: str, value: Callable[[], float], text: str = "") -> None:
        if name in names:
            text = text or MEASURES[name].text
            out[name] = {"value": float(value()), "unit": UNITS[name], "text": text}

    t = np.asarray(signals["time"])
    span = float(t[-1] - t[0])
    trace = _tracer(scene, signals)
    add("peak_force", lambda: trace(np.hypot(signals["fx"], signals["fy"])).peak())
    if scene.wall is not None:
        frame = wall_frame(scene, signals)
        pen = trace(frame["penetration"], -_tip_speed(scene, signals))
        add("max_penetration", lambda: max(pen.peak(), 0.0))
        if not _OF_CONTACT.isdisjoint(names):
            _add_contact((float(t[0]), float(t[-1])), frame, pen, trace, add)
    currents = [np.asarray(signals[f"imot{j}"]) for j in range(1, scene.joints + 1)]
    both = [trace(sign * current) for current in currents for sign in (1.0, -1.0)]

    @cache
    def peak() -> float:
        return max(each.peak() for each in both)

    def over_rated() -> float:
        if not span or peak() <= constants.i_rated:
            return 0.0
        return together([each.above(constants.i_rated) for each in both]).length / span

    add("peak_current", peak)
    add("rated_share", lambda: peak() / constants.i_rated)
    add("over_rated", over_rated)
    add("heat", lambda: span * sum(each.mean_square() for each in both[::2]))
    add("dac_saturations", lambda: float(samples["saturated"].sum()))
    add("unreachable_samples", lambda: float(samples["unsolved"].sum()))
    tightest = headroom(amplifiers)
    if tightest:
        first = tightest[0]
        used = f"{quantity(first['peak_v'], 'V')} of {quantity(first['swing_v'], 'V')}"
        text = f"{first['path']} ({first['part']}) clips first: {used}"
        add("headroom", lambda: first["headroom"], text)
    add("ledger_closure", lambda: ledger["closure"])
    return out


def why_none(scene: Scene, model: str, name: str) -> str:
    """Return why a run on this model has no such measure, one of those that `standard` leaves out."""
    if name == "headroom":
        return "no amplifier's output was watched: a run on spice has it, of a board with bounded outputs"
    if scene.wall is None:
        return "the scene has no wall"
    if name in ("peak_normal_force", "mean_normal_force"):
        return "the tip never touches the wall"
    if name == "tangential_ratio":
        return "no normal force throughout the last fifth of the run"
    return "no contact throughout the last fifth of the run"


def _add_contact(
    run_s: tuple[float, float],
    frame: Mapping[str, NDArray[np.float64]],
    pen: Trace,
    trace: Callable[..., Trace],
    add: Callable[..., None],
) -> None:
    """Add the measures of contact in a run from one time to another; `pen` is the depth in the wall [m]."""
    begin, end = run_s
    normal = trace(frame["normal"])
    contact = pen.above(0.0)
    add("contact_share", lambda: contact.length / (end - begin) if end > begin else 0.0)
    if contact.length > 0.0:
        add("peak_normal_force", lambda: normal.peak(contact))
        add("mean_normal_force", lambda: normal.mean_over(contact))
    late = end - STEADY * (end - begin), end
    if not len(contact.end) or contact.begin[-1] > late[0] or contact.end[-1] < late[1]:
        return

    def mean(of: Trace) -> float:
        return of.cut(*late).mean()

    sink, push, drag = mean(pen), mean(normal), mean(trace(frame["tangent"]))
    add("steady_penetration", lambda: sink)
    add("steady_normal_force", lambda: push)
    add("steady_tangential_force", lambda: drag)
    add("rendered_stiffness", lambda: mean(trace(frame["push"])) / sink)
    if push != 0.0:  # a device that nobody holds
        add("tangential_ratio", lambda: abs(drag / push))
    add("force_ripple", lambda: math.sqrt(trace(frame["normal"] - push).cut(*late).mean_square()))


def _tracer(scene: Scene, signals: Signals) -> Callable[..., Trace]:
    """Return a function that makes a trace of a signal: (values, rate of change where it is known)."""
    t, effects = np.asarray(signals["time"]), scene.effects
    dacs = [np.asarray(signals[name]) for name in channels(scene.joints) if name in signals]
    changed = changes(dacs, len(t))
    edges = np.diff(changed, prepend=False, append=False)
    # while a DAC settles it ramps: signals have kinks at the ramp's ends, and none jumps
    jumped, kinks = (np.zeros_like(changed), edges) if effects.dac_settling else (changed, None)
    bent = effects.pot_noise is not PotNoise.NONE or effects.component_noise

    def trace(y: NDArray[np.float64], rate: NDArray[np.float64] | None = None) -> Trace:
        return Trace(t, y, jumped, kinks=kinks, slope=rate, bent=bent and rate is None)

    return trace


def _tip_speed(scene: Scene, signals: Signals) -> NDArray[np.float64]:
    """Speed of the tip along the wall's normal [m/s]."""
    assert scene.wall is not None
    nx, ny = scene.wall.normal
    device = scene.device
    if scene.is_slider:
        assert device.slider is not None
        dx, dy = device.slider.direction
        along = (dx * nx + dy * ny) / math.hypot(dx, dy) * device.slider.radius_m
        return np.asarray(along * np.asarray(signals["v1"]))
    assert device.chain is not None
    total = np.zeros(len(np.asarray(signals["time"])))
    phi, rate = np.zeros_like(total), np.zeros_like(total)
    for j, length in enumerate(device.chain.lengths_m, start=1):
        phi = phi + signals[f"q{j}"]
        rate = rate + signals[f"v{j}"]
        total += length * rate * (ny * np.cos(phi) - nx * np.sin(phi))
    return total


def own_measures(scene: Scene) -> list[str]:
    """Return the user's own measures among `[measures] names`: ``file.py:Class``."""
    return [name for name in scene.measures.names if ":" in name]


def chosen(measures: Mapping[str, Mapping[str, Any]], scene: Scene) -> dict[str, Mapping[str, Any]]:
    """Return the measures that `[measures] names` asks for and this run has, all when it asks for none.

    The user's own are called by the name of their class and come on top.
    """
    own = [name.rpartition(":")[2] for name in own_measures(scene)]
    wanted = [name for name in scene.measures.names if ":" not in name] or [*measures]
    return {name: measures[name] for name in dict.fromkeys([*wanted, *own]) if name in measures}


@dataclass(frozen=True)
class Tolerance:
    """A change of a measure that does not matter.

    Attributes
    ----------
    size : share of the measure's value, or in its unit
    relative : which of the two
    """

    size: float
    relative: bool

    def allowed(self, value: float) -> float:
        """Return the allowed change of this value, in its unit."""
        return self.size * abs(value) if self.relative else self.size

    def text(self, unit: str) -> str:
        """Return it in words."""
        return f"{100 * self.size:.4g} %" if self.relative else f"{self.size:.4g} {unit}".strip()


_AMOUNT = re.compile(r"^([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*)$")
#: Prefixes of a unit that a user may write; behind a number of SPICE, M is milli.
PREFIXES = {"u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}


def tolerances(scene: Scene) -> dict[str, Tolerance]:
    """Return the scene's `tolerance` by measure: a bare number is a share, text an amount with its unit.

    Raises
    ------
    InputError
        For every unknown measure, and every amount in a unit that its measure does not have.
    """
    asked, problems = {}, []
    for name, stated in scene.tolerance.measures.items():
        key = f"tolerance.{name}"
        measure = find(name)
        if measure is None:
            problems.append(_unknown(scene, key, name))
            continue
        size = Tolerance(stated, True) if isinstance(stated, float | int) else amount(stated, measure.unit)
        if size is None:
            problems.append(
                Problem(
                    "is not a change of this measure",
                    file=scene.file_name,
                    key=key,
                    value=stated,
                    allowed=f'a share such as 0.01 or "1 %", or an amount such as "0.05 {measure.unit}"'
                    if measure.unit
                    else 'a share such as 0.01 or "1 %", or an amount as text such as "0.05"',
                )
            )
        else:
            asked[name] = size
    if problems:
        raise InputError(problems)
    return asked


def amount(text: str, unit: str) -> Tolerance | None:
    """Return an amount such as ``1 %``, ``0.05 N`` or ``20 mN`` of a measure in `unit`; None for others."""
    match = _AMOUNT.match(text.strip())
    try:
        size = float(match[1]) if match else 0.0
    except ValueError:
        return None
    if match is None or not 0.0 < size < float("inf"):
        return None
    written = match[2].strip()
    if written == "%":
        return Tolerance(size / 100, True)
    if written in (unit, pretty(unit)):
        return Tolerance(size, False)
    if unit and "^" not in unit and written[1:] == unit and written[0] in PREFIXES:
        return Tolerance(size * PREFIXES[written[0]], False)
    return None


def _unknown(scene: Scene, key: str, name: str) -> Problem:
    classes = CLASSES if key.startswith("tolerance.") else ()  # a slip may be one of either kind
    near = nearest(name, (*classes, *NAMES))
    return Problem(
        "no such measure" + (f"; nearest is {near}" if near else ""),
        file=scene.file_name,
        key=key,
        value=name,
        allowed=", ".join((*classes, ALL_NAMES)),
    )


def check_names(scene: Scene) -> None:
    """Raise an `InputError` for every name in `[measures] names` that no run can have."""
    own = own_measures(scene)
    problems = [
        _unknown(scene, "measures.names", name)
        for name in scene.measures.names
        if find(name) is None and name not in own
    ]
    classes = [name.rpartition(":")[2] for name in own]
    problems += [
        Problem(
            "an own measure needs a class whose name no other measure has",
            file=scene.file_name,
            key="measures.names",
            value=name,
        )
        for name, kind in zip(own, classes, strict=True)
        if find(kind) or classes.count(kind) > 1 or not kind.isidentifier()
    ]
    if problems:
        raise InputError(problems)
