"""Amplifiers that nobody supplies so: at most levels their model does not look at its supply pins."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.caution import Caution
from cosim.ngspice.deck import Deck

__all__ = ["supplies"]


def supplies(board: Deck) -> Iterator[Caution]:
    """Yield the amplifiers whose supply pins are crossed or on one net, or whose positive one is at ground.

    A negative pin at ground is a single supply. What hangs from the rails through other elements is not
    judged.
    """
    for amplifier in board.amplifiers:
        positive, negative = amplifier.supplies
        if not positive:
            continue
        if positive == negative:
            fault = f"both supply pins are on one net, {positive}"
        elif positive == "vee" or negative == "vcc":
            fault = f"the supplies are crossed: vcc is on {positive}, vee on {negative}"
        elif positive == "0":
            fault = "the positive supply pin is at ground"
        else:
            continue
        yield Caution(
            "supplies-crossed",
            f"{amplifier.path} ({amplifier.part}): {fault}; the real one fails, its model may not see it",
            f"correct the order of nodes on its line: {amplifier.part} has its pins as its .subckt line says",
        )
