"""What is checked: a scene's board with the effects it asks for, or a board file at a level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cosim.caution import collected
from cosim.circuits.instability.stability_verdict import Question
from cosim.errors import InputError, Problem
from cosim.ngspice.deck import Deck, load_deck
from cosim.plan import resolve
from cosim.scene import Potentiometer, Scene, load_scene
from cosim.scene.load import SceneLike
from cosim.stability_gate import FINITE, question
from cosim.variants import Variant

_PARTS = ("opamp", "vca", "driver_level")
LEVELS: Mapping[str, Mapping[str, str]] = {
    "ideal": dict.fromkeys((*_PARTS, "motor", "potentiometer"), "ideal"),
    "gbw": FINITE,
    "full": dict.fromkeys((*_PARTS, "motor", "potentiometer"), "full"),
}
"""Level of every role by one word; a winding's inductance and a wiper's resistance know no gbw."""


@dataclass(frozen=True)
class Subject:
    """A board to check.

    Attributes
    ----------
    board, ideal : its deck at the levels in force, and with ideal parts
    driver : kind of drive
    scene : the scene, if one was given
    stability : the question whether it is stable, which is the same for every level and model
    label : the values of ``--set`` in words
    """

    board: Deck
    ideal: Deck
    driver: str
    scene: Scene | None
    stability: Question
    label: str = ""

    @property
    def potentiometer(self) -> Potentiometer:
        """The potentiometer's noise: the scene's, or what a scene has where it says nothing."""
        return self.scene.device.potentiometer if self.scene else Potentiometer()


def load_subject(
    target: SceneLike, variant: Variant, level: str | None, driver: str | None, *, trust: bool = False
) -> Subject:
    """Load a scene (``.toml``, or one that is there already) or a board.

    Parameters
    ----------
    target
        Scene or board file.
    variant
        Values of ``--set``.
    level, driver
        Key of `LEVELS`, and ``voltage`` or ``current``; instead of the scene's effects, or of ``full`` and
        ``voltage``.
    trust
        Whether control blocks and file access may pass.

    Raises
    ------
    InputError
        For anything wrong with either file, or a scene's key set on a board.
    """
    if isinstance(target, Scene) or Path(target).suffix.lower() == ".toml":
        return _of_scene(target, variant, level, driver, trust)
    keys = [name for name, override in zip(_names(variant), variant.overrides, strict=True)
            if not override.startswith("device.values.")]  # fmt: skip
    if keys:
        raise InputError(
            [
                Problem("a board has no scene keys: give a scene, or a name of the netlist", key=k)
                for k in keys
            ]
        )
    kind = driver or "voltage"
    board, ideal, finite = (
        load_deck(str(target), levels={**levels, "driver": kind}, overrides=dict(variant.values), trust=trust)
        for levels in (LEVELS[level or "full"], LEVELS["ideal"], FINITE)
    )
    judged = Question((finite, board) if (level or "full") == "full" else (finite,))
    return Subject(board, ideal, kind, None, judged, variant.label)


def _of_scene(
    target: SceneLike, variant: Variant, level: str | None, driver: str | None, trust: bool
) -> Subject:
    kind = [f"effects.driver={driver}"] if driver else []
    scene = load_scene(target, [*variant.overrides, *_effects(level), *kind])
    plain = load_scene(target, [*variant.overrides, *_effects("ideal"), *kind])
    # a vendor's model has no ideal level: the part that it replaces shows the board's own share
    plain = plain.model_copy(update={"device": plain.device.model_copy(update={"parts": {}})})
    plan = resolve(scene, trust=trust)
    with collected(forward=False):  # a value that ideal parts leave out is used by those in force
        ideal = resolve(plain, trust=trust)
    kind_of_drive = scene.effects.driver.value
    return Subject(plan.board, ideal.board, kind_of_drive, scene, question(plan), variant.label)


def _effects(level: str | None) -> list[str]:
    return [f"effects.{role}={value}" for role, value in LEVELS[level].items()] if level else []


def _names(variant: Variant) -> list[str]:
    return [name for name, _ in variant.values]
