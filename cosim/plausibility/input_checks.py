"""Likely mistakes in scene and netlist, seen before anything runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from cosim.caution import Caution
from cosim.ngspice.deck import Deck
from cosim.plausibility.capacitors import capacitors
from cosim.plausibility.definitions import definitions
from cosim.plausibility.resistors import resistors
from cosim.plausibility.sources import sources
from cosim.plausibility.supplies import supplies
from cosim.scene import Chain, Scene, Slider

__all__ = ["of_plan"]

#: A revolute joint turns less than this between its stops [rad]; in degrees every pose beyond 6.28 is more.
_TURN_RAD = 2.0 * math.pi
#: g for kg, the commonest slip, is a factor of 1000; a light hand on a heavy arm is a factor of 100.
_MASS_RATIO = 1000.0
#: Mass over length of a link [kg/m]: a steel bar of 13 cm. The upper arm of an industrial robot has some 20.
_MOST_KG_PER_M = 100.0
_STEEL_KG_PER_M3 = 7850.0


def of_plan(scene: Scene, board: Deck, model: str, bare: Callable[[], Deck]) -> list[Caution]:
    """Return the cautions about a scene and its flattened board.

    Parameters
    ----------
    model
        Circuit model that will run.
    bare
        Makes the board without the scene's `device.values`, to tell an edit from the original.
    """
    return [
        *_outside_stops(scene),
        *_degrees(scene),
        *_masses(scene),
        *_late(scene),
        *resistors(scene.device.values, board, bare),
        *capacitors(scene.device.values, board),
        *definitions(board),
        *supplies(board),
        *sources(model, board),
    ]


def _table(scene: Scene) -> Chain | Slider:
    table = scene.device.slider if scene.is_slider else scene.device.chain
    assert table is not None  # the scene's checks hold this
    return table


def _outside_stops(scene: Scene) -> Iterator[Caution]:
    stops, q = _table(scene).stops_rad, scene.device.start.q_rad
    if not stops:
        return
    if q is None:
        from cosim.scene.mechanism import mechanism, start  # compiled code, which a plan has no other need of

        q = tuple(start(scene, mechanism(scene, 1.0))[0].tolist())
    for joint, (angle, (low, high)) in enumerate(zip(q, stops, strict=False), 1):
        if not low <= angle <= high:
            off = "" if scene.effects.end_stops else " (which are off: effects.end_stops)"
            yield Caution(
                "start-outside-stops",
                f"joint {joint} starts at {angle:.4g} rad, outside of its stops {low:g} to {high:g} rad{off}",
                "correct device.start or stops_rad",
            )


def _degrees(scene: Scene) -> Iterator[Caution]:
    if scene.is_slider:  # a drum may turn many times
        return
    stops = _table(scene).stops_rad
    for key, angles in (
        ("device.start.q_rad", scene.device.start.q_rad or ()),
        ("device.chain.stops_rad", [angle for pair in stops for angle in pair]),
    ):
        far = max(angles, key=abs, default=0.0)
        if abs(far) > _TURN_RAD:
            yield Caution(
                "angle-beyond-turn",
                f"{key} holds {far:g} rad, more than a full turn",
                f"angles are in radians: {far:g} degrees are {math.radians(far):.4g} rad",
            )


def _masses(scene: Scene) -> Iterator[Caution]:
    table, person = _table(scene), scene.operator
    named = {}
    if isinstance(table, Chain):
        named = {f"link {k}": mass for k, mass in enumerate(table.masses_kg, 1)}
        for k, (mass, length, inertia) in enumerate(
            zip(table.masses_kg, table.lengths_m, table.inertias_kg_m2, strict=True), 1
        ):
            if mass > _MOST_KG_PER_M * length:
                thick_m = math.sqrt(4.0 * mass / length / (math.pi * _STEEL_KG_PER_M3))
                yield Caution(
                    "mass-beyond-length",
                    f"link {k} of {length:g} m has {mass:g} kg, as a bar of steel {thick_m:.2g} m thick",
                    "masses are in kilograms: look at the units of device.chain.masses_kg",
                )
            # a link with its mass at both ends has m L^2 / 4 about its middle; none has more
            if mass > 0.0 and inertia > mass * length**2:
                yield Caution(
                    "inertia-beyond-length",
                    f"link {k} of {mass:g} kg and {length:g} m has an inertia of {inertia:g} kg m^2, more "
                    f"than its mass can have within its length ({mass * length**2 / 4:.3g} kg m^2)",
                    "look at the units of device.chain.inertias_kg_m2",
                )
    else:
        named = {"the carriage": table.mass_kg}
    held = getattr(person, "mass_kg", 0.0)
    if person.type == "mass" or (person.type == "hand" and scene.effects.operator_dynamics):
        named["the operator"] = held
    known = {name: mass for name, mass in named.items() if mass > 0.0}
    if len(known) > 1:
        light, heavy = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
        if known[heavy] > _MASS_RATIO * known[light]:
            yield Caution(
                "masses-far-apart",
                f"{heavy} has {known[heavy]:g} kg, {light} {known[light]:g} kg",
                "masses are in kilograms: look at their units",
            )


def _late(scene: Scene) -> Iterator[Caution]:
    """Yield the operator's schedules that begin when the run is over: milliseconds, most likely."""
    for key in ("waypoints_s_m", "force_s_n"):
        times = [float(row[0]) for row in getattr(scene.operator, key, ()) if row[0] > 0.0]
        if times and min(times) > scene.duration_s:
            yield Caution(
                "schedule-beyond-run",
                f"operator.{key} begins at {min(times):g} s, when the run of {scene.duration_s:g} s is over",
                "its times are in seconds; shorten them or lengthen duration_s",
            )
