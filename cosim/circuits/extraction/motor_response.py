"""What motors answer to potentiometers and speeds, channel by channel, kept by the deck's content.

Multipliers are linear in their gains, so that the response at any gains is a sum of these.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.circuits.cache import load_arrays, store_arrays
from cosim.ngspice.deck import Deck
from cosim.types import Array, Complex

__all__ = ["MotorResponse", "keep", "known", "measure"]


_VERSION = 3
#: Every frequency at which a device and its circuit can move each other.
_SWEEP = "dec 10 1m 1g"
_LOWEST = "lin 1 1m 1m"
_ARRAYS = ("hz", "rest", "channel", "command")


@dataclass(frozen=True)
class MotorResponse:
    """Motor currents per volt at `hz` [F].

    Attributes
    ----------
    hz
        [F] Hz.
    rest
        [F, n, 2 n]: pot, vel -> imot with all gains at zero.
    channel
        [F, m, n, n]: what each gain pin at full scale adds to pot -> imot, in the order of `names`.
    command
        [n]: cmd -> imot as the frequency goes to zero.
    v_fs
        Full scale [V].
    """

    hz: Array
    rest: Complex
    channel: Complex
    command: Array
    v_fs: float
    names: tuple[str, ...]

    def at(self, volts: Mapping[str, float]) -> Complex:
        """Return [F, n, 2 n]: pot, vel -> imot with these volts at the gain pins."""
        out = self.rest.copy()
        share = np.array([volts.get(name, 0.0) / self.v_fs for name in self.names])
        out[:, :, : out.shape[1]] += np.einsum("c,fcij->fij", share, self.channel)
        return out


def measure(payload: Mapping[str, Any], report: Callable[[dict[str, Any]], None]) -> MotorResponse:
    """Measure a board in ngspice's child process; payload: 'board'."""
    # who finds the answer kept needs no ngspice
    from cosim.circuits.extraction.testbench import Testbench

    bench = Testbench(payload["board"], multipliers=False)
    n = bench.joints
    motors, pots = [f"imot{i}" for i in range(1, n + 1)], [f"pot{j}" for j in range(1, n + 1)]

    def driven(pins: list[str]) -> Complex:
        report({})
        return np.stack([bench.respond(pin, _SWEEP, motors) for pin in pins], axis=2)

    command = [bench.respond(f"cmd{i}", _LOWEST, [f"imot{i}"])[0, 0].real for i in range(1, n + 1)]
    rest = driven([*pots, *(f"vel{j}" for j in range(1, n + 1))])
    each = []
    for channel in bench.channels:
        bench.hold({channel: bench.v_fs})
        each.append(driven(pots) - rest[:, :, :n])
        bench.hold({channel: 0.0})
    names = tuple(bench.channels)
    return MotorResponse(bench.hz, rest, np.stack(each, axis=1), np.array(command), bench.v_fs, names)


def _name(board: Deck) -> str:
    return "motors-" + hashlib.sha256(f"{_VERSION}\n{board.text}".encode()).hexdigest()


def known(board: Deck) -> MotorResponse | None:
    """Return what was measured of the same deck before."""
    stored = load_arrays(_name(board))
    try:
        if stored is None:
            return None
        about, arrays = stored
        hz, rest, channel, command = (arrays[name] for name in _ARRAYS)
        return MotorResponse(hz, rest, channel, command, float(about["v_fs"]), tuple(about["names"]))
    except (KeyError, TypeError, ValueError):  # damaged: the board itself is at hand
        return None


def keep(board: Deck, motor_response: MotorResponse) -> None:
    """Keep it under the deck's digest."""
    arrays = {name: getattr(motor_response, name) for name in _ARRAYS}
    store_arrays(_name(board), {"v_fs": motor_response.v_fs, "names": list(motor_response.names)}, arrays)
