"""Models of many draws, and how far two models are from each other."""

import numpy as np

from cosim.circuits.draws.models import Draws
from cosim.circuits.fitting.refit import GOOD

#: Within one of the other: both models promise 1e-9 of the path's maximum (unreduced).
UNREDUCED = 2.0 * GOOD


def apart(first, second, highest_hz, volts=None):
    """Largest difference of any path, relative to its maximum up to the highest frequency."""
    s = 2j * np.pi * np.geomspace(1e-2, highest_hz, 400)
    held = np.full(len(first.gain), 10.0) if volts is None else volts
    a, b = first.response(s, held), second.response(s, held)
    peak = np.abs(a).max(axis=0)
    return float((np.abs(a - b).max(axis=0) / np.where(peak > 1e-12, peak, 1.0)).max())


def drawn(payload, report):
    """In ngspice's process: the model of every set, in this order."""
    draws = Draws(payload["board"], payload["keys"], payload["nominal"], payload["model"])
    return draws.why_slow, [draws.at(values, *payload.get("reduced", ())) for values in payload["sets"]]
