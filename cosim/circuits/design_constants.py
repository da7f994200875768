"""The board's design constants: with its pins, the interface that every circuit model shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from math import isfinite
from typing import Any

import numpy as np

from cosim.errors import InputError, Problem
from cosim.types import Array

#: No board has constants beyond these: results computed from them would overflow a double.
LEAST, MOST = 1e-30, 1e30
#: Resolution of a DAC, as a scene may state it as well.
MOST_BITS = 32
_RANGE = f"{LEAST:g} to {MOST:g}"


@dataclass(frozen=True)
class DesignConstants:
    """What the board's designer states for the computer (`.csparam` lines); never measured, never sampled.

    Parameters
    ----------
    v_rad : V/rad at the pins u
    k_fs : N m/rad at the joint for a spring gain of `v_fs`
    c_fs : N m s/rad at the joint for a damper gain of `v_fs`
    v_fs : V, full scale of the gain pins
    v_nm : V at the pins cmd per N m at the joint
    kt : N m/A, torque constant of the motor
    gear : motor turns per joint turn
    i_rated, i_limit : A, thermal rating and driver limit
    dac_v, dac_bits : range +-V and resolution of the DACs
    w_rated : V, multiplier output at rated torque
    r_tip : m, reach for which figures at the tip are quoted
    motor_k : N m/A, torque constant of the motor as it is, where its part states one (at its temperature);
        0 where none does: then it is `kt`, which is what the computer believes
    motors : N m/A, torque constants of the motors, one a joint, of a device whose motors differ; else empty
    """

    v_rad: float
    k_fs: float
    c_fs: float
    v_fs: float
    v_nm: float
    kt: float
    gear: float
    i_rated: float
    i_limit: float
    dac_v: float
    dac_bits: float
    w_rated: float
    r_tip: float
    motor_k: float = 0.0
    motors: tuple[float, ...] = ()

    @property
    def torque_per_amp(self) -> float:
        """Torque at the joint per ampere that the motor gives [N m/A]."""
        return (self.motor_k or self.kt) * self.gear

    def torques_per_amp(self, joints: int) -> Array:
        """Return the torque at each joint per ampere of its motor [joints] N m/A."""
        return np.array(self.motors or (self.motor_k or self.kt,) * joints) * self.gear

    def motor_ratios(self, joints: int) -> Array:
        """Return each motor's torque constant over the common one [joints]."""
        return self.torques_per_amp(joints) / self.torque_per_amp

    def as_dict(self) -> dict[str, float]:
        """Return them JSON-ready; of motors that differ `motor_k1` and so on."""
        single = {f"motor_k{joint}": value for joint, value in enumerate(self.motors, 1)}
        return {name: getattr(self, name) for name in (*self.names(), "motor_k")} | single

    @classmethod
    def names(cls) -> list[str]:
        """Names of the constants, as the board's `.csparam` lines spell them."""
        return [each.name for each in fields(DesignConstants) if each.default is MISSING]

    @classmethod
    def read(cls, values: Mapping[str, float | None], file: str) -> DesignConstants:
        """From what ngspice read back; `InputError` names every constant that is missing or not positive."""
        problems = []
        good: dict[str, Any] = {}
        for name in cls.names():
            value = values.get(name)
            if value is None:
                problems.append(
                    Problem(
                        f"the board states no design constant '{name}' (.csparam {name} = ...)", file=file
                    )
                )
            elif not LEAST <= value <= MOST:
                problems.append(
                    Problem(
                        "a design constant must be positive", file=file, key=name, value=value, allowed=_RANGE
                    )
                )
            elif name == "dac_bits" and not 1 <= value <= MOST_BITS:
                problems.append(
                    Problem("is not a possible resolution of a DAC", file=file, key=name, value=value,
                            unit="bits", allowed=f"1 to {MOST_BITS}")
                )  # fmt: skip
            else:
                good[name] = value
        if problems:
            raise InputError(problems)
        own = values.get("motor_k")
        return cls(**good, motor_k=own if own is not None and isfinite(own) else 0.0)


#: Data of a part, by its role, that no part has without being a positive number.
_POSITIVE = {
    "opamp": ("gbw", "aol", "sr", "swing"),
    "driver": ("gbw", "aol", "sr", "swing", "ilim"),
    "vca": ("bw", "sr", "swing"),
    "motor": ("r", "k"),
}


@dataclass(frozen=True)
class Stated(DesignConstants):
    """All that a flattened board states in numbers: its design constants, and the data of its parts.

    Parameters
    ----------
    numbers : every `.csparam` of the deck by its lower-case name, such as 'tl072_gbw', in the netlist's units
    parts : role -> names of the parts that play it
    count : role -> how many amplifiers of that role the board holds
    straight, bent : elements that ngspice evaluates at every point, see `cosim.circuits.element_count`
    """

    numbers: Mapping[str, float] = field(default_factory=dict)
    parts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    count: Mapping[str, int] = field(default_factory=dict)
    straight: int = 0
    bent: int = 0

    def design(self) -> dict[str, float]:
        """Return the design constants alone, JSON-ready."""
        return {name: getattr(self, name) for name in self.names()}

    def constants(self) -> DesignConstants:
        """Return the design constants as such."""
        return DesignConstants(**self.design(), motor_k=self.motor_k, motors=self.motors)

    def check(self, file: str) -> None:
        """Refuse data of parts by which nothing can be divided, naming each; `InputError`."""
        problems = [
            Problem(
                f"data of a {role} must be positive", file=file, key=f"{part}_{quantity}",
                value=self.numbers[f"{part}_{quantity}"], allowed=_RANGE,
            )
            for role, quantities in _POSITIVE.items()
            for part in self.parts.get(role, ())
            for quantity in quantities
            if not LEAST <= self.numbers.get(f"{part}_{quantity}", 1.0) <= MOST
        ]  # fmt: skip
        if problems:
            raise InputError(problems)

    def of(self, role: str, quantity: str) -> tuple[float, ...]:
        """Return what the parts of a role state as '<part>_<quantity>'; empty where none does.

        A vendor's model states nothing, so that what depends on it has no a-priori size of its own.
        """
        named = (f"{part}_{quantity}" for part in self.parts.get(role, ()))
        return tuple(self.numbers[name] for name in named if name in self.numbers)
