"""What is wrong between the keys of a scene's device: linkage, shafts, stops, start, reach."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from cosim.errors import Problem

__all__ = ["DEVICE_CHECKS", "Check", "Get", "Skip", "joint_count", "list_length", "wall_reachable"]

Get = Callable[[str], Any]
Check = Callable[[Get], Iterator[Problem]]


class Skip(Exception):
    """A check needs a value that is missing or already refused."""


def _linkage_table(get: Get) -> Iterator[Problem]:
    kind = get("device.linkage")
    for name in ("chain", "slider"):
        given = get(f"device.{name}") is not None
        if name == kind and not given:
            yield Problem(f'linkage = "{kind}" needs the table [device.{name}]', key=f"device.{name}")
        if name != kind and given:
            yield Problem(f'linkage = "{kind}" does not use this table', key=f"device.{name}")


def joint_count(get: Get) -> int:
    """Return the number of joints that the linkage states."""
    if get("device.linkage") == "slider":
        return 1
    if get("device.chain") is None:
        raise Skip
    return len(get("device.chain.lengths_m"))


def list_length(key: str, *, empty_is_default: bool = False) -> Check:
    """Return the check that a list has one value a joint."""

    def check(get: Get) -> Iterator[Problem]:
        joints, values = joint_count(get), get(key)
        if values is None or (empty_is_default and not values):
            return
        if len(values) != joints:
            plural = "s" if joints != 1 else ""
            yield Problem(
                f"lists {len(values)}, but the linkage has {joints} joint{plural}",
                key=key,
                value=list(values),
            )

    return check


def _of_linkage(kind: str, check: Check) -> Check:
    def guarded(get: Get) -> Iterator[Problem]:
        if get("device.linkage") == kind and get(f"device.{kind}") is not None:
            yield from check(get)

    return guarded


def _coms_on_links(get: Get) -> Iterator[Problem]:
    for i, (com, length) in enumerate(
        zip(get("device.chain.coms_m"), get("device.chain.lengths_m"), strict=False)
    ):
        if com > length:
            yield Problem(
                "centre of mass lies beyond the end of its link",
                key=f"device.chain.coms_m[{i}]",
                value=com,
                unit="m",
                allowed=f"0 to {length:g}",
            )


def _joint_can_accelerate(get: Get) -> Iterator[Problem]:
    joints = joint_count(get)
    masses, coms, inertias = (
        get(f"device.chain.{name}") for name in ("masses_kg", "coms_m", "inertias_kg_m2")
    )
    rotors = get("device.chain.rotor_inertia_kg_m2") or (0.0,) * joints
    turning = get("effects.rotor_inertia") and not get("effects.shaft")  # behind a shaft it turns apart
    if {len(masses), len(coms), len(inertias), len(rotors)} != {joints}:
        raise Skip
    # A last link that weighs nothing makes the mass matrix singular.
    outboard = masses[-1] * coms[-1] ** 2 + inertias[-1] + (rotors[-1] if turning else 0.0)
    if not outboard > 0:
        yield Problem(
            "the last link has no inertia about its joint: give it mass, inertia or a rotor with "
            "effects.rotor_inertia and without effects.shaft",
            key="device.chain.masses_kg",
            value=list(masses),
            unit="kg",
        )


def _per_joint(get: Get, name: str) -> list[float]:
    value = get(f"device.{get('device.linkage')}.{name}")
    if value is None:  # a list's default: zeros
        return [0.0] * joint_count(get)
    return list(value) if isinstance(value, list | tuple) else [value]


#: With shafts joints and motors are coordinates each; compiled code holds six.
_MOST_SHAFTS = 3


def _shafts(get: Get) -> Iterator[Problem]:
    if not get("effects.shaft"):
        return
    kind, joints = get("device.linkage"), joint_count(get)
    if joints > _MOST_SHAFTS:
        yield Problem(
            f"the effect is there for up to {_MOST_SHAFTS} joints",
            key="effects.shaft",
            value=True,
            allowed=f"false with {joints} joints",
        )
    for name, unit, why in (
        ("shaft_stiffness_n_m_per_rad", "N m/rad", "effects.shaft needs a shaft's stiffness"),
        (
            "rotor_inertia_kg_m2",
            "kg m^2",
            "effects.shaft needs a rotor's inertia: it turns apart from the joint",
        ),
    ):
        values = _per_joint(get, name)
        if not all(value > 0 for value in values):
            shown = values if kind == "chain" else values[0]
            yield Problem(why, key=f"device.{kind}.{name}", value=shown, unit=unit, allowed="> 0")


def _stops_ordered(get: Get) -> Iterator[Problem]:
    key = f"device.{get('device.linkage')}.stops_rad"
    for i, (low, high) in enumerate(get(key)):
        if not low < high:
            yield Problem(
                "lower stop must lie below the upper one",
                key=f"{key}[{i}]",
                value=[low, high],
                unit="rad",
                allowed="low < high",
            )


def _start_once(get: Get) -> Iterator[Problem]:
    given = [name for name in ("q_rad", "tip_m") if get(f"device.start.{name}") is not None]
    if len(given) != 1:
        message = "give one of q_rad and tip_m" + (", not both" if given else "")
        yield Problem(message, key="device.start")


def _start_reachable(get: Get) -> Iterator[Problem]:
    tip = get("device.start.tip_m")
    if tip is None:
        return
    if get("device.linkage") == "slider":
        (x0, y0), (dx, dy) = get("device.slider.origin_m"), get("device.slider.direction")
        across = abs((tip[0] - x0) * dy - (tip[1] - y0) * dx) / math.hypot(dx, dy)
        if across > 1e-9:
            yield Problem(
                f"the slider cannot reach this point: it lies {across:.3g} m beside its line",
                key="device.start.tip_m",
                value=list(tip),
                unit="m",
            )
        return
    inner, outer = _reach(get)
    if not inner <= math.hypot(*tip) <= outer:
        yield Problem(
            f"out of reach: {math.hypot(*tip):.4g} m from the base, the links: {inner:.4g} to {outer:.4g} m",
            key="device.start.tip_m",
            value=list(tip),
            unit="m",
        )


def _reach(get: Get) -> tuple[float, float]:
    lengths = get("device.chain.lengths_m")
    # The tip cannot come closer to the base than the longest link exceeds all the others.
    return max(0.0, 2 * max(lengths) - sum(lengths)), sum(lengths)


def _start_between_stops(get: Get) -> Iterator[Problem]:
    pose = get("device.start.q_rad")
    stops = get(f"device.{get('device.linkage')}.stops_rad")
    for i, (q, (low, high)) in enumerate(zip(pose or (), stops, strict=False)):
        if low < high and not low <= q <= high:
            yield Problem(
                "starts beyond the end stop",
                key=f"device.start.q_rad[{i}]",
                value=q,
                unit="rad",
                allowed=f"{low:g} to {high:g}",
            )


def wall_reachable(get: Get) -> Iterator[Problem]:
    """Check that the device can reach its wall."""
    if get("wall") is None:
        return
    (px, py), (nx, ny) = get("wall.point_m"), get("wall.normal")
    norm = math.hypot(nx, ny)
    if norm == 0:
        raise Skip
    if get("device.linkage") == "slider":
        dx, dy = get("device.slider.direction")
        if abs(dx * nx + dy * ny) < 1e-9 * norm * math.hypot(dx, dy):
            yield Problem(
                "the slider moves along this wall and never meets it", key="wall.normal", value=[nx, ny]
            )
        return
    distance = (px * nx + py * ny) / norm
    reach = _reach(get)[1]
    if abs(distance) >= reach:
        yield Problem(
            f"out of reach: the wall passes the base at {abs(distance):.4g} m, the links reach {reach:.4g} m",
            key="wall.point_m",
            value=[px, py],
            unit="m",
        )


DEVICE_CHECKS: tuple[Check, ...] = (
    _linkage_table,
    *(
        _of_linkage("chain", list_length(f"device.chain.{name}"))
        for name in (
            "masses_kg",
            "coms_m",
            "inertias_kg_m2",
            "rotor_inertia_kg_m2",
            "viscous_n_m_s",
            "coulomb_n_m",
            "shaft_stiffness_n_m_per_rad",
            "shaft_damping_n_m_s",
            "backlash_rad",
        )
    ),
    _of_linkage("chain", list_length("device.chain.stops_rad", empty_is_default=True)),
    _of_linkage("slider", list_length("device.slider.stops_rad", empty_is_default=True)),
    _of_linkage("chain", _coms_on_links),
    _of_linkage("chain", _joint_can_accelerate),
    _shafts,
    _stops_ordered,
    _start_once,
    list_length("device.start.q_rad"),
    list_length("device.start.v_rad_per_s", empty_is_default=True),
    _start_reachable,
    _start_between_stops,
)
