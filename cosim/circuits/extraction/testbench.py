"""A board in ngspice with a plain source at every pin, and the analyses that are run on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cosim.circuits.decks import Drive
from cosim.circuits.driven_board import DrivenBoard
from cosim.circuits.extraction.multipliers import Multiplier, find_multipliers
from cosim.circuits.extraction.noise_analysis import by_element
from cosim.circuits.extraction.probes import find_probes
from cosim.circuits.linear_circuit import channel_names
from cosim.errors import NoOperatingPoint
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator
from cosim.types import Array, Complex

__all__ = ["Testbench"]


#: Nodes named in one command: ngspice cuts off what is longer than 512 characters.
_A_LINE = 8


class Testbench(DrivenBoard):
    """A board in ngspice with a plain source at every pin.

    Parameters
    ----------
    board
        The flat deck.
    extra
        Further lines of the deck: sources at nodes inside the board.
    multipliers
        Whether to look for them, which takes analyses.
    beat
        Called before each attempt at an analysis: a sign of life for whoever waits.

    Attributes
    ----------
    v_fs
        Full scale of the gain pins [V].
    multipliers
        In the order of `channel_names`; empty where a gain pin has no multiplier with probes.
    """

    def __init__(
        self,
        board: Deck,
        extra: Sequence[str] = (),
        *,
        multipliers: bool = True,
        beat: Callable[[], object] = lambda: None,
    ) -> None:
        joints = range(1, board.joints + 1)
        self.channels = channel_names(board.joints)
        self.signals = [f"{kind}{j}" for kind in ("pot", "u") for j in joints]
        self.commands = [f"{kind}{j}" for kind in ("cmd", "vel") for j in joints]
        drive = Drive(
            board.joints, True, (*(f"u{j}" for j in joints), *self.channels, *(f"cmd{j}" for j in joints))
        )
        self._outputs = [f"imot{i}" for i in joints]
        self._saved: tuple[str, ...] = ()
        self._beat = beat
        self._hz: dict[str, Array] = {}
        super().__init__(
            Simulator(),
            board,
            drive,
            ["cosim extraction", *(line.text for line in board.lines[1:])],
            board.lines,
            [*extra, ".save " + " ".join(f"v({node})" for node in self._outputs)],
        )
        self.v_fs = self.simulator.constant("v_fs")
        self._probes = find_probes(board)
        halves = (self.signals[: self.joints], self.signals[self.joints :])
        self.multipliers: list[Multiplier] = []
        if multipliers:
            self.multipliers = find_multipliers(self, self._probes, self.channels, halves)

    @property
    def aid(self) -> str:
        """What helps ngspice to an operating point, in words; empty where nothing is needed."""
        return self._rest.aid

    def alter(self, elements: Mapping[str, float]) -> None:
        """Give elements other values, by ngspice's names; a later `parameters` takes them back."""
        for name, value in elements.items():
            self._rest.alter(name, value)

    def parameters(self, values: Mapping[str, float]) -> None:
        """Give `.param`s other values and read the deck again: all that was altered is undone."""
        self._rest.parameters(values)
        self._saved, self._held = (), {}

    def operating_point(self, nodes: Sequence[str]) -> Array:
        """Return DC voltages [V]."""
        self._analyse("op", nodes)
        volts = np.array([float(self.simulator.vector(node)[0]) for node in nodes])
        self.simulator.command("destroy")
        return volts

    def sweep(
        self, pin: str, begin: float, end: float, steps: int, node: str, *, aided: bool = True
    ) -> Array:
        """Return the DC voltage of `node` [steps + 1] while `pin` goes from `begin` to `end` [V].

        Raises
        ------
        NoOperatingPoint
            Where ngspice finds one of the points neither as it is nor, if it is to be `aided`, with aids.
        """
        step = (end - begin) / steps
        self._analyse(f"dc {self._source[pin]} {begin!r} {end!r} {step!r}", [node], aided=aided)
        volts = np.asarray(self.simulator.vector(node), float)
        self.simulator.command("destroy")
        return volts

    def respond(self, source: str | Mapping[str, float], sweep: str, nodes: Sequence[str]) -> Complex:
        """Drive a pin or a probe with 1 V, or several with given voltages, and return what nodes do.

        The shape is [F, len(nodes)].
        """
        driven = {source: 1.0} if isinstance(source, str) else source
        with self._excited(driven):
            self._analyse(f"ac {sweep}", nodes)
            if sweep not in self._hz:
                self._hz[sweep] = np.real(self.simulator.vector("frequency")).astype(float)
            self.hz = self._hz[sweep]
            response: Complex = np.zeros((len(self.hz), len(nodes)), np.complex128)
            alive = [k for k, node in enumerate(nodes) if node != "0"]
            response[:, alive] = self.simulator.vectors([nodes[k] for k in alive])
        self.simulator.command("destroy")
        return response

    def transient(self, step_s: float, length_s: float, node: str) -> tuple[Array, Array]:
        """Return times [s] and the voltage of `node` with steps of at most `step_s`."""
        self._analyse(f"tran {step_s!r} {length_s!r} 0 {step_s!r}", [node])
        time, volts = (np.asarray(self.simulator.vector(name), float) for name in ("time", node))
        self.simulator.command("destroy")
        return time, volts

    def noise(self, node: str, sweep: str) -> dict[str, Array]:
        """Return what each element adds to the noise of `node` by `.noise` [F] V/sqrt(Hz), by its name."""
        run = self.simulator.command

        def ready() -> None:
            run("delete all")  # `.noise` keeps no vector of its own where some are asked for
            run("destroy all")

        self._saved = ()
        self._rest.analyse(f"noise v({node}) {self._source[self.signals[0]]} {sweep} 1", ready)
        run("setplot noise1")
        densities, none = by_element(self.simulator, "onoise_")
        self.mute |= set(none)
        run("destroy all")
        return densities

    def reading(self, element: str, what: str) -> float:
        """Return what ngspice tells of an element at its operating point, such as ``resistance``."""
        return float(self.simulator.command(f"print @{element}[{what}]")[0].rpartition("=")[2])

    def before(self, part: Multiplier) -> str:
        """Return the node before the X probe of a multiplier."""
        first, second = self._ends(part)
        return second if first == part.x_node else first

    def sign(self, part: Multiplier) -> float:
        """Return the sign with which the voltage of the X probe adds to X."""
        return 1.0 if self._ends(part)[0] == part.x_node else -1.0

    def _ends(self, part: Multiplier) -> tuple[str, str]:
        return next(probe.nodes for probe in self._probes if probe.source == part.x)

    def _analyse(self, command: str, nodes: Sequence[str], *, aided: bool = True) -> None:
        """Run an analysis and have it hand over these nodes."""
        again = False

        def ready() -> None:
            nonlocal again
            if again:  # the deck was read anew, and what was saved is forgotten
                self._saved = ()
            again = True
            self._beat()
            self._save(nodes)

        try:
            self._rest.analyse(command, ready, aided=aided)
        except NoOperatingPoint:
            self._saved = ()
            raise

    def _save(self, nodes: Sequence[str]) -> None:
        """Have ngspice hand over these nodes only: each costs time at every point."""
        wanted = tuple(dict.fromkeys(node for node in nodes if node != "0"))
        if not set(wanted) <= set(self._saved) or len(self._saved) > 2 * len(wanted):
            self.simulator.command("delete all")
            for k in range(0, len(wanted), _A_LINE):
                self.simulator.command("save " + " ".join(f"v({node})" for node in wanted[k : k + _A_LINE]))
            self._saved = wanted
