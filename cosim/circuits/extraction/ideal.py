"""The `ideal` circuit model: gains as frequency goes to zero, the paper's footnote 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.extraction.path_measurement import LOW_HZ, Paths
from cosim.circuits.linear_circuit import LinearCircuit, channel_names
from cosim.errors import InputError, Problem
from cosim.types import Array
from cosim.units import quantity

__all__ = ["DC_SWEEP", "dc_gains", "ideal"]


#: Two frequencies, the second ten times the first.
DC_SWEEP = f"dec 1 {LOW_HZ[0]} {LOW_HZ[1]}"
#: Largest difference between the two that counts as agreement, relative to the path.
_AGREE = 1e-3
#: DC gain that is negligible beside a damper's at this rate of change [1/s]: bias paths of real op-amps.
_SLOWEST = 1e-2


def dc_gains(low: NDArray[np.complex128]) -> Array:
    """Return H(0) from H at the two frequencies of `DC_SWEEP`; its error is of fourth order in frequency."""
    first, second = low[0].real, low[1].real
    out: Array = first + (first - second) / 99.0
    return out


def slopes(low: NDArray[np.complex128], hz: Array) -> tuple[Array, Array]:
    """Return H(jw)/(jw) as w goes to zero [s], without H(0), and how far the two frequencies differ."""
    each = low.imag / (2.0 * np.pi * hz).reshape(-1, *(1,) * (low.ndim - 1))
    return each[0] + (each[0] - each[1]) / 99.0, np.abs(each[1] - each[0])


def ideal(paths: Paths, file: str) -> LinearCircuit:
    """Return the board's gains as w -> 0, from paths measured over `DC_SWEEP`.

    Raises
    ------
    InputError
        Where a damper's path is not proportional to frequency, or a gain has no limit.
    """
    m = len(paths.gain)
    n = paths.post.shape[1]
    channels = channel_names(n)
    static, after = dc_gains(paths.x), dc_gains(paths.post)
    slope, apart = slopes(paths.x, paths.hz)
    problems = []
    changed = np.abs(paths.x[1].real - paths.x[0].real).max(axis=1)
    rate = np.zeros((m, n))
    for c, pin in enumerate(channels):
        if pin.startswith("ksp"):
            if changed[c] > _AGREE * np.abs(static[c]).max():
                problems.append(
                    _refused(pin, "the spring's gain has no limit as frequency goes to zero", file)
                )
            continue
        rate[c] = slope[c, :n]
        size = np.abs(rate[c]).max()
        if apart[c, :n].max() > _AGREE * size:
            problems.append(_refused(pin, "H(jw)/(jw) has no limit as frequency goes to zero", file))
        elif np.abs(static[c]).max() > _SLOWEST * size:
            problems.append(
                _refused(
                    pin, f"the damper has a DC gain of {np.abs(static[c]).max():.3g} besides its slope of "
                    f"{quantity(size, 's')}: it is no damper as frequency goes to zero", file
                )
            )  # fmt: skip
        static[c] = 0.0
    if problems:
        raise InputError(problems)
    none = np.zeros((0, 0))
    return LinearCircuit(
        joints=n,
        model="ideal",
        a_pre=none,
        b_pre=np.zeros((0, 2 * n)),
        c_pre=np.zeros((m, 0)),
        d_pre=static,
        e_pre=rate,
        gain=paths.gain,
        a_post=none,
        b_post=np.zeros((0, m + 2 * n)),
        c_post=np.zeros((n, 0)),
        d_post=after,
        offset=np.zeros(n),
        limit=np.tile([-np.inf, np.inf], (n, 1)),
        certificate={"model": "ideal", "order": 0},
    )


def _refused(pin: str, reason: str, file: str) -> Problem:
    return Problem(f"no `ideal` model: {reason}; use `linear`", file=file, key=pin)
