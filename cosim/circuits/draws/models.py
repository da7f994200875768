"""The `ideal` or `linear` model of a board for many sets of values of its placed components.

Every set starts from the nominal board, never from the set before it, so the order of the sets does not
matter. Where all values are admittances, the paths follow from `DrawnNetwork` and are fitted with the
nominal board's number of poles; if that is not enough, with as many as they need. Values of another kind, and
boards without probes, are extracted again from a deck of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from cosim.circuits.cache import Asked
from cosim.circuits.draws.admittances import Unlike, changes
from cosim.circuits.draws.network import DrawnNetwork
from cosim.circuits.extraction.ideal import DC_SWEEP, ideal
from cosim.circuits.extraction.limits_and_offsets import current_limits
from cosim.circuits.extraction.measured_model import SWEEP, extracted, networks, without_rates
from cosim.circuits.extraction.path_measurement import Paths, Session
from cosim.circuits.extraction.testbench import Testbench
from cosim.circuits.fitting.rational_fit import WORST, FitError, Modes
from cosim.circuits.fitting.refit import Batch, Unfit, batches, fitted, points
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.ngspice.deck import Deck
from cosim.ngspice.placed_values import Placed
from cosim.types import Array

__all__ = ["Draws"]


#: Relative detuning at which a board shows all its poles; multiples of the golden ratio spread evenly.
_OFF, _GOLDEN = 0.01, 0.6180339887498949


def _spread(count: int) -> list[float]:
    """Return so many different shares up to a hundredth, the same each time."""
    return [_OFF * (2.0 * (k * _GOLDEN % 1.0) - 1.0) for k in range(1, count + 1)]


class Draws:
    """A board whose placed components take many sets of values.

    To be used in ngspice's child process; it holds the one circuit that ngspice can have there.

    Parameters
    ----------
    board
        The flat deck.
    keys
        Components, as `Placed` takes them.
    nominal
        Their values on the board as it is, SI.
    model
        ``ideal`` or ``linear``.

    Attributes
    ----------
    why_slow
        Why every set is extracted again; empty where it is not.

    Raises
    ------
    InputError
        For unknown components, and a board that has no such model.
    """

    def __init__(self, board: Deck, keys: Sequence[str], nominal: Sequence[float], model: str) -> None:
        self._placed = Placed.of(board, keys)
        self._model, self._nominal = model, tuple(map(float, nominal))
        self._file = str(board.path)
        self._as_is = self._placed.deck(self._nominal)
        self.why_slow = ""
        try:
            self._learn(keys)
        except Unlike as reason:
            self.why_slow = str(reason)

    def _learn(self, keys: Sequence[str]) -> None:
        """Ask ngspice for the board as it is, and find out which poles each row of paths has."""
        elements = changes(self._placed.board, keys)
        self._network = network = DrawnNetwork(self._as_is, elements, self._nominal)
        session = network.session
        if not session.multipliers:
            raise Unlike("the multipliers have no probes")
        paths = session.measure(DC_SWEEP if self._model == "ideal" else SWEEP)
        circuit = extracted(session, Asked(self._as_is.text, self._model, 0.0, 0.0), paths)
        network.learn(paths.gain, circuit)
        self._limit = circuit.limit
        if self._model == "ideal":
            network.sweep(DC_SWEEP)
            return
        before = [session.before(part) for part in session.multipliers]
        same: dict[str, list[int]] = {}
        for c, node in enumerate(before):
            same.setdefault(node, []).append(c)
        rows = [(True, tuple(places)) for places in same.values()]
        rows += [(False, (i,)) for i in range(session.joints)]
        network.sweep(SWEEP)
        # where values are as designed, a zero may lie on a pole: a board off it shows one pole more
        typical = [value * (1.0 + off) for value, off in zip(self._nominal, _spread(len(keys)), strict=True)]
        self._learned: list[tuple[list[float], tuple[Batch, ...]]] = []
        for at in (typical, list(self._nominal)):
            with suppress(FitError):
                self._learned.append(
                    (at, batches(without_rates(network.paths(SWEEP, network.change(at)))[1], rows))
                )
        self._sweep = points([batch for _, batches in self._learned for batch in batches])
        network.sweep(self._sweep)
        self._kept: dict[tuple[float, float], list[tuple[Batch, ...]]] = {}

    def _known_rows(self, omega: float, share: float) -> list[tuple[Batch, ...]]:
        """Return the rows with the poles that the board keeps at such a reduction, off its design and on."""
        if (omega, share) not in self._kept:
            kept = []
            for at, rows in self._learned:
                paths = without_rates(self._network.paths(self._sweep, self._network.change(at)))[1]
                with suppress(Unfit):
                    kept.append(fitted(paths, rows, omega, share).batches)
            self._kept[omega, share] = kept
        return self._kept[omega, share]

    def deck(self, values: Sequence[float]) -> Deck:
        """Return the board with these values."""
        return self._placed.deck(values)

    def at(self, values: Sequence[float], band_hz: float = 0.0, tolerance: float = 0.0) -> LinearCircuit:
        """Return the model with these values.

        Parameters
        ----------
        values
            In the order of the keys, SI.
        band_hz, tolerance
            Band and largest error of the reduced model, as `extract` takes them; 0: unreduced.

        Raises
        ------
        InputError
            For values with which there is no model: an unstable board.
        """
        if self.why_slow:
            asked = Asked(self._placed.board.text, self._model, band_hz, tolerance)
            return extracted(Session(self._placed.deck(values)), asked)
        change = self._network.change(values)
        if self._model == "ideal":
            paths = self._network.paths(DC_SWEEP, change)
            still = ideal(paths, self._file)
            parts = {name: value for name, value in still.arrays().items() if name[2:] in ("pre", "post")}
            return self._finished(parts | {"certificate": still.certificate}, paths, values, change)
        try:
            return self._quickly(values, change, band_hz, tolerance)
        except Unfit as reason:
            return self._wholly(values, change, band_hz, tolerance, str(reason))

    def _quickly(
        self, values: Sequence[float], change: Array, band_hz: float, tolerance: float
    ) -> LinearCircuit:
        """Fit with as many poles as the board has as it is."""
        omega = 2.0 * np.pi * band_hz
        share = float(np.sqrt(1.0 + tolerance) - 1.0)  # of each side: a + b (1 + a) <= tolerance
        rate, paths = without_rates(self._network.paths(self._sweep, change))
        refitted, reason = None, Unfit("the board as designed has no model of known order")
        for rows in self._known_rows(omega, share):
            try:
                refitted = fitted(paths, rows, omega, share)
                break
            except Unfit as misfit:
                reason = misfit
        if refitted is None:
            raise reason
        notes = {"model": "linear", "order": len(refitted.pre.a) + len(refitted.post.a),
                "full_order": len(refitted.poles), "fit_error": refitted.error}  # fmt: skip
        return self._finished(self._parts(refitted.pre, refitted.post, rate, notes), paths, values, change)

    def _wholly(
        self, values: Sequence[float], change: Array, band_hz: float, tolerance: float, reason: str
    ) -> LinearCircuit:
        """Fit with as many poles as it takes."""
        rate, paths = without_rates(self._network.paths(SWEEP, change))
        pre, post = networks(paths, self._file, max(WORST, tolerance))
        if band_hz > 0.0 and tolerance > 0.0:
            half = float(np.sqrt(1.0 + tolerance) - 1.0)
            pre, post = (side.reduced(2.0 * np.pi * band_hz, half)[0] for side in (pre, post))
        first, second = pre.joined(), post.joined()
        notes = {"model": "linear", "order": len(first.a) + len(second.a), "anew": reason}
        return self._finished(self._parts(first, second, rate, notes), paths, values, change)

    @staticmethod
    def _parts(pre: Modes, post: Modes, rate: Array, notes: dict[str, Any]) -> dict[str, Any]:
        return {
            "a_pre": pre.a, "b_pre": pre.b, "c_pre": pre.c, "d_pre": pre.d, "e_pre": rate,
            "a_post": post.a, "b_post": post.b, "c_post": post.c, "d_post": post.d, "certificate": notes,
        }  # fmt: skip

    def _finished(
        self, parts: dict[str, Any], paths: Paths, values: Sequence[float], change: Array
    ) -> LinearCircuit:
        """Return the circuit with offsets and limits."""
        n, v_fs, m = self._limit.shape[0], self._network.session.v_fs, len(paths.gain)
        steady = parts["d_post"][:, :m]
        if len(parts["a_post"]):
            steady = steady - parts["c_post"] @ np.linalg.solve(parts["a_post"], parts["b_post"][:, :m])
        offsets = self._network.offsets(paths, steady, change)
        return LinearCircuit(
            joints=n,
            model=self._model,
            gain=paths.gain * v_fs / (v_fs + offsets.y),
            offset=offsets.current,
            x_offset=offsets.x,
            y_offset=offsets.y,
            limit=self._limits(values),
            **parts,
        )

    def _limits(self, values: Sequence[float]) -> Array:
        """Return the motors' limits of current [n, 2], by `.dc` where the board as it is shows some."""
        if not np.isfinite(self._limit).any():
            return self._limit
        return current_limits(Testbench(self._placed.deck(values), multipliers=False))
