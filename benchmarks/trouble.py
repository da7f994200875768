"""Random search for trouble: `python -m benchmarks.trouble --seed S -n N`.

Shipped scenes with random periods, stiffnesses, masses, resistors, bandwidths and effects run on `linear` and
on `spice`. Of each the outcome is told and kept (``out/trouble.jsonl``): agreed; told (apart by more than
`APART`, but by no more than the errors that both print); refused or failed with a clear error; apart, no
number, or crashed. The last three are trouble, and exit code 1. A scene is drawn from seed and number alone:
`--seed S --only K` runs one again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig import ROOT
from cosim.accuracy.estimate import estimator
from cosim.caution import collected
from cosim.errors import CosimError, InputError
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.storage.staging import scratch_folder

#: Measures that are compared, and from which share of the larger one two models count as apart.
MEASURES, APART = ("peak_force", "max_penetration", "peak_current", "heat"), 0.02
TROUBLE = ("apart", "no number", "crashed")
#: Resistors of the shipped boards that are drawn within a factor of two either way.
_RESISTORS = {"r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_diff_fb": 169e3}
_SWITCHES = ("gravity", "viscous", "encoder", "dac", "dac_settling", "rotor_inertia", "delay", "driver_limit",
             "pot_calibration", "opamp_offset")  # fmt: skip


def drawn(seed: int, number: int) -> tuple[Path, tuple[str, ...]]:
    """Return the scene `number` of a seed: its file and what is changed in it."""
    rng = np.random.default_rng([seed, number])

    def power(low: float, high: float) -> float:
        return float(f"{10 ** rng.uniform(low, high):.4g}")

    name = str(rng.choice(["drop", "press", "slope"]))
    period = min(power(-3.5, -0.7), 0.2)
    method = str(rng.choice(["discrete", "continuous", "combined"]))
    discrete, analog, damping = power(0, 4), power(0, 2.3), power(-2, 0.5)
    changes = [
        f"computer.period_s={period}", f"duration_s={max(0.3, 4 * period):.4g}",
        f"computer.method={method}",
        f"computer.discrete_stiffness_n_per_m={0.0 if method == 'continuous' else discrete}",
        f"computer.analog_stiffness_n_per_m={0.0 if method == 'discrete' else analog}",
        f"computer.analog_damping_n_s_per_m={0.0 if method == 'discrete' else damping}",
        f"effects.opamp={rng.choice(['ideal', 'gbw'])}",
        f"effects.motor={rng.choice(['ideal', 'emf', 'full'])}",
        f"effects.differentiator={rng.choice(['ideal', 'corner'])}",
    ]  # fmt: skip
    changes += [f"effects.{switch}={str(bool(rng.integers(2))).lower()}" for switch in _SWITCHES]
    changes += [f"device.values.{key}='{v * 2 ** rng.uniform(-1, 1):.5g}'" for key, v in _RESISTORS.items()]
    changes += [f"device.values.tl072_gbw='{power(5, 8)}'"] if rng.integers(2) else []
    if name == "drop":
        changes += [f"device.slider.mass_kg={power(-3, 1)}", f"operator.mass_kg={power(-3, 1)}"]
    else:
        changes += [f"operator.stiffness_n_per_m={power(0, 3)}", f"operator.mass_kg={power(-2, 0.5)}"]
    return ROOT / "scenes" / f"{name}.toml", tuple(changes)


def outcome(file: Path, changes: tuple[str, ...], child: Child | None) -> dict[str, Any]:
    """Run a scene on both models and say what came of it."""
    answers: list[dict[str, float]] = []
    doubts: list[dict[str, float]] = []
    for model in ("linear", "spice"):
        try:
            with scratch_folder("trouble") as folder, collected(forward=False):
                plan = resolve(load_scene(file, (*changes, f"solver.model={model}")))
                errors = estimator(plan, child)
                rows = run(plan, folder / "run", formats=(), child=child, errors=errors).measures
            answers.append({name: float(rows[name]["value"]) for name in MEASURES if name in rows})
            doubts.append({name: float(rows[name].get("error") or 0.0) for name in answers[-1]})
        except InputError as error:
            return {"outcome": "refused", "model": model, "words": error.problems[0].message}
        except CosimError as error:
            return {"outcome": "failed", "model": model, "words": str(error).splitlines()[0]}
        except Exception as error:
            return {"outcome": "crashed", "model": model, "words": repr(error)}
    if not all(math.isfinite(value) for each in answers for value in each.values()):
        return {"outcome": "no number", "measures": [{k: repr(v) for k, v in m.items()} for m in answers]}
    linear, spice = answers
    shares = {
        name: abs(linear[name] - spice[name]) / max(abs(linear[name]), abs(spice[name]))
        for name in linear
        if name in spice and max(abs(linear[name]), abs(spice[name])) > 0.0
    }
    worst = max(shares, key=lambda name: shares[name], default="")
    off = shares.get(worst, 0.0)
    if off <= APART:
        return {"outcome": "agreed", "measure": worst, "share": off}
    explained = abs(linear[worst] - spice[worst]) <= sum(each[worst] for each in doubts)
    return {"outcome": "told" if explained else "apart", "measure": worst, "share": off}


def main() -> int:
    """Draw, run, tell and keep; 1 where there is trouble."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trouble", description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-n", type=int, default=100, help="how many scenes")
    parser.add_argument("--only", type=int, metavar="K", help="this one of them alone")
    parser.add_argument("--out", type=Path, default=Path("out/trouble.jsonl"))
    args = parser.parse_args()
    counts: Counter[str] = Counter()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
    with args.out.open("w", encoding="utf-8") as stream:
        for number in range(args.n) if args.only is None else [args.only]:
            if not child.alive:
                child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
            file, changes = drawn(args.seed, number)
            seen = outcome(file, changes, child)
            counts[seen["outcome"]] += 1
            row = {"seed": args.seed, "number": number, "scene": file.stem, "changes": changes, **seen}
            stream.write(json.dumps(row) + "\n")
            stream.flush()
            if seen["outcome"] in TROUBLE:
                print(json.dumps(row), flush=True)
    child.close()
    print(", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    return int(any(counts[kind] for kind in TROUBLE))


if __name__ == "__main__":
    sys.exit(main())
