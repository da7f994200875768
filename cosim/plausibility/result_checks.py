"""Likely mistakes that a finished run shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.caution import Caution
from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.design_constants import DesignConstants
from cosim.measures import AT_LIMIT, Signals, wall_frame
from cosim.plausibility.constants import DEVIATION
from cosim.scene import Level, Method, Scene
from cosim.units import quantity

__all__ = ["of_run"]

#: An output this far beyond its limit is not limited by its model: a limited one stops within a few per cent.
_UNLIMITED = 1.05
#: A start this deep in the wall is more than a rounded start on its surface [m].
_BEGUN_M = 1e-5
#: Force at the tip that a finger does not notice [N], as in `cosim check`.
_REST_N = 0.05


def of_run(
    scene: Scene,
    constants: DesignConstants,
    signals: Signals,
    samples: Signals,
    measures: Mapping[str, Mapping[str, Any]],
    amplifiers: Sequence[Mapping[str, Any]],
    ledger: Mapping[str, Any],
) -> list[Caution]:
    """Return the cautions about a finished run; `measures` are all there are, whatever the scene asks for."""
    return [
        *_clipped(scene, amplifiers),
        *_converters(scene, samples),
        *_gains(scene, constants, samples),
        *_stiffness(scene, signals, measures),
        *_over_limit(scene, constants, measures),
        *_untouched(scene, measures),
        *_begun_inside(scene, constants, signals),
        *_free_force(scene, constants, signals, samples),
        *_ledger(scene, ledger),
    ]


def _asked_stiffness(scene: Scene) -> float:
    """Return the stiffness along the normal that a built-in method asks for [N/m]; 0 where none does."""
    computer = scene.computer
    if scene.wall is None or computer.law is not None:
        return 0.0
    discrete, analog = computer.discrete_stiffness_n_per_m, computer.analog_stiffness_n_per_m
    return {Method.DISCRETE: discrete, Method.CONTINUOUS: analog, Method.COMBINED: discrete + analog}.get(
        computer.method, 0.0
    )


def _clipped(scene: Scene, amplifiers: Sequence[Mapping[str, Any]]) -> Iterator[Caution]:
    unknown = sorted({str(a["part"]) for a in amplifiers if not a["swing_v"]})
    if unknown:
        yield Caution(
            "amplifier-unwatched",
            f"the output limit of {', '.join(unknown)} is not known: nobody sees it clip",
            "state it with swing= in the *@ line of the part's file",
        )
    for a in amplifiers:
        if a["swing_v"] and a["peak_v"] >= AT_LIMIT * a["swing_v"]:
            long_s = a.get("clipped_s")
            share = f" for {quantity(long_s, 's')} of {quantity(scene.duration_s, 's', 4)}" if long_s else ""
            beyond = a["peak_v"] > _UNLIMITED * a["swing_v"]
            reached = f"{a['path']} ({a['part']}) reaches {quantity(a['peak_v'], 'V')}"
            if beyond and not a.get("swing_stated", True) and a["swing_v"] < SUPPLY_V:
                # a model that limits its current: its load here is lighter than that of the bench
                yield Caution(
                    "amplifier-clipped",
                    f"{reached}{share}: into 10 kOhm its model goes no further than "
                    f"{quantity(a['swing_v'], 'V')}, so its current is near its limit",
                    "keep the load light, or take a part with more current",
                )
                continue
            yield Caution(
                "amplifier-clipped",
                f"{reached} of {quantity(a['swing_v'], 'V')}{share}"
                + (": the real one clips, at this level the model does not" if beyond else ""),
                "lower the gain before it or the command"
                + (", or switch on its saturation (level full)" if beyond else ""),
            )


def _converters(scene: Scene, samples: Signals) -> Iterator[Caution]:
    clipped = int(np.count_nonzero(samples["saturated"]))
    if clipped:
        yield Caution(
            "dac-clipped",
            f"a DAC was at the end of its range at {clipped} of {len(samples['saturated'])} samples "
            f"({quantity(clipped * scene.computer.period_s, 's')})",
            "lower the stiffness, damping or force asked for, or change the board's scales",
        )


def _gains(scene: Scene, constants: DesignConstants, samples: Signals) -> Iterator[Caution]:
    pairs = [f"{a}{b}" for a in range(1, scene.joints + 1) for b in range(1, scene.joints + 1)]
    for prefix, what, unit, full in (
        ("ksp", "spring", "N m/rad", constants.k_fs),
        ("ksd", "damper", "N m s/rad", constants.c_fs),
    ):
        gains = np.array([np.abs(samples[f"{prefix}{pair}"]) for pair in pairs], np.float64)
        asked: NDArray[np.float64] = np.asarray(gains.max(axis=0), np.float64)
        beyond = int(np.count_nonzero(asked > full * (1 + 1e-9)))
        if beyond:
            yield Caution(
                "gain-beyond-full-scale",
                f"a {what} gain of {float(asked.max()):.4g} {unit} is asked for, "
                f"{float(asked.max()) / full:.3g} times the board's full scale of {full:.4g} {unit} "
                f"({beyond} of {len(asked)} samples)",
                "ask for less, or raise the board's gain",
            )


def _stiffness(
    scene: Scene, signals: Signals, measures: Mapping[str, Mapping[str, Any]]
) -> Iterator[Caution]:
    asked = _asked_stiffness(scene)
    if asked <= 0.0:
        return
    advice = "look at the board's gains (cosim check) and at edits of its netlist"
    frame = wall_frame(scene, signals)
    inside = frame["penetration"] > 0.0
    weight = np.gradient(np.asarray(signals["time"]))[inside] if inside.sum() > 1 else np.zeros(0)
    push = float((weight * frame["push"][inside]).sum() / weight.sum()) if weight.sum() > 0.0 else 0.0
    if push < 0.0:
        yield Caution(
            "stiffness-wrong-sign",
            f"in contact the motors pull into the wall, with {quantity(-push, 'N')} on average",
            advice,
        )
    elif "rendered_stiffness" in measures:
        rendered = float(measures["rendered_stiffness"]["value"])
        if abs(rendered / asked - 1.0) > DEVIATION:
            yield Caution(
                "stiffness-far-off",
                f"{quantity(rendered, 'N/m', 4)} are rendered where {quantity(asked, 'N/m', 4)} are "
                f"asked for "
                f"({100 * (rendered / asked - 1):+.3g} %)",
                advice,
            )


def _over_limit(
    scene: Scene, constants: DesignConstants, measures: Mapping[str, Mapping[str, Any]]
) -> Iterator[Caution]:
    limited = scene.effects.driver_limit or scene.effects.driver_level is Level.FULL
    peak = float(measures["peak_current"]["value"])
    if not limited and peak > constants.i_limit:
        yield Caution(
            "current-beyond-limit",
            f"a motor gets {quantity(peak, 'A', 4)}, the board's driver stops at i_limit = "
            f"{quantity(constants.i_limit, 'A', 4)}",
            "set effects.driver_limit = true, or ask for less",
        )


def _untouched(scene: Scene, measures: Mapping[str, Mapping[str, Any]]) -> Iterator[Caution]:
    if scene.wall is not None and measures["contact_share"]["value"] == 0.0:
        yield Caution(
            "no-contact",
            "the wall was never touched",
            "look at device.start, at the wall and at the operator's path, or take out [wall]",
        )


def _begun_inside(scene: Scene, constants: DesignConstants, signals: Signals) -> Iterator[Caution]:
    """Yield a start inside the wall: so deep that rated torque is passed, or left for good at once."""
    if scene.wall is None:
        return
    depth = wall_frame(scene, signals)["penetration"]
    begun = float(depth[0])
    if begun <= _BEGUN_M:
        return
    rated_n = constants.i_rated * constants.torque_per_amp / constants.r_tip
    left = np.flatnonzero(depth < 0.0)
    if begun * _asked_stiffness(scene) > rated_n:
        what = f"where the wall asks for more than the motors' rated {quantity(rated_n, 'N')}"
    elif left.size and (depth[left[0] :] < 0.0).all():
        what = "leaves it and never comes back"
    else:
        return
    yield Caution(
        "start-inside-wall",
        f"the tip starts {quantity(begun, 'm')} inside the wall, {what}",
        "look at device.start, at wall.point_m and at the side that wall.normal points to, the free one",
    )


def _free_force(
    scene: Scene, constants: DesignConstants, signals: Signals, samples: Signals
) -> Iterator[Caution]:
    """Yield a force while neither tip nor computer is in contact, beside the back-EMF's brake."""
    if scene.wall is None or scene.computer.law is not None:
        return
    t = np.asarray(signals["time"])
    wait = (2 + scene.computer.delay_periods * scene.effects.delay) * scene.computer.period_s
    touched = np.asarray(samples["time"])[np.asarray(samples["contact"]) > 0.5]
    last = np.searchsorted(touched, t, side="right")
    since = (
        t - np.where(last > 0, touched[np.maximum(last - 1, 0)], -np.inf) if touched.size else t * 0 + np.inf
    )
    free = (wall_frame(scene, signals)["penetration"] < 0.0) & (since > wait)
    if free.sum() < 10:
        return
    per_amp = constants.torques_per_amp(scene.joints)
    for joint in range(1, scene.joints + 1):
        current, speed = signals[f"imot{joint}"][free], signals[f"v{joint}"][free]
        offset = float(np.linalg.lstsq(np.stack([np.ones_like(speed), speed], 1), current, rcond=None)[0][0])
        force = abs(offset * per_amp[joint - 1] / constants.r_tip)
        if force > _REST_N:
            yield Caution(
                "force-out-of-contact",
                f"out of contact motor {joint} pushes with {quantity(force, 'N')} at a reach of "
                f"{quantity(constants.r_tip, 'm', 4)}",
                "look for offsets before it, or a spring that does not switch off (cosim check)",
            )


def _ledger(scene: Scene, ledger: Mapping[str, Any]) -> Iterator[Caution]:
    if not ledger["closes"]:
        # M(q) changes along the way; velocity products compensate for that
        unbalanced = not (scene.is_slider or scene.effects.coriolis)
        yield Caution(
            "ledger-open",
            f"the energy ledger leaves {ledger['closure']:.2g} of the energy unexplained "
            f"(tolerance {ledger['tolerance']:g})",
            "set effects.coriolis = true: without it the motion of links does not conserve energy"
            if unbalanced
            else "shorten solver.max_step_s",
        )
