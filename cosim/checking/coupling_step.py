"""The step that a scene's linkage leaves to the coupling with its motors' back-EMF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.circuits.design_constants import DesignConstants
from cosim.scene import Scene


@dataclass(frozen=True)
class Coupling:
    """Explicit coupling at the scene's first pose.

    Attributes
    ----------
    rate_per_s : fastest rate of back-EMF braking on the linkage's and the operator's mass
    step_s : 0.5 m_eff/b_eff, the longest step that is stable
    max_step_s : the scene's longest step
    """

    rate_per_s: float
    step_s: float
    max_step_s: float


def step_bound(
    scene: Scene, admittance_a_s: Sequence[Sequence[float]], constants: DesignConstants
) -> Coupling | None:
    """Bound the coupling's step as the lockstep does; ``None`` without a back-EMF."""
    from cosim.scene.mechanism import mechanism, operator, start

    linkage = mechanism(scene, constants.gear)
    q, _ = start(scene, linkage)
    viscosity = np.asarray(admittance_a_s) * constants.kt * constants.gear**2
    mass = linkage.mass_matrix(q, operator(scene))
    if scene.effects.shaft:  # then the rotors alone are braked
        mass = np.diag(linkage.armature_kg_m2)
    rates = np.abs(np.linalg.eigvals(np.linalg.solve(mass, viscosity)))
    fastest = float(rates.max())
    if not fastest > 0.0:
        return None
    return Coupling(fastest, 0.5 / fastest, scene.solver.max_step_s)
