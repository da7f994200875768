"""The `spice` circuit model: the board as built, in ngspice's transient analysis.

Writes the one deck that a lockstep run loads: the flattened board, its supplies, one EXTERNAL source for each
pin that the scene drives, and a plain 0 V source for each pin that it does not (an effect that is off leaves
no external source behind).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cosim.ngspice.deck import Deck, board_pins

#: Nodes that are recorded or watched, at most.
MOST_NODES = 256
#: Supplies of every board [V]: vcc and vee are driven by the deck.
SUPPLY_V = 15.0
#: A device that moves slower [rad/s] is at rest: its differentiators are then at their operating point.
REST_RAD_PER_S = 0.05
#: An output may hang from this share of its limit on; of the supply, where its part states none.
AT_LIMIT, AT_SUPPLY = 0.97, 0.6


@dataclass(frozen=True)
class Drive:
    """Which pins are driven, in the order of the lockstep's source array.

    Attributes
    ----------
    joints : number of joints; all `joints` potentiometers are driven
    speeds : whether the pins `vel` are (the motor has a back-EMF)
    channels : names of the driven DAC pins (u, ksp, ksd, cmd)
    """

    joints: int
    speeds: bool
    channels: tuple[str, ...]

    def sources(self) -> list[str]:
        """Pins with an EXTERNAL source, in order."""
        joint = range(1, self.joints + 1)
        return (
            [f"pot{j}" for j in joint]
            + ([f"vel{j}" for j in joint] if self.speeds else [])
            + list(self.channels)
        )


@dataclass(frozen=True)
class Tolerances:
    """ngspice's own error control.

    Attributes
    ----------
    rtol : relative tolerance of Newton's method and of the integration
    method : 'gear' or 'trap'
    charge_c : charge [C] below which a capacitor's truncation error does not shorten the step: op-amps'
        internal poles (pF, settling in microseconds) are then stepped over by the L-stable method, while
        motor, differentiator and filter are resolved.
    """

    rtol: float
    method: str
    charge_c: float

    def line(self) -> str:
        """Return the `.options` line."""
        return (
            f".options method={self.method} maxord=2 reltol={self.rtol:.6g} vntol={self.rtol * 1e-2:.6g} "
            f"abstol={self.rtol * 1e-6:.6g} chgtol={self.charge_c:.6g} trtol=1 "
            "noopac nomod itl4=50"
        )


def saved(drive: Drive, nodes: tuple[str, ...]) -> list[str]:
    """Vectors that ngspice hands over at every point: motor currents, then `nodes`."""
    return [f"imot{j}" for j in range(1, drive.joints + 1)] + list(nodes)


def testbench(board: Deck, drive: Drive, sources: dict[str, str]) -> list[str]:
    """Supplies, the board as `xboard` and a source at each pin.

    `sources` maps a driven pin to what follows its nodes on the source's line (`dc 1`, `external`,
    `pwl(...)`); one that is not in it is left to the caller. Pins that the scene does not drive are at 0 V.
    """
    lines = [
        f"Vcc vcc 0 {SUPPLY_V}",
        f"Vee vee 0 {-SUPPLY_V}",
        f"Xboard {' '.join(board.pins)} {board.board}",
    ]
    for number, pin in enumerate(drive.sources()):
        if pin in sources:
            lines.append(f"v{number:02d} {pin} 0 {sources[pin]}")
    passive = set(drive.sources()) | {"vcc", "vee"} | {f"imot{j}" for j in range(1, drive.joints + 1)}
    lines += [f"Vz{pin} {pin} 0 0" for pin in board_pins(drive.joints) if pin not in passive]
    return lines


def lockstep_deck(
    board: Deck,
    drive: Drive,
    tolerances: Tolerances,
    nodes: tuple[str, ...],
    extra: Sequence[str] = (),
) -> str:
    """Return the deck of a lockstep run: every driven pin is EXTERNAL; `extra` are further lines."""
    # the speeds also take an `.ac` excitation; `ac` must come before `external` (ngspice 39)
    external = {pin: "ac 0 external" if pin.startswith("vel") else "external" for pin in drive.sources()}
    lines = [
        "cosim lockstep",
        *(line.text for line in board.lines[1:]),
        *testbench(board, drive, external),
        tolerances.line(),
        *extra,
        ".save " + " ".join(f"v({name})" for name in saved(drive, nodes)),
        ".end",
    ]
    return "\n".join(lines) + "\n"
