"""From a netlist to the `ideal` and `linear` circuit models: ngspice is asked, the answers are fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from cosim.circuits.fit import FitError, Modes, fit
from cosim.circuits.ideal import DC_SWEEP, ideal
from cosim.circuits.linear import LinearCircuit
from cosim.circuits.measure import Paths, Session
from cosim.errors import InputError, Problem
from cosim.ngspice.deck import Deck

__all__ = ["extract", "linear"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Report = Callable[[dict[str, Any]], None]

#: A decade more than 0.1 Hz to 100 MHz at each end, for the poles just outside.
SWEEP = "dec 20 1m 1g"
#: A path below this share of the strongest one to the same output is rounding.
_ROUNDING = 1e-13


def extract(payload: dict[str, Any], report: Report) -> LinearCircuit:
    """Extract a circuit model; runs in ngspice's child process.

    Parameters
    ----------
    payload
        'board': Deck; 'model': 'ideal' or 'linear'; 'band_hz': band in which the reduced model must be good
        [Hz]; 'tolerance': its largest error there, relative to the maximum of each path (0: unreduced)
    report
        called with the stage that was reached

    Raises
    ------
    InputError
        For a board that has no such model: unstable, no limit as frequency goes to zero, nonlinear gains.
    """
    board: Deck = payload["board"]
    report({"stage": "load"})
    session = Session(board)
    report({"stage": "measure"})
    if payload["model"] == "ideal":
        return ideal(session.measure(DC_SWEEP), str(board.path))
    return linear(session.measure(SWEEP), str(board.path))


def linear(paths: Paths, file: str) -> LinearCircuit:
    """Return the unreduced state space of measured paths.

    Raises
    ------
    InputError
        For an unstable board, or one whose responses no rational function fits.
    """
    m, n = len(paths.gain), paths.post.shape[1]
    pre = fit_block(paths.s, paths.x, "before the multipliers", file)
    post = fit_block(paths.s, paths.post, "after the multipliers", file)
    return LinearCircuit(
        joints=n,
        model="linear",
        a_pre=pre.a,
        b_pre=pre.b,
        c_pre=pre.c,
        d_pre=pre.d,
        e_pre=np.zeros((m, n)),
        gain=paths.gain,
        a_post=post.a,
        b_post=post.b,
        c_post=post.c,
        d_post=post.d,
        offset=np.zeros(n),
        limit=np.tile([-np.inf, np.inf], (n, 1)),
        certificate={
            "model": "linear",
            "order": len(pre.a) + len(post.a),
            "fit_error": float(max(pre.error.max(), post.error.max())),
        },
    )


def fit_block(s: Complex, h: Complex, where: str, file: str) -> Modes:
    """Fit the paths [F, outputs, inputs] of a block, each group that shares no signal with the others apart.

    Raises
    ------
    InputError
        For a pole in the right half plane, or responses that no rational function fits.
    """
    peak = np.abs(h).max(axis=0)
    linked = peak > _ROUNDING * peak.max(axis=1, keepdims=True)
    d, error = np.zeros(peak.shape), np.zeros(peak.shape)
    parts: list[Modes] = []
    for rows, columns in groups(linked):
        place = np.ix_(rows, columns)
        try:
            part = fit(s, np.where(linked[place], h[:, rows][:, :, columns], 0.0))
        except FitError as reason:
            raise InputError(_problem(reason, where, file)) from reason
        d[place], error[place] = part.d, part.error
        b, c = np.zeros((len(part.a), peak.shape[1])), np.zeros((peak.shape[0], len(part.a)))
        b[:, columns], c[rows] = part.b, part.c
        parts.append(replace(part, b=b, c=c))
    return Modes(
        scipy.linalg.block_diag(np.zeros((0, 0)), *[part.a for part in parts]),
        np.concatenate([np.zeros((0, peak.shape[1])), *[part.b for part in parts]]),
        np.concatenate([np.zeros((peak.shape[0], 0)), *[part.c for part in parts]], axis=1),
        d,
        np.concatenate([np.empty(0, complex), *[part.poles for part in parts]]),
        tuple(size for part in parts for size in part.blocks),
        error,
    )


def groups(linked: NDArray[np.bool_]) -> list[tuple[list[int], list[int]]]:
    """Split a table of which input reaches which output into parts that share neither."""
    found: list[tuple[list[int], list[int]]] = []
    left = set(np.flatnonzero(linked.any(axis=1)).tolist())
    while left:
        rows, columns = {min(left)}, set[int]()
        size = 0
        while size != len(rows) + len(columns):
            size = len(rows) + len(columns)
            columns |= set(np.flatnonzero(linked[sorted(rows)].any(axis=0)).tolist())
            rows |= set(np.flatnonzero(linked[:, sorted(columns)].any(axis=1)).tolist())
        left -= rows
        found.append((sorted(rows), sorted(columns)))
    return found


def _problem(reason: FitError, where: str, file: str) -> Problem:
    if reason.poles is None:
        return Problem(f"no `linear` model of the paths {where}: {reason}; use `spice`", file=file)
    worst = reason.poles[np.argmax(reason.poles.real)]
    shown = f"{worst.real:.4g} {worst.imag:+.4g}j" if worst.imag else f"{worst.real:.4g}"
    hz = abs(worst) / (2.0 * np.pi)
    return Problem(
        f"the board is unstable: {where} there is a pole at {shown} rad/s ({hz:.4g} Hz), it grows by e every "
        f"{1.0 / worst.real:.3g} s" if worst.real > 0.0 else f"a pole lies on the imaginary axis, at {hz:.4g} Hz",
        file=file,
    )  # fmt: skip
