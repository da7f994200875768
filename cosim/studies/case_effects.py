"""The effects that the cases of a study include, with their levels, for the study's page."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.analysis.tip import row
from cosim.effects import EFFECTS
from cosim.scene import Scene
from cosim.scene.parameters import Variation
from cosim.studies.study import StudyFile, Table

__all__ = ["holds_table", "in_words"]

#: What a small motion about rest leaves out though a scene asks for it; `cosim.analysis.linearise` says why.
_NO_PART = frozenset(
    {"coulomb", "encoder", "dac", "period_jitter", "coriolis", "geometric_stiffness", "pot_linearity",
     "pot_calibration", "end_stops", "backlash", "driver_limit", "opamp_slew", "opamp_saturation"}
)  # fmt: skip


def in_words(name: str, value: object) -> str:
    """Return an effect in force as ``opamp gbw``, or its name where it is on or off."""
    return name if value is True else f"{name} {value}"


def holds_table(spec: StudyFile, cases: Sequence[Variation], adds: str) -> Table:
    """Return the effects of every case, which is a linear model about rest, one row a case.

    Parameters
    ----------
    adds
        What the study itself adds to them, in a sentence.
    """
    columns: dict[str, list[str]] = {}
    off: list[set[str]] = []
    for case in cases:
        scene = spec.scene(*case.set)
        held = [effect for effect in EFFECTS if effect.is_in_force(scene)]
        off.append({effect.name for effect in EFFECTS} - {effect.name for effect in held})
        moving = [effect for effect in held if effect.name not in _NO_PART]
        row(columns, {
            "case": case.name,
            "of the circuit": _listed(scene, {e.name for e in moving if e.home == "netlist"}),
            "of mechanics and computer": _listed(scene, {e.name for e in moving if e.home != "netlist"}),
            "in the scene, but no part of a small motion": _listed(scene, {e.name for e in held} & _NO_PART),
        })  # fmt: skip
    never = [effect.name for effect in EFFECTS if all(effect.name in each for each in off)]
    return Table("holds", "What the cases hold", columns, f"{adds} In no case: {', '.join(never)}.")


def _listed(scene: Scene, names: set[str]) -> str:
    return ", ".join(in_words(e.name, e.value(scene)) for e in EFFECTS if e.name in names) or "nothing"
