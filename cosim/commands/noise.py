"""``cosim noise``: rms force and jitter of a held contact under potentiometer noise, without sampling."""

import argparse
from typing import Any

from cosim.caution import collected
from cosim.commands.command import Command, about, load_variants, scene_arguments
from cosim.units import quantity


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import on_demand

    with on_demand() as child:
        from cosim.api.queries import contact, noise

        cases, texts = [], []
        every = load_variants(args)
        for variant, scene in every:
            with collected(about(variant, every)):
                held = contact(scene, trust=args.trust, child=child)
                facts, model = noise(held, child=child).as_dict(), held.circuit.model
                cases.append({"set": dict(variant.values), "model": model, **facts})
                texts.append(f"{variant.label or scene.title} (circuit model {model})\n{describe(facts)}")
    return {"cases": cases}, "\n".join(texts)


def describe(facts: dict[str, Any]) -> str:
    """Return the figures of a `NoiseCovariance`, and of the components' noise, in words."""
    lines = _of_potentiometers(facts) if "kind" in facts else []
    if "component_force_noise_rms_n" in facts:
        lines.append(
            f"  the board's components {quantity(facts['component_force_noise_rms_n'], 'N', 4)} along the "
            f"normal up to {quantity(facts['component_noise_bandwidth_hz'], 'Hz', 4)}, the tip held still"
        )
    return "\n".join([*lines, *(f"  left out: {note}" for note in facts.get("notes", ()))])


def _of_potentiometers(facts: dict[str, Any]) -> list[str]:
    angles = ", ".join(quantity(x, "rad", 4) for x in facts["angle_jitter_rms_rad"])
    force, everything, operator = (
        quantity(facts[f"{name}_rms_n"], "N", 4)
        for name in ("force_noise", "force_noise_all", "operator_force_noise")
    )
    tip, normal = (quantity(facts[f"{name}_rms_m"], "m", 4) for name in ("jitter", "penetration_jitter"))
    return [
        f"  {facts['kind']} noise of the potentiometers, exact rms over time at rest in contact",
        f"  force of the motors   {force} along the normal, {everything} in all",
        f"  force on the operator {operator} along the normal",
        f"  jitter of the tip     {tip}, {normal} along the normal",
        f"  joint angles          {angles}",
    ]


COMMAND = Command(
    "noise", "compute rms force and jitter of a held contact exactly, without a run", scene_arguments, _run
)
