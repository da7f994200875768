"""Effects: what a scene may switch on, where it lives, and what it costs when it is there.

An effect is asked for, or it is not there. `in_force` and `left_out` are what `cosim plan` prints; the
levels of the netlist's parts follow from them, nothing else picks a level.
"""

from __future__ import annotations

from typing import Any

from cosim.circuits.design_constants import Stated
from cosim.effects.circuit import CARRIED, CIRCUIT
from cosim.effects.circuit_noise import NOISE
from cosim.effects.effect import Cost, Effect, Size
from cosim.effects.linkage import LINKAGE
from cosim.effects.sampling import COMPUTER
from cosim.effects.sensing import SENSING
from cosim.errors import InputError, Problem
from cosim.ngspice.deck import NOMINAL_C, Feature
from cosim.scene import CircuitModelName, Differentiator, Scene

__all__ = ["EFFECTS", "Cost", "Effect", "Size", "check", "circuit_model", "features", "in_force",
           "left_out", "lesser", "levels", "temperature_c", "without_dynamics"]  # fmt: skip

#: Every effect, in the order in which a plan lists them.
EFFECTS: tuple[Effect, ...] = (*CIRCUIT, *NOISE, *SENSING, *COMPUTER, *LINKAGE)


def in_force(scene: Scene, constants: Stated) -> list[dict[str, Any]]:
    """List what the scene asks for, JSON-ready, in the order of `EFFECTS`: name, value, home, cost, size."""
    return [_row(effect, scene, constants) for effect in EFFECTS if effect.is_in_force(scene)]


def left_out(scene: Scene, constants: Stated) -> list[dict[str, Any]]:
    """List what the scene leaves in its null form, JSON-ready, the largest a-priori size first.

    What cannot apply to the scene comes last, with the reason instead of a force.
    """
    rows = [_row(effect, scene, constants) for effect in EFFECTS if not effect.is_in_force(scene)]
    return sorted(rows, key=lambda row: (bool(row["not_applicable"]), -float(row["size"]["force_n"])))


def _row(effect: Effect, scene: Scene, constants: Stated) -> dict[str, Any]:
    size, cost = effect.size(scene, constants), effect.cost(scene, constants)
    return {
        "name": effect.name,
        "value": effect.value(scene),
        "home": effect.home,
        "models": sorted(effect.carriers(scene)),
        "cost": vars(cost),
        "size": vars(size) | {"words": str(size)},
        "not_applicable": effect.lacks(scene),
        "requires": list(effect.requires),
        "excludes": list(effect.excludes),
    }


def check(scene: Scene) -> None:
    """Refuse effects in force without those that they require, or beside those that they exclude.

    Raises
    ------
    InputError
        With every such effect.
    """
    problems = []
    known = {effect.name: effect for effect in EFFECTS}
    for effect in EFFECTS:
        if not effect.is_in_force(scene):
            continue
        for names, wanted, words in (
            (effect.requires, True, "means nothing without effects."),
            (effect.excludes, False, "cannot be in force together with effects."),
        ):
            problems += [
                Problem(
                    f"{words}{name}",
                    file=scene.file_name,
                    key=f"effects.{effect.name}",
                    value=effect.value(scene),
                )
                for name in names
                if known[name].is_in_force(scene) is not wanted
            ]
    if problems:
        raise InputError(problems)


def circuit_model(scene: Scene) -> str:
    """Return the circuit model that the scene forces, or the cheapest that carries its effects.

    Nodes inside the board exist in `spice` only.

    Raises
    ------
    InputError
        When the forced model cannot carry an effect in force, or a node to be recorded; all at once.
    """
    forced = scene.solver.model
    file = scene.file_name
    if forced is CircuitModelName.AUTO:
        for model in ("ideal", "linear"):
            if not scene.record.nodes and all(model in effect.carriers(scene) for effect in EFFECTS):
                return model
        return "spice"
    problems = [
        Problem(
            f"the model {forced.value} cannot carry this effect",
            file=file,
            key=f"effects.{effect.name}",
            value=effect.value(scene),
            allowed=f"{effect.null}, or the model {' or '.join(sorted(effect.carriers(scene)))}",
        )
        for effect in EFFECTS
        if forced.value not in effect.carriers(scene)
    ]
    if forced is not CircuitModelName.SPICE and scene.record.nodes:
        nodes = ", ".join(scene.record.nodes)
        problems.append(
            Problem(
                "nodes inside the board exist in the model spice only",
                file=file,
                key="record.nodes",
                value=nodes,
            )
        )
    if problems:
        raise InputError(problems)
    return forced.value


def without_dynamics(scene: Scene) -> tuple[str, ...]:
    """Return the overrides that bring a scene to the model `ideal`: the assumption of footnote 1."""
    return (*lesser(scene, "ideal"), "solver.model=ideal")


def lesser(scene: Scene, model: str) -> tuple[str, ...]:
    """Return the overrides that leave out what a circuit model cannot carry, as `load_scene` takes them.

    An effect takes a lesser value that the model can carry, or its null form, and with it those that mean
    nothing without it.
    """
    out: dict[str, str | bool] = {}
    for effect in EFFECTS:
        if model in effect.carriers(scene):
            continue
        less = [v for v in effect.on if v != "full" and model in effect.models]
        out[effect.name] = less[-1] if less and effect.value(scene) == "full" else effect.null
    gone = {effect.name for effect in EFFECTS if out.get(effect.name) == effect.null}
    while more := [
        e for e in EFFECTS if gone & {*e.requires} and e.name not in gone and e.is_in_force(scene)
    ]:
        out |= {effect.name: effect.null for effect in more}
        gone |= {effect.name for effect in more}
    nodes = ("record.nodes=[]",) if scene.record.nodes and model != "spice" else ()
    words = (f"effects.{k}={str(v).lower() if isinstance(v, bool) else v}" for k, v in out.items())
    return (*words, *nodes)


def levels(scene: Scene) -> dict[str, str]:
    """Return the levels of the netlist's parts by role, as `load_deck` takes them."""
    effects = scene.effects
    return {
        "opamp": effects.opamp.value,
        "vca": effects.vca.value,
        "driver": effects.driver.value,
        "driver_level": effects.driver_level.value,
        "motor": effects.motor.value,
        "potentiometer": effects.potentiometer.value,
    }


def features(scene: Scene) -> tuple[Feature, ...]:
    """Return the single effects of the netlist's parts and blocks, as `load_deck` takes them."""
    corner = scene.effects.differentiator is Differentiator.CORNER
    single = (Feature(name, bool(getattr(scene.effects, name)), roles) for name, roles in CARRIED.items())
    return (*single, Feature("differentiator_corner", corner))


def temperature_c(scene: Scene) -> float:
    """Return the temperature of the board [C]."""
    return scene.device.temperature_c if scene.effects.temperature else NOMINAL_C
