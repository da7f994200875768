"""Limits of a sampled wall in closed form: the rules that haptics designers know, for one mass at the tip.

All are about a mass m [kg] with viscosity b [N s/m] and Coulomb friction f_c [N] along the wall's normal, and
a computer that holds the force -K x - B v over its period T [s]. They know no circuit: an analog path enters
by the damping that it leaves the device with. The exact border of a whole scene is in
`cosim.analysis.stability`, the certified passivity of any law in `cosim.analysis.passivity`.

References
----------
.. [1] J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic
   interfaces", J. Robotic Systems 14(1), 37-47, 1997.
.. [2] T. Hulin, C. Preusche and G. Hirzinger, "Stability boundary for haptic rendering: influence of physical
   damping", IEEE/RSJ IROS 2006; J. J. Gil, E. Sanchez, T. Hulin, C. Preusche and G. Hirzinger, "Stability
   boundary for haptic rendering: influence of damping and delay", J. Computing and Information Science in
   Engineering 9(1), 2009.
.. [3] J. J. Abbott and A. M. Okamura, "Effects of position quantization and sampling rate on virtual-wall
   passivity", IEEE Trans. Robotics 21(5), 952-964, 2005.
.. [4] N. Diolaiti, G. Niemeyer, F. Barbagli and J. K. Salisbury, "Stability of haptic rendering:
   discretization, quantization, time delay, and Coulomb effects", IEEE Trans. Robotics 22(2), 256-268, 2006.
"""

from __future__ import annotations

import math

import scipy  # loads its parts when they are used

__all__ = [
    "abbott_okamura",
    "beta_stiffness",
    "cycle_amplitude",
    "gil_hulin",
    "stiffness_of_cycle",
]


def gil_hulin(viscosity: float, period: float, damping: float = 0.0, delay: float = 0.0) -> float:
    """Return the rule of thumb (b + B)/(T/2 + t_d) for the border [2]_ [N/m].

    It holds where b T/m and B T/m are far below one.

    Examples
    --------
    >>> gil_hulin(0.5, 1e-3), gil_hulin(0.5, 1e-3, delay=5e-4)
    (1000.0, 500.0)
    """
    return (viscosity + damping) / (0.5 * period + delay)


def abbott_okamura(viscosity: float, period: float, coulomb: float, resolution: float) -> float:
    """Return the largest passive stiffness min(2 b/T, 2 f_c/Delta) with a quantised position [3]_ [N/m].

    Parameters
    ----------
    coulomb, resolution
        Friction f_c [N] and step Delta of the position [m], both at the tip; without steps the second part is
        infinite, with steps and no friction it is zero.

    Examples
    --------
    >>> abbott_okamura(0.5, 1e-3, 0.0, 1e-5), abbott_okamura(0.5, 1e-3, 0.01, 1e-5)
    (0.0, 1000.0)
    """
    rough = 2.0 * coulomb / resolution if resolution > 0.0 else math.inf
    return min(2.0 * viscosity / period, rough)


def beta_stiffness(viscosity: float, period: float, delay: float = 0.0) -> float:
    """Return the stiffness [N/m] at which beta is at its border: b/(T/2 + t_d) [4]_.

    Examples
    --------
    >>> beta_stiffness(0.5, 1e-3)
    1000.0
    """
    return viscosity / (0.5 * period + delay)


def cycle_amplitude(
    stiffness: float, mass: float, viscosity: float, period: float, coulomb: float, delay: float = 0.0
) -> float:
    """Return the amplitude of the large cycle 4 f_c/(pi w (K (T/2 + t_d) - b)), w^2 = K/m [4]_ [m].

    In it Coulomb friction dissipates what sampling adds, averaged over a cycle. It is unstable: smaller
    motions die out, larger ones grow. Infinite where sampling adds nothing.
    """
    excess = stiffness * (0.5 * period + delay) - viscosity
    if excess <= 0.0:
        return math.inf
    return 4.0 * coulomb / (math.pi * math.sqrt(stiffness / mass) * excess)


def stiffness_of_cycle(
    amplitude: float, mass: float, viscosity: float, period: float, coulomb: float, delay: float = 0.0
) -> float:
    """Return the stiffness [N/m] at which the large cycle of [4]_ has an amplitude [m]; up to it motions die.

    The inverse of `cycle_amplitude`, which falls with stiffness.
    """
    low = viscosity / (0.5 * period + delay)
    if coulomb == 0.0:
        return low

    def over(x: float) -> float:
        k = low * (1.0 + math.exp(x))
        return math.log(cycle_amplitude(k, mass, viscosity, period, coulomb, delay) / amplitude)

    # without viscosity the excess is K itself: search over K above a floor
    if low == 0.0:
        return float(
            (4.0 * coulomb * math.sqrt(mass) / (math.pi * amplitude * (0.5 * period + delay))) ** (2.0 / 3.0)
        )
    return low * (1.0 + math.exp(float(scipy.optimize.brentq(over, -60.0, 60.0))))
