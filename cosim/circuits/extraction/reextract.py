"""The `linear` model of a board again after a change of values: known orders, few frequencies, one process.

The first extraction gives the poles of each path. After a change of values ngspice measures all paths at
few frequencies over the whole range of these poles, so that a loop that became unstable outside the scene's
band shows as well; every row of paths is fitted with as many poles as before, and checked at frequencies that
it was not fitted to. A board that fails the check is extracted again, and its certificate says why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.circuits.cache import Asked
from cosim.circuits.extraction.alter import Handle, Way, altered, handle, nominal_value
from cosim.circuits.extraction.limits_and_offsets import current_limits
from cosim.circuits.extraction.measured_model import SWEEP, extracted, linear, with_offsets
from cosim.circuits.extraction.path_measurement import Paths, Session
from cosim.circuits.fitting.rational_fit import FitError
from cosim.circuits.fitting.refit import GRID, Batch, Fitted, Unfit, batches, fitted, points
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import InputError, Problem, SimulationError
from cosim.ngspice.deck import Deck
from cosim.units import quantity

__all__ = ["Reextraction", "circuits"]

#: Parameters that the measurement itself depends on.
_OURS = ("v_fs", "dac_v")
#: Entries of the certificate that are taken over from the nominal board.
_NOMINAL = (
    "control_nonlinearity",
    "control_nonlinearity_worst",
    "control_delay_s",
    "control_error",
    "current_limited",
    "large_signal_error",
    "large_signal_worst",
    "probes",
)


class Reextraction:
    """A board that is extracted again and again with other values.

    To be used in ngspice's child process; it holds the one circuit that ngspice can have there.

    Parameters
    ----------
    board
        The flat deck.
    band_hz, tolerance
        Band and largest error of the reduced model, as `extract` takes them; 0: unreduced.

    Attributes
    ----------
    circuit
        The model of the board as it is.

    Raises
    ------
    InputError
        For a board that has no `linear` model.
    """

    def __init__(self, board: Deck, band_hz: float, tolerance: float) -> None:
        self._board = board
        self._asked = Asked(board.text, "linear", float(band_hz), float(tolerance))
        self._handles: dict[str, Handle] = {}
        self._renew()
        paths = self._session.measure(SWEEP)
        self.circuit = extracted(self._session, self._asked, paths)
        # as it is measured, at full scale, to which an offset there adds
        self._gain = self.circuit.gain * (1.0 + self.circuit.y_offset / self._session.v_fs)
        self._batches: tuple[Batch, ...] = ()
        self._sweep = SWEEP
        self._learn(paths)

    def at(self, values: Mapping[str, float]) -> LinearCircuit:
        """Return the model with other values, all others as on the board.

        Unreduced it is within `rowfit.GOOD` of the maximum of each path, as the first extraction is; reduced,
        within the tolerance at `rowfit.GRID` frequencies of the band. The split of a path's gain between a
        multiplier and what follows it is the board's own, as are nonlinearity and delay of gain pins: what
        the certificate names in 'from_nominal'. 'extracted_anew' in it is why a model took the long way.

        Parameters
        ----------
        values
            Names of parameters and elements as in a scene's overrides -> value.

        Raises
        ------
        InputError
            For an unknown name, a value that is no number, and values with which there is no model: an
            unstable board.
        """
        wrong = [Problem("is not a number", key=k, value=v) for k, v in values.items() if not np.isfinite(v)]
        if wrong:
            raise InputError(wrong)
        for name in values:
            if name not in self._handles:
                self._handles[name] = handle(self._board, name)
        try:
            if any(self._handles[name].way is Way.DECK or name.lower() in _OURS for name in values):
                return self._other_deck(values)
            self._put(values)
            if not self._session.multipliers:
                return _extracted_anew(
                    extracted(self._session, self._asked), "the multipliers have no probes"
                )
            if self.circuit.e_pre.any():
                return _extracted_anew(
                    extracted(self._session, self._asked), "a pure differentiator has no poles"
                )
            return self._quickly()
        except BaseException:
            self._stale = True
            raise

    def _quickly(self) -> LinearCircuit:
        """Return the model of the board as it is in ngspice."""
        session, asked = self._session, self._asked
        paths = session.measure(self._sweep, self._gain)
        share = float(np.sqrt(1.0 + asked.tolerance) - 1.0)  # of each side: a + b (1 + a) <= tolerance
        try:
            refitted = fitted(paths, self._batches, 2.0 * np.pi * asked.band_hz, share)
        except Unfit as reason:
            measured = session.measure(SWEEP)
            circuit = _extracted_anew(extracted(session, asked, measured), str(reason))
            self._learn(measured)
            return circuit
        self._batches = refitted.batches
        session.hold(dict.fromkeys(session.channels, 0.0))
        limit = self.circuit.limit
        limit = current_limits(session) if np.isfinite(limit).any() else limit
        circuit = linear(paths, refitted.pre, refitted.post, limit, certificate=self._certificate(refitted))
        return with_offsets(session, circuit)

    def _renew(self) -> None:
        """Load the board as it is."""
        self._session = Session(self._board)
        self._params: dict[str, float] = {}
        self._elements: dict[str, float] = {}
        self._stale = False

    def _other_deck(self, values: Mapping[str, float]) -> LinearCircuit:
        self._stale = True
        deck = altered(self._board, {name: repr(float(value)) for name, value in values.items()})
        return _extracted_anew(
            extracted(Session(deck), self._asked), "a value is none of an element or a parameter at the top"
        )

    def _put(self, values: Mapping[str, float]) -> None:
        """Give the board in ngspice these values, and every other its own."""
        if self._stale:
            self._renew()
        params: dict[str, float] = {}
        elements: dict[str, float] = {}
        for name in sorted(values, key=lambda name: self._handles[name].rank):
            kind = self._handles[name]
            into = params if kind.way is Way.PARAMETER else elements
            into |= dict.fromkeys(kind.targets, float(values[name]))
        if any(name not in params for name in self._params):
            nominal = {name: nominal_value(self._board, name) for name in self._params}
            if None in nominal.values():
                self._renew()
            else:
                params = {name: value for name, value in nominal.items() if value is not None} | params
        if params != self._params or any(name not in elements for name in self._elements):
            self._session.parameters(params)
            self._params, self._elements = params, {}
        self._session.alter({k: v for k, v in elements.items() if self._elements.get(k) != v})
        self._elements = elements

    def _learn(self, paths: Paths) -> None:
        """Find out which poles each row of paths has."""
        if paths.lumped or self.circuit.e_pre.any():
            return
        same: dict[str, list[int]] = {}
        for c, part in enumerate(self._session.multipliers):
            same.setdefault(self._session.before(part), []).append(c)
        rows = [(True, tuple(outputs)) for outputs in same.values()]
        rows += [(False, (i,)) for i in range(self._session.joints)]
        self._batches = batches(paths, rows)
        self._sweep = points(self._batches)

    def _certificate(self, refitted: Fitted) -> dict[str, Any]:
        own, order = self.circuit.certificate, len(refitted.pre.a) + len(refitted.post.a)
        certificate: dict[str, Any] = {
            "model": "linear",
            "order": order,
            "full_order": len(refitted.poles),
            "poles_rad_per_s": [[float(p.real), float(p.imag)] for p in refitted.poles],
            "fit_error": refitted.error,
            "reduced": bool(refitted.lost),
            "from_nominal": [name for name in _NOMINAL if name in own],
        }
        certificate |= {name: own[name] for name in certificate["from_nominal"]}
        if self._asked.band_hz > 0.0 and self._asked.tolerance > 0.0:
            error = refitted.lost + refitted.lost * (1.0 + refitted.lost)
            certificate |= {
                "band_hz": self._asked.band_hz,
                "tolerance": self._asked.tolerance,
                "error": error,
                "sentence": f"up to {quantity(self._asked.band_hz, 'Hz', 6)} the model of order "
                f"{order} differs "
                f"from the circuit (order {len(refitted.poles)}) by {100.0 * error:.3g} % of the path's "
                f"maximum, looked at {GRID} frequencies",
            }
        return certificate


def _extracted_anew(circuit: LinearCircuit, reason: str) -> LinearCircuit:
    return replace(circuit, certificate=circuit.certificate | {"extracted_anew": reason})


def circuits(
    payload: dict[str, Any], report: Callable[[dict[str, Any]], None]
) -> list[LinearCircuit | InputError | SimulationError]:
    """Extract a board with each of many sets of values; runs in ngspice's child process.

    Parameters
    ----------
    payload
        'board': Deck; 'band_hz', 'tolerance' as `extract` takes them; 'sets': mappings of
        names to values
    report
        called with 'done', how many sets are through

    Returns
    -------
    list
        For each set its model, or why it has none, such as an unstable board.

    Raises
    ------
    InputError
        When the board as it is has no `linear` model.
    """
    board = Reextraction(payload["board"], payload["band_hz"], payload["tolerance"])
    answers: list[LinearCircuit | InputError | SimulationError] = []
    for values in payload["sets"]:
        try:
            answers.append(board.at(values))
        except (InputError, SimulationError) as reason:
            answers.append(reason)
        except FitError as reason:
            answers.append(SimulationError(f"no `linear` model: {reason}"))
        report({"done": len(answers)})
    return answers
