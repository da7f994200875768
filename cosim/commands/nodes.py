"""``cosim nodes``: what a run of a scene can record, and what it can be asked for."""

import argparse
from typing import Any

from cosim.commands.command import Command, load_variants, scene_arguments


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import call, start_early

    with start_early("cosim.loop.recordable") as child:
        from cosim.catalogue import ETA_OF, MEASURES, find
        from cosim.circuits.extraction.block_delays import groups_of
        from cosim.errors import fail
        from cosim.plan import resolve
        from cosim.units import heading, sample_unit, signal_unit

        every = load_variants(args)
        if len(every) > 1:
            fail("names are of one scene: give each name one value", key="--set", value=args.set)
        scene = every[0][1]
        # nodes follow from the effects that the scene states, not from a later choice
        stated = scene.effects.model_copy(update={"auto": False})
        plan = resolve(scene.model_copy(update={"effects": stated}), trust=args.trust)
        names = call(
            "cosim.loop.recordable:recordable",
            {"scene": plan.scene, "board": plan.board, "tolerances": plan.tolerances},
            time_limit_s=scene.solver.time_limit_s,
            deck=str(plan.board.path),
            child=child,
        )
    shares = (find(f"{ETA_OF}{group}") for group in groups_of(plan.board))
    every_measure = [*MEASURES.values(), *filter(None, shares)]
    result = {
        "model": plan.model,
        "nodes": names["nodes"],
        "signals": {name: signal_unit(name) for name in names["signals"]},
        "samples": {name: sample_unit(name) for name in names["samples"]},
        "measures": {m.name: {"unit": m.unit, "text": m.text} for m in every_measure},
    }
    where = "" if plan.model == "spice" else f" (not on this scene's model {plan.model}: --model spice)"
    text = [
        f"nodes, for record.nodes{where}:",
        *(f"  {name}" for name in names["nodes"]),
        "signals, in every result:",
        *(f"  {heading(name, unit)}" for name, unit in result["signals"].items()),
        "samples of the computer, in every result:",
        *(f"  {heading(name, unit)}" for name, unit in result["samples"].items()),
        "measures, for measures.names, tolerance and --measure:",
        *(f"  {heading(m.name, m.unit):30} {m.text}" for m in every_measure),
    ]
    return result, "\n".join(text)


COMMAND = Command("nodes", "list nodes that can be recorded, signals and measures", scene_arguments, _run)
