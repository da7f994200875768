"""What ``effects = "auto"`` chose, or would try, in words."""

import argparse
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cosim.caution import collected
from cosim.commands.verbosity import remark
from cosim.units import quantity

if TYPE_CHECKING:
    from cosim.ngspice.child import Child
    from cosim.plan import Plan
    from cosim.scene import Scene
    from cosim.variants import Variant


def plan_of(args: argparse.Namespace, scene: "Scene", child: "Child") -> "Plan":
    """Return the plan of a scene, its effects chosen where it leaves that open."""
    from cosim.api.simulation import plan

    begun = time.perf_counter()
    chosen = plan(scene, child=child, trust=args.trust, on_choice=_remark_choice)
    if chosen.choice:
        took = quantity(time.perf_counter() - begun, "s")
        remark(f"effects chosen in {chosen.choice['runs']} runs, {took}")
    return chosen


def open_choice(args: argparse.Namespace, variant: "Variant") -> dict[str, Any]:
    """Return what would be tried, in order, JSON-ready; nothing runs."""
    from cosim.comparisons.effect_candidates import Candidates
    from cosim.ngspice.child import on_demand

    forced = [f"solver.model={args.model}"] if args.model else []
    with collected(forward=False), on_demand() as child:
        candidates = Candidates(args.scene, (*forced, *variant.overrides), trust=args.trust, child=child)
        force_n, least_n, ranked = candidates.force_n(), candidates.tolerance_n(), candidates.ranked()
    return {
        "auto": True,
        "tolerance": candidates.scene.tolerance.measures,
        "force_n": force_n,
        "tolerance_n": least_n,
        "fixed": {name: [candidates.null[name], why] for name, why in candidates.fixed.items()},
        "refused": [[name, value, why] for (name, value), why in candidates.refused.items()],
        "candidates": [
            {
                "effect": rung.effect.name,
                "value": rung.value,
                "model": plan.model,
                "seconds": plan.cost()["seconds"],
                "size_n": size.force_n,
                "size": str(size),
                "to_be_run": size.force_n >= least_n,
            }
            for rung, plan, size in ranked
        ],
    }


def open_lines(scene: "Scene", choice: Mapping[str, Any]) -> list[str]:
    """Return the same in words."""
    stated = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in choice["tolerance"].items())
    head = ("effect", "setting", "model", "predicted", "a priori")

    def table(wanted: bool) -> list[str]:
        rows = [
            (c["effect"], _word(c["value"]), c["model"], f"{quantity(c['seconds'], 's', 2)}", c["size"])
            for c in choice["candidates"]
            if c["to_be_run"] is wanted
        ]
        return [f"    {row}" for row in _aligned([head, *rows])] if rows else ["    none"]

    fixed = [f"{name} = {_word(value)} ({why})" for name, (value, why) in choice["fixed"].items()]
    return [
        f"{scene.title}: effects to be chosen for a tolerance of {stated}",
        f"  before anything has run, forces are taken to be of the order of "
        f"{quantity(choice['force_n'], 'N', 2)}, and "
        f"{quantity(choice['tolerance_n'], 'N', 2)} to matter",
        "  may matter: `cosim run` tries them by size per predicted second and keeps what does",
        *table(True),
        "  too small by themselves: the largest of them is tried, and all of them at once",
        *table(False),
        *([f"  not chosen: {', '.join(fixed)}"] if fixed else []),
        *(f"  not possible here: {name} = {_word(value)}: {why}" for name, value, why in choice["refused"]),
    ]


def _remark_choice(words: str) -> None:
    remark(f"choosing effects: {words}", detail=True)


def choice_lines(choice: Mapping[str, Any]) -> list[str]:
    """Return the list of effects with the reason of each, and what was verified."""
    stated = ", ".join(
        f"{name.replace('_', ' ')} {100 * t['size']:.4g} %"
        if t["relative"]
        else f"{name.replace('_', ' ')} {t['size']:.4g}"
        for name, t in choice["tolerance"].items()
    )
    lines = [f"  effects chosen for a tolerance of {stated}, in {choice['runs']} runs:"]
    rows = [
        ("in" if d["in_force"] else "out", d["effect"], _word(d["value"]), d["why"])
        for d in sorted(choice["decisions"], key=lambda d: not d["in_force"])
    ]
    lines += [f"    {row}" for row in _aligned(rows)]
    return [*lines, *(f"  verified: {verified}" for verified in choice["verified"])]


def _word(value: Any) -> str:
    return str(value).lower()


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
