"""The linkage's integrator in lockstep: a variable-step Adams predictor and corrector.

The circuit needs the joint angles at a point whose motor current is not known yet: it gets the predictor
(acceleration extrapolated along its last slope: local error O(h^3) in v, O(h^4) in q). When ngspice has
accepted the point, the current is known and the corrector (a parabola through the last three accelerations)
takes the linkage there. Their difference is Milne's estimate of what the coupling got wrong, for free.

Where ngspice integrates by trapezoids, the corrector of the speed is the trapezoid, too. What that rule gets
wrong of a current that settles behind a jump of a DAC, L di/dt = u - R i, cancels in the impulse: the rule's
own sum of h (i_n + i_n+1)/2 is (u t - L i)/R without an error, and a parabola through the same points is not.
With Gear's rule nothing cancels, and the parabola's order counts.

Right after a discontinuity (a DAC step) nothing behind is smooth: the first step holds the acceleration of
its *end*, as backward Euler does in ngspice at the same step, so that the jump is taken with its right-hand
limit and the circuit's own delay keeps its first moment.

`s.history` counts the accelerations of the present smooth piece: 0 right after a discontinuity (`a` is its
left-hand limit), 1 when `a` belongs to the piece, 2 when `a_old` does too.
"""

from __future__ import annotations

from typing import Any

from cosim.loop.state import STATE
from cosim.types import Record
from mech.compiled import entry, inner_spliced, vector

Vector = Any


@entry(STATE, float, vector, vector, how=inner_spliced)
def predict(s: Record, h: float, q_out: Vector, v_out: Vector) -> None:
    """Angles and speeds [rad, rad/s] a time `h` after the last accepted point."""
    for j in range(s.coordinates):
        slope = (s.a[j] - s.a_old[j]) / s.h_old if s.history > 1 else 0.0
        q_out[j] = s.q[j] + h * (s.v[j] + h * (s.a[j] / 2 + h * slope / 6))
        v_out[j] = s.v[j] + h * (s.a[j] + h * slope / 2)


@entry(STATE, float, vector, float, bool, result=float, how=inner_spliced)
def correct(s: Record, h: float, a_new: Vector, weight: float, take: bool) -> float:
    """Return the defect [rad] of the step `h` with `a_new` [rad/s^2] at its end, and `take` q and v there.

    The defect is the largest |predicted - corrected| of any joint, speeds weighted with a time `weight` [s].
    """
    defect = 0.0
    first = s.history == 0
    for j in range(s.coordinates):
        if first:
            q = s.q[j] + h * (s.v[j] + h * a_new[j] / 2)
            v = s.v[j] + h * a_new[j]
        else:
            # a(x) = a + b x + c x^2 through -h_old, 0, h
            right = (a_new[j] - s.a[j]) / h
            c = 0.0
            if s.history > 1 and s.steps.trapezoids == 0:
                c = (right - (s.a[j] - s.a_old[j]) / s.h_old) / (h + s.h_old)
            b = right - c * h
            q = s.q[j] + h * (s.v[j] + h * (s.a[j] / 2 + h * (b / 6 + h * c / 12)))
            v = s.v[j] + h * (s.a[j] + h * (b / 2 + h * c / 3))
        e = abs(q - s.q_trial[j]) + weight * abs(v - s.v_trial[j])
        if not e <= defect:  # a NaN gets through, and is seen
            defect = e
        if take:
            s.q[j] = q
            s.v[j] = v
    return defect
