"""Noise of each element by `.noise`, also where ngspice has no number for some of them.

ngspice makes a noise of sqrt(4 k T / R) for a resistor, which is no number where R is negative (vendors fit
output stages with such); its sums are then NaN, too. Such an element is identified and made noiseless, so
that all others are measured.
"""

from __future__ import annotations

import contextlib

import numpy as np

from cosim.errors import CosimError, SimulationError
from cosim.ngspice.simulator import Simulator
from cosim.types import Array

__all__ = ["by_element", "left_out", "silence"]


def by_element(simulator: Simulator, prefix: str) -> tuple[dict[str, Array], list[str]]:
    """Return what the current plot holds of each element's noise, and the elements of which it is no number.

    Parameters
    ----------
    simulator
        ngspice behind a `noise` command.
    prefix
        Of the vectors' names: ``onoise_`` for densities, ``onoise_total_`` for integrals.
    """
    named = {name.removeprefix(prefix) for name in simulator.vector_names() if name.startswith(prefix)} - {
        "spectrum"
    }
    # an element's parts (r1_thermal, q1_ic) are listed beside their sum (r1)
    complete = sorted(n for n in named if not any(n[:k] in named for k, c in enumerate(n) if c == "_"))
    densities: dict[str, Array] = {}
    none: list[str] = []
    for name in complete:
        try:
            densities[name] = np.asarray(simulator.vector(prefix + name), np.float64)
        except SimulationError:  # it holds something that is not a number
            none.append(name)
    return densities, none


def silence(simulator: Simulator, elements: list[str]) -> None:
    """Let resistors make no noise, until the deck is read again; others are left as they are."""
    for name in elements:
        if name.startswith("r"):
            with contextlib.suppress(CosimError):  # then its sums stay without a number, and are not used
                simulator.command(f"alter @{name}[noisy] = 0")


def left_out(elements: list[str]) -> str:
    """Say which elements are left out of the noise."""
    shown = [name.partition(".")[2].removeprefix("xboard.") for name in sorted(elements)]
    more = f" and {len(shown) - 4} more" if len(shown) > 4 else ""
    return (
        f"the noise of {', '.join(shown[:4])}{more} is left out: ngspice has no number for it "
        "(a negative resistor has none)"
    )
