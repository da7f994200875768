"""Whether the errors that runs print hold, over shipped scenes and variants at several tolerances.

`python -m benchmarks.estimates [CASE ...]` prints, by model, how many errors are within their bound or
thrice it, how tight the bounds are, and what the estimates cost. Errors are against a lockstep far
tighter than any other, and count only from ten times what this and our own loop, as tight, disagree by: for
a lockstep whose twin is our own loop the reference is therefore not its twin.

`--random N --seed S` takes N scenes of `benchmarks.trouble` instead: none that a margin was tuned on.
`--perturbed N` takes N variants of each case, one resistor moved by up to 1 %. A bound may be large beside
one error that happens to be small: bounds and errors are compared as root mean squares over the variants,
for each case, model, setting and measure.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import trouble
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
from cosim.storage.staging import scratch_folder

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
#: A tightness is of so many errors at least, and fails beyond so many times.
LEAST_PERTURBED, LOOSE = 20, 10.0
WITHOUT = frozenset({"ledger_closure", "headroom"})


@dataclass(frozen=True)
class Seen:
    """One measure of one run: its error and bound, as shares of the value."""

    case: str
    model: str
    measure: str
    error: float
    bound: float | None
    setting: int = 0  # of `SETTINGS`


def shipped(names: list[str]) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Return the cases of these names, or all: name -> scene's file and changes."""
    picked = names or [*CASES]
    return {name: (ROOT / "scenes" / f"{CASES[name][0]}.toml", CASES[name][1]) for name in picked}


def random_cases(seed: int, count: int) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Return the first scenes of the random search whose board is sound, by seed and number."""
    sound = ((k, scene) for k in itertools.count() if (scene := trouble.drawn(seed, k)).slip is None)
    return {f"{seed}/{k}": (s.file, s.overrides({})) for k, s in itertools.islice(sound, count)}


def perturbed(
    cases: dict[str, tuple[Path, tuple[str, ...]]], count: int
) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Return variants of each case, its summing resistor within 1 % of its 24.3 kOhm."""
    rng = np.random.default_rng(11)
    return {
        f"{name}/{k}": (
            path,
            (*changes, f"device.values.r_sum_spring='{24.3e3 * rng.uniform(0.99, 1.01):.7g}'"),
        )
        for name, (path, changes) in cases.items()
        for k in range(count)
    }


def tightness(every: list[Seen]) -> dict[tuple[str, str, str], float]:
    """Return rms bound over rms error by (case, model, measure), variants of a case together."""
    groups: dict[tuple[str, str, str], list[Seen]] = {}
    for each in every:
        groups.setdefault(
            (each.case.rpartition("/")[0], f"{each.model} {each.setting}", each.measure), []
        ).append(each)
    return {
        key: math.sqrt(sum((s.bound or math.inf) ** 2 for s in of) / sum(s.error**2 for s in of))
        for key, of in groups.items()
        if len(of) >= LEAST_PERTURBED
    }


def seen(
    name: str, path: Path, changes: tuple[str, ...], child: Child | None
) -> Iterator[Seen | tuple[str, float]]:
    """Run a case: yields what was seen, and for each run (model, CPU with the estimate over without)."""
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
        for number, setting in enumerate(settings):
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
                    yield Seen(name, model, measure, error / size, bound, number)


def main(arguments: list[str]) -> int:
    """Run the cases and print the table; 1 when fewer than 95 % of the errors are within their bound."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.estimates", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--random", type=int, default=0, metavar="N", help="random scenes instead")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--perturbed", type=int, default=0, metavar="N", help="variants of each case")
    args = parser.parse_args(arguments)
    cases = random_cases(args.seed, args.random) if args.random else shipped(args.names)
    if args.perturbed:
        cases = perturbed(cases, args.perturbed)
    every: list[Seen] = []
    ratios: dict[str, list[float]] = {}
    reads = [ROOT / "scenes"]
    child = start_early("cosim.loop.spice.run_spice", reads=reads)
    for name, (path, changes) in cases.items():
        if not child.alive:
            child = start_early("cosim.loop.spice.run_spice", reads=reads)
        try:
            for each in seen(name, path, changes, child):
                if isinstance(each, Seen):
                    every.append(each)
                else:
                    ratios.setdefault(each[0], []).append(each[1])
        except CosimError as error:
            print(f"{name}: {str(error).splitlines()[0]}", flush=True)
        print(f"{name}: {sum(s.case == name for s in every)} errors", flush=True)
        _keep(every)
    child.close()
    for model in SETTINGS:
        mine = [s for s in every if s.model == model]
        if mine:
            print(f"{model}: {_words(mine)}; wall with the estimate over without, one process: median "
                  f"{statistics.median(ratios[model]):.2f}")  # fmt: skip
    for s in every:
        if s.bound is None or s.error > s.bound:
            bound = "none" if s.bound is None else f"{s.bound:.2e}"
            print(f"  beyond: {s.case}, {s.model}, {s.measure}: error {s.error:.2e}, bound {bound}")
    ratios_of = tightness(every) if args.perturbed else {}
    if ratios_of:
        loose = {key: ratio for key, ratio in ratios_of.items() if ratio > LOOSE}
        count = f"{len(ratios_of)} of case, setting and measure, {len(loose)} beyond {LOOSE:g}"
        print(f"rms bound over rms error: {count}")
        for key, ratio in loose.items():
            print(f"  loose: {', '.join(key)}: {ratio:.3g}")
    within = sum(s.bound is not None and s.error <= s.bound for s in every)
    print(f"all: {_words(every)}" if every else "nothing is above the floor")
    return 0 if within >= 0.95 * len(every) else 1


def _keep(seen: list[Seen]) -> None:
    Path("out").mkdir(exist_ok=True)
    Path("out/estimates.json").write_text(json.dumps([vars(s) for s in seen], indent=1) + "\n", "utf-8")


def _words(seen: list[Seen]) -> str:
    one, three = (sum(s.bound is not None and s.error <= k * s.bound for s in seen) for k in (1, 3))
    tight = statistics.median(s.bound / s.error for s in seen if s.bound is not None)
    count = len(seen)
    return (
        f"{count} errors, {100 * one / count:.1f} % within the bound, {100 * three / count:.1f} % within "
        f"three times it, bound over error {tight:.2f} in the median"
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
