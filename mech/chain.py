"""A planar serial chain of revolute joints."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mech.linkage import Array, Linkage, PerJoint
from mech.parameter_checks import Checker, ParameterError, Refusal
from mech.records import NMAX

__all__ = ["Chain"]


@final
@dataclass(frozen=True, kw_only=True)
class Chain(Linkage):
    """A planar serial chain of 1 to 6 links in relative joint angles.

    The tip is at origin + sum_i lengths[i] (cos, sin)(q_1 + ... + q_i). Where a field takes one number a
    joint, a single number stands for all.

    Parameters
    ----------
    lengths_m
        Joint to joint, the last one joint to fingertip.
    masses_kg
        Of the links.
    coms_m
        Distance from a link's joint to its centre of mass, on the line to the next joint; half the
        length if left out.
    inertias_kg_m2
        About the centre of mass; those of slender rods, m l^2 / 12, if left out.
    coriolis
        False leaves the terms with products of speeds out.

    Raises
    ------
    ParameterError
        With every refused parameter.

    Examples
    --------
    >>> import numpy as np
    >>> arm = Chain(lengths_m=(0.1, 0.1), masses_kg=(0.1, 0.1), coms_m=(0.05, 0.05),
    ...             inertias_kg_m2=(1e-4, 1e-4))
    >>> np.round(arm.forward([0.0, np.pi / 2]), 12).tolist()  # m
    [0.1, 0.1]
    """

    lengths_m: Sequence[float]
    masses_kg: PerJoint
    coms_m: PerJoint | None = None
    inertias_kg_m2: PerJoint | None = None
    coriolis: bool = True

    def __post_init__(self) -> None:
        check = Checker()
        try:
            n = len(self.lengths_m)
        except TypeError:
            n = 0
        if not 1 <= n <= NMAX or isinstance(self.lengths_m, str):
            raise ParameterError([Refusal("lengths_m", self.lengths_m, f"1 to {NMAX} numbers > 0")])
        lengths = check.numbers("lengths_m", self.lengths_m, n, above=0.0, spread=False)
        masses = check.numbers("masses_kg", self.masses_kg, n, least=0.0)
        if self.coms_m is None:
            coms = tuple(0.5 * x for x in lengths)
        else:
            coms = check.numbers("coms_m", self.coms_m, n)
        if self.inertias_kg_m2 is None:
            inertias = tuple(m * x * x / 12.0 for m, x in zip(masses, lengths, strict=True))
        else:
            inertias = check.numbers("inertias_kg_m2", self.inertias_kg_m2, n, least=0.0)
        self._store(lengths_m=lengths, masses_kg=masses, coms_m=coms, inertias_kg_m2=inertias)
        self._check(check, n)
        check.done()
        self._check_inertia()

    @property
    def reach_m(self) -> tuple[float, float]:
        """Least and greatest distance of the fingertip from the origin [m]."""
        most = math.fsum(self.lengths_m)
        return max(0.0, 2.0 * max(self.lengths_m) - most), most

    @property
    def size_m(self) -> float:
        """Length of the stretched chain [m]."""
        return self.reach_m[1]

    def _masses(self) -> tuple[Array, Array]:
        """Return `couple` and `moment` of `mech.records.LINKAGE`, shapes (n, n) and (n,)."""
        lengths, coms, masses, inertias = (
            np.asarray(x, dtype=float)
            for x in (self.lengths_m, self.coms_m, self.masses_kg, self.inertias_kg_m2)
        )
        arms = np.tril(np.tile(lengths, (self.n, 1)), -1) + np.diag(coms)
        return arms.T @ (masses[:, None] * arms) + np.diag(inertias), arms.T @ masses

    def _check_inertia(self) -> None:
        # Stretched out, every centre of mass moves along one line, so that masses that leave a motion
        # free of inertia do so here.
        total = np.tril(np.ones((self.n, self.n)))
        stretched = total.T @ self._masses()[0] @ total + np.diag(self._fixed_kg_m2)
        values = np.linalg.eigvalsh(stretched)
        if not values[0] > 1e-13 * values[-1]:
            allowed = "such that every joint moves some mass, inertia or rotor"
            raise ParameterError([Refusal("masses_kg", self.masses_kg, allowed)])

    def _record(self) -> np.ndarray[Any, Any]:
        record = self._pack()
        p = record[0]
        p["length"][: self.n] = self.lengths_m
        couple, moment = self._masses()
        p["couple"][: self.n, : self.n] = couple
        p["moment"][: self.n] = moment
        p["coriolis"] = self.coriolis
        return record

    def _seed(self, target: Array, elbow: int) -> Array:
        q = np.zeros(self.n)
        if self.n > 2:
            # An arc, turned so that its end lies in the target's direction.
            q[1:] = 0.6 * elbow
            origin = np.asarray(self.origin_m)
            bent, wanted = self.forward(q) - origin, target - origin
            q[0] = math.atan2(wanted[1], wanted[0]) - math.atan2(bent[1], bent[0])
        return q

    def _geometric(self, jac: Array, force: Array) -> Array:
        # J_i turned by a right angle is minus the arm from joint i to the tip, and dJ_i/dq_j is minus the
        # arm from the later of the two joints.
        arm = force[0] * jac[1] - force[1] * jac[0]
        later = np.maximum.outer(np.arange(self.n), np.arange(self.n))
        stiffness: Array = -arm[later]
        return stiffness

    def _where(self) -> str:
        least, most = self.reach_m
        span = f"{most:g}" if self.n == 1 else f"{least:g} to {most:g}"
        return f"{span} m from the origin ({self.origin_m[0]:g}, {self.origin_m[1]:g}) m"
