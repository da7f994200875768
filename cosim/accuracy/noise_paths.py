"""What noise does to the errors of a study: how far other paths lead, and what a setting does to the mean.

A study runs all settings on one path of the noise; their errors on it are strong errors. From path to path a
quantity scatters by itself: digits below that are the path's. The weak error, of the mean over all paths, is
that of the differences from the reference on shared paths, which scatter less than the values do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.accuracy.solver_settings import Setting
from cosim.scene import PotNoise, Scene

__all__ = ["PATHS", "NoisePaths", "noise_paths", "noisy"]

#: Paths besides the study's own: a scatter is known to a third (95 %).
PATHS = 20
_TAIL = 0.025

Run = Mapping[str, Any]


@dataclass(frozen=True)
class NoisePaths:
    """What other paths of the noise say.

    Attributes
    ----------
    count : number of paths
    scatter : quantity -> by how much another path changes it, rms, and the 95 % interval of that; shares
    weak : label of a setting -> measure -> mean difference from the reference on shared paths, and half of
        its 95 % interval; shares
    """

    count: int
    scatter: Mapping[str, tuple[float, float, float]]
    weak: Mapping[str, Mapping[str, tuple[float, float]]]

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "count": self.count,
            "scatter": {name: list(of) for name, of in self.scatter.items()},
            "weak": {label: {name: list(of) for name, of in row.items()} for label, row in self.weak.items()},
        }


def noisy(scene: Scene) -> bool:
    """Whether noise is drawn anew for every seed."""
    return scene.effects.pot_noise is not PotNoise.NONE or scene.effects.component_noise


def on_path(setting: Setting, seed: int) -> Setting:
    """Return the setting on the path of another seed."""
    return replace(setting, label=f"{setting.label}, seed {seed}",
                   overrides=(*setting.overrides, f"seed={seed}"))  # fmt: skip


def noise_paths(
    seeds: Sequence[int],
    point: Callable[[Setting, int], Run],
    reference: Setting,
    settings: Sequence[Setting],
    judged: Callable[[Run], Mapping[str, float]],
    values: Mapping[str, float],
) -> NoisePaths:
    """Run the reference and some settings on other paths.

    Parameters
    ----------
    seeds
        Of the paths.
    point
        Runs a setting: (setting, repetition) -> measures and motion, or why it failed.
    judged
        Errors of a run against the reference on the study's own path, shares.
    values
        Measures of that reference.
    """
    from scipy.stats import chi2, t

    truths = {seed: run for seed in seeds if "failed" not in (run := point(on_path(reference, seed), 0))}
    changes = [judged(run) for run in truths.values()]
    scatter: dict[str, tuple[float, float, float]] = {}
    weak: dict[str, dict[str, tuple[float, float]]] = {}
    for name in changes[0] if changes else ():
        there = [each[name] for each in changes if name in each]
        rms = math.sqrt(sum(each * each for each in there) / len(there))
        low, high = (rms * math.sqrt(len(there) / chi2.ppf(q, len(there))) for q in (1.0 - _TAIL, _TAIL))
        scatter[name] = rms, float(low), float(high)
    for setting in settings:
        runs = {seed: point(on_path(setting, seed), 0) for seed in truths}
        weak[setting.label] = {}
        for name, value in values.items():
            apart = np.array(
                [
                    (run["measures"][name] - truths[seed]["measures"][name]) / abs(value)
                    for seed, run in runs.items()
                    if name in run.get("measures", {}) and name in truths[seed]["measures"] and value != 0.0
                ]
            )
            if len(apart) > 1:
                half = t.ppf(1.0 - _TAIL, len(apart) - 1) * apart.std(ddof=1) / math.sqrt(len(apart))
                weak[setting.label][name] = float(apart.mean()), float(half)
    return NoisePaths(len(truths), scatter, weak)
