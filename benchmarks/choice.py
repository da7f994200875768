"""``effects = "auto"`` against all effects on: what the chosen set costs, and what it gets wrong."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.figure import Figure, figure
from benchmarks.rig import ROOT
from cosim.comparisons.choose_effects import choose
from cosim.comparisons.effect_candidates import Candidates
from cosim.measures import tolerances
from cosim.ngspice.child import Child
from cosim.runner import run

#: The scenes, with what each of them decides itself: how the arm lies, who holds it, whether its
#: potentiometer is noisy.
SCENES: Mapping[str, str] = {
    "press": "gravity=false, operator_dynamics=true",
    "drop": 'pot_noise="none", operator_dynamics=true',
    "slope": "gravity=false, operator_dynamics=true",
}
TOLERANCE = ("tolerance.peak_force=0.02", "tolerance.max_penetration=0.02")


@dataclass(frozen=True)
class Compared:
    """The chosen set against everything.

    Attributes
    ----------
    share : change of each measure over the change allowed
    ratios : processor time of the chosen set over that of everything, one a repetition
    choice : processor time of all runs of the choice, verification included, over that of one of everything
    runs : how many runs that was
    """

    share: dict[str, float]
    ratios: list[float]
    choice: float
    runs: int


def compared(name: str, repetitions: int, child: Child | None = None) -> Compared:
    """Choose the effects of a shipped scene and compare with all of them on."""
    scene = ROOT / "scenes" / f"{name}.toml"
    overrides = ("solver.model=auto", f"effects={{auto=true, {SCENES[name]}}}", *TOLERANCE)
    plan, choice_s = choose(scene, overrides, child=child)
    candidates = Candidates(scene, overrides, child=child)
    full = candidates.plan(candidates.everything())
    ratios, slow_s = [], []
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        for repetition in range(repetitions + 1):  # the first warms up
            few, all_ = (
                run(each, Path(folder) / str(k), formats=(), child=child)
                for k, each in enumerate((plan, full))
            )
            if repetition:
                slow_s.append(float(all_.stats["cpu_s"]))
                ratios.append(float(few.stats["cpu_s"]) / slow_s[-1])
        share = {}
        for measure, tolerance in tolerances(candidates.scene).items():
            last = float(all_.measures[measure]["value"])
            share[measure] = abs(float(few.measures[measure]["value"]) - last) / tolerance.allowed(last)
    return Compared(share, ratios, choice_s / statistics.median(slow_s), int(plan.choice["runs"]))


def chosen(repetitions: int) -> list[Figure]:
    """Time of the chosen set over that of everything, of the scene where it is worst."""
    with Child() as child:
        compared_scenes = {name: compared(name, repetitions, child) for name in SCENES}
    worst = max(compared_scenes.values(), key=lambda each: statistics.median(each.ratios))
    details = {
        name: {
            "ratio": statistics.median(each.ratios),
            "choice_over_one_full_run": each.choice,
            "runs_of_the_choice": each.runs,
            **{f"{measure}_over_tolerance": share for measure, share in each.share.items()},
        }
        for name, each in compared_scenes.items()
    }
    return [
        figure(
            "auto_vs_all_effects",
            worst.ratios,
            error_ours=max(share for each in compared_scenes.values() for share in each.share.values()),
            error_unit="largest difference of a measure, over the tolerance of 2 %",
            details=details,
        )
    ]
