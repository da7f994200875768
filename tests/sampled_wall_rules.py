"""Rules of a sampled wall that the program itself has no use for, to hold its exact results against.

Sources are those of `cosim.analysis.closed_form_limits`.
"""

import math
from dataclasses import dataclass


def held_mass(mass: float, viscosity: float, period: float) -> float:
    """Return the exact border of -K x, held over T, on a mass with viscosity [N/m].

    With tau = m/b and E = exp(-T/tau) it is b (1 - E)/(tau (1 - E) - T E): a root of the map of one period on
    the unit circle.

    Examples
    --------
    A mass of 0.1 kg with 1 N s/m at 1 ms: near 2 b/T, for b T/m is small.

    >>> round(held_mass(0.1, 1.0, 1e-3) / (2 * 1.0 / 1e-3), 2)
    1.0
    """
    tau = mass / viscosity
    gone = -math.expm1(-period / tau)
    return viscosity * gone / (tau * gone - period * (1.0 - gone))


def colgate_schenkel(viscosity: float, period: float, damping: float = 0.0) -> float:
    """Return the largest passive stiffness 2 (b - |B|)/T of K x + B v, v by backward difference [1]_ [N/m].

    Zero where the virtual damping alone is too much.

    Examples
    --------
    >>> colgate_schenkel(0.5, 1e-3), colgate_schenkel(0.5, 1e-3, 0.2)
    (1000.0, 600.0)
    """
    return max(2.0 * (viscosity - abs(damping)) / period, 0.0)


@dataclass(frozen=True)
class Diolaiti:
    """A wall in the dimensionless plane of [4]_, with the borders at 1/2.

    Attributes
    ----------
    beta : b/(K T)
    sigma : f_c/(K Delta); infinite without steps of the position
    beta_border : 1/2 + t_d/T: below, energy leaks in with each period, and large motions grow
    sigma_border : 1/2: below, friction does not hold what one step of the position makes
    """

    beta: float
    sigma: float
    beta_border: float
    sigma_border: float = 0.5

    @property
    def region(self) -> str:
        """What the wall does, in words."""
        if self.beta > self.beta_border:
            return "rests" if self.sigma > self.sigma_border else "small cycle of the position's steps"
        if self.sigma > self.sigma_border:
            return "rests from small motions, large ones grow"
        return "never rests"


def diolaiti(
    stiffness: float, viscosity: float, period: float, coulomb: float, resolution: float, delay: float = 0.0
) -> Diolaiti:
    """Return a wall's place in the plane of [4]_; units as in `abbott_okamura`.

    Examples
    --------
    >>> diolaiti(500.0, 0.5, 1e-3, 0.01, 1e-5).region
    'rests'
    """
    sigma = coulomb / (stiffness * resolution) if resolution > 0.0 else math.inf
    return Diolaiti(viscosity / (stiffness * period), sigma, 0.5 + delay / period)


def switching_energy(stiffness: float, speed: float, period: float) -> float:
    """Return the most that switching on a spring at a sample, up to a period late, injects: K (v T)^2/2 [J].

    Switching off late takes as much away, averaged over the phase of the samples.

    Examples
    --------
    >>> switching_energy(1000.0, 0.1, 1e-3)
    5e-06
    """
    return 0.5 * stiffness * (speed * period) ** 2
