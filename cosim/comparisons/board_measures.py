"""Measures that need no run: of the contact held at the wall, and of the board alone.

How stiff the wall may be, how much damping the circuit's delay takes, how uneven the rendered gains are: the
studies' numbers at the pose of a scene, one at a time, under the names of `cosim.catalogue`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any

import numpy as np

from cosim.analysis.control_law import law_point
from cosim.analysis.extracted import circuit_of
from cosim.analysis.stability import border, held
from cosim.analysis.stiffness_limits import RANGE, largest_passive, varied
from cosim.analysis.stiffness_map import pencil
from cosim.analysis.tip import Tip, joint_area
from cosim.catalogue import ETA_OF, MEASURES, Need, find, needing_no_run
from cosim.checking.board_margins import Standing, standing
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.block_delays import SpringDelay, slowest, spring_delays
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError
from cosim.ngspice.child import Child
from cosim.plan import Plan
from cosim.scene import Method
from cosim.scene.mechanism import mechanism
from cosim.types import Array, Complex
from mech import Chain

__all__ = ["BoardMeasures", "Lacking", "board_measures", "contact_measures"]

Row = dict[str, Any]

#: A gain that the circuit's model gives is good to this share of the largest.
_ROUNDING = 1e-12
#: Radius of the circle of `circle_energy` [m].
_CIRCLE_M = 0.01
#: Where the damper is looked at [Hz]: far below the corner of any differentiator.
_SLOW_HZ = 1.0


class Lacking(Exception):
    """A scene or a board has no such measure; the message says why."""


class BoardMeasures:
    """Measures of one plan; circuit, pose and loops are computed once, on first use.

    A plan for `spice` is studied with the `linear` model of the same parts. `circuit` is that model,
    unreduced, where it is known.
    """

    def __init__(self, plan: Plan, child: Child | None = None, circuit: LinearCircuit | None = None) -> None:
        self._plan, self._scene, self._child, self._known = plan, plan.scene, child, circuit

    def row(self, name: str) -> Row:
        """Return a measure as a run's own ones are kept: {value, unit, text}.

        Raises
        ------
        Lacking
            Where the scene or the board has none: two joints for a curl, loops for a margin.
        InputError
            Where what it is taken from does not exist: no wall, a law in Python, a board without a model.
        """
        measure = find(name)
        assert measure is not None
        value = _HOW[name](self) if name in _HOW else self.eta_of(name.removeprefix(ETA_OF))
        return {"value": float(value), "unit": measure.unit, "text": measure.text}

    @cached_property
    def _circuit(self) -> tuple[LinearCircuit, DesignConstants]:
        if self._known is not None:
            return self._known, self._plan.stated(self._child)
        return circuit_of(self._plan, child=self._child)

    @cached_property
    def _tip(self) -> Tip:
        circuit, constants = self._circuit
        return Tip.at_wall(self._scene, constants, circuit)

    @cached_property
    def _standing(self) -> Standing:
        return standing(self._plan.board, self._scene.solver.time_limit_s, self._child)

    @cached_property
    def _ksp(self) -> Array:
        """Stiffness that the board renders at the joints for the gains that the law writes [N m/rad]."""
        return self._rendered(self._gains, 0.0).real

    @cached_property
    def _gains(self) -> Array:
        """Volts that the law writes at the gain pins: of the springs, then of the dampers."""
        tip, n = self._tip, self._scene.joints
        law = law_point(self._scene, tip.constants, tip.linkage, tip.q)
        return law.volts[n : n + len(tip.circuit.gain)]

    def _rendered(self, gains: Array, hz: float) -> Complex:
        """Return torques against angles that the board renders at a frequency [n, n] N m/rad."""
        tip, n = self._tip, self._scene.joints
        current = tip.circuit.response(2j * np.pi * hz, gains)[0][:, :n]
        rendered: Complex = -tip.constants.torques_per_amp(n)[:, None] * current
        return rendered

    def _commanded(self, key: str) -> float:
        value: float = getattr(self._scene.computer, key)
        analog = key.startswith("analog")
        if not value > 0.0 or (analog and self._scene.computer.method is Method.DISCRETE):
            raise Lacking(f"the scene commands no {key}")
        return value

    def _arm(self) -> Chain:
        chain = mechanism(self._scene, 1.0)
        if not isinstance(chain, Chain) or chain.n != 2:
            raise Lacking("it is of an arm of two joints")
        return chain

    def k_max(self) -> float:
        """Largest stable stiffness: the discrete one, or the analog one where there is no other [N/m]."""
        tip, key = self._tip, varied(self._scene)
        if key == "discrete_stiffness_n_per_m":
            most = pencil(tip).first(*RANGE)
        else:
            most = border(lambda k: held(tip.with_computer(**{key: k})), *RANGE, rtol=1e-9).value
        if not math.isfinite(most):
            raise Lacking(f"stable up to {RANGE[1]:g} N/m")
        return most

    def k_margin(self) -> float:
        """How many times as much as commanded is stable."""
        return self.k_max() / self._commanded(varied(self._scene))

    def stiffness_share(self) -> float:
        """At rest, the tip led along the normal and nowhere else."""
        along = self._tip.motion
        return float(along @ self._ksp @ along) / self._commanded("analog_stiffness_n_per_m")

    def damping_share(self) -> float:
        """Of the dampers' gains alone: what the spring's delay takes from them is `eta`."""
        gains, along = self._gains.copy(), self._tip.motion
        gains[: self._scene.joints**2] = 0.0
        rendered = complex(along @ self._rendered(gains, _SLOW_HZ) @ along)
        return rendered.imag / (2.0 * np.pi * _SLOW_HZ) / self._commanded("analog_damping_n_s_per_m")

    def leakage(self) -> float:
        """Its sign kept: positive where the tip is pushed to the left of the normal."""
        self._commanded("analog_stiffness_n_per_m")
        inverse = np.linalg.inv(self._arm().jacobian(self._tip.q))
        normal = self._tip.normal
        force = inverse.T @ self._ksp @ inverse @ normal
        along_wall = normal[0] * force[1] - normal[1] * force[0]
        return _beyond_rounding(along_wall, force) / float(normal @ force)

    def force_noise(self) -> float:
        """Exact second moments about the pose of rest [N]."""
        from cosim.analysis.noise_covariance import noise_covariance  # which no other measure needs

        tip = self._tip
        try:
            return noise_covariance(tip).rms("motor_normal")
        except InputError as error:  # of a batch one device that is unstable lacks this measure alone
            raise Lacking(error.in_brief) from error

    def passive_stiffness(self) -> float:
        """Largest passive stiffness of the same part; 0 where nothing is passive [N/m]."""
        most = largest_passive(self._tip)
        if not math.isfinite(most):
            raise Lacking("passive at every stiffness")
        return most

    def eta(self) -> float:
        """Share of the viscosity along the normal that the slowest spring path eats."""
        return self._eaten(self._slowest.total_s)

    def eta_of(self, group: str) -> float:
        """Share of the same viscosity that blocks of that path eat, ``a_and_b``; they add up to `eta`."""
        late = self._slowest.of_group(group)
        if late is None:
            known = ", ".join(self.shares_of_eta())
            raise Lacking(f"delays of the slowest spring path are known by {known}")
        return self._eaten(late)

    def shares_of_eta(self) -> tuple[str, ...]:
        """Return the names of the measures that add up to `eta`, in the order of the signal."""
        return tuple(f"{ETA_OF}{group}" for group in self._slowest.groups)

    @cached_property
    def _slowest(self) -> SpringDelay:
        limit = self._scene.solver.time_limit_s
        return slowest(spring_delays(self._plan.board, self._child, time_limit_s=limit))

    def _eaten(self, late_s: float) -> float:
        c = self._scene.computer
        k = 0.0 if c.method is Method.DISCRETE else c.analog_stiffness_n_per_m
        viscosity = self._tip.viscosity()
        if viscosity == 0.0:
            raise Lacking("the device has no viscosity along the normal")
        return k * late_s / viscosity

    def curl(self) -> float:
        """dF_y/dx - dF_x/dy of the rendered force F = -K dr, its sign kept [N/m]."""
        inverse = np.linalg.inv(self._arm().jacobian(self._tip.q))
        at_tip = inverse.T @ self._ksp @ inverse
        return _beyond_rounding(at_tip[0, 1] - at_tip[1, 0], at_tip)

    def least_stiffness(self) -> float:
        """Least eigenvalue of sym(Ksp) [N m/rad]."""
        return _beyond_rounding(np.linalg.eigvalsh(0.5 * (self._ksp + self._ksp.T))[0], self._ksp)

    def circle_energy(self) -> float:
        """Energy fed in the direction that is fed [J]; only the antisymmetric part of Ksp does work."""
        try:
            area = joint_area(self._arm(), self._tip.q, _CIRCLE_M)
        except ValueError as error:
            raise Lacking("the circle leaves the workspace") from error
        return abs(_beyond_rounding(self._ksp[0, 1] - self._ksp[1, 0], self._ksp)) * area

    def rest_force(self) -> float:
        """Largest over the motors [N]."""
        return max(abs(rest.force_n) for rest in self._standing.rest)

    def phase_margin(self) -> float:
        """Least over all crossings of all loops [deg]."""
        return self._least(loop.phase_margin_deg for loop in self._standing.loops)

    def gain_margin(self) -> float:
        """Return the margin nearest to 0 dB of all loops [dB]; negative where less gain is needed."""
        return self._least(loop.gain_margin_db for loop in self._standing.loops)

    @staticmethod
    def _least(margins: Iterable[float | None]) -> float:
        known = [margin for margin in margins if margin is not None]
        if not known:
            raise Lacking("no loop has one: parts without bandwidth")
        return min(known)


def _beyond_rounding(value: float, of: Array) -> float:
    """Return 0 for a difference of the matrix that is within its rounding."""
    return float(value) if abs(value) > _ROUNDING * np.abs(of).max() else 0.0


_HOW: dict[str, Callable[[BoardMeasures], float]] = {
    name: getattr(BoardMeasures, name) for name in needing_no_run(MEASURES)
}


def board_measures(
    plan: Plan, names: Iterable[str], *, child: Child | None = None, lenient: bool = False
) -> tuple[dict[str, Row], dict[str, str]]:
    """Return measures of a plan by name, and why others of them are lacking; nothing is simulated.

    Parameters
    ----------
    plan, names
        Names that need a run are passed over.
    lenient
        Whether the basis of a measure may be missing (no wall, a law in Python, a board without a
        model); the measure is then listed as lacking.

    Raises
    ------
    InputError
        Where something is missing without `lenient`, see `BoardMeasures.row`.
    """
    return _rows(BoardMeasures(plan, child), needing_no_run(names), lenient)


def contact_measures(plan: Plan, child: Child | None = None) -> tuple[dict[str, Row], dict[str, str]]:
    """Return every measure of the held contact, `eta` by blocks too, and why others are lacking."""
    of = BoardMeasures(plan, child)
    names = tuple(name for name, each in MEASURES.items() if each.needs is Need.CONTACT)
    rows, lacking = _rows(of, names, lenient=True)
    if rows.get("eta", {}).get("value"):
        rows |= {name: of.row(name) for name in of.shares_of_eta()}
    return rows, lacking


def _rows(of: BoardMeasures, names: Iterable[str], lenient: bool) -> tuple[dict[str, Row], dict[str, str]]:
    rows: dict[str, Row] = {}
    lacking: dict[str, str] = {}
    for name in names:
        try:
            rows[name] = of.row(name)
        except Lacking as why:
            lacking[name] = str(why)
        except InputError as error:
            if not lenient:
                raise
            lacking[name] = error.in_brief
    return rows, lacking
