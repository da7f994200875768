"""The board's pins and design constants: the interface that every circuit model shares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from math import isfinite

from cosim.errors import InputError, Problem, nearest


def pins(joints: int) -> list[str]:
    """Pins of a board with `joints` joints (design table): names decide, their order is free."""
    j = range(1, joints + 1)
    pairs = [f"{a}{b}" for a in j for b in j]
    return (
        [f"pot{i}" for i in j]
        + [f"vel{i}" for i in j]
        + [f"u{i}" for i in j]
        + [f"ksp{ab}" for ab in pairs]
        + [f"ksd{ab}" for ab in pairs]
        + [f"cmd{i}" for i in j]
        + [f"imot{i}" for i in j]
        + ["vcc", "vee"]
    )


def require_pins(found: Iterable[str], joints: int, file: str) -> None:
    """Raise `InputError` naming every missing and every unknown pin of a board file."""
    have, want = {pin.lower() for pin in found}, pins(joints)
    problems = [
        Problem(f"the board has no pin '{pin}', which a device with {joints} joint(s) needs", file=file)
        for pin in want
        if pin not in have
    ]
    for pin in sorted(have.difference(want)):
        hint = nearest(pin, want)
        problems.append(
            Problem(
                f"the board has a pin '{pin}' that a device with {joints} joint(s) does not know"
                + (f"; did you mean '{hint}'?" if hint else ""),
                file=file,
            )
        )
    if problems:
        raise InputError(problems)


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

    @classmethod
    def names(cls) -> list[str]:
        """Names of the constants, as the board's `.csparam` lines spell them."""
        return [field.name for field in fields(cls)]

    @classmethod
    def read(cls, values: Mapping[str, float | None], file: str) -> DesignConstants:
        """From what ngspice read back; `InputError` names every constant that is missing or not positive."""
        problems = []
        good: dict[str, float] = {}
        for name in cls.names():
            value = values.get(name)
            if value is None:
                problems.append(
                    Problem(f"the board states no design constant '{name}' (.csparam {name} = ...)", file=file)
                )
            elif not (isfinite(value) and value > 0.0):
                problems.append(
                    Problem("a design constant must be positive", file=file, key=name, value=value, allowed="> 0")
                )
            else:
                good[name] = value
        if problems:
            raise InputError(problems)
        return cls(**good)
