"""A board in ngspice: every pin has a source, every amplifier a probe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.checking.loop_probes import Probe, insert_probes
from cosim.circuits.decks import Drive
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.driven_board import DrivenBoard
from cosim.circuits.extraction.noise_analysis import by_element, silence
from cosim.errors import InputError
from cosim.ngspice.deck import Deck, board_pins
from cosim.ngspice.simulator import Simulator
from cosim.types import Complex

Real = NDArray[np.float64]
HIGHEST_HZ = 1e8
"""Sweeps end here: above every pole of a part of this trade."""


@dataclass(frozen=True)
class OutputNoise:
    """Noise of an output over a band.

    Attributes
    ----------
    total : rms of all
    elements : rms of every element that makes any, by its instance path: ``xboard.xsum1.r31``
    gain : from the input at the lowest frequency, as `.noise` sees it: not the true one if a device does not
        take part in this analysis; ``None`` where it has no number
    """

    total: float
    elements: dict[str, float]
    gain: float | None


class ProbedBoard(DrivenBoard):
    """One board with a probe at every amplifier; `simulator` may hold another board before and after.

    Parameters
    ----------
    simulator
        ngspice.
    board
        Flat deck of the board.
    """

    def __init__(self, simulator: Simulator, board: Deck) -> None:
        lines, self.probes = insert_probes(board)
        inputs = [pin for pin in board_pins(board.joints) if pin not in ("vcc", "vee")]
        channels = tuple(p for p in inputs if not p.startswith(("pot", "vel", "imot")))
        self.outputs = tuple(f"imot{i}" for i in range(1, board.joints + 1))
        self.nodes = tuple(dict.fromkeys(a.out_node for a in board.amplifiers))
        drive = Drive(board.joints, True, channels)
        super().__init__(simulator, board, drive, [line.text for line in lines], lines)

    def constants(self) -> DesignConstants:
        """Return what the board states; `InputError` names what is missing."""
        return DesignConstants.read(
            {name: self.constant(name) for name in DesignConstants.names()}, str(self.board.path)
        )

    def constant(self, name: str) -> float | None:
        """Return a ``.csparam``, or ``None`` if the board states none of this name."""
        try:
            return self.simulator.constant(name)
        except InputError:
            return None

    def hold_only(self, pins: Mapping[str, float]) -> None:
        """Set these pins to these DC voltages [V] and all others to zero."""
        self.hold({pin: pins.get(pin, 0.0) for pin in sorted({*self._held, *pins})})

    def operating_point(self) -> dict[str, float]:
        """Return the volts (and amperes at 1 V/A) of motors and amplifiers with the pins as held."""
        self._run("op")
        return {name: float(np.real(self.simulator.vector(name)[0])) for name in (*self.outputs, *self.nodes)}

    def response(self, pin: str, sweep: str) -> dict[str, Complex]:
        """Return what 1 V at a pin makes of motors and amplifiers; ``frequency`` is among the names.

        Parameters
        ----------
        pin
            Which source.
        sweep
            As ngspice's ``ac`` takes it: ``dec 10 1 1e8``.
        """
        return self._swept(pin, sweep, (*self.outputs, *self.nodes))

    def loop_gain(self, probe: Probe, sweep: str) -> tuple[Real, Complex]:
        """Return frequencies [Hz] and the return ratio T of the loop at a probe; 1 + T = 0 is unstable.

        Tian, Visvanathan, Hantgan and Kundert, "Striving for Small-Signal Stability", IEEE Circuits and
        Devices Magazine 17 (2001): one injection of each kind, blind to loading and to direction. With the
        two-port admittance Y of the net cut at the probe, T = (Yab + Yba)/(Yaa + Ybb).
        """
        branch = f"{probe.series}#branch"
        names = (probe.node, branch)
        by_volt = self._swept(probe.series, sweep, names)
        by_ampere = self._swept(probe.shunt, sweep, names)
        v1, i1 = by_volt[probe.node], by_volt[branch]
        v2, i2 = by_ampere[probe.node], by_ampere[branch]
        share = i2 - v1 + 2.0 * (v1 * i2 - i1 * v2)  # (Yaa + Ybb)/(Yaa + Yab + Yba + Ybb)
        return np.real(by_volt["frequency"]), 1.0 / share - 1.0

    def noise(self, output: str, pin: str, sweep: str) -> OutputNoise:
        """Return the rms noise of an output over a band.

        A pin must be named as the input that ngspice refers the noise to; it makes none.
        """
        analysis = f"noise v({output}) {self._source[pin]} {sweep} 1"
        self._run(analysis)
        totals, none = by_element(self.simulator, "onoise_total_")
        if none:  # again without them: no sum has a number with them
            self.mute |= set(none)
            silence(self.simulator, none)
            self._run(analysis)
            totals, none = by_element(self.simulator, "onoise_total_")
        gain = None
        if not none:
            out, referred = (
                float(self.simulator.vector(f"noise1.{name}_spectrum")[0]) for name in ("onoise", "inoise")
            )
            gain = out / referred if referred > 0.0 else 0.0
        elements = {name.partition(".")[2] or name: float(rms[0]) for name, rms in totals.items()}
        return OutputNoise(math.sqrt(sum(rms**2 for rms in elements.values())), elements, gain)

    def _swept(self, source: str, sweep: str, names: tuple[str, ...]) -> dict[str, Complex]:
        with self._excited({source: 1.0}):
            self._run(f"ac {sweep}")
        return {
            name: np.asarray(self.simulator.vector(name), np.complex128) for name in ("frequency", *names)
        }

    def _run(self, analysis: str) -> None:
        self._rest.analyse(analysis, lambda: self.simulator.command("destroy all"))
