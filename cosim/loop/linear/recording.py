"""Accepted points of our own loop: counted, checked, and written as rows where rows are wanted."""

from __future__ import annotations

import math
from typing import Any

from cosim.loop.columns import write_row
from cosim.loop.equations_of_motion import RUNAWAY_RAD_PER_S
from cosim.loop.pin_voltages import noise_at, volts
from cosim.loop.state import Fault
from cosim.types import Record
from mech.compiled import call_plain, carray, doubles_at, inner_inlined

#: Torques that differ by this share are one.
_SAME = 1e-9
_COLLAPSED, _NOT_FINITE, _RAN_AWAY = Fault.STEP_COLLAPSED, Fault.NOT_FINITE, Fault.RAN_AWAY


@inner_inlined
def show(s: Record) -> None:
    """Fill the pins' voltages that a row shows."""
    for j in range(s.n):
        s.q_trial[j] = s.q[j]
        s.out[j] = s.q[j]
        if s.noise.address != 0 or s.position_noise.address != 0:
            s.out[j] += noise_at(s, s.t, j)
    for i in range(s.dac.count):
        s.out[s.dac.first + i] = volts(s, s.dac.channel[i], s.t)


@inner_inlined
def record(s: Record) -> None:
    """Write the accepted point as a row, when rows are wanted."""
    s.points += 1
    row(s)


@inner_inlined
def row(s: Record) -> None:
    """Write a row, when rows are wanted: of an accepted point, or of what a jump there makes of it."""
    if s.rows.capacity == 0:
        return
    show(s)
    write_row(s, s.t, carray(doubles_at(s.rows.address + 8 * s.columns * s.rows.used), (s.columns,)))
    s.rows.used += 1
    if s.rows.used == s.rows.capacity:
        call_plain(s.drain_address)


@inner_inlined
def moved(s: Record, b: Any) -> bool:
    """Whether a motor's torque jumped from what it was before, by more than rounding."""
    for j in range(s.n):
        if abs(s.tau[j] - b.before[j]) > _SAME * max(abs(s.tau[j]), abs(b.before[j])):
            return True
    return False


@inner_inlined
def check(s: Record) -> None:
    """End the run on speeds that no device has, and on steps cut endlessly."""
    if s.points - s.points_before > s.steps.most:
        s.fault = _COLLAPSED
    for j in range(s.coordinates):
        if not abs(s.v[j]) < RUNAWAY_RAD_PER_S:
            s.fault = _RAN_AWAY if abs(s.v[j]) < math.inf else _NOT_FINITE
