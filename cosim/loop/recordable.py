"""What a run of a scene can record: nodes of its board, signals, and columns of the computer's samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cosim.circuits.decks import lockstep_deck
from cosim.loop.columns import columns, sample_columns
from cosim.loop.dac_channels import drive
from cosim.loop.signals import signal_names
from cosim.ngspice.simulator import Simulator

__all__ = ["recordable"]


def recordable(payload: dict[str, Any], report: Callable[[dict[str, Any]], None]) -> dict[str, list[str]]:
    """Return names as 'nodes', 'signals' and 'samples'; runs in ngspice's child process.

    Nodes are those of an operating point, so with all that vendors' models hold.

    Raises
    ------
    InputError
        For a board that ngspice does not accept.
    """
    scene, board = payload["scene"], payload["board"]
    circuit = drive(scene)
    simulator = Simulator()
    deck = lockstep_deck(board, circuit, payload["tolerances"], ())
    everything = "\n".join(line for line in deck.splitlines() if not line.startswith(".save"))
    simulator.load(everything, lines=board.lines, name=str(board.path))
    simulator.attach(source=lambda name, t: 0.0)
    simulator.command("op")
    return {
        "nodes": sorted(name for name in simulator.vector_names() if "." in name and "#" not in name),
        "signals": signal_names(columns(circuit, (), shafts=scene.effects.shaft))[0],
        "samples": sample_columns(circuit.joints),
    }
