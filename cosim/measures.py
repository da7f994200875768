"""Measures: the figures a designer asks of a run, each with unit and words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.port import DesignConstants
from cosim.errors import InputError, Problem, nearest
from cosim.scene import Scene

Signals = Mapping[str, NDArray[np.float64]]
#: Every measure there is; those of the wall need one, some of them steady contact.
NAMES = (
    "peak_force",
    "max_penetration",
    "contact_share",
    "peak_normal_force",
    "mean_normal_force",
    "steady_penetration",
    "steady_normal_force",
    "steady_tangential_force",
    "rendered_stiffness",
    "tangential_ratio",
    "force_ripple",
    "peak_current",
    "rated_share",
    "over_rated",
    "heat",
    "dac_saturations",
    "unreachable_samples",
    "headroom",
    "ledger_closure",
)
#: The share of a run, at its end, over which steady figures are averaged.
_STEADY = 0.2


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
    """Amplifiers ordered by what is left to their output limit: the first clips first."""
    return sorted((a for a in amplifiers if a["swing_v"]), key=lambda a: float(a["headroom"]))


def standard(
    scene: Scene,
    constants: DesignConstants,
    signals: Signals,
    samples: Signals,
    amplifiers: list[dict[str, Any]],
    ledger: Mapping[str, Any],
) -> dict[str, dict[str, Any]]:
    """Every measure that applies to the scene: name -> {value, unit, text}."""
    out: dict[str, dict[str, Any]] = {}

    def add(name: str, value: float, unit: str, text: str) -> None:
        out[name] = {"value": float(value), "unit": unit, "text": text}

    t = np.asarray(signals["time"])
    late = t >= t[-1] - _STEADY * (t[-1] - t[0])
    force = np.hypot(signals["fx"], signals["fy"])
    add("peak_force", force.max(), "N", "largest force between operator and device")
    if scene.wall is not None:
        frame = wall_frame(scene, signals)
        pen, normal, tangent = frame["penetration"], frame["normal"], frame["tangent"]
        add("max_penetration", max(float(pen.max()), 0.0), "m", "deepest penetration of the wall")
        inside = pen > 0.0
        add("contact_share", time_mean(t, inside.astype(float)), "", "share of the time in contact")
        if inside.any():
            add("peak_normal_force", normal[inside].max(), "N", "largest normal force in contact")
            held = np.where(inside, normal, 0.0)
            mean = time_mean(t, held) / time_mean(t, inside.astype(float))
            add("mean_normal_force", mean, "N", "mean normal force while in contact")
        steady = late & inside
        if steady.sum() > 2 and inside[late].all():
            sink, push = time_mean(t[late], pen[late]), time_mean(t[late], normal[late])
            drag = time_mean(t[late], tangent[late])
            add("steady_penetration", sink, "m", "mean penetration in the last fifth of the run")
            add("steady_normal_force", push, "N", "mean normal force in the last fifth of the run")
            add("steady_tangential_force", drag, "N", "mean tangential force in the last fifth of the run")
            rendered = time_mean(t[late], frame["push"][late]) / sink
            add("rendered_stiffness", rendered, "N/m", "steady force of the motors over steady penetration")
            if push != 0.0:  # a device that nobody holds
                add("tangential_ratio", abs(drag / push), "", "|F_t/F_n| in the last fifth of the run")
            ripple = normal[late] - push
            add(
                "force_ripple",
                float(np.sqrt(time_mean(t[late], ripple**2))),
                "N",
                "rms of the normal force about its mean",
            )
    n = scene.joints
    current = np.max([np.abs(signals[f"imot{j}"]) for j in range(1, n + 1)], axis=0)
    add("peak_current", current.max(), "A", "largest motor current")
    add("rated_share", current.max() / constants.i_rated, "", "largest motor current over rated current")
    add(
        "over_rated",
        time_mean(t, (current > constants.i_rated).astype(float)),
        "",
        "share of time above rated",
    )
    add("heat", _heat(t, signals, n), "A^2 s", "integral of the squared motor currents")
    add(
        "dac_saturations", float(samples["saturated"].sum()), "", "DAC words clipped at the converter's range"
    )
    add(
        "unreachable_samples",
        float(samples["unsolved"].sum()),
        "",
        "samples whose contact point was out of reach",
    )
    tightest = headroom(amplifiers)
    if tightest:
        first = tightest[0]
        used = f"{first['peak_v']:.3g} V of {first['swing_v']:.3g} V"
        text = f"{first['path']} ({first['part']}) clips first: {used}"
        add("headroom", first["headroom"], "", text)
    add("ledger_closure", ledger["closure"], "", "unexplained share of the energy turned over")
    return out


def _heat(t: NDArray[np.float64], signals: Signals, n: int) -> float:
    squares = np.sum([np.square(signals[f"imot{j}"]) for j in range(1, n + 1)], axis=0)
    return float(np.trapezoid(squares, t))


def chosen(measures: dict[str, dict[str, Any]], scene: Scene) -> dict[str, dict[str, Any]]:
    """Return the measures that `[measures] names` asks for and this run has, all when it asks for none."""
    return {name: measures[name] for name in scene.measures.names or measures if name in measures}


def check_names(scene: Scene) -> None:
    """Raise an `InputError` for every name in `[measures] names` that no run can have."""
    problems = [
        Problem(
            "no such measure" + (f"; nearest is {near}" if (near := nearest(name, NAMES)) else ""),
            file=str(scene.file) if scene.file else None,
            key="measures.names",
            value=name,
            allowed=", ".join(NAMES),
        )
        for name in scene.measures.names
        if name not in NAMES
    ]
    if problems:
        raise InputError(problems)
