"""Whether the errors that runs print hold, over shipped scenes and variants at several tolerances.

`python -m benchmarks.estimates [CASE ...]` prints, by model, how many errors are within their bound or
thrice it, how tight the bounds are, and what the estimates cost. Errors are against a lockstep far
tighter than any other, and count only from ten times what this and our own loop, as tight, disagree by: for
a lockstep whose twin is our own loop the reference is therefore not its twin.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.rig import ROOT
from cosim.accuracy.estimate import estimator
from cosim.accuracy.solver_settings import carries, reference, second_reference
from cosim.caution import collected
from cosim.errors import CosimError
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.results import Run
from cosim.runner import run
from cosim.scene import load_scene
from cosim.staging import scratch_folder

#: Name -> scene and changes.
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "press": ("press", ()),
    "drop": ("drop", ()),
    "slope": ("slope", ()),
    "slope, discrete": ("slope_discrete", ()),
    "slope, joint PD": ("slope_joint_pd", ()),
    "slope, gravity and friction": ("slope", ("effects.gravity=true", "effects.coulomb=true")),
    "slope, white noise": ("slope", ("effects.pot_noise=white", "device.potentiometer.noise_rad=1e-4")),
    "press, parts in full": ("press", ("effects.opamp=full", "effects.vca=full")),
    "drop, 3 ms, no rounding": ("drop", ("computer.period_s=0.003", "effects.encoder=false")),
}
#: Per model, what is run besides the scene's own tolerances.
SETTINGS = {
    "spice": ((), ("solver.rtol=1e-3",), ("solver.rtol=1e-5", "solver.coupling_tolerance_rad=1e-8")),
    "linear": ((), ("solver.max_step_s=8e-3",), ("solver.coupling_tolerance_rad=1e-3",)),
}
#: An error counts from so many times the references' disagreement.
ABOVE_FLOOR = 10.0
WITHOUT = frozenset({"ledger_closure", "headroom"})


@dataclass(frozen=True)
class Seen:
    """One measure of one run: its error and bound, as shares of the value."""

    case: str
    model: str
    measure: str
    error: float
    bound: float | None


def seen(name: str, child: Child | None) -> Iterator[Seen | tuple[str, float]]:
    """Run a case: yields what was seen, and for each run (model, CPU with the estimate over without)."""
    file, changes = CASES[name]
    path = ROOT / "scenes" / f"{file}.toml"
    scene = load_scene(path, changes)

    def simulated(*overrides: str, estimate: bool = False) -> Run:
        with scratch_folder("estimates") as folder, collected(forward=False):
            plan = resolve(load_scene(path, (*changes, *overrides)))
            asked = estimator(plan, child) if estimate else None
            return run(plan, folder / "run", formats=(), child=child, errors=asked)

    first, second = (
        simulated(*setting.overrides).measures for setting in (reference(scene), second_reference(scene))
    )
    truth, other = (second, first) if carries(scene, "linear") else (first, second)
    floor = {n: abs(truth[n]["value"] - other[n]["value"]) for n in truth if n in other}
    for model, settings in SETTINGS.items():
        if not carries(scene, model):
            continue
        for setting in settings:
            begun = time.perf_counter()
            plain = simulated(f"solver.model={model}", *setting)
            middle = time.perf_counter()
            estimated = simulated(f"solver.model={model}", *setting, estimate=True)
            yield model, (time.perf_counter() - middle) / (middle - begun)
            assert {n: r["value"] for n, r in plain.measures.items()} == {
                n: r["value"] for n, r in estimated.measures.items()
            }
            for measure, row in estimated.measures.items():
                if measure in WITHOUT or measure not in floor:
                    continue
                error = abs(row["value"] - truth[measure]["value"])
                if error > ABOVE_FLOOR * floor[measure]:
                    size = abs(truth[measure]["value"]) or 1.0
                    bound = None if row["error"] is None else row["error"] / size
                    yield Seen(name, model, measure, error / size, bound)


def main(names: list[str]) -> int:
    """Run the cases and print the table; 1 when fewer than 95 % of the errors are within their bound."""
    found: list[Seen] = []
    ratios: dict[str, list[float]] = {}
    with start_early("cosim.loop.spice.run_spice", reads=[ROOT / "scenes"]) as child:
        for name in names or CASES:
            try:
                for each in seen(name, child):
                    if isinstance(each, Seen):
                        found.append(each)
                    else:
                        ratios.setdefault(each[0], []).append(each[1])
            except CosimError as error:
                print(f"{name}: {str(error).splitlines()[0]}", flush=True)
            print(f"{name}: {sum(s.case == name for s in found)} errors", flush=True)
    for model in SETTINGS:
        mine = [s for s in found if s.model == model]
        if mine:
            print(f"{model}: {_words(mine)}; wall with the estimate over without, one process: median "
                  f"{statistics.median(ratios[model]):.2f}")  # fmt: skip
    for s in found:
        if s.bound is None or s.error > s.bound:
            bound = "none" if s.bound is None else f"{s.bound:.2e}"
            print(f"  beyond: {s.case}, {s.model}, {s.measure}: error {s.error:.2e}, bound {bound}")
    Path("out").mkdir(exist_ok=True)
    Path("out/estimates.json").write_text(json.dumps([vars(s) for s in found], indent=1) + "\n", "utf-8")
    within = sum(s.bound is not None and s.error <= s.bound for s in found)
    print(f"all: {_words(found)}" if found else "nothing is above the floor")
    return 0 if within >= 0.95 * len(found) else 1


def _words(found: list[Seen]) -> str:
    one, three = (sum(s.bound is not None and s.error <= k * s.bound for s in found) for k in (1, 3))
    tight = statistics.median(s.bound / s.error for s in found if s.bound is not None)
    count = len(found)
    return (
        f"{count} errors, {100 * one / count:.1f} % within the bound, {100 * three / count:.1f} % within "
        f"three times it, bound over error {tight:.2f} in the median"
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
