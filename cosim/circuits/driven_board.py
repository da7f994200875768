"""A board in ngspice with a voltage source at every pin: what its testbenches share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from cosim.circuits.decks import Drive, testbench
from cosim.circuits.operating_point import AtRest
from cosim.ngspice.deck import Deck
from cosim.ngspice.lines import Line
from cosim.ngspice.simulator import Simulator

__all__ = ["DrivenBoard"]


class DrivenBoard:
    """A board loaded into ngspice, its DC voltages and its AC excitation.

    Parameters
    ----------
    simulator
        ngspice.
    board
        The flat deck.
    drive
        Pins with a source.
    head, tail
        Lines of the deck before and behind the testbench.
    lines
        Lines of the board's files, to which ngspice's messages belong.

    Attributes
    ----------
    mute
        Elements of whose noise ngspice has no number, as far as a noise analysis has met them.
    """

    def __init__(
        self,
        simulator: Simulator,
        board: Deck,
        drive: Drive,
        head: Sequence[str],
        lines: Sequence[Line],
        tail: Sequence[str] = (),
    ) -> None:
        self.simulator, self.board, self.joints = simulator, board, board.joints
        pins = drive.sources()
        self._source = {pin: f"v{k:02d}" for k, pin in enumerate(pins)}
        rows = [*head, *testbench(board, drive, dict.fromkeys(pins, "dc 0 ac 0")), *tail]
        self._held: dict[str, float] = {}
        self.mute: set[str] = set()
        self._rest = AtRest(
            simulator,
            lambda more: simulator.load(
                "\n".join([*rows, *more, ".end\n"]), lines=lines, name=str(board.path)
            ),
        )

    def hold(self, pins: Mapping[str, float]) -> None:
        """Set the DC voltage of some pins or probes [V]; the others keep theirs."""
        for pin, volts in pins.items():
            if self._held.get(pin, 0.0) != volts:
                self._rest.alter(f"{self._source.get(pin, pin)} dc", volts)
                self._held[pin] = volts

    @contextmanager
    def _excited(self, volts: Mapping[str, float]) -> Iterator[None]:
        """Give pins or probes these AC amplitudes [V], and zero afterwards."""
        sources = {self._source.get(pin, pin): amplitude for pin, amplitude in volts.items()}
        for source, amplitude in sources.items():
            self._rest.alter(f"@{source}[acmag]", amplitude)
        try:
            yield
        finally:
            for source in sources:
                self._rest.alter(f"@{source}[acmag]", 0.0)
