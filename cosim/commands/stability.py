"""``cosim stability``: how stiff the scene's wall may be, exactly, and by passivity."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.caution import collected
from cosim.commands.command import Command, about, load_variants, out_argument, scene_arguments
from cosim.units import quantity

if TYPE_CHECKING:
    from cosim.analysis.stiffness_limits import Limits


def _arguments(parser: argparse.ArgumentParser) -> None:
    scene_arguments(parser)
    out_argument(parser)


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.ngspice.child import on_demand

    with on_demand() as child:
        from cosim.api.queries import contact, stability

        cases, texts = [], []
        every = load_variants(args)
        folders = _folders(args, [variant.label for variant, _ in every])
        for (variant, scene), folder in zip(every, folders, strict=True):
            with collected(about(variant, every)):
                held = contact(scene, trust=args.trust, child=child)
                limits, model = stability(held), held.circuit.model
                cases.append({"set": dict(variant.values), "model": model, **limits.as_dict()})
                head = variant.label or scene.title
                texts.append(f"{head} (circuit model {model})\n{describe(limits)}")
                if folder is not None:
                    from reports.stability import write_stability

                    plot = write_stability(limits, held.held(), folder)
                    texts.append(f"wrote {plot}")
    return {"cases": cases}, "\n".join(texts)


def _folders(args: argparse.Namespace, labels: list[str]) -> list[Path | None]:
    """Return where each case is written, if anywhere; refuses what is in the way before the first."""
    if not args.out:
        return [None] * len(labels)
    from cosim.commands.run import folder_names
    from cosim.storage.owned_files import refuse_foreign
    from reports.stability import FILES, MANIFEST

    names = folder_names(labels) if any(labels) else [""]
    folders = [Path(args.out) / name for name in names]
    for folder in folders:
        refuse_foreign(folder, FILES, MANIFEST)
    return [*folders]


def describe(limits: "Limits") -> str:
    """Return the limits in words."""
    facts = limits.as_dict()
    name = limits.key.split("_")[0]
    lines = []
    critical = limits.stability.critical
    if critical is not None:
        verdict = "stable" if limits.stability.stable else "UNSTABLE"
        goes = "grows" if critical.growth > 1.0 else "decays"
        lines.append(
            f"  {verdict} at {_stiff(limits.stiffness)} {name}: critical mode {goes} x {critical.growth:.6f} "
            f"a period, {quantity(critical.frequency_hz, 'Hz', 4)}, damping ratio {critical.damping:.3g}"
            + (" (ambiguous: sampling folds it onto another frequency)" if critical.ambiguous else "")
        )
    if facts["border_n_per_m"] is not None and limits.border.value > 0.0:
        lines.append(
            f"  exact border       {_stiff(limits.border.value)}, "
            f"at {quantity(facts['border_frequency_hz'], 'Hz', 4)}"
        )
    elif limits.border.value > 0.0:
        lines.append("  exact border       none up to 1e7 N/m")
    else:
        lines.append("  exact border       nothing is stable")
    if limits.passive_n_per_m is not None:
        lines.append(f"  passive up to      {_stiff(limits.passive_n_per_m)}")
    elif limits.least_damping_n_m_s < 0.0:
        lines.append("  passive            never: the analog part alone is active at some frequency")
    if limits.gil_hulin_n_per_m is not None:
        lines.append(f"  Gil and Hulin      {_stiff(limits.gil_hulin_n_per_m)} (rule of thumb)")
    if limits.board_n_per_m is not None:
        lines.append(f"  board's range      {_stiff(limits.board_n_per_m)}, its gain DACs at full scale")
    lines.append(
        f"  device's damping   {quantity(limits.viscosity_n_s_per_m, 'N s/m', 5)} along the normal"
        + (
            f"; the discrete law needs {quantity(limits.needed_n_s_per_m, 'N s/m', 5)}"
            if limits.needed_n_s_per_m is not None
            else ""
        )
    )
    lines.append(f"  design for         {_advice(limits)}")
    if limits.stability.free:
        lines.append(f"  free directions    {limits.stability.free} (nothing holds the tip along the wall)")
    return "\n".join([*lines, *(f"  left out: {note}" for note in limits.stability.notes)])


def _stiff(value: float) -> str:
    return quantity(value, "N/m", 5)


def _advice(limits: "Limits") -> str:
    """Return which limit to design for, and why the others differ."""
    value, which = limits.design
    if value == 0.0:
        return "nothing: no stiffness is stable with this circuit and period"
    if math.isinf(value):
        return "any stiffness up to 1e7 N/m"
    text = f"{_stiff(value)}, {which}: "
    if which == "the board's range":
        text += "no stiffness beyond it can be commanded, and up to it this scene is stable"
    elif which == "the largest passive stiffness":
        text += "stable whoever holds the device, at rest or moving"
    elif limits.passive_n_per_m is None:
        text += "for this operator and pose, contact held; another hand or pose has another border"
    else:
        text += "this operator or pose is worse than the device held by nobody"
    if which != "the exact border" and limits.border.value > value:
        text += "; the exact border is for this operator and pose, contact held"
    if limits.gil_hulin_n_per_m is not None:
        text += (
            "; Gil and Hulin's rule knows the device's damping and the delay alone, no mass and no circuit"
        )
    return text


COMMAND = Command(
    "stability", "find how stiff a wall may be: exact border, modes, passivity", _arguments, _run
)
