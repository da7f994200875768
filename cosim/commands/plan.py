"""``cosim plan``: what a run would simulate, what it leaves out, and what it would cost."""

import argparse
from typing import TYPE_CHECKING, Any

from cosim.caution import collected, warn
from cosim.commands.command import Command, about, load_variants, scene_arguments
from cosim.units import quantity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cosim.plan import Plan


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.analysis.board_range import of_asked
    from cosim.commands.chosen_effects import open_choice, open_lines
    from cosim.plan import resolve

    texts, facts = [], []
    every = load_variants(args)
    for variant, scene in every:
        with collected(about(variant, every)):
            if scene.effects.auto:
                choice = open_choice(args, variant)
                text = "\n".join(open_lines(scene, choice))
            else:
                plan = resolve(scene, trust=args.trust)
                if plan.circuit_states() is None:
                    plan.extracted()
                text, choice = describe(plan), plan.as_dict()
                warn(*of_asked(scene, plan.stated()))
        texts.append((f"{variant.label}\n" if variant.label else "") + text)
        facts.append({"set": dict(variant.values), **choice})
    return {"plans": facts}, "\n\n".join(texts)


def describe(plan: "Plan") -> str:
    """Return a plan in words."""
    facts = plan.as_dict()
    cost = facts["predicted"]
    lines = [
        f"{plan.scene.title}: {quantity(plan.scene.duration_s, 's', 4)} on circuit model '{plan.model}'",
        f"  board {facts['board']}, {facts['joints']} joint(s), {facts['amplifiers']} amplifiers, "
        f"{len(facts['external_sources'])} driven pins",
        f"  states: {facts['mechanical_states']} of the mechanics, {_order(facts)} of the circuit",
        f"  predicted: {cost['points']:.0f} points, {quantity(cost['seconds'], 's')}"
        + (
            f"; of these {cost['noise_points']:.0f} points and "
            f"{quantity(cost['noise_seconds'], 's')} for noise"
            if cost["noise_points"]
            else "; no noise"
        )
        + f"; about {quantity(cost['start_seconds'], 's', 2)} to start",
        "  in force:",
        *(_line(row) for row in facts["effects"]),
        "  left out, the largest first:",
        *(_line(row) for row in facts["left_out"]),
    ]
    return "\n".join([*lines, *(f"  note: {note}" for note in facts["notes"])])


def _order(facts: "Mapping[str, Any]") -> str:
    states = facts["circuit_states"]
    return "an unknown number" if states is None else str(states)


def _line(row: "Mapping[str, Any]") -> str:
    """Return an effect in a line: what it is set to, and how large it is, or why it cannot apply."""
    words = f"not applicable: {row['not_applicable']}" if row["not_applicable"] else row["size"]["words"]
    return f"    {row['name']:19} {row['value']!s:12} {words}"


COMMAND = Command("plan", "show what a run would simulate, leave out and cost", scene_arguments, _run)
