"""Rows of the lockstep just behind a jump of the DACs.

ngspice hands over accepted points; the one at the instant of a jump is the limit from the left. The limit
from the right is where the smooth piece behind it begins: its first two points, extrapolated to the instant.
That is of order two in the step, and exact for what the DACs drive through resistors. Where less than half of
the first step's change is at the instant, the signal is continuous, as a capacitor's voltage is, and the
limits are one.

A circuit that settles within a step makes trapezoids ring, and their first points point nowhere. Where the
third turns back, the limit is the first: over that step, of backward Euler, it is the step's own polynomial,
and with it the integral over the step is right (see `spice/adams.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.types import Array

#: How many rows behind that of a jump its limit from the right rests on.
REACH = 3
#: Columns that an instant does not change, by their names without the joint's number: time, place, motion,
#: and what depends on these alone. Friction acts over a step as at its start.
_KEPT = frozenset("time rule x y q v pot qm vm tau_shaft p_shaft e_shaft tau_visc tau_coul tau_stop".split())
#: Share of the first step's change from which on it is a jump.
_JUMP = 0.5


def right_limits(
    rows: Array, columns: Sequence[str], channels: Sequence[str]
) -> tuple[NDArray[np.intp], Array]:
    """Return the rows [J] at which DACs jump, and the limits there from the right [J, columns].

    A step that begins at a jump is known by its rule, 0; the `channels` of the DACs hold over it. Where the
    piece behind a jump has one point only, up to the next jump or the end, the limit is that point.
    """
    rule = rows[:, columns.index("rule")]
    first = np.flatnonzero(rule[1:] == 0.0) + 1
    begins = np.append(rule == 0.0, [True, True])  # a piece of its own; so does what is beyond the rows
    second = first + ~begins[first + 1]
    third = second + ~(begins[first + 1] | begins[first + 2])
    left, rise, onward = rows[first - 1], rows[second] - rows[first], rows[third] - rows[second]
    share = (rows[first, 0] - left[:, 0]) / np.where(second > first, rise[:, 0], 1.0)
    held = np.array([name in channels for name in columns])
    right = rows[first] - share[:, None] * np.where((rise * onward < 0.0) | held, 0.0, rise)
    change = rows[first] - left
    jumps = (right - left) * change > _JUMP * change**2
    jumps[:, [name.rstrip("0123456789") in _KEPT for name in columns]] = False
    return first - 1, np.where(jumps, right, left)
