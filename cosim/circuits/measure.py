"""Ask ngspice for every path of a board apart: before the multipliers, and after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.linear import channel_names
from cosim.circuits.probes import Probe, find_probes
from cosim.circuits.spice import Drive, testbench
from cosim.ngspice.deck import Deck
from cosim.ngspice.simulator import Simulator

__all__ = ["Multiplier", "Paths", "Session"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A response below this is none [V/V]: parasitic paths of macro-models are far below, working paths above.
_NONE = 1e-6
#: Where wiring is found out and DC gains are read [Hz]: below every pole that matters, above rounding.
LOW_HZ = (1e-5, 1e-4)


@dataclass(frozen=True)
class Multiplier:
    """The probes of one multiplier.

    Attributes
    ----------
    channel
        Its gain pin.
    x, z
        Names of the sources in series with X and (if there is one) Z.
    x_node, z_node
        Nodes behind them, as the multiplier sees them.
    """

    channel: str
    x: str
    x_node: str
    z: str | None
    z_node: str | None


@dataclass(frozen=True)
class Paths:
    """What was measured, at the frequencies `hz` [F].

    Attributes
    ----------
    x
        [F, m, 2 n]: pot, u -> behind the X probe of each multiplier. A lumped board: its share of the
        current of motor i at a gain of `v_fs`.
    gain
        [m], 1/V.
    post
        [F, n, m + 2 n]: multiplier's product, cmd, vel -> imot.
    total
        [F, n, 2 n]: pot, u -> imot with every gain pin at `v_fs`, measured as a whole.
    lumped
        Whether the multipliers have no probes.
    v_fs
        Full scale of the gain pins [V].
    """

    hz: Array
    x: Complex
    gain: Array
    post: Complex
    total: Complex
    lumped: bool
    v_fs: float

    @property
    def s(self) -> Complex:
        """The frequencies as s = jw [rad/s]."""
        out: Complex = 2j * np.pi * self.hz.astype(complex)
        return out


class Session:
    """A board in ngspice with a plain source at every pin.

    Parameters
    ----------
    board
        The flat deck.
    extra
        Further lines of the deck: sources at nodes inside the board.

    Attributes
    ----------
    v_fs
        Full scale of the gain pins [V].
    multipliers
        In the order of `channel_names`; empty where a gain pin has no multiplier with probes.
    """

    def __init__(self, board: Deck, extra: Sequence[str] = ()) -> None:
        self.board, self.joints = board, board.joints
        joints = range(1, self.joints + 1)
        self.channels = channel_names(self.joints)
        self.signals = [f"{kind}{j}" for kind in ("pot", "u") for j in joints]
        self.commands = [f"{kind}{j}" for kind in ("cmd", "vel") for j in joints]
        drive = Drive(
            self.joints, True, (*(f"u{j}" for j in joints), *self.channels, *(f"cmd{j}" for j in joints))
        )
        pins = drive.sources()
        self._source = {pin: f"v{k:02d}" for k, pin in enumerate(pins)}
        self._outputs = [f"imot{i}" for i in joints]
        self._probes = find_probes(board)
        nodes = dict.fromkeys(node for probe in self._probes for node in probe.nodes if node != "0")
        text = "\n".join(
            [
                "cosim extraction",
                *board.text.splitlines()[1:],
                *testbench(board, drive, dict.fromkeys(pins, "dc 0 ac 0")),
                *extra,
                ".save " + " ".join(f"v({node})" for node in (*self._outputs, *nodes)),
                ".end",
            ]
        )
        self.simulator = Simulator()
        self.simulator.load(text + "\n", lines=board.lines, name=str(board.path))
        self.v_fs = self.simulator.constant("v_fs")
        self.multipliers = self._find_multipliers()

    def hold(self, pins: dict[str, float]) -> None:
        """Set the DC voltage of some pins or probes [V]."""
        for pin, volts in pins.items():
            self.simulator.command(f"alter {self._source.get(pin, pin)} dc = {volts!r}")

    def operating_point(self, nodes: list[str]) -> Array:
        """Return DC voltages [V]."""
        self.simulator.command("op")
        found = np.array([float(self.simulator.vector(node)[0]) for node in nodes])
        self.simulator.command("destroy")
        return found

    def sweep(self, pin: str, reach: float, steps: int, node: str) -> Array:
        """Return the DC voltage of `node` [steps + 1] while `pin` goes from -`reach` to `reach` [V]."""
        step = 2.0 * reach / steps
        self.simulator.command(f"dc {self._source[pin]} {-reach!r} {reach!r} {step!r}")
        found = np.asarray(self.simulator.vector(node), float)
        self.simulator.command("destroy")
        return found

    def respond(self, source: str, sweep: str, nodes: list[str]) -> Complex:
        """Drive a pin or a probe with 1 V and return the response of `nodes`; shape [F, len(nodes)]."""
        name = self._source.get(source, source)
        run = self.simulator.command
        run(f"alter @{name}[acmag] = 1")
        try:
            run(f"ac {sweep}")
            size = len(self.simulator.vector("frequency"))
            found: Complex = np.zeros((size, len(nodes)), np.complex128)
            for k, node in enumerate(nodes):
                if node != "0":
                    found[:, k] = self.simulator.vector(node)
            self.hz = np.real(self.simulator.vector("frequency")).astype(float)
        finally:
            run(f"alter @{name}[acmag] = 0")
        run("destroy")
        return found

    def keep_everything(self) -> None:
        """Let analyses keep every vector: `.noise` keeps none of its own otherwise."""
        self.simulator.command("delete all")

    def noise(self, node: str, sweep: str) -> dict[str, Array]:
        """Return what each element adds to the noise of `node` by `.noise` [F] V/sqrt(Hz), by its name."""
        run = self.simulator.command
        run("destroy all")
        run(f"noise v({node}) {self._source[self.signals[0]]} {sweep} 1")
        run("setplot noise1")
        prefix = "onoise_"
        found = {name.removeprefix(prefix) for name in self.simulator.vector_names() if prefix in name}
        # an element's parts (r1_thermal, q1_ic) are listed beside their sum (r1)
        whole = [n for n in found if not any(n[:k] in found for k, c in enumerate(n) if c == "_")]
        out = {
            name: np.asarray(self.simulator.vector(prefix + name), float)
            for name in sorted(whole)
            if name != "spectrum"
        }
        run("destroy all")
        return out

    def thermal(self, resistor: str) -> tuple[float, float]:
        """Return a resistor's resistance [Ohm] and temperature [K]."""
        ohms, celsius = (
            float(self.simulator.command(f"print @{resistor}[{what}]")[0].rpartition("=")[2])
            for what in ("resistance", "temp")
        )
        return ohms, celsius + 273.15

    def before(self, part: Multiplier) -> str:
        """Return the node before the X probe of a multiplier."""
        first, second = self._ends(part)
        return second if first == part.x_node else first

    def sign(self, part: Multiplier) -> float:
        """Return the sign with which the voltage of the X probe adds to X."""
        return 1.0 if self._ends(part)[0] == part.x_node else -1.0

    def _ends(self, part: Multiplier) -> tuple[str, str]:
        return next(probe.nodes for probe in self._probes if probe.source == part.x)

    def measure(self, sweep: str) -> Paths:
        """Measure all paths over a sweep such as ``dec 20 0.1 100meg``."""
        return self._apart(sweep) if self.multipliers else self._lumped(sweep)

    def _apart(self, sweep: str) -> Paths:
        n, m = self.joints, len(self.channels)
        inside = [multiplier.x_node for multiplier in self.multipliers]
        nodes = inside + self._outputs
        self.hold(dict.fromkeys(self.channels, self.v_fs))
        sides = np.stack([self.respond(pin, sweep, nodes) for pin in self.signals], axis=2)
        probed = np.stack([self.respond(part.x, sweep, nodes) for part in self.multipliers], axis=2)
        # a driven probe also moves what stands before it a little: solve for each multiplier's own share
        share = np.linalg.solve(probed[:, :m].transpose(0, 2, 1), probed[:, m:].transpose(0, 2, 1)).transpose(
            0, 2, 1
        )
        hz = self.hz
        gain = np.array([self._gain(part, share[0, :, c], hz[0]) for c, part in enumerate(self.multipliers)])
        direct = [self.respond(pin, sweep, self._outputs) for pin in self.commands]
        post = np.concatenate([share / (gain * self.v_fs), np.stack(direct, axis=2)], axis=2)
        self.hold(dict.fromkeys(self.channels, 0.0))
        return Paths(hz, sides[:, :m], gain, post, sides[:, m : m + n], False, self.v_fs)

    def _gain(self, part: Multiplier, share: NDArray[Any], hz: float) -> float:
        """Return w per X and volt at the gain pin; `share` is X -> imot at full scale and `hz`."""
        if part.z is None or part.z_node is None:
            return 1.0 / self.v_fs
        response = self.respond(part.z, f"lin 1 {float(hz)!r} {float(hz)!r}", [*self._outputs, part.z_node])[
            0
        ]
        strongest = int(np.argmax(np.abs(response[:-1])))
        return float(np.real(share[strongest] * response[-1] / (response[strongest] * self.v_fs)))

    def _lumped(self, sweep: str) -> Paths:
        n, m = self.joints, len(self.channels)
        none = [self.respond(pin, sweep, self._outputs) for pin in self.signals]
        size = len(self.hz)
        x = np.zeros((size, m, 2 * n), complex)
        post = np.zeros((size, n, m + 2 * n), complex)
        for c, pin in enumerate(self.channels):
            motor = c // n % n
            self.hold({pin: self.v_fs})
            for k, signal in enumerate(self.signals):
                x[:, c, k] = (self.respond(signal, sweep, self._outputs) - none[k])[:, motor]
            self.hold({pin: 0.0})
            post[:, motor, c] = 1.0
        for k, pin in enumerate(self.commands):
            post[:, :, m + k] = self.respond(pin, sweep, self._outputs)
        self.hold(dict.fromkeys(self.channels, self.v_fs))
        total = np.stack([self.respond(pin, sweep, self._outputs) for pin in self.signals], axis=2)
        self.hold(dict.fromkeys(self.channels, 0.0))
        return Paths(self.hz, x, np.full(m, 1.0 / self.v_fs), post, total, True, self.v_fs)

    def _find_multipliers(self) -> list[Multiplier]:
        """Find which probes belong to which gain pin, by what moves when a pin is driven."""
        groups: dict[str, list[Probe]] = {}
        for probe in self._probes:
            groups.setdefault(probe.group, []).append(probe)
        groups = {path: probes for path, probes in groups.items() if len(probes) > 1}
        if not groups:
            return []
        once = f"lin 1 {LOW_HZ[1]} {LOW_HZ[1]}"
        nodes = list(dict.fromkeys(probe.nodes[1] for probes in groups.values() for probe in probes))
        moved = {
            pin: dict(zip(nodes, np.abs(self.respond(pin, once, nodes)[0]), strict=True))
            for pin in (*self.channels, *self.signals)
        }
        found: dict[str, Multiplier] = {}
        for probes in groups.values():
            control = [(p, pin) for p in probes for pin in self.channels if moved[pin][p.nodes[1]] > _NONE]
            if len(control) != 1 or control[0][1] in found:
                continue
            rest = [probe for probe in probes if probe is not control[0][0]]
            driven = [p for p in rest if any(moved[pin][p.nodes[1]] > 0.0 for pin in self.signals)]
            if len(driven) != 1 or len(rest) > 2:
                continue
            still = next((probe for probe in rest if probe is not driven[0]), None)
            found[control[0][1]] = Multiplier(
                control[0][1],
                driven[0].source,
                self._behind(driven[0]),
                still.source if still else None,
                self._behind(still) if still else None,
            )
        return [found[pin] for pin in self.channels] if len(found) == len(self.channels) else []

    def _behind(self, probe: Probe) -> str:
        """Return the end of a probe that follows when it is driven; what stands before holds the other."""
        moved = np.abs(self.respond(probe.source, f"lin 1 {LOW_HZ[1]} {LOW_HZ[1]}", list(probe.nodes))[0])
        return probe.nodes[int(np.argmax(moved))]
