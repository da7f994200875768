"""Accelerations of linkage and operator under the torques of the motors - compiled."""

from __future__ import annotations

from typing import Any

from cosim.types import Record
from mech.compiled import inner
from mech.kernels import dynamics

#: No joint of a haptic device turns this fast [rad/s], ten times the fastest start that a scene may state.
RUNAWAY_RAD_PER_S = 1e5


@inner
def evaluate(s: Record, t: float, q: Any, v: Any, a_out: Any) -> None:
    """Find the accelerations [rad/s^2] at a state, the motors' torques `s.tau` given."""
    dynamics(s.p, s.op, t, q, v, s.tau, a_out, s.w)
