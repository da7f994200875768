"""What is wrong between the keys of a scene, although each of them alone is in order.

Each check asks for the values it needs by their dotted keys. A value that is missing or already
refused makes `Values.get` raise `Skip` and only that check is left out: so one run reports
single-key and cross-key problems together.
"""

import os
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

from cosim.errors import Problem
from cosim.scene.device_checks import DEVICE_CHECKS, Check, Get, Skip, list_length, wall_reachable
from cosim.scene.sizes import SIZES
from cosim.scene.tolerance_table import Tolerance


def _one_sample(get: Get) -> Iterator[Problem]:
    period, duration = get("computer.period_s"), get("duration_s")
    if period > duration:
        yield Problem(
            "longer than the whole run",
            key="computer.period_s",
            value=period,
            unit="s",
            allowed=f"> 0 and <= duration_s = {duration:g}",
        )


_PARTS = {
    "discrete": ("discrete_stiffness_n_per_m", "discrete_damping_n_s_per_m"),
    "analog": ("analog_stiffness_n_per_m", "analog_damping_n_s_per_m"),
    "joint": ("joint_stiffness_n_m_per_rad", "joint_damping_n_m_s_per_rad"),
}
# Parts of the impedance a method must have and those that it cannot carry.
_NEEDS = {
    "discrete": ["discrete"],
    "continuous": ["analog"],
    "combined": ["discrete", "analog"],
    "joint_pd": [],
}
_CARRIES = {**_NEEDS, "joint_pd": ["analog", "joint"]}


def _method_has_its_gains(get: Get) -> Iterator[Problem]:
    if get("computer.law") is not None:
        return  # the user's own law decides what it reads
    method = get("computer.method")
    stated = {part: [k for k in keys if _nonzero(get(f"computer.{k}"))] for part, keys in _PARTS.items()}
    for part in _NEEDS[method]:
        if not stated[part]:
            first, second = _PARTS[part]
            yield Problem(f'method = "{method}" needs {first} or {second} above 0', key=f"computer.{first}")
    if method == "joint_pd" and not stated["analog"] and not stated["joint"]:
        yield Problem(
            'method = "joint_pd" needs joint_stiffness_n_m_per_rad, or analog_stiffness_n_per_m'
            " to derive the joints' gains from",
            key="computer.joint_stiffness_n_m_per_rad",
        )
    for part, keys in stated.items():
        if part not in _CARRIES[method]:
            for key in keys:
                value = get(f"computer.{key}")
                yield Problem(
                    f'method = "{method}" does not display this; set it to 0 or leave it out',
                    key=f"computer.{key}",
                    value=value if isinstance(value, float | int) else list(value),
                )


def _onset_of_the_built_in_law(get: Get) -> Iterator[Problem]:
    if get("computer.law") is None:
        return
    for key, null in (("computer.onset", "wall"), ("computer.gain_ramp_samples", 0)):
        if get(key) != null:
            yield Problem("the user's law decides how a contact begins", key=key, value=get(key),
                          allowed=str(null))  # fmt: skip


def _nonzero(value: Any) -> bool:
    return any(value) if isinstance(value, tuple) else value != 0


def _times_increase(key: str) -> Check:
    def check(get: Get) -> Iterator[Problem]:
        if get("operator.type") != "hand":
            return
        rows = get(key)
        for i, (row, following) in enumerate(pairwise(rows)):
            if not following[0] > row[0]:
                yield Problem(
                    "times must increase from row to row",
                    key=f"{key}[{i + 1}]",
                    value=list(following),
                    allowed=f"t > {row[0]:g} s",
                )

    return check


def _file_exists(key: str) -> Check:
    def check(get: Get) -> Iterator[Problem]:
        value = get(key)
        if value is not None and not os.path.isfile(value):
            yield Problem("no such file", key=key, value=str(value))

    return check


def _class_in_file(key: str, needed: Callable[[Get], bool]) -> Check:
    def check(get: Get) -> Iterator[Problem]:
        value = get(key) if needed(get) else None
        if value is None:
            return
        path, separator, name = str(value).rpartition(":")
        if not separator or not path.endswith(".py") or not name.isidentifier():
            yield Problem(
                "must name a Python file and a class in it", key=key, value=value, allowed='"file.py:Class"'
            )
        elif not os.path.isfile(path):
            yield Problem("no such file", key=key, value=path)

    return check


def _part_files(get: Get) -> Iterator[Problem]:
    for name, part in get("device.parts").items():
        if isinstance(part, dict):
            yield from _file_exists(f"device.parts.{name}.file")(get)


def _measures(tolerance: Any) -> set[str]:
    """Return the keys of the table that are measures: all that are no classes of components."""
    if isinstance(tolerance, Tolerance):
        return set(tolerance.measures)
    return set(tolerance) - set(Tolerance.model_fields)


def _auto_has_a_tolerance(get: Get) -> Iterator[Problem]:
    if get("effects.auto") and not _measures(get("tolerance")):
        yield Problem(
            'effects = "auto" needs the change of a measure that may be left out, such as peak_force = 0.01',
            key="tolerance",
        )


CHECKS: tuple[Check, ...] = (
    *DEVICE_CHECKS,
    list_length("computer.joint_stiffness_n_m_per_rad", empty_is_default=True),
    list_length("computer.joint_damping_n_m_s_per_rad", empty_is_default=True),
    wall_reachable,
    _one_sample,
    _method_has_its_gains,
    _onset_of_the_built_in_law,
    _auto_has_a_tolerance,
    _times_increase("operator.waypoints_s_m"),
    _times_increase("operator.force_s_n"),
    _file_exists("device.board"),
    _part_files,
    _class_in_file("operator.file", lambda get: get("operator.type") == "python"),
    _class_in_file("computer.law", lambda get: True),
)


def cross_problems(get: Get) -> Iterator[Problem]:
    """Yield what all checks find; `get` gives a value by dotted key or raises `Skip`."""
    for check in (*CHECKS, *SIZES):
        try:
            yield from check(get)
        except Skip:
            continue
