"""How far noise moves what is not linear in it, as peaks, heat and rms: measures of paths that are drawn.

A path is the run without noise and a deviation drawn with the exact covariance of the contact held at rest
(`cosim.analysis.noise_draws`). A maximum is one over all rivals, whichever of them the noise makes the
largest; a mean square has its distribution, not a normal one of the same variance.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cosim.analysis.held_contact import HeldContact
from cosim.analysis.noise_covariance import NoiseCovariance, moments_about
from cosim.analysis.noise_draws import PLACES, WEIGHTS, drawn
from cosim.errors import fail
from cosim.measures import STEADY, wall_frame
from cosim.types import Array

__all__ = ["DRAWN", "drawn_halves", "require_one_gain"]

#: The measures that are drawn.
DRAWN = ("peak_force", "max_penetration", "contact_share", "peak_normal_force", "mean_normal_force",
         "force_ripple", "peak_current", "rated_share", "over_rated", "heat")  # fmt: skip
#: Paths: a share of 95 % is known to 0.7 % by a thousand of them, to 1.1 % by the least number.
_MOST, _LEAST = 1000, 400
#: Paths times stretches without an event, from where fewer paths are drawn; some seconds.
_DRAWS = 4e6
#: By how much the scatter may differ between rest and the pose of the contact that is farthest from it.
_SAME_GAIN = 0.15
_SHARE = 0.95
_OUTPUTS = ("penetration", "operator_force", "currents")


def drawn_halves(path: Mapping[str, Array], at_rest: HeldContact, begin_s: float) -> dict[str, float]:
    """Return for each of `DRAWN` how far 95 % of all paths lie from their mean, in its unit.

    Parameters
    ----------
    path
        Signals of the run without noise.
    at_rest
        Contact at its pose of rest, which a path keeps from its beginning on.
    begin_s
        Of the sample that makes the contact, since the run's start.

    Raises
    ------
    InputError
        Where paths leave the wall.
    """
    return {name: _half(values) for name, values in _measures(path, at_rest, begin_s).items()}


def _half(values: Array) -> float:
    """Return the distance from their mean that 95 % of the values keep."""
    return float(np.quantile(np.abs(values - values.mean()), _SHARE))


def require_one_gain(
    path: Mapping[str, Array], at_rest: HeldContact, here: NoiseCovariance, since_s: float
) -> None:
    """Raise an `InputError` where noise moves the contact otherwise at the pose farthest from rest.

    `path` is as of `drawn_halves`, `here` of the contact at rest; poses count from `since_s` [s] on.
    """
    inside = path["time"] >= since_s
    poses = np.column_stack([path[f"q{j + 1}"][inside] for j in range(at_rest.scene.joints)])
    far = poses[np.abs(poses - at_rest.q).max(axis=1).argmax()]
    there = moments_about(at_rest.at(far))
    names = ("penetration", "operator_normal", "currents")
    ratios = [there.rms(name) / here.rms(name) for name in names if here.rms(name) > 0.0]
    apart = max((abs(ratio - 1.0) for ratio in ratios), default=0.0)
    if apart > _SAME_GAIN:
        fail(f"along the contact the gain of the noise changes by {100 * apart:.0f} %")


def _measures(path: Mapping[str, Array], at_rest: HeldContact, begin_s: float) -> dict[str, Array]:
    """Return the measures of `DRAWN` of each path, heat from the contact on; [paths] each."""
    scene, t = at_rest.scene, path["time"]
    assert scene.wall is not None
    end_s, frame = float(t[-1]), wall_frame(scene, path)
    currents = [path[f"imot{j + 1}"] for j in range(scene.joints)]
    mean_path = np.vstack([frame["penetration"], path["fx"], path["fy"], *currents])
    normal = -np.array(scene.wall.normal)
    before = t <= begin_s
    hardest = np.hypot(path["fx"], path["fy"])[before].max()
    largest = np.abs(mean_path[3:, before]).max()
    late_s = end_s - STEADY * end_s
    count = _paths(at_rest, end_s - begin_s)
    peaks = {"depth": np.full(count, -np.inf), "normal": np.full(count, -np.inf),
             "force": np.full(count, hardest), "current": np.full(count, largest)}  # fmt: skip
    heat, pushed, late, squares = np.zeros((4, count))
    held = late_length = 0.0
    inside = np.clip(PLACES, 1e-6, 1.0 - 1e-6)  # a jump's own side
    for stretch in drawn(at_rest, _OUTPUTS, begin_s, end_s, count, scene.seed):
        at = stretch.begin_s + stretch.length_s * inside
        y = stretch.values + np.array([np.interp(at, t, each) for each in mean_path]).T[:, :, None]
        weights = stretch.length_s * WEIGHTS
        push = np.einsum("pok,o->pk", y[:, 1:3], normal)
        seen = {"depth": y[:, 0], "normal": push, "force": np.hypot(y[:, 1], y[:, 2]),
                "current": np.abs(y[:, 3:]).max(axis=1)}  # fmt: skip
        for name, values in seen.items():
            np.maximum(peaks[name], values.max(axis=0), out=peaks[name])
        if (y[:, 0] <= 0.0).any():
            fail("the tip leaves the wall on some of the paths drawn")
        heat += weights @ (y[:, 3:] ** 2).sum(axis=1)
        pushed += weights @ push
        held += stretch.length_s
        if stretch.begin_s >= late_s - 1e-9:
            late, squares = late + weights @ push, squares + weights @ push**2
            late_length += stretch.length_s
    constants = at_rest.constants
    # no path drawn leaves the wall, so the share of contact is that of the run without noise in each of them
    made = {
        "peak_force": peaks["force"], "max_penetration": peaks["depth"], "contact_share": np.zeros(count),
        "peak_normal_force": peaks["normal"], "mean_normal_force": pushed / held, "heat": heat,
        "peak_current": peaks["current"], "rated_share": peaks["current"] / constants.i_rated,
    }  # fmt: skip
    if late_length > 0.0:
        made["force_ripple"] = np.sqrt((squares / late_length - (late / late_length) ** 2).clip(0.0))
    if peaks["current"].max() < constants.i_rated:
        made["over_rated"] = np.zeros(count)
    return made


def _paths(at_rest: HeldContact, span_s: float) -> int:
    """Return how many paths to draw over a time [s]."""
    scene = at_rest.scene
    events = span_s * (3.0 / scene.computer.period_s + 2.0 * scene.device.potentiometer.noise_bandwidth_hz)
    return int(np.clip(_DRAWS / max(events, 1.0), _LEAST, _MOST))
