"""Free motion of a mechanism with an operator, integrated to a stated tolerance, with its energy ledger."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mech.linkage import Linkage
from mech.operator import NoOperator, Operator
from mech.parameter_checks import Checker, vector
from mech.records import new_work

__all__ = ["WORKS", "Motion", "free_motion"]

Array = NDArray[np.float64]

WORKS = ("motors", "operator", "viscous", "coulomb", "stops", "shafts")
"""Columns of `Motion.works`."""


@dataclass(frozen=True)
class Motion:
    """A motion on the integrator's own steps, and between them through `at`.

    Attributes
    ----------
    time
        [s], shape (k,).
    q, v
        Joint angles [rad] and speeds [rad/s], shape (k, coordinates).
    works
        Work done on the mechanism since the start [J], shape (k, 6), columns `WORKS`. That of the
        operator is without weight and inertia of its mass, which `energy` counts.
    energy
        Kinetic, gravity and shafts' energy [J], operator's mass included, shape (k,).
    evaluations
        Of the equations of motion.
    """

    time: Array
    q: Array
    v: Array
    works: Array
    energy: Array
    evaluations: int
    _dense: Callable[[float], Array]

    @property
    def imbalance(self) -> Array:
        """Energy that no work explains [J], shape (k,)."""
        gap: Array = self.energy - self.energy[0] - self.works.sum(axis=1)
        return gap

    def at(self, t: float) -> tuple[Array, Array]:
        """Return q [rad] and v [rad/s] at time `t` [s], within the steps by 7th-order interpolation."""
        n = self.q.shape[1]
        state = self._dense(t)
        return state[:n], state[n : 2 * n]


def free_motion(
    linkage: Linkage,
    q: ArrayLike,
    v: ArrayLike,
    duration_s: float,
    *,
    tau: ArrayLike | None = None,
    operator: Operator | None = None,
    rtol: float = 1e-12,
    atol: float = 1e-12,
    max_step_s: float = np.inf,
) -> Motion:
    """Integrate the mechanism under constant motor torques, with scipy's DOP853 on the compiled equations.

    Parameters
    ----------
    linkage, operator
        Mechanism, and who holds it.
    q, v
        Angles [rad] and speeds [rad/s] at t = 0, one a coordinate of the linkage.
    duration_s
        [s]
    tau
        Motor torques at the joints [N m], shape (n,); zero if left out.
    rtol, atol
        Relative tolerance, and absolute one in rad and rad/s; works get a thousandth of it, in J.
    max_step_s
        Longest step [s]; needed only to see an event shorter than what the motion itself asks for.

    Raises
    ------
    ParameterError
        An argument is refused.
    ArithmeticError
        The motion cannot be continued (with the time reached), for example because a force became NaN.
    """
    from scipy.integrate import OdeSolution, solve_ivp

    from mech import kernels
    from mech.energy import energy as energy_of
    from mech.shaft import windup_energy

    check = Checker()
    check.number("duration_s", duration_s, above=0.0)
    if any(linkage.backlash_rad):  # type: ignore[arg-type]
        check.refuse("backlash_rad", linkage.backlash_rad, "0: flanks are kept by a time loop only")
    check.done()
    n = linkage.coordinates
    held = operator or NoOperator()
    p, op, work = linkage.pack()[0], held.pack()[0], new_work()[0]
    torques = np.zeros(linkage.n) if tau is None else vector("tau", tau, linkage.n)
    state = np.concatenate([vector("q", q, n), vector("v", v, n), np.zeros(len(WORKS))])
    tolerance = np.concatenate([np.full(2 * n, atol), np.full(len(WORKS), 1e-3 * atol)])

    def rate(t: float, y: Array) -> Array:
        out = np.empty(y.size)
        kernels.flow(p, op, t, y, torques, out, work)
        if not np.all(np.isfinite(out)):
            held.raise_pending()
            raise ArithmeticError(f"acceleration is not finite at t = {t:.9g} s, q = {y[:n]} rad")
        return out

    # No step straddles a kink of the operator's force: there the integrator's order would be lost.
    knots = [0.0, *(t for t in held.knots_s if 0.0 < t < duration_s), duration_s]
    times, states, pieces, evaluations = [np.zeros(1)], [state[:, None]], [], 0
    for start, end in pairwise(knots):
        part: Any = solve_ivp(
            rate,
            (start, end),
            state,
            method="DOP853",
            rtol=rtol,
            atol=tolerance,
            max_step=max_step_s,
            dense_output=True,
        )
        if not part.success:
            raise ArithmeticError(f"integration stopped at t = {part.t[-1]:.9g} s: {part.message}")
        state = part.y[:, -1]
        times.append(part.t[1:])
        states.append(part.y[:, 1:])
        pieces.extend(part.sol.interpolants)
        evaluations += part.nfev
    time, history = np.concatenate(times), np.concatenate(states, axis=1).T
    angles, speeds = history[:, :n].copy(), history[:, n : 2 * n].copy()
    energy = np.array(
        [sum(energy_of(p, op, a, b)) + windup_energy(p, a, work) for a, b in zip(angles, speeds, strict=True)]
    )
    dense = OdeSolution(time, pieces)
    return Motion(time, angles, speeds, history[:, 2 * n :], energy, evaluations, dense)
