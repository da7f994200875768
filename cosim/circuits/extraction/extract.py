"""A board's `ideal` or `linear` circuit model: from the cache, or measured.

What measures and fits is loaded where the cache has no answer: most runs find one.
"""

from __future__ import annotations

from typing import Any

from cosim.circuits import cache
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.ngspice.deck import Deck
from cosim.types import Report

__all__ = ["extract"]


def extract(payload: dict[str, Any], report: Report) -> LinearCircuit:
    """Extract a circuit model, or take it from the cache; runs in ngspice's child process.

    Parameters
    ----------
    payload
        'board': Deck; 'model': 'ideal' or 'linear'; 'band_hz': band in which the reduced model must be good
        [Hz]; 'tolerance': its largest error there, relative to the maximum of each path (0: unreduced);
        'cache': whether to use it (yes)
    report
        called with the stage that was reached, and with a note where a cached file was of no use

    Raises
    ------
    InputError
        For a board that has no such model: unstable, no limit as frequency goes to zero, nonlinear gains.
    """
    board: Deck = payload["board"]
    asked = cache.Asked(
        board.text,
        payload["model"],
        float(payload.get("band_hz", 0.0)),
        float(payload.get("tolerance", 0.0)),
    )
    kept = payload.get("cache", True)
    if kept:
        known, note = cache.load(asked)
        if note:
            report({"note": note})
        if known is not None:
            return known
    from cosim.circuits.extraction.measured_model import extracted
    from cosim.circuits.extraction.path_measurement import Session

    report({"stage": "load"})
    circuit = extracted(Session(board, beat=lambda: report({})), asked)
    if kept:
        cache.store(asked, circuit)
    return circuit
