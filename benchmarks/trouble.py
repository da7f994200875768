"""Random search for trouble: `python -m benchmarks.trouble --seed S -n N`.

Shipped scenes with random periods, stiffnesses, masses, bandwidths, resistors and effects run on every model
that carries them, and once more on the cheapest in another form of the same experiment (`TWINS`): the frame
turned or mirrored, the hand some periods later, values in other units. Every measure is compared between all
models, and between the cheapest and the twin; the outcome is kept (``out/trouble.jsonl``):

agreed    all measures within the sum of the bounds that both runs print, and none apart by more than `APART`
bounded   within that sum, but some apart by more than `APART`: the printed bounds say so
nearly    beyond the sum, but within three times it: of bounds that hold in 95 % a few are
flagged   apart, but both runs' cautions doubt the result, or the measure is printed as not estimable
unstable  apart, or ended by an error, and the held contact grows by the exact eigenvalue of its period map;
          or a board with a slip that all models refuse, with a pole that the eigenvalues of an independent
          nodal analysis have; a board that only one of both calls unstable is apart
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
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

from benchmarks.rig import ROOT
from benchmarks.trouble_boards import growing, is_told
from benchmarks.trouble_scenes import Drawn, drawn, twin_changes
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
from cosim.stability_gate import question
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
#: A follower of gain 1e9 loses 1e-9 of the angle it passes: of an arm that is turned a spring's end moves by
#: 1e-9 rad or 1e-10 m, such a share of the least penetrations.
_TURNED_ARM = 1e-5
#: Measures that do not change when a device at rest waits longer.
_TIMELESS = frozenset({
    "peak_force", "max_penetration", "peak_normal_force", "mean_normal_force", "peak_current", "rated_share",
    "heat", "dac_saturations",
})  # fmt: skip


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
    try:
        return (
            _outcome(scene, seed, number, child)
            if scene.slip is None
            else slipped(scene, seed, number, child)
        )
    except Exception as error:
        return {"outcome": "crashed", "run": "scene", "words": repr(error)}


def slipped(scene: Drawn, seed: int, number: int, child: Child | None) -> dict[str, Any]:
    """Run a scene whose board has a slip; where the board is stable all the same, as any other scene."""
    slip = scene.slip
    assert slip is not None
    with scratch_folder("trouble") as folder:
        board = slip.board(load_scene(scene.file).device.board.name, folder / "netlists")
        scene = replace(scene, changes=scene.changes | {"device.board": str(board)})
        with collected(forward=False):
            asked = question(resolve(load_scene(scene.file, scene.overrides({}))))
        poles = growing(asked.boards[0], asked.commanded)
        words = refusals(scene, child)
        seen: dict[str, Any] = {"slip": slip.words, "poles": [str(pole) for pole in poles or ()]}
        if not poles and not any("unstable" in each for each in words):
            return seen | _outcome(scene, seed, number, child)
        return seen | {"outcome": board_outcome(words, poles), "said": words}


def refusals(scene: Drawn, child: Child | None) -> list[str]:
    """Return what each model that carries the scene refuses it with; empty words where it runs."""
    tables = load_scene(scene.file, scene.overrides({}))
    said = []
    for name in (each for each in MODELS if carries(tables, each)):
        try:
            answer(name, scene.file, scene.overrides({"solver.model": name}), child)
            said.append("")
        except CosimError as error:
            said.append(str(error).splitlines()[0])
    return said


def board_outcome(words: list[str], poles: list[complex] | None) -> str:
    """Hold what all models say of a board against its true poles; None: it has no operating point."""
    if poles is None:
        return "refused" if all(words) else "apart"
    told = ["unstable" in each and is_told(each, poles) for each in words]
    return "unstable" if all(told) else "apart"


def _outcome(scene: Drawn, seed: int, number: int, child: Child | None) -> dict[str, Any]:
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
