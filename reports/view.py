"""The attributes of a run that reports use, and views of it that several figures share.

Anything with the attributes of `RunLike` can be drawn. Every part may be empty: a figure that misses
its signals is left out and the page says so.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.caution import Caution
from cosim.types import Array
from reports.decimate import merge_spans

__all__ = ["Amplifier", "RunLike", "View", "WallFrame", "plain"]


class RunLike(Protocol):
    """The attributes of a run that a report reads (`cosim.results.Run` has them)."""

    @property
    def scene(self) -> Any:
        """Scene as a mapping, or as an object with ``as_dict()``."""

    @property
    def plan(self) -> Mapping[str, Any]:
        """Effects in force and left out, model, ``constants`` of the board, peaks of its ``amplifiers``."""

    @property
    def signals(self) -> Mapping[str, ArrayLike]:
        """Signals at the solver's accepted points, all of one length, ``time`` [s] among them."""

    @property
    def samples(self) -> Mapping[str, ArrayLike]:
        """What the computer read and wrote at its samples, ``time`` [s] among them."""

    @property
    def events(self) -> Sequence[Mapping[str, Any]]:
        """Contacts, clippings and the like, each with a time."""

    @property
    def measures(self) -> Mapping[str, Mapping[str, Any]]:
        """Name -> ``{"value", "unit", "text"}``."""

    @property
    def ledger(self) -> Mapping[str, Any]:
        """Energy ledger at the end of the run [J]."""

    @property
    def stats(self) -> Mapping[str, Any]:
        """Points, wall time, error estimate."""

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Versions, seed, digests, command line."""

    @property
    def warnings(self) -> Sequence[Caution]:
        """What to doubt about the result."""

    @property
    def printed(self) -> Sequence[str]:
        """Lines that the scene's own Python printed."""


@dataclass(frozen=True)
class WallFrame:
    """Axes of a straight wall: `normal` points to the free side, `tangent` = (n_y, -n_x)."""

    point: tuple[float, float]
    normal: tuple[float, float]

    @property
    def tangent(self) -> tuple[float, float]:
        """Unit vector along the wall."""
        return self.normal[1], -self.normal[0]


@dataclass(frozen=True)
class Amplifier:
    """Largest output of an amplifier [V] during the run against the swing [V] at which it clips."""

    name: str
    part: str
    peak_v: float
    swing_v: float

    @property
    def used(self) -> float:
        """Share of the swing that was used."""
        return self.peak_v / self.swing_v


def plain(value: Any) -> Any:
    """Return a scene, plan or the like as plain dictionaries; an empty one for anything else."""
    if isinstance(value, Mapping):
        return value
    for method in ("as_dict", "model_dump"):
        if hasattr(value, method):
            return getattr(value, method)()
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else {}


