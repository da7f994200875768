"""How far a board at rest answers to large signals as it does to small ones.

A linear model holds about the operating point. An output stage without bias there (class B), or an op-amp
that saturates below rated torque, has another gain where the motors work, which no `.ac` at rest sees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cosim.circuits.extraction.limits_and_offsets import current_limits
from cosim.circuits.extraction.multipliers import LOW_HZ
from cosim.circuits.extraction.testbench import Testbench
from cosim.errors import InputError, NoOperatingPoint
from cosim.types import Array, Report

__all__ = ["large_signal_error", "measure"]

#: Points of the sweep from rest to rated current, on either side.
_STEPS = 8


def large_signal_error(bench: Testbench, limits: Array) -> tuple[float, str] | None:
    """Compare the currents of a `.dc` sweep of each spring with the slope at rest, up to rated current.

    Parameters
    ----------
    bench
        The board.
    limits
        Lowest and highest current of each motor [n, 2] A (`current_limits`): models have them as clamps.

    Returns
    -------
    tuple or None
        Largest difference as a share of rated current, and the gain pin that it was met at; ``None`` where
        the board states no rated current or ngspice finds no operating point on the way.
    """
    try:
        rated, reach = (bench.simulator.constant(name) for name in ("i_rated", "dac_v"))
    except InputError:
        return None
    once = f"lin 1 {LOW_HZ[0]!r} {LOW_HZ[0]!r}"
    worst, where = 0.0, ""
    for pin in (name for name in bench.channels if name.startswith("ksp")):
        motor, source = f"imot{pin[3]}", f"u{pin[4]}"
        bench.hold({pin: bench.v_fs})
        try:
            low, high = limits[int(pin[3]) - 1]
            slope = float(bench.respond(source, once, [motor])[0, 0].real)
            if slope != 0.0:
                end = min(rated / abs(slope), reach)
                for volts in (end, -end):
                    current = bench.sweep(source, 0.0, volts, _STEPS, motor)
                    straight = current[0] + slope * np.linspace(0.0, volts, _STEPS + 1)
                    off = float(np.abs(current - np.clip(straight, low, high)).max()) / rated
                    worst, where = max((worst, where), (off, pin))
        except NoOperatingPoint:
            return None
        finally:
            bench.hold({pin: 0.0})
    return worst, where


def measure(payload: Mapping[str, Any], report: Report) -> float:
    """Return the same of a board in ngspice's child process, 0 where it is not known; payload: 'board'."""
    report({})
    bench = Testbench(payload["board"], multipliers=False)
    error, _ = large_signal_error(bench, current_limits(bench)) or (0.0, "")
    return error
