"""What a flattened board states in numbers (`.csparam`), evaluated by ngspice, kept by the deck's content."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.circuits.cache import folder
from cosim.circuits.decks import Drive, testbench
from cosim.circuits.design_constants import DesignConstants, Stated
from cosim.circuits.element_count import element_count
from cosim.errors import CosimError
from cosim.ngspice.deck import Deck, board_pins
from cosim.types import Report

if TYPE_CHECKING:
    from cosim.ngspice.simulator import Simulator

__all__ = ["kept", "of_deck", "read", "read_constants"]


def of_deck(board: Deck, numbers: Mapping[str, float]) -> Stated:
    """Put the numbers of a deck's `.csparam` lines together with its parts.

    Raises
    ------
    InputError
        Naming every design constant that is missing, and what is out of range of them and of the parts' data.
    """
    design = DesignConstants.read(numbers, str(board.path))
    parts: dict[str, tuple[str, ...]] = {}
    for part in board.parts:
        if part.role is not None:
            parts[part.role] = (*parts.get(part.role, ()), part.name)
    count: dict[str, int] = {}
    for amplifier in board.amplifiers:
        if amplifier.role is not None:
            count[amplifier.role] = count.get(amplifier.role, 0) + 1
    elements = element_count(board)
    stated = Stated(
        **vars(design), numbers=dict(numbers), parts=parts, count=count,
        straight=elements.straight, bent=elements.bent,
    )  # fmt: skip
    stated.check(str(board.path))
    return stated


def read(payload: dict[str, Any], report: Report) -> Stated:
    """Read a board in ngspice's child process; payload: 'board', a `Deck`."""
    board: Deck = payload["board"]
    channels = tuple(
        pin
        for pin in board_pins(board.joints)
        if pin not in ("vcc", "vee") and not pin.startswith(("pot", "vel", "imot"))
    )
    drive = Drive(board.joints, True, channels)
    bench = testbench(board, drive, dict.fromkeys(drive.sources(), "dc 0"))
    from cosim.ngspice.simulator import Simulator  # who finds the numbers kept needs no ngspice

    simulator = Simulator()
    simulator.load(
        "\n".join([*(line.text for line in board.lines), *bench, ".end"]) + "\n",
        lines=board.lines,
        name=str(board.path),
    )
    numbers = simulator.constants()
    _keep(board, numbers)
    return of_deck(board, numbers)


def read_constants(simulator: Simulator, file: str) -> DesignConstants:
    """Design constants of the loaded board."""
    values: dict[str, float | None] = {}
    for name in (*DesignConstants.names(), "motor_k"):
        try:
            values[name] = simulator.constant(name)
        except CosimError:
            values[name] = None
    return DesignConstants.read(values, file)


def kept(board: Deck) -> Stated | None:
    """Return what was read of the same deck before, or ``None``."""
    try:
        numbers = json.loads(_file(board).read_text())
        return of_deck(board, {str(name): float(value) for name, value in numbers.items()})
    except (OSError, ValueError, AttributeError, TypeError):  # the board itself is at hand
        return None


def _file(board: Deck) -> Path:
    return folder() / f"{board.digest}.json"


def _keep(board: Deck, numbers: Mapping[str, float]) -> None:
    with contextlib.suppress(OSError):  # where nothing can be written, nothing is kept
        folder().mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder(), suffix=".part")
        try:
            with os.fdopen(handle, "w") as file:
                json.dump(numbers, file)
            os.replace(name, _file(board))
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise
