"""Effects of the mechanism."""

from __future__ import annotations

import math

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import HandOperator, Scene
from cosim.scene.device_tables import Chain, Slider


def _table(scene: Scene) -> Chain | Slider:
    table = scene.device.chain or scene.device.slider
    assert table is not None  # the scene's checks hold this
    return table


def _largest(value: float | tuple[float, ...]) -> float:
    return max(value) if isinstance(value, tuple) else value


def _gravity(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    pull = math.hypot(*_table(scene).gravity_m_per_s2)
    weight = (at.device_kg + at.person_kg) * pull
    return Size(weight, "N", weight, "of weight", "m g, all of it at the tip")


def _coriolis(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    force = at.mass_kg * at.speed_m_per_s**2 / at.reach_m
    return Size(force, "N", force, "of velocity products", "m v^2 / r")


def _lacks_bends(scene: Scene) -> str:
    return "a slider moves along a straight line" if scene.is_slider else ""


def _viscous(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    b = at.joints * _largest(_table(scene).viscous_n_m_s) / at.reach_m**2
    return Size(b, "N s/m", b * at.speed_m_per_s, "of bearings at the tip", "b v, of all joints")


def _lacks_viscous(scene: Scene) -> str:
    return "" if _largest(_table(scene).viscous_n_m_s) > 0.0 else "viscous_n_m_s is zero"


def _coulomb(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    force = at.joints * _largest(_table(scene).coulomb_n_m) / at.reach_m
    return Size(force, "N", force, "of dry friction at the tip", "f_c / r, of all joints")


def _coulomb_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, 0, "short steps near rest")


def _lacks_coulomb(scene: Scene) -> str:
    return "" if _largest(_table(scene).coulomb_n_m) > 0.0 else "coulomb_n_m is zero"


def _rotor(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    share = at.rotor_kg / at.mass_kg
    # a mass caught by a spring makes v sqrt(k m): half the share of the mass; carried along, all of it
    return Size(at.rotor_kg, "kg", share * at.force_n, "behind the gears at the tip", "F J gear^2 / (r^2 m)")


def _lacks_rotor(scene: Scene) -> str:
    return "" if _largest(_table(scene).rotor_inertia_kg_m2) > 0.0 else "rotor_inertia_kg_m2 is zero"


def _stops(scene: Scene, constants: Stated) -> Size:
    at, table = scale(scene, constants), _table(scene)
    # all kinetic energy of the tip into the stop's spring
    hit = at.speed_m_per_s * math.sqrt(at.mass_kg * table.stop_stiffness_n_m_per_rad) / at.reach_m
    stiffness = table.stop_stiffness_n_m_per_rad
    return Size(stiffness, "N m/rad", hit, "beyond the travel", "v sqrt(k m) where a stop is hit")


def _lacks_stops(scene: Scene) -> str:
    return "" if _table(scene).stops_rad else "no stops_rad are stated"


def _person(scene: Scene, constants: Stated) -> Size:
    at, hand = scale(scene, constants), scene.operator
    damping = hand.damping_n_s_per_m if isinstance(hand, HandOperator) else 0.0
    caught = at.speed_m_per_s * math.sqrt(at.stiffness_n_per_m * at.person_kg)
    force = damping * at.speed_m_per_s + caught
    return Size(at.person_kg, "kg", force, f"of hand, with {damping:.3g} N s/m", "b v + v sqrt(k m)")


def _lacks_hand(scene: Scene) -> str:
    return "" if isinstance(scene.operator, HandOperator) else "no hand holds the tip"


def _shaft(scene: Scene, constants: Stated) -> Size:
    at, table = scale(scene, constants), _table(scene)
    stiffness = _least(table.shaft_stiffness_n_m_per_rad)
    soft = stiffness / at.reach_m**2
    # the wall's spring and the shaft's one after the other: k/(1 + k/k_s)
    less = at.force_n * at.stiffness_n_per_m / (at.stiffness_n_per_m + soft) if soft > 0.0 else at.force_n
    return Size(stiffness, "N m/rad", less, "of wind-up at the joint", "F k / (k + k_s / r^2)")


def _shaft_cost(scene: Scene, constants: Stated) -> Cost:
    table = _table(scene)
    rotor = _least(table.rotor_inertia_kg_m2) * constants.gear**2
    stiffness = _largest(table.shaft_stiffness_n_m_per_rad)
    # of the rotor alone: the links, heavier, add little
    rate = math.sqrt(stiffness / rotor) if rotor > 0.0 else 0.0
    return Cost(5.0 * rate, 0, "steps of a fifth of the shaft's period over 2 pi; two coordinates a joint")


def _lacks_shaft(scene: Scene) -> str:
    if _least(_table(scene).shaft_stiffness_n_m_per_rad) <= 0.0:
        return "shaft_stiffness_n_m_per_rad is not stated"
    return "" if _least(_table(scene).rotor_inertia_kg_m2) > 0.0 else "rotor_inertia_kg_m2 is zero"


def _backlash(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    gap = _largest(_table(scene).backlash_rad)
    force = at.capped(at.stiffness_n_per_m * gap * at.reach_m)
    return Size(gap, "rad", force, "between the flanks", "k r gap")


def _backlash_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(30.0 / scene.computer.period_s, 0, "short steps at each contact of teeth, about one a sample")


def _lacks_backlash(scene: Scene) -> str:
    return "" if _largest(_table(scene).backlash_rad) > 0.0 else "backlash_rad is zero"


def _least(values: float | tuple[float, ...]) -> float:
    return min(values) if isinstance(values, tuple) else values


def _of_joints(*names: str) -> tuple[str, ...]:
    """Return keys of a mechanism, those of both linkages."""
    return tuple(f"device.{kind}.{name}" for kind in ("chain", "slider") for name in names)


#: In the order in which a plan lists them.
LINKAGE = (
    Effect("gravity", False, (True,), "linkage", ALL, size=_gravity, keys=_of_joints("gravity_m_per_s2")),
    Effect("coriolis", False, (True,), "linkage", ALL, size=_coriolis, lacks=_lacks_bends),
    Effect(
        "viscous", False, (True,), "linkage", ALL,
        size=_viscous, lacks=_lacks_viscous, keys=_of_joints("viscous_n_m_s"),
    ),
    Effect(
        "coulomb", False, (True,), "linkage", ALL,
        size=_coulomb, cost=_coulomb_cost, lacks=_lacks_coulomb,
        keys=_of_joints("coulomb_n_m", "coulomb_speed_rad_per_s"),
        not_held="Coulomb friction, which only takes energy",
    ),
    Effect(
        "rotor_inertia", False, (True,), "linkage", ALL,
        size=_rotor, lacks=_lacks_rotor, keys=_of_joints("rotor_inertia_kg_m2"),
    ),
    Effect(
        "end_stops", False, (True,), "linkage", ALL, size=_stops, lacks=_lacks_stops,
        keys=_of_joints(
            "stops_rad", "stop_stiffness_n_m_per_rad", "stop_damping_n_m_s", "stop_restitution"
        ),
        not_monolithic="end stops",
    ),
    Effect(
        "shaft", False, (True,), "linkage", ALL,
        size=_shaft, cost=_shaft_cost, lacks=_lacks_shaft, requires=("rotor_inertia",),
        keys=_of_joints("shaft_stiffness_n_m_per_rad", "shaft_damping_n_m_s"),
    ),
    Effect(
        "backlash", False, (True,), "linkage", ALL,
        size=_backlash, cost=_backlash_cost, lacks=_lacks_backlash, requires=("shaft",),
        keys=_of_joints("backlash_rad"),
        not_monolithic="flanks of gears that remember which of them carries",
    ),
    Effect(
        "operator_dynamics", False, (True,), "operator", ALL, size=_person, lacks=_lacks_hand,
        keys=("operator.mass_kg", "operator.damping_n_s_per_m"),
    ),
)  # fmt: skip
