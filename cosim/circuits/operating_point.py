"""A deck in ngspice that is helped to an operating point where ngspice finds none as it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from cosim.errors import NoOperatingPoint
from cosim.ngspice.simulator import Simulator

__all__ = ["LOOSE", "STEPPING", "AtRest"]

#: Newton's method ends at steps of 10 uV and 1 nA, as `spice` does at its loosest, not at 1 uV and 1 pA: a
#: picoampere is the rounding of the currents of amperes that some models have inside.
LOOSE = ".options vntol=1e-5 abstol=1e-9"
#: ngspice's older stepping, in equal steps, and the conductance that stays across every junction [S].
STEPPING = ".options gminsteps=20 srcsteps=20 gmin=1e-10"


class AtRest:
    """The circuit that ngspice holds, what was altered of it, and analyses of it.

    Parameters
    ----------
    simulator
        ngspice.
    load
        Loads the deck with some further lines.

    Attributes
    ----------
    aid
        What helps it, in words; empty as long as nothing is needed.
    """

    def __init__(self, simulator: Simulator, load: Callable[[Sequence[str]], object]) -> None:
        self._simulator, self._load = simulator, load
        self._parameters: dict[str, float] = {}
        self._altered: dict[str, float] = {}
        self.aid = ""
        load(())

    def alter(self, what: str, value: float) -> None:
        """Give an element, or a parameter of it such as ``@v1[acmag]``, another value."""
        self._simulator.command(f"alter {what} = {value!r}")
        self._altered[what] = value

    def parameters(self, values: Mapping[str, float]) -> None:
        """Give `.param`s other values and read the deck again: all that was altered is undone."""
        self._parameters |= values
        self._altered = {}
        self._read_again()

    def analyse(
        self, command: str, ready: Callable[[], object] = lambda: None, *, aided: bool = True
    ) -> None:
        """Run an analysis.

        ngspice starts from its last solution. If it does not converge from there, it starts again
        from zero, which takes a new reading of the deck; then with `LOOSE`, then with `STEPPING` as well,
        which stay on.

        Parameters
        ----------
        command
            ngspice's.
        ready
            Called before each attempt: what is saved is forgotten when the deck is read.
        aided
            Whether there is a second attempt: whoever has another way to ask saves the vain ones.

        Raises
        ------
        NoOperatingPoint
            The first one, where nothing helps; the deck is as it was then.
        """
        before = self.aid
        first: NoOperatingPoint | None = None
        for prepare in (None, *((self._read_again, self._loose, self._stepping) if aided else ())):
            try:
                if prepare is not None:
                    prepare()
                ready()
                self._simulator.command(command)
            except NoOperatingPoint as lost:
                first = first or lost
            else:
                return
        assert first is not None
        if not before:
            self.aid = ""
            self._load(())
        self._read_again()
        raise first

    def _loose(self) -> None:
        self.aid = "operating point found to 10 uV and 1 nA (vntol, abstol)"
        self._load((LOOSE,))
        self._read_again()

    def _stepping(self) -> None:
        self.aid = "operating point found with gmin and source stepping, gmin = 1e-10 S, to 10 uV and 1 nA"
        self._load((LOOSE, STEPPING))
        self._read_again()

    def _read_again(self) -> None:
        for name, value in self._parameters.items():
            self._simulator.command(f"alterparam {name} = {value!r}")
        self._simulator.command("reset")
        for what, value in self._altered.items():
            self._simulator.command(f"alter {what} = {value!r}")
