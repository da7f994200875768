"""Exact sampled stability: eigenvalues of the map of one period, and the borders where they leave the circle.

Nothing is simulated. A border is a root of the spectral radius less one over a stiffness (or any other
number of the scene), found between the points of a geometric scan.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.analysis.floquet import exponents
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.linearise import linearise
from cosim.analysis.period_map import Lifted, lift
from cosim.errors import fail
from cosim.types import Array

__all__ = [
    "Border",
    "Mode",
    "Stability",
    "border",
    "held",
    "monodromy",
    "stability",
]


#: Points of the scan a decade; a window of stability narrower than a step (15 %) may be missed.
SCAN = 16
#: An eigenvalue this close to 1 is a free direction, such as along a frictionless wall; a double one, without
#: damping, comes out split by the square root of rounding.
FREE = 1e-7


@dataclass(frozen=True)
class Mode:
    """One eigenvalue z of the map of a period.

    Attributes
    ----------
    z
        Growth a period is its modulus.
    frequency_hz, damping
        Of the exponent s, z = exp(s T), that tells the motion between the samples
        (`cosim.analysis.floquet`): |Im s|/(2 pi) and -Re s/|s|.
    share
        Of the motion that goes by exp(s t): below one half another frequency describes it as well; NaN where
        the circuit swings too fast for the period to tell.
    shape
        Part of each joint angle [rad], largest one 1.
    """

    z: complex
    frequency_hz: float
    damping: float
    share: float
    shape: NDArray[np.complex128]

    @property
    def growth(self) -> float:
        """Factor by which the mode grows in a period."""
        return abs(self.z)

    @property
    def ambiguous(self) -> bool:
        """Whether sampling leaves open which frequency and damping the mode has."""
        return not self.share >= 0.5


@dataclass(frozen=True)
class Stability:
    """Eigenvalues of the map of one period, the largest modulus first.

    Attributes
    ----------
    modes
        Those that matter: of modulus above 1e-6.
    free
        How many of them are 1: directions that nothing holds, such as along a frictionless wall.
    stable
        Whether all others decay.
    notes
        What the linear system leaves out.
    """

    modes: tuple[Mode, ...]
    free: int
    stable: bool
    notes: tuple[str, ...]

    @property
    def critical(self) -> Mode | None:
        """The mode nearest to growing, free directions apart."""
        return next((mode for mode in self.modes if abs(mode.z - 1.0) > FREE), None)


@dataclass(frozen=True)
class Border:
    """Where a scene stops being stable.

    Attributes
    ----------
    value
        Lowest value above the stable range; infinite when no end was found, 0 when nothing is stable.
    from_value
        Where the stable range begins within the scan.
    stability
        At the border; None without one.
    """

    value: float
    from_value: float
    stability: Stability | None


def held(contact: HeldContact) -> Lifted:
    """Return the map of a period of a contact that is held at a wall just touched."""
    return lift(linearise(contact, preload=False))


def stability(lifted: Lifted) -> Stability:
    """Return the modes of a lifted scene."""
    z, vectors = np.linalg.eig(monodromy(lifted))
    order = np.argsort(-np.abs(z), kind="stable")
    order = order[(np.abs(z[order]) >= 1e-6) & (z[order].imag >= 0.0)]
    exponent, share = exponents(lifted, z[order], vectors[:, order])
    modes = []
    for at, k in enumerate(order):
        s = exponent[at]
        shape = vectors[: lifted.system.joints, k]
        top = shape[int(np.argmax(np.abs(shape)))]
        modes.append(
            Mode(
                complex(z[k]),
                abs(s.imag) / (2.0 * math.pi),
                -s.real / abs(s) if s != 0 else 0.0,
                float(share[at]),
                shape / top if top != 0 else shape,
            )
        )
    held = [mode for mode in modes if abs(mode.z - 1.0) > FREE]
    stable = all(mode.growth < 1.0 for mode in held)
    return Stability(tuple(modes), len(modes) - len(held), stable, lifted.system.notes)


def monodromy(lifted: Lifted) -> Array:
    """Return the map of one period.

    Raises
    ------
    InputError
        Where it overflows: something grows by more than 1e300 within a period.
    """
    product = lifted.period()
    if not np.isfinite(product).all():
        fail(
            "the loop cannot be studied over a period: between two samples it grows beyond all numbers: "
            "shorten the period, or look for an unstable circuit (cosim check)",
            key="computer.period_s",
            value=lifted.system.period_s,
            unit="s",
        )
    return product


def border(at: Callable[[float], Lifted], low: float, high: float, *, rtol: float = 1e-12) -> Border:
    """Return the end of the first stable range between two positive values.

    Parameters
    ----------
    at
        The lifted scene for a value, for example of the discrete stiffness.
    low, high
        Range that is scanned geometrically.

    Notes
    -----
    Free directions keep eigenvalues at 1 whatever the value is; as many of the largest are left out as do so
    at `low` and a little above.
    """
    if not 0.0 < low < high:
        raise ValueError("a range needs 0 < low < high")

    free = min(stability(at(value)).free for value in (low, 1.5 * low))

    def over(value: float) -> float:
        z = np.linalg.eigvals(monodromy(at(value)))
        z = z[np.argsort(np.abs(z - 1.0), kind="stable")][free:]
        return float(np.abs(z).max(initial=0.0)) - 1.0

    count = max(2, math.ceil(SCAN * math.log10(high / low)) + 1)
    values = np.geomspace(low, high, count)
    begin: float | None = None
    last = float(values[0])
    for value in values:
        now = over(float(value))
        if begin is None and now < 0.0:
            begin = last if value != values[0] else float(value)
            if value != values[0]:
                begin = float(scipy.optimize.brentq(over, last, float(value), rtol=rtol, xtol=1e-300))
        elif begin is not None and now >= 0.0:
            edge = float(scipy.optimize.brentq(over, last, float(value), rtol=rtol, xtol=1e-300))
            return Border(edge, begin, stability(at(edge)))
        last = float(value)
    return Border(math.inf, begin, None) if begin is not None else Border(0.0, math.nan, None)
