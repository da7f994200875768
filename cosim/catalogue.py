"""The catalogue of measures: every figure that a designer may ask for, with unit, words and what it needs.

A scene's `[measures]` and `[tolerance]`, ``--measure`` of every command, tables and pages know a measure by
its name here. Those that need a run come from `cosim.measures`, the others from
`cosim.comparisons.board_measures`, which simulates nothing. What a block takes of `eta` has a name for every
block of a board, ``eta_diffamp``: `find` knows these, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

__all__ = [
    "ALL_NAMES", "AND", "ETA_OF", "MEASURES", "NAMES", "OF_A_RUN", "UNITS", "Measure", "Need", "by_need",
    "find", "needing_no_run",
]  # fmt: skip


class Need(Enum):
    """What a measure is taken from."""

    RUN = "a simulation of the scene"
    CONTACT = "the circuit's linear model and the contact held at the wall's point; no simulation"
    BOARD = "the board alone, asked of ngspice; no simulation"


@dataclass(frozen=True)
class Measure:
    """A figure: its name, its unit ('' for a plain number), what it is in words, and what it needs."""

    name: str
    unit: str
    text: str
    needs: Need = Need.RUN


_EVERY = (
    Measure("peak_force", "N", "largest force between operator and device"),
    Measure("max_penetration", "m", "deepest penetration of the wall"),
    Measure("contact_share", "", "share of the time in contact"),
    Measure("peak_normal_force", "N", "largest normal force in contact"),
    Measure("mean_normal_force", "N", "mean normal force while in contact"),
    Measure("steady_penetration", "m", "mean penetration in the last fifth of the run"),
    Measure("steady_normal_force", "N", "mean normal force in the last fifth of the run"),
    Measure("steady_tangential_force", "N", "mean tangential force in the last fifth of the run"),
    Measure("rendered_stiffness", "N/m", "steady force of the motors over steady penetration"),
    Measure("tangential_ratio", "", "|F_t/F_n| in the last fifth of the run"),
    Measure("force_ripple", "N", "rms of the normal force about its mean"),
    Measure("peak_current", "A", "largest motor current"),
    Measure("rated_share", "", "largest motor current over rated current"),
    Measure("over_rated", "", "share of time above rated"),
    Measure("heat", "A^2 s", "integral of the squared motor currents"),
    Measure("dac_saturations", "", "DAC words clipped at the converter's range"),
    Measure("unreachable_samples", "", "samples whose contact point was out of reach"),
    Measure("headroom", "", "share of its output range that the amplifier which clips first has left"),
    Measure("ledger_closure", "", "unexplained share of the energy turned over"),
    Measure("k_max", "N/m", "largest stable stiffness of the held contact", Need.CONTACT),
    Measure("k_margin", "", "k_max over the stiffness that is commanded", Need.CONTACT),
    Measure("passive_stiffness", "N/m", "largest stiffness of the held contact that is passive",
            Need.CONTACT),
    Measure("stiffness_share", "", "stiffness of the analog spring along the normal over the commanded one",
            Need.CONTACT),
    Measure("damping_share", "", "damping of the analog damper along the normal at 1 Hz over that commanded",
            Need.CONTACT),
    Measure("leakage", "", "tangential over normal force of the analog spring, pressed along the normal",
            Need.CONTACT),
    Measure("force_noise", "N", "rms of the motors' normal force by noise of the potentiometers, at rest",
            Need.CONTACT),
    Measure("eta", "", "share of the device's damping that the analog spring's delay eats", Need.CONTACT),
    Measure("curl", "N/m", "curl of the rendered field of force at the wall's point", Need.CONTACT),
    Measure("least_stiffness", "N m/rad", "least eigenvalue of sym(Ksp), as rendered at the joints",
            Need.CONTACT),
    Measure("circle_energy", "J", "energy fed to a hand once round a circle of 1 cm, gains held",
            Need.CONTACT),
    Measure("rest_force", "N", "tip force of a motor out of contact, all gains zero", Need.BOARD),
    Measure("phase_margin", "deg", "least phase margin of all loops", Need.BOARD),
    Measure("gain_margin", "dB", "least gain margin of all loops", Need.BOARD),
)  # fmt: skip

#: Every measure by its name.
MEASURES: dict[str, Measure] = {measure.name: measure for measure in _EVERY}
NAMES = tuple(MEASURES)
UNITS: dict[str, str] = {measure.name: measure.unit for measure in _EVERY}
#: Those that need a run; a run gives all of them unless some are asked for.
OF_A_RUN = tuple(measure.name for measure in _EVERY if measure.needs is Need.RUN)

#: Begins the name of a block's share of `eta`, and joins several blocks: ``eta_driver_and_motor``.
ETA_OF, AND = "eta_", "_and_"
#: The names, for who mistyped one.
ALL_NAMES = ", ".join((*NAMES, f"{ETA_OF}BLOCK"))


def find(name: str) -> Measure | None:
    """Return the measure of a name, None where there is none; whether a board has the block is not asked."""
    block = name.removeprefix(ETA_OF)
    if name in MEASURES or block in ("", name) or not name.isidentifier():
        return MEASURES.get(name)
    return Measure(name, "", f"what the delay of {block.replace(AND, ' and ')} takes of eta", Need.CONTACT)


def by_need(names: Iterable[str]) -> dict[Need, tuple[str, ...]]:
    """Return the names of measures by what they are taken from, in their order."""
    known = [measure for name in names if (measure := find(name)) is not None]
    return {need: tuple(of.name for of in known if of.needs is need) for need in Need}


def needing_no_run(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of measures that need no run."""
    return tuple(name for name in names if (of := find(name)) is not None and of.needs is not Need.RUN)
