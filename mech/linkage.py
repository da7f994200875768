"""What every mechanism offers: kinematics, mass matrix, bias, energy of single poses, and its record.

A mechanism is a frozen, validated dataclass (`mech.chain`, `mech.slider`) packed into one record
(`mech.records.LINKAGE`) that the compiled kernels work on; the methods here are their Python face. The
kernels are imported at the first use: importing this module costs numpy only.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mech.operator import NoOperator, Operator
from mech.parameter_checks import Checker, ParameterError, Refusal, vector
from mech.records import LINKAGE, NMAX, new_work

__all__ = ["Array", "Linkage", "PerJoint"]

Array = NDArray[np.float64]
PerJoint = float | Sequence[float]
"""One number for all joints, or one for each."""

Stops = Sequence[Sequence[float]] | None
"""(low, high) in rad for each joint."""


@dataclass(frozen=True, kw_only=True)
class Linkage(ABC):
    """A mechanism with `n` joint angles q [rad] that moves a fingertip r [m] in the plane.

    Where a field takes one number a joint, a single number stands for all.

    Parameters
    ----------
    origin_m
        Of the fingertip's coordinates.
    rotor_inertia_kg_m2
        On the motor's side; gear^2 times that is added to the joint. A rotor's spin with the link that
        carries it is neglected, as is usual above a gear of a few.
    gear
        Motor turns a joint turn.
    viscous_n_m_s, coulomb_n_m
        Friction at the joints. Coulomb friction is coulomb tanh(v / coulomb_speed), or holds and slips at
        located instants where the integrator can (`mech.stiction`).
    coulomb_speed_rad_per_s
        Width of that step, where it is one: in exported decks.
    stops_rad
        (low, high) for each joint; infinite bounds are allowed.
    stop_stiffness_n_m_per_rad, stop_damping_n_m_s
        The stop pushes k x + c x x' at depth x, never pulls; c in N m s/rad^2.
    stop_restitution
        Speed after an impact over speed before, for stops that do not give; only where contacts are located
        instants. None: the stop gives, as above.
    gravity_m_per_s2
        Vector, zero when gravity is off.
    shaft_stiffness_n_m_per_rad, shaft_damping_n_m_s
        Of the shafts between motors and joints, at the joint; None: rigid. With shafts angles and speeds are
        those of the joints, then those of the motors (at the joint: motor turns over gear).
    backlash_rad
        Full width of the gears' gaps, at the joint.
    """

    origin_m: Sequence[float] = (0.0, 0.0)
    rotor_inertia_kg_m2: PerJoint = 0.0
    gear: PerJoint = 1.0
    viscous_n_m_s: PerJoint = 0.0
    coulomb_n_m: PerJoint = 0.0
    coulomb_speed_rad_per_s: float = 0.01
    stops_rad: Stops = None
    stop_stiffness_n_m_per_rad: float = 100.0
    stop_damping_n_m_s: float = 10.0
    stop_restitution: float | None = None
    gravity_m_per_s2: Sequence[float] = (0.0, 0.0)
    shaft_stiffness_n_m_per_rad: PerJoint | None = None
    shaft_damping_n_m_s: PerJoint = 0.0
    backlash_rad: PerJoint = 0.0
    n: int = field(init=False, repr=False)

    @abstractmethod
    def _record(self) -> np.ndarray[Any, Any]:
        """Return the mechanism as a `LINKAGE` array of shape (1,)."""

    @property
    @abstractmethod
    def reach_m(self) -> tuple[float, float]:
        """Least and greatest distance of the fingertip from the origin [m]."""

    @property
    @abstractmethod
    def size_m(self) -> float:
        """Length [m] against which rounding is judged."""

    @cached_property
    def _packed(self) -> np.ndarray[Any, Any]:
        return self._record()

    def pack(self) -> np.ndarray[Any, Any]:
        """Return a fresh record for the kernels, shape (1,), dtype `LINKAGE`."""
        return self._packed.copy()

    def forward(self, q: ArrayLike) -> Array:
        """Return the fingertip position [m], shape (2,), at joint angles `q` [rad], shape (n,)."""
        r = np.empty(2)
        _kernels().tip(self._packed[0], vector("q", q, self.n), r)
        return r

    def tip_velocity(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the fingertip velocity J(q) v [m/s], shape (2,)."""
        rdot = np.empty(2)
        _kernels().tip_velocity(self._packed[0], vector("q", q, self.n), vector("v", v, self.n), rdot)
        return rdot

    def jacobian(self, q: ArrayLike) -> Array:
        """Return J = d r / d q [m/rad], shape (2, n)."""
        jac = np.empty((2, NMAX))
        _kernels().jacobian(self._packed[0], vector("q", q, self.n), jac)
        return jac[:, : self.n].copy()

    def inverse(self, r: ArrayLike, elbow: int = 1, seed: ArrayLike | None = None) -> Array:
        """Return joint angles [rad], shape (n,), that put the fingertip on `r` [m].

        Parameters
        ----------
        r
            Target, shape (2,).
        elbow
            +1 or -1, the sign of the second joint's angle of a two-link chain; for longer chains the
            side on which the search without a `seed` starts.
        seed
            Pose from which longer chains search, and whose whole turns the answer keeps.

        Raises
        ------
        ParameterError
            The target is out of reach, or not found from the seed.
        """
        target = vector("r", r, 2)
        if elbow not in (1, -1):
            raise ParameterError([Refusal("elbow", elbow, "+1 or -1")])
        q = self._seed(target, elbow) if seed is None else vector("seed", seed, self.n)
        left = _kernels().inverse(self._packed[0], target[0], target[1], float(elbow), q)
        # A target on the rim must pass with the rounding of its own coordinates and of the pose.
        if not left <= 1e-12 * (self.size_m + float(np.hypot(*target))):
            raise ParameterError([Refusal("r", target.tolist(), f"{self._where()}, it is {left:.3g} m off")])
        return q

    def mass_matrix(self, q: ArrayLike, operator: Operator | None = None) -> Array:
        """Return the joint-space mass matrix [kg m^2], shape (n, n), operator's mass included.

        Rotors are part of it unless a shaft lies between them and the joint.
        """
        work = new_work()
        _kernels().mass_matrix(self._packed[0], _held(operator)[0], vector("q", q, self.n), work[0])
        return np.array(work["mass"][0, : self.n, : self.n])

    def bias(self, q: ArrayLike, v: ArrayLike, operator: Operator | None = None) -> Array:
        """Return the Coriolis and gravity torque h [N m], shape (n,), in M a + h = tau.

        The weight of an operator's mass is a force of the operator and not part of h.
        """
        work = new_work()
        held = _held(operator)[0]
        _kernels().bias(self._packed[0], held, vector("q", q, self.n), vector("v", v, self.n), work[0])
        return np.array(work["bias"][0, : self.n])

    def acceleration(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, operator: Operator | None = None, t: float = 0.0
    ) -> Array:
        """Return each coordinate's acceleration [rad/s^2] under motor torques `tau` [N m], shape (n,)."""
        work = new_work()
        a = np.empty(self.coordinates)
        angles, speeds = (vector(s, x, self.coordinates) for s, x in (("q", q), ("v", v)))
        torques = vector("tau", tau, self.n)
        _kernels().dynamics(self._packed[0], _held(operator)[0], t, angles, speeds, torques, a, work[0])
        if operator is not None:
            operator.raise_pending()
        return a

    def energy(self, q: ArrayLike, v: ArrayLike, operator: Operator | None = None) -> tuple[float, float]:
        """Return kinetic and gravity energy [J], rotors and operator's mass included, shafts' not."""
        from mech.energy import energy  # compiled code, which a plan has no need of

        held = _held(operator)[0]
        angles, speeds = (vector(s, x, self.coordinates) for s, x in (("q", q), ("v", v)))
        kinetic, lift = energy(self._packed[0], held, angles, speeds)
        return float(kinetic), float(lift)

    def geometric_stiffness(self, q: ArrayLike, force_to_tip_n: ArrayLike) -> Array:
        """Return K_g [N m/rad], shape (n, n), with columns (dJ^T/dq_j) F.

        The conservative congruence transformation is K_theta = J^T K J + K_g(F). `force_to_tip_n` is the
        force F applied TO the tip, growing with displacement as dF = K dr; with the restoring force of a
        spring, -F, the sign of K_g flips.

        References
        ----------
        S.-F. Chen and I. Kao, "Conservative congruence transformation for joint and Cartesian stiffness
        matrices of robotic hands and fingers", Int. J. Robotics Research 19(9), 2000.
        """
        force = vector("force_to_tip_n", force_to_tip_n, 2)
        return self._geometric(self.jacobian(q), force)

    def tip_mass(self, q: ArrayLike, direction: ArrayLike, operator: Operator | None = None) -> float:
        """Return the effective mass [kg] that a force along `direction` at the fingertip has to move.

        It is 1 / (u^T J M^-1 J^T u), infinite where the fingertip cannot move along u: a chain at full
        stretch, along itself.
        """
        u = vector("direction", direction, 2)
        size = float(np.hypot(*u))
        if not size > 0.0:
            raise ParameterError([Refusal("direction", direction, "other than zero")])
        lever = self.jacobian(q).T @ (u / size)
        # What rounding of sines and cosines leaves of a lever that is zero.
        if float(np.max(np.abs(lever))) <= 4.0 * self.n * np.finfo(float).eps * self.size_m:
            return math.inf
        return 1.0 / float(lever @ np.linalg.solve(self.mass_matrix(q, operator), lever))

    @abstractmethod
    def _seed(self, target: Array, elbow: int) -> Array:
        """Return where an inverse without a seed starts."""

    @abstractmethod
    def _geometric(self, jac: Array, force: Array) -> Array:
        """Return the columns (dJ^T/dq_j) F."""

    @abstractmethod
    def _where(self) -> str:
        """Say in words which fingertip positions there are."""

    @property
    def coordinates(self) -> int:
        """Number of angles: n, or 2 n where shafts lie between motors and joints."""
        return self.n if self.shaft_stiffness_n_m_per_rad is None else 2 * self.n

    @property
    def armature_kg_m2(self) -> Array:
        """Rotor inertia seen at the joints, gear^2 times that of the rotor, shape (n,)."""
        gear = np.asarray(self.gear, dtype=float)
        armature: Array = gear**2 * np.asarray(self.rotor_inertia_kg_m2, dtype=float)
        return armature

    @property
    def _fixed_kg_m2(self) -> Array:
        """Rotor inertia that moves with the joints, shape (n,)."""
        return self.armature_kg_m2 if self.shaft_stiffness_n_m_per_rad is None else np.zeros(self.n)

    def _store(self, **fields: object) -> None:
        """Set fields from within ``__post_init__``."""
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def _check(self, check: Checker, n: int) -> None:
        """Check the fields declared here and store them in their plain form."""
        self._store(n=n)
        for name, value, least, above in (
            ("rotor_inertia_kg_m2", self.rotor_inertia_kg_m2, 0.0, None),
            ("gear", self.gear, None, 0.0),
            ("viscous_n_m_s", self.viscous_n_m_s, 0.0, None),
            ("coulomb_n_m", self.coulomb_n_m, 0.0, None),
        ):
            self._store(**{name: check.numbers(name, value, n, least=least, above=above)})
        for name, pair in (("gravity_m_per_s2", self.gravity_m_per_s2), ("origin_m", self.origin_m)):
            self._store(**{name: check.numbers(name, pair, 2, spread=False)})
        check.number("coulomb_speed_rad_per_s", self.coulomb_speed_rad_per_s, above=0.0)
        check.number("stop_stiffness_n_m_per_rad", self.stop_stiffness_n_m_per_rad, above=0.0)
        check.number("stop_damping_n_m_s", self.stop_damping_n_m_s, least=0.0)
        if self.stop_restitution is not None:
            check.number("stop_restitution", self.stop_restitution, least=0.0)
            if self.stop_restitution > 1.0:
                check.refuse("stop_restitution", self.stop_restitution, "<= 1")
        if self.stops_rad is not None:
            self._store(stops_rad=_stops(check, self.stops_rad, n))
        self._check_shafts(check, n)

    def _check_shafts(self, check: Checker, n: int) -> None:
        for name, value in (
            ("shaft_damping_n_m_s", self.shaft_damping_n_m_s),
            ("backlash_rad", self.backlash_rad),
        ):
            self._store(**{name: check.numbers(name, value, n, least=0.0)})
        name, stiffness = "shaft_stiffness_n_m_per_rad", self.shaft_stiffness_n_m_per_rad
        if stiffness is None:
            if any(self.backlash_rad):  # type: ignore[arg-type]
                check.refuse("backlash_rad", self.backlash_rad, f"0 without {name}: a tooth has a stiffness")
            return
        self._store(**{name: check.numbers(name, stiffness, n, above=0.0)})
        if 2 * n > NMAX:
            check.refuse(name, stiffness, f"None for more than {NMAX // 2} joints")
        if not all(rotor > 0.0 for rotor in self.rotor_inertia_kg_m2):  # type: ignore[union-attr]
            check.refuse("rotor_inertia_kg_m2", self.rotor_inertia_kg_m2, "> 0 where a shaft turns with it")

    def _pack(self) -> np.ndarray[Any, Any]:
        """Return a `LINKAGE` array with the fields declared here."""
        n = self.n
        record = np.zeros(1, LINKAGE)
        p = record[0]
        p["n"] = n
        p["origin"] = self.origin_m
        p["gravity"] = self.gravity_m_per_s2
        p["heavy"] = bool(np.any(p["gravity"]))
        p["armature"][:n] = self._fixed_kg_m2
        p["viscous"][:n] = self.viscous_n_m_s
        p["viscous_on"] = bool(np.any(p["viscous"]))
        p["coulomb"][:n] = self.coulomb_n_m
        p["coulomb_on"] = bool(np.any(p["coulomb"]))
        p["coulomb_speed"] = self.coulomb_speed_rad_per_s
        p["stop_low"], p["stop_high"] = -math.inf, math.inf
        if self.stops_rad is not None:
            p["stops_on"] = 1
            p["stop_low"][:n] = [low for low, _ in self.stops_rad]
            p["stop_high"][:n] = [high for _, high in self.stops_rad]
        p["stop_stiffness"] = self.stop_stiffness_n_m_per_rad
        p["stop_damping"] = self.stop_damping_n_m_s
        if self.stop_restitution is not None:
            p["rigid"], p["restitution"] = 1, self.stop_restitution
        if self.shaft_stiffness_n_m_per_rad is not None:
            p["shaft_on"] = 1
            p["rotor"][:n] = self.armature_kg_m2
            p["shaft_stiffness"][:n] = self.shaft_stiffness_n_m_per_rad
            p["shaft_damping"][:n] = self.shaft_damping_n_m_s
            p["half_gap"][:n] = 0.5 * np.asarray(self.backlash_rad)
            p["backlash_on"] = bool(np.any(p["half_gap"]))
        return record


def _kernels() -> Any:
    from mech import kernels

    return kernels


def _held(operator: Operator | None) -> np.ndarray[Any, Any]:
    return (operator or NoOperator()).pack()


def _stops(check: Checker, raw: object, n: int) -> tuple[tuple[float, float], ...]:
    try:
        pairs = tuple((float(low), float(high)) for low, high in raw)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        pairs = ()
    if len(pairs) != n or not all(low < high for low, high in pairs):
        check.refuse("stops_rad", raw, f"{n} pairs [low, high] with low < high")
    return pairs
