"""``cosim effects``: what each effect changes in a scene, and what it costs."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, tolerance_argument, trust_arguments
from cosim.commands.progress import progress
from cosim.units import measured, quantity, signed

if TYPE_CHECKING:
    from cosim.comparisons.effects_ledger import EffectsLedger


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="scene file (TOML)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a key of the scene; repeatable",
    )
    parser.add_argument(
        "--measure",
        default="peak_force",
        metavar="NAME",
        help="measure of the table and the picture; of your own: file.py:Class",
    )
    tolerance_argument(parser, "choose each run's solver settings so that the measure is this right")
    trust_arguments(parser)
    parser.add_argument("-o", "--out", metavar="FOLDER", help="folder for the picture and the table (CSV)")


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import start_early

    with start_early("cosim.loop.early_imports", reads=[Path(args.scene).parent]) as child:
        from cosim.catalogue import OF_A_RUN
        from cosim.comparisons.effects_ledger import effects_ledger
        from cosim.comparisons.measure_values import check_measures
        from cosim.errors import fail
        from cosim.variants import parse_settings

        if args.out:
            from cosim.storage.owned_files import refuse_foreign
            from reports.effects import FILES, MANIFEST

            refuse_foreign(Path(args.out), FILES, MANIFEST)
        check_measures([args.measure])
        name = args.measure.rpartition(":")[2]  # of a user's class, results call it by its name
        own = name != args.measure
        wanted = OF_A_RUN if own or name in OF_A_RUN else (name,)

        settings = parse_settings(args.set, several=False)
        if any(len(setting.values) > 1 for setting in settings):
            fail("a ledger is of one scene: give each name one value", key="--set", value=args.set)
        overrides = tuple(setting.override(setting.values[0]) for setting in settings)
        if own:
            overrides = (*overrides, f"measures.names={json.dumps([args.measure])}")
        how: dict[str, Any] = {"measures": wanted, "child": child, "trust": args.trust}
        if args.tol:
            from cosim.accuracy.tolerance_control import measurer_within, parse_tolerances

            free = all(setting.name != "solver.model" for setting in settings)
            how["measurer"] = measurer_within(replace(parse_tolerances(args.tol), of={name}), free=free)
        with progress("effects") as show:
            ledger = effects_ledger(args.scene, overrides, on_progress=show, **how)
    if name not in ledger.full:
        why = ledger.lacking.get(name)
        fail(
            "this scene has no such measure" + (f": {why}" if why else ""),
            key="--measure", value=args.measure, allowed=", ".join(ledger.full) or None,
        )  # fmt: skip
    text = table(ledger, name)
    if args.out:
        from cosim.scene import load_scene
        from reports.effects import write_effects

        title = load_scene(args.scene, overrides).title

        text += f"\nwrote {write_effects(ledger, name, Path(args.out), title)}"
    return as_dict(ledger), text


def as_dict(ledger: "EffectsLedger") -> dict[str, Any]:
    """Return the ledger JSON-ready."""
    return {
        "runs": ledger.runs,
        "null": {"measures": dict(ledger.null), "wall_s": ledger.null_s},
        "full": {"measures": dict(ledger.full), "wall_s": ledger.full_s},
        "rows": [vars(row) for row in ledger.rows],
        "not_applicable": dict(ledger.not_applicable),
    }


def table(ledger: "EffectsLedger", measure: str) -> str:
    """Return the ledger of one measure, the largest effect first."""
    row = ledger.full[measure]
    unit = str(row["unit"])
    none, last = ledger.null.get(measure), row["value"]
    first = (
        quantity(none["value"], unit, 5)
        if none
        else f"none ({ledger.lacking.get(measure, 'the scene has none')})"
    )
    lines = [
        f"{measure}: {first} with no effect ({quantity(ledger.null_s, 's')}), "
        f"{quantity(last, unit, 5)} with all ({quantity(ledger.full_s, 's')}); "
        + (f"{ledger.runs} runs" if ledger.runs else "no run is needed"),
        "",
        f"{'effect':19} {'value':14} {'alone':>20} {'cost':>9} {'on top of all':>20} {'cost':>9}",
    ]
    size = lambda r: max(abs(r.on.get(measure, 0.0)), abs(r.off.get(measure, 0.0)))  # noqa: E731
    for r in sorted(ledger.rows, key=size, reverse=True):
        sides = [
            f"{_change(changed[measure], errors.get(measure), unit):>20} {signed(cost, 's'):>9}"
            if measure in changed
            else f"{'-':>20} {'-':>9}"
            for changed, errors, cost in ((r.on, r.on_error, r.on_s), (r.off, r.off_error, r.off_s))
        ]
        lines.append(f"{r.effect:19} {r.value:14} {' '.join(sides)}" + (f"  {r.note}" if r.note else ""))
    if ledger.not_applicable:
        lines += ["", "not applicable, not run:"]
        lines += [f"  {name:19} {why}" for name, why in ledger.not_applicable.items()]
    return "\n".join(lines)


def _change(value: float, error: float | None, unit: str) -> str:
    """Return a change, to the digit of its error where there is one."""
    if not error:
        return signed(value, unit)
    return ("+" if value > 0.0 else "") + measured(value, error, unit)


COMMAND = Command("effects", "measure what each effect changes and costs in a scene", _arguments, _run)
