"""Orders of everything that converges, fitted where it is asymptotic: one table, `pytest -s`.

A fit is a least-squares line through log(error) over log(step) (or number of samples, or band over pole). The
expected order is that of the method's theory; a fit may miss it by what the next term of its expansion and
variable steps leave over the range, or by the scatter of a root mean square of that many repetitions.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from linear_runs import ideal, propagate, rows
from scipy.linalg import expm
from slope import RADIUS
from support import EMF_TRUE, K_FS, SPRING_TRUE, merge, quick, scene_of, shared_child, slider

from cosim.circuits.fitting.rational_fit import Modes
from cosim.circuits.fitting.reduction import reduce
from cosim.ngspice.child import call
from cosim.tolerance.unit_cube import REPLICATES, sampling

START, INERTIA = -0.04, 0.2 * RADIUS**2
#: Undamped frequency [rad/s] of the carriage on the circuit's spring of 100 N/m.
OMEGA = math.sqrt(100 * RADIUS**2 * SPRING_TRUE / K_FS / INERTIA)
#: A carriage that is let go in the wall and never leaves it in the time that is looked at.
HELD: dict[str, Any] = {
    "duration_s": 0.06, "device": {"start": {"q_rad": [START]}}, "computer": {"period_s": 0.06},
    "solver": {"coupling_tolerance_rad": 0.1},  # steps as long as allowed; sweeps go to `tol`
}  # fmt: skip


def rc(method: str, step: float) -> float:
    """Error at 1 s of a capacitor behind 1 Ohm, time constant 1 s, driven by a sine."""
    deck = f"rc\nV1 in 0 sin(0 1 0.5)\nR1 in out 1\nC1 out 0 1\n.options method={method} reltol=0.1\n.end\n"
    asked = {"deck": deck, "command": f"tran {step!r} 1 0 {step!r}", "names": ("time", "out")}
    target = "cosim.accuracy.hard_cases.hard_case:analysed"
    time, out = call(target, asked, child=shared_child())
    w, end = math.pi, float(time[-1])
    exact = (math.sin(w * end) - w * math.cos(w * end) + w * math.exp(-end)) / (1 + w**2)
    return abs(float(out[-1]) - exact)


def coupling(tmp_path, step: float, method: str = "gear") -> float:
    """Error of the angle in lockstep with an ideal circuit whose spring and viscosity are exact."""
    tables = merge(HELD, {"effects": {"motor": "emf"}, "solver": {"max_step_s": step, "method": method}})
    run = quick(tmp_path, slider(**tables))
    t, q = (np.asarray(run.signals[name]) for name in ("time", "q1"))
    rate = np.array([[0.0, 1.0], [-(OMEGA**2), -EMF_TRUE / INERTIA]])
    exact = np.array([(expm(rate * x) @ [START, 0.0])[0] for x in t])
    return float(np.abs(q - exact).max())


def collocation(tmp_path, step: float) -> float:
    """Error at the end of a step, where Gauss's nodes are of twice their number; its exponentials are off."""
    tables = merge(HELD, {"solver": {"max_step_s": step}})
    made = propagate(scene_of(tmp_path, slider(**tables)), ideal(1, emf=False), tol=1e-13, exact=False)
    t, q = float(rows(made, "time")[-1]), float(rows(made, "q1")[-1])
    return abs(q - START * math.cos(OMEGA * t))


def event(tmp_path, step: float) -> float:
    """Error of the instant at which the carriage strikes a stop on its way: of one step's quartic, O(h^5)."""
    stop = 0.3 * START
    tables = merge(HELD, {
        "device": {"slider": {"stops_rad": [[-1.0, stop]], "stop_restitution": 0.5}},
        "effects": {"end_stops": True}, "solver": {"max_step_s": step},
    })  # fmt: skip
    made = propagate(scene_of(tmp_path, slider(**tables)), ideal(1, emf=False), tol=1e-13, exact=False)
    t, v = rows(made, "time"), rows(made, "v1")
    return abs(float(t[1:][v[1:] < 0.0][0]) - math.acos(0.3) / OMEGA)


def reduction(band: float) -> float:
    """Error in a band [rad/s] far below it of one pole at 1 rad/s that is left out at its gain at rest."""
    one = np.ones((1, 1))
    full = Modes(-one, one, one, 0.0 * one, np.array([-1.0 + 0.0j]), (1,), 0.0 * one)
    small, bound = reduce(full, band, 0.5)
    assert len(small.a) == 0
    return float(bound.lower.max())


def mean(method: str, n: int) -> float:
    """Error of a smooth mean over the cube of five dimensions, root mean square of 12 studies."""
    off = []
    for seed in range(12):
        made = sampling(method, n, 5, seed)
        points = made.uniforms(0, made.n).reshape(made.replicates, -1, 5)
        off.append(np.prod(1.0 + (points - 0.5), axis=2).mean(axis=1) - 1.0)
    return float(np.sqrt(np.mean(np.square(off))))


@dataclass(frozen=True)
class Order:
    """What converges: its name, a function of (folder, size), sizes, expected order, what a fit may miss."""

    name: str
    error: Any
    sizes: tuple[float, ...]
    expected: float
    within: float


#: Variable steps at the start of ngspice's runs, and the next term of an expansion, leave a tenth. A
#: scrambled net is of order 1 for any function of bounded variation and of 3/2 for smooth ones (Owen 1997).
ORDERS = (
    Order("ngspice, trapezoids", lambda _, h: rc("trap", h), (0.02, 0.01, 0.005, 0.0025), 2.0, 0.15),
    Order("ngspice, Gear's rule", lambda _, h: rc("gear", h), (0.02, 0.01, 0.005, 0.0025), 2.0, 0.15),
    Order("coupling", coupling, (4e-3, 2e-3, 1e-3), 3.0, 0.35),
    Order("coupling, trapezoids", lambda f, h: coupling(f, h, "trap"), (4e-3, 2e-3, 1e-3), 2.0, 0.35),
    Order("collocation", collocation, (0.06, 0.03, 0.015), 6.0, 0.35),
    Order("event location", event, (0.03, 0.015, 0.0075), 5.0, 0.35),
    Order("reduction, of band over pole", lambda _, w: reduction(w), (0.1, 0.03, 0.01), 1.0, 0.1),
    Order("Monte Carlo", lambda _, n: mean("plain", int(n)), (2**9, 2**11, 2**13), -0.5, 0.15),
    Order("Sobol", lambda _, n: mean("sobol", int(n) * REPLICATES), (2**6, 2**8, 2**10), -1.25, 0.35),
)


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order.name)
def test_order(order: Order, tmp_path) -> None:
    errors = np.array([order.error(tmp_path, size) for size in order.sizes])
    fitted = float(np.polyfit(np.log(order.sizes), np.log(errors), 1)[0])
    table = ", ".join(f"{size:g}: {error:.1e}" for size, error in zip(order.sizes, errors, strict=True))
    wanted = f"{order.expected:g} +- {order.within:g}"
    print(f"\n{order.name:30s} order {fitted:6.2f}, expected {wanted} ({table})")
    assert abs(fitted - order.expected) <= order.within
    assert (np.diff(errors) < 0).all()
