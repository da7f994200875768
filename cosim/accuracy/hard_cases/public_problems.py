"""Problems with published solutions that nobody here wrote, as decks.

The transistor amplifier of the test set for initial value problem solvers (Lioen and de Swart, CWI 1998; from
Hairer, Lubich and Roche, 1989): an index-1 differential-algebraic system of eight voltages. Its transistors
are written as sources, exactly as the set states them, so that no device model enters.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.accuracy.hard_cases.hard_case import Bench, HardCase

__all__ = ["CASES"]

#: The set's solution at 0.2 s [V], by PSIDE with tolerances of 1e-14.
_AMPLIFIER = (
    -0.5562145012262709e-2, 0.3006522471903042e1, 0.2849958788608128e1, 0.2926422536206241e1,
    0.2704617865010554e1, 0.2761837778393145e1, 0.4770927631616772e1, 0.1236995868091548e1,
)  # fmt: skip
_START = (0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0)
_END_S, _STEP_S = 0.2, 2e-6
_DECK = f"""transistor amplifier
Vb b 0 6
Vin in 0 sin(0 0.1 100)
R0 in n1 1k
C1 n1 n2 1u
R1 n2 0 9k
R2 n2 b 9k
B1 n2 n3 i=0.01*1e-6*(exp((v(n2)-v(n3))/0.026)-1)
B2 n4 n3 i=0.99*1e-6*(exp((v(n2)-v(n3))/0.026)-1)
R3 n3 0 9k
C2 n3 0 2u
R4 n4 b 9k
C3 n4 n5 3u
R5 n5 0 9k
R6 n5 b 9k
B3 n5 n6 i=0.01*1e-6*(exp((v(n5)-v(n6))/0.026)-1)
B4 n7 n6 i=0.99*1e-6*(exp((v(n5)-v(n6))/0.026)-1)
R7 n6 0 9k
C4 n6 0 4u
R8 n7 b 9k
C5 n7 n8 5u
R9 n8 0 9k
.ic {" ".join(f"v(n{k + 1})={v!r}" for k, v in enumerate(_START))}
.options reltol=1e-9 abstol=1e-15 vntol=1e-10 chgtol=1e-18 method=trap
.end
"""


def ending(payload: dict[str, Any], report: Any) -> list[float]:
    """Run the amplifier in ngspice's process and return its voltages [8] V at the end."""
    from cosim.ngspice.simulator import Simulator

    simulator = Simulator(on_time=lambda reached: report({"time_s": reached}))
    simulator.load(_DECK)
    simulator.command(f"tran {_STEP_S!r} {_END_S!r} 0 {_STEP_S!r}")
    return [float(np.real(simulator.vector(f"n{k}"))[-1]) for k in range(1, 9)]


def _amplifier(bench: Bench, model: str) -> float:
    """Return the largest error at 0.2 s in the set's mixed norm, |error| / (1 + |value|)."""
    found = np.array(bench.ask("cosim.accuracy.hard_cases.public_problems:ending", {}))
    exact = np.array(_AMPLIFIER)
    return float((np.abs(found - exact) / (1.0 + np.abs(exact))).max())


CASES = (
    HardCase(
        "transistor amplifier, published solution", 61, "largest error, mixed norm", 0.0, {"spice": 1e-5},
        "trapezoids of 2 us on junctions of 80 Ohm and 2 uF: (h/tau)^2/12 = 1.3e-5 of what moves so fast",
        _amplifier,
    ),
)  # fmt: skip