class View:
    """A run as the figures see it: arrays, wall frame, contacts, amplifiers.

    Parameters
    ----------
    run
        The run to report; it is not changed.
    """

    def __init__(self, run: RunLike) -> None:
        self.run = run
        self.scene: Mapping[str, Any] = plain(run.scene)
        self.plan: Mapping[str, Any] = plain(run.plan)
        self.time = self._array(run.signals, "time", np.zeros(0))
        self.sample_time = self._array(run.samples, "time", np.zeros(0))

    @staticmethod
    def _array(table: Mapping[str, ArrayLike], name: str, default: Array) -> Array:
        # A plain array even of a memory map: only the columns that are drawn are read.
        return np.asarray(table[name], dtype=np.float64) if name in table else default

    def has(self, *names: str) -> bool:
        """Tell whether there are at least two points and all signals `names`."""
        return self.time.size > 1 and all(name in self.run.signals for name in names)

    def signal(self, name: str) -> Array:
        """Return a signal; zeros when it was not recorded (an effect that is off)."""
        return self._array(self.run.signals, name, np.zeros_like(self.time))

    def sampled(self, name: str) -> Array:
        """Return a quantity of the computer's samples; zeros when there is none."""
        return self._array(self.run.samples, name, np.zeros_like(self.sample_time))

    def scene_at(self, *keys: str, default: Any = None) -> Any:
        """Return the value of a nested key of the scene, `default` where a table or key is absent."""
        value: Any = self.scene
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        return default if value is None else value

    @property
    def end_s(self) -> float:
        """Last time of the signals [s]."""
        return float(self.time[-1]) if self.time.size else 0.0

    @cached_property
    def joints(self) -> int:
        """Number of joints, from the names of the signals."""
        count = 0
        while f"q{count + 1}" in self.run.signals or f"imot{count + 1}" in self.run.signals:
            count += 1
        return count

    @cached_property
    def wall(self) -> WallFrame | None:
        """Frame of the wall, if the scene has one."""
        wall = self.scene_at("wall")
        if not isinstance(wall, Mapping) or "normal" not in wall:
            return None
        nx, ny = (float(part) for part in wall["normal"])
        px, py = (float(part) for part in wall.get("point_m", (0.0, 0.0)))
        size = math.hypot(nx, ny)
        return WallFrame((px, py), (nx / size, ny / size))

    def _along(self, axis: tuple[float, float], x: Any, y: Any) -> Any:
        return axis[0] * x + axis[1] * y

    @cached_property
    def straight(self) -> bool:
        """Whether the tip moves along the wall's normal only, as a slider over a floor does."""
        if self.place is None:
            return False
        return bool(np.ptp(self.place[0]) < 1e-6 * np.ptp(self.place[1]))

    @cached_property
    def place(self) -> tuple[Array, Array] | None:
        """Position of the tip along the wall's tangent and normal [m], from the wall's point."""
        if self.wall is None or not self.has("x", "y"):
            return None
        x = self.signal("x") - self.wall.point[0]
        y = self.signal("y") - self.wall.point[1]
        return self._along(self.wall.tangent, x, y), self._along(self.wall.normal, x, y)

    @cached_property
    def force(self) -> tuple[Array, Array] | None:
        """Force of the device on the operator along the wall's tangent and normal [N]."""
        if self.wall is None or not self.has("fx", "fy"):
            return None
        fx, fy = -self.signal("fx"), -self.signal("fy")
        return self._along(self.wall.tangent, fx, fy), self._along(self.wall.normal, fx, fy)

    @cached_property
    def contact(self) -> NDArray[np.bool_]:
        """Whether the computer holds the contact at each point; without samples, is the tip inside."""
        if self.sample_time.size and "contact" in self.run.samples:
            latest = np.searchsorted(self.sample_time, self.time, side="right") - 1
            seen = self.sampled("contact") > 0.5
            return np.where(latest >= 0, seen[np.maximum(latest, 0)], False)
        if self.place is not None:
            return self.place[1] < 0.0
        return np.zeros(self.time.size, dtype=np.bool_)

    @cached_property
    def contact_spans(self) -> list[tuple[float, float]]:
        """Spans of contact [s], those too close to be seen apart joined."""
        if not self.contact.any():
            return []
        padded = np.concatenate(([False], self.contact, [False])).astype(np.int8)
        starts = np.flatnonzero(np.diff(padded) == 1)
        stops = np.minimum(np.flatnonzero(np.diff(padded) == -1), self.time.size - 1)
        spans = zip(self.time[starts].tolist(), self.time[stops].tolist(), strict=True)
        return merge_spans(list(spans), 1e-3 * (self.end_s - float(self.time[0])))

    @property
    def period_s(self) -> float | None:
        """Sampling period [s]."""
        stated = self.scene_at("computer", "period_s")
        if stated is not None:
            return float(stated)
        return float(np.median(np.diff(self.sample_time))) if self.sample_time.size > 1 else None

    @property
    def stiffness(self) -> float:
        """Normal stiffness that the method asks for [N/m]; 0 where it asks for joint stiffness instead."""
        shares = {
            "discrete": ("discrete_stiffness_n_per_m",),
            "continuous": ("analog_stiffness_n_per_m",),
            "combined": ("discrete_stiffness_n_per_m", "analog_stiffness_n_per_m"),
        }.get(self.scene_at("computer", "method", default=""), ())
        return sum((float(self.scene_at("computer", key, default=0.0)) for key in shares), 0.0)

    def constant(self, name: str) -> float | None:
        """Return a design constant of the board such as ``i_limit``, if the plan states it."""
        value = plain(self.plan.get("constants")).get(name)
        return float(value) if isinstance(value, int | float) else None

    def motor_force(self, part: NDArray[np.bool_]) -> Array | None:
        """Return the motors' force at the tip along the wall's normal [N] at the points `part`.

        The least force that gives the motors' torques, F = (J J^T)^-1 J tau: exact up to two joints. ``None``
        without the motor's constants, for a chain of one link, and near a stretched arm.
        """
        kt, gear, n = self.constant("kt"), self.constant("gear"), self.joints
        if self.wall is None or not kt or not gear or not self.has(*(f"imot{j + 1}" for j in range(n))):
            return None
        torque = kt * gear * np.array([self.signal(f"imot{joint + 1}")[part] for joint in range(n)])
        radius = self.scene_at("device", "slider", "radius_m")
        if radius is not None and n == 1:
            direction = self.scene_at("device", "slider", "direction", default=(0.0, 1.0))
            return np.asarray(torque[0] / float(radius) * self._along(self.wall.normal, *direction))
        lengths = np.asarray(self.scene_at("device", "chain", "lengths_m", default=()), dtype=np.float64)
        if n < 2 or lengths.size != n or not self.has(*(f"q{joint + 1}" for joint in range(n))):
            return None
        angle = np.cumsum([self.signal(f"q{joint + 1}")[part] for joint in range(n)], axis=0)
        # Column j of J sums the links from j outwards.
        across = np.cumsum((-lengths[:, None] * np.sin(angle))[::-1], axis=0)[::-1]
        upward = np.cumsum((lengths[:, None] * np.cos(angle))[::-1], axis=0)[::-1]
        jac = np.stack((across, upward)).transpose(2, 0, 1)
        square = jac @ jac.transpose(0, 2, 1)
        if square.size == 0 or float(np.linalg.cond(square).max()) > 1e6:
            return None
        force = np.linalg.solve(square, jac @ torque.T[:, :, None])[:, :, 0]
        return np.asarray(force @ np.array(self.wall.normal), dtype=np.float64)

    @cached_property
    def amplifiers(self) -> list[Amplifier]:
        """Amplifiers in order of the share of their swing that was used, the fullest first."""
        rows = [
            Amplifier(
                str(row["path"]), str(row.get("part", "")), abs(float(row["peak_v"])), float(row["swing_v"])
            )
            for row in self.plan.get("amplifiers") or ()
            if isinstance(row, Mapping) and row.get("swing_v") and row.get("peak_v") is not None
        ]
        return sorted(rows, key=lambda amplifier: -amplifier.used)
