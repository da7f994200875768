"""Random search for trouble: `python -m benchmarks.trouble --seed S -n N`.

Shipped scenes with random periods, stiffnesses, masses, bandwidths, resistors and effects run on every model
that carries them, and once more on the cheapest in another form of the same experiment (`TWINS`): the frame
turned or mirrored, the hand some periods later, values in other units. Every measure is compared between all
models, and between the cheapest and the twin; the outcome is kept (``out/trouble.jsonl``):

agreed    all measures within the sum of the bounds that both runs print, and none apart by more than `APART`
bounded   within that sum, but some apart by more than `APART`: the printed bounds say so
nearly    beyond the sum, but within three times it: of bounds that hold in 95 % a few are
flagged   apart, but both runs' cautions doubt the result, or the measure is printed as not estimable
unstable  apart, or ended by an error, and the held contact grows by the exact eigenvalue of its period map
refused, failed   with a clear error
apart, no number, crashed   trouble, and exit code 1

A scene is drawn from seed and number alone: `--seed S --only K` runs one again. `--resume` leaves out what
the file of results holds already.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rig import ROOT
from cosim.accuracy.estimate import estimator
from cosim.accuracy.solver_settings import MODELS, carries
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.stability import held, stability
from cosim.caution import collected
from cosim.errors import CosimError, InputError
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.storage.staging import scratch_folder

#: From which share of the larger value two runs count as apart for a person who reads no bounds.
APART = 0.02
#: Bounds are of 95 %; beyond three times their sum is no chance.
_CHANCE = 3.0
#: A measure that is zero but for rounding has no share of its own: of the largest of its unit.
_ROUNDING = 1e-9
TROUBLE = ("apart", "no number", "crashed")
#: What a run says where its measures are not to be believed to their bounds.
_DOUBTS = frozenset({
    "sequence-differs", "coupling-unstable", "ledger-open", "not-linear", "rough-fit", "unstable-circuit",
    "stability-unknown", "convergence-aided", "output-latched", "operating-point-left", "amplifier-clipped",
})  # fmt: skip
#: Another form of the same experiment; joints in another order are another device in a chain of links.
TWINS = ("turned", "mirrored", "later", "units")
#: A follower of gain 1e9 loses 1e-9 of the angle it passes: of an arm that is turned a spring's end moves by
#: 1e-9 rad or 1e-10 m, such a share of the least penetrations.
_TURNED_ARM = 1e-5
#: Measures that do not change when a device at rest waits longer.
_TIMELESS = frozenset({
    "peak_force", "max_penetration", "peak_normal_force", "mean_normal_force", "peak_current", "rated_share",
    "heat", "dac_saturations",
})  # fmt: skip
#: Resistors of the shipped boards that are drawn within a factor of two either way.
_RESISTORS = {"r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_diff_fb": 169e3}
_COMMON = ("gravity", "viscous", "encoder", "dac", "dac_settling", "rotor_inertia", "delay", "driver_limit",
           "pot_calibration", "opamp_offset")  # fmt: skip
#: Effects of few devices, each in a tenth of the scenes.
_RARE = ("coulomb", "end_stops", "shaft", "backlash", "component_noise", "dac_skew", "pot_linearity",
         "vca_gain_error", "vca_offset", "vca_nonlinearity", "opamp_slew", "opamp_saturation")  # fmt: skip
#: What a chain's motors see by the angle itself, which the twin changes; a slider's angle stays what it is.
_BY_ANGLE = {"encoder": False, "dac": False, "pot_linearity": False, "pot_calibration": False,
             "opamp_offset": False, "vca_offset": False, "end_stops": False, "pot_noise": "none",
             "vca_nonlinearity": False, "vca_gain_error": False,
             "component_noise": False, "opamp_saturation": False, "opamp_slew": False}  # fmt: skip
#: What keeps a device from resting until its hand moves, or is drawn by the number of the sample.
_BY_TIME = {"gravity": False, "opamp_offset": False, "vca_offset": False, "pot_noise": "none",
            "component_noise": False, "period_jitter": "none", "pot_calibration": False}  # fmt: skip
#: Keys that hold places and directions of the plane.
_PLANE = ("wall.point_m", "wall.normal", "device.start.tip_m", "device.chain.gravity_m_per_s2",
          "device.slider.direction", "device.slider.origin_m", "device.slider.gravity_m_per_s2",
          "operator.waypoints_s_m", "operator.force_s_n")  # fmt: skip

Changes = dict[str, Any]


@dataclass(frozen=True)
class Drawn:
    """A scene of the search: its file, what is changed in it, and which twin it runs against."""

    file: Path
    changes: Changes
    twin: str

    def overrides(self, more: Changes) -> tuple[str, ...]:
        """Return the changes and `more` of them as `load_scene` takes them."""
        merged = self.changes | more
        return tuple(f"{key}={json.dumps(value)}" for key, value in merged.items())


def drawn(seed: int, number: int) -> Drawn:
    """Return the scene `number` of a seed."""
    rng = np.random.default_rng([seed, number])

    def power(low: float, high: float) -> float:
        return float(f"{10 ** rng.uniform(low, high):.4g}")

    def one_of(*words: str) -> str:
        return str(rng.choice(words))

    def rarely() -> bool:
        return bool(rng.random() < 0.1)

    name = one_of("drop", "press", "slope")
    twin = one_of(*(each for each in TWINS if name != "drop" or each != "later"))
    method = one_of("discrete", "continuous", "combined")
    period = min(power(-4, -0.7), 0.2)
    lowest = rng.random() < 0.3  # a circuit of ideal parts, for the model `ideal`
    changes: Changes = {
        "computer.period_s": period,
        "duration_s": float(f"{max(0.3, 4 * period):.4g}"),
        "computer.method": method,
        "computer.discrete_stiffness_n_per_m": 0.0 if method == "continuous" else power(0, 5),
        "computer.analog_stiffness_n_per_m": 0.0 if method == "discrete" else power(0, 2.3),
        "computer.analog_damping_n_s_per_m": 0.0 if method == "discrete" else power(-2, 0.5),
        "computer.dac.skew_s": power(-6, -4),
        "computer.jitter_share": power(-3, -1),
        "solver.time_limit_s": 60.0,
        "seed": int(rng.integers(1 << 30)),
    }
    level = "ideal" if lowest else None
    effects: Changes = {
        "opamp": level or one_of("ideal", "gbw", "full"),
        "vca": level or one_of("ideal", "gbw"),
        "driver_level": level or one_of("ideal", "gbw"),
        "motor": level or one_of("ideal", "emf", "full"),
        "differentiator": level or one_of("ideal", "corner"),
        "period_jitter": one_of("uniform", "normal") if rarely() else "none",
        "pot_noise": one_of("white", "peak_to_peak", "static", "position") if rarely() else "none",
    }
    effects |= {each: bool(rng.integers(2)) and not (lowest and each == "opamp_offset") for each in _COMMON}
    effects |= {each: rarely() and not (lowest and each[:3] in ("vca", "opa", "com")) for each in _RARE}
    changes |= {f"device.values.{key}": f"{v * 2 ** rng.uniform(-1, 1):.5g}" for key, v in _RESISTORS.items()}
    if rng.integers(2):
        changes["device.values.tl072_gbw"] = f"{power(4, 9):g}"
    changes |= _linkage(name, rng, power)
    arm = twin in ("turned", "mirrored") and name != "drop"
    if twin == "later" or arm:
        effects |= _BY_ANGLE if arm else _BY_TIME
        effects["opamp"] = effects["opamp"].replace("full", "gbw")  # `full` has offsets
    if arm and twin == "turned":  # what a follower loses and a rounded scale adds goes by the angle
        effects["opamp"] = "ideal"
        changes["device.values.v_rad"] = repr(20.0 / math.radians(340.0))
    for each in ("opamp_slew", "opamp_saturation"):
        effects[each] &= effects["opamp"] != "ideal"
    effects["rotor_inertia"] |= effects["shaft"]
    effects["backlash"] &= effects["shaft"]
    changes |= {f"effects.{key}": value for key, value in effects.items()}
    return Drawn(ROOT / "scenes" / f"{name}.toml", changes, twin)


def _linkage(name: str, rng: np.random.Generator, power: Any) -> Changes:
    """Draw masses, friction, shafts and stops of a device, and its operator."""
    if name == "drop":
        low, high = float(f"{rng.uniform(-0.3, -0.05):.4g}"), float(f"{rng.uniform(0.01, 0.3):.4g}")
        return {
            "device.slider.mass_kg": power(-3, 1), "operator.mass_kg": power(-3, 1),
            "device.slider.coulomb_n_m": power(-4, -1), "device.slider.stops_rad": [[low, high]],
            "device.slider.shaft_stiffness_n_m_per_rad": power(1, 3),
            "device.slider.shaft_damping_n_m_s": power(-3, -1), "device.slider.backlash_rad": power(-4, -2),
        }  # fmt: skip
    masses = [power(-3, 0), power(-3, 0)]
    return {
        "operator.stiffness_n_per_m": power(0, 3), "operator.mass_kg": power(-3, 1),
        "device.chain.masses_kg": masses,
        "device.chain.inertias_kg_m2": [float(f"{m * 0.1**2 / 12:.4g}") for m in masses],
        "device.chain.coulomb_n_m": [power(-4, -1.5), power(-4, -1.5)],
        "device.chain.stops_rad": [[0.3, float(f"{rng.uniform(0.63, 0.8):.4g}")],
                                   [float(f"{rng.uniform(0.8, 1.05):.4g}"), 2.0]],
        "device.chain.shaft_stiffness_n_m_per_rad": [power(1, 3), power(1, 3)],
        "device.chain.shaft_damping_n_m_s": [power(-3, -1), power(-3, -1)],
        "device.chain.backlash_rad": [power(-4, -2), power(-4, -2)],
    }  # fmt: skip


def twin_changes(scene: Drawn, seed: int, number: int) -> Changes:
    """Return what turns the scene into its twin."""
    rng = np.random.default_rng([seed, number, 1])
    if scene.twin == "units":  # 24300 is 24.3k is 24300000m
        return {f"device.values.{key}": _in_other_units(scene.changes[f"device.values.{key}"], rng)
                for key in _RESISTORS}  # fmt: skip
    if scene.twin == "later":
        operator = load_scene(scene.file).operator
        later = int(rng.integers(1, 6)) * scene.changes["computer.period_s"]
        rows = {key: [[row[0] + later, *row[1:]] for row in getattr(operator, key)]
                for key in ("waypoints_s_m", "force_s_n")}  # fmt: skip
        return {f"operator.{key}": value for key, value in rows.items()} | {
            "duration_s": scene.changes["duration_s"] + later
        }
    angle = rng.uniform(-1.0, 1.0)
    cos, sin = math.cos(angle), math.sin(angle)
    if scene.twin == "turned":
        return _moved(scene, np.array([[cos, -sin], [sin, cos]]))
    # a mirrored arm bends the other way
    bent = {} if scene.file.stem == "drop" else {"device.start.elbow": -1}
    return _moved(scene, np.array([[1.0, 0.0], [0.0, -1.0]])) | bent


def _in_other_units(ohms: str, rng: np.random.Generator) -> str:
    suffix, power = (("k", -3), ("meg", -6), ("m", 3))[int(rng.integers(3))]
    mantissa, exponent = f"{float(ohms):e}".split("e")
    return f"{mantissa}e{int(exponent) + power}{suffix}"


def _moved(scene: Drawn, matrix: NDArray[np.float64]) -> Changes:
    """Return all places and directions of the scene under a linear map of the plane."""
    tables = load_scene(scene.file, scene.overrides({}))
    changes: Changes = {}
    for key in _PLANE:
        value: Any = tables
        for name in key.split("."):
            value = getattr(value, name, None)
        if value is not None:
            rows = np.array(value, float)
            rows[..., -2:] = rows[..., -2:] @ matrix.T
            changes[key] = rows.tolist()
    return changes


@dataclass(frozen=True)
class Answer:
    """What a run said: measures with their bounds (None: not estimable), and its cautions."""

    name: str
    measures: Mapping[str, tuple[float, float | None, str]]
    cautions: frozenset[str]


def answer(name: str, file: Path, overrides: tuple[str, ...], child: Child | None) -> Answer:
    """Run a scene with its estimates."""
    with scratch_folder("trouble") as folder, collected(forward=False) as cautions:
        plan = resolve(load_scene(file, overrides))
        rows = run(plan, folder / "run", formats=(), child=child, errors=estimator(plan, child)).measures
    return Answer(
        name,
        {key: (float(row["value"]), row.get("error"), str(row.get("unit", ""))) for key, row in rows.items()
         if key != "ledger_closure"},
        frozenset(each.code for each in cautions),
    )  # fmt: skip


def gaps(one: Answer, other: Answer, least: float) -> Iterator[dict[str, Any]]:
    """Yield of each measure that both have by how much they are apart: over the bounds, and as a share.

    `least` is the share of the largest of a unit that is no difference.
    """
    common = one.measures.keys() & other.measures.keys()
    if other.name == "later":
        common &= _TIMELESS
    largest: dict[str, float] = {}
    for each in (one, other):
        for value, _, unit in each.measures.values():
            largest[unit] = max(largest.get(unit, 0.0), abs(value))
    for key in sorted(common):
        (a, bound_a, unit), (b, bound_b, _) = one.measures[key], other.measures[key]
        if other.name == "mirrored" and key == "steady_tangential_force":
            b = -b  # the tangent is the normal turned, in either frame
        floor = least * largest[unit]
        known = None if bound_a is None or bound_b is None else bound_a + bound_b + floor
        apart, size = abs(a - b), max(abs(a), abs(b))
        over = math.inf if known is None else apart / known if known > 0.0 else 0.0
        yield {
            "measure": key, "between": [one.name, other.name], "values": [a, b], "bounds": [bound_a, bound_b],
            "over": over if apart > floor else 0.0, "share": apart / size if apart > floor else 0.0,
        }  # fmt: skip


def growth(scene: Drawn, child: Child | None) -> float | None:
    """Return the largest |eigenvalue| of the held contact's period map, free directions apart.

    None where it cannot be linearised.
    """
    try:
        with collected(forward=False):
            plan = resolve(load_scene(scene.file, scene.overrides({"solver.model": "linear"})))
            critical = stability(held(HeldContact.of(plan, child=child))).critical
    except CosimError:
        return None
    return None if critical is None else float(critical.growth)


def judged(answers: list[Answer], twin: Answer, least: float = _ROUNDING) -> dict[str, Any]:
    """Compare the models with one another and the first with the twin, all measures; the worst decides."""
    each_run = [*answers, twin]
    if not all(math.isfinite(value) for run in each_run for value, _, _ in run.measures.values()):
        return {"outcome": "no number", "measures": {run.name: repr(run.measures) for run in each_run}}
    rows = [row for pair in combinations(answers, 2) for row in gaps(*pair, _ROUNDING)]
    rows += gaps(answers[0], twin, least)
    doubted = {run.name for run in each_run if run.cautions & _DOUBTS}
    doubts = sorted(set().union(*(run.cautions & _DOUBTS for run in each_run)))
    seen = {"models": [run.name for run in answers], "compared": len(rows), "doubts": doubts}
    worst = max(rows, key=lambda row: (row["over"], row["share"]))
    if worst["over"] <= 1.0:
        widest = max(rows, key=lambda row: float(row["share"]))
        return seen | {"outcome": "agreed" if widest["share"] <= APART else "bounded", "worst": widest}
    silent = [
        row for row in rows
        if row["over"] > 1.0 and math.isfinite(row["over"]) and not doubted.intersection(row["between"])
    ]  # fmt: skip
    if not silent:
        return seen | {"outcome": "flagged", "worst": worst}
    worst = max(silent, key=lambda row: float(row["over"]))
    return seen | {"outcome": "nearly" if worst["over"] <= _CHANCE else "apart", "worst": worst,
                   "silent": [[row["measure"], *row["between"]] for row in silent]}  # fmt: skip


def outcome(scene: Drawn, seed: int, number: int, child: Child | None) -> dict[str, Any]:
    """Run a scene on all that carries it, and its twin, and say what came of it."""
    answers: list[Answer] = []
    name = "scene"
    try:
        tables = load_scene(scene.file, scene.overrides({}))
        models = [each for each in MODELS if carries(tables, each)]
        for name in models:
            answers.append(answer(name, scene.file, scene.overrides({"solver.model": name}), child))
        name = scene.twin
        changed = twin_changes(scene, seed, number) | {"solver.model": models[0]}
        twin = answer(name, scene.file, scene.overrides(changed), child)
        arm = scene.twin == "turned" and scene.file.stem != "drop"
        seen = judged(answers, twin, _TURNED_ARM if arm else _ROUNDING)
    except InputError as error:
        return {"outcome": "refused", "run": name, "words": error.problems[0].message}
    except CosimError as error:
        seen = {"outcome": "failed", "run": name, "words": str(error).splitlines()[0]}
    except Exception as error:
        return {"outcome": "crashed", "run": name, "words": repr(error)}
    return _confirmed(seen, scene, child)


def _confirmed(seen: dict[str, Any], scene: Drawn, child: Child | None) -> dict[str, Any]:
    """Put the exact eigenvalue beside what did not agree: a motion that grows is unstable."""
    if seen["outcome"] not in ("apart", "flagged", "failed"):
        return seen
    seen["growth"] = growth(scene, child)
    if seen["outcome"] != "flagged" and seen["growth"] is not None and seen["growth"] > 1.0:
        seen |= {"outcome": "unstable", "was": seen["outcome"]}
    return seen


def _kept(file: Path, seed: int) -> dict[int, str]:
    """Return the outcomes that a file holds of a seed by number; a last line that was cut off is dropped."""
    if not file.exists():
        return {}
    *lines, cut = file.read_text(encoding="utf-8").split("\n")
    if cut:
        file.write_text("".join(line + "\n" for line in lines), encoding="utf-8")
    rows = [json.loads(line) for line in lines]
    return {row["number"]: row["outcome"] for row in rows if row["seed"] == seed}


def main() -> int:
    """Draw, run, tell and keep; 1 where there is trouble."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trouble", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-n", type=int, default=100, help="how many scenes")
    parser.add_argument("--only", type=int, metavar="K", help="this one of them alone")
    parser.add_argument("--out", type=Path, default=Path("out/trouble.jsonl"))
    parser.add_argument("--resume", action="store_true", help="go on with what --out holds of this seed")
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    done = _kept(args.out, args.seed) if args.resume else {}
    counts = Counter(done.values())
    child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
    with args.out.open("a" if args.resume else "w", encoding="utf-8") as stream:
        for number in range(args.n) if args.only is None else [args.only]:
            if number in done:
                continue
            if not child.alive:
                child = start_early("cosim.loop.early_imports", reads=[ROOT / "scenes"])
            scene = drawn(args.seed, number)
            seen = outcome(scene, args.seed, number, child)
            counts[seen["outcome"]] += 1
            row = {"seed": args.seed, "number": number, "scene": scene.file.stem, "twin": scene.twin,
                   **seen, "changes": scene.changes}  # fmt: skip
            stream.write(json.dumps(row) + "\n")
            stream.flush()
            if seen["outcome"] in TROUBLE:
                print(json.dumps(row), flush=True)
    child.close()
    print(", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    return int(any(counts[kind] for kind in TROUBLE))


if __name__ == "__main__":
    sys.exit(main())
