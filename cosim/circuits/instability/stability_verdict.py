"""The verdict on a board's stability: one for every circuit model, kept by the content of its decks.

Implicit steps of a millisecond damp a pole at +1e6 rad/s, and an ideal amplifier has no pole at all: a run
that looks calm proves nothing. So a board is judged apart from its run, by `search.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from cosim.caution import Caution
from cosim.circuits.cache import load_arrays, store_arrays
from cosim.errors import InputError, Problem
from cosim.ngspice.deck import Deck
from cosim.units import quantity, signed

__all__ = ["Instability", "Latched", "Question", "Verdict", "keep", "known"]

#: To be raised with every change that may change a verdict.
_VERSION = 8


@dataclass(frozen=True)
class Instability:
    """A loop whose disturbances grow.

    Attributes
    ----------
    real, imag
        Its fastest growing pole [rad/s]; NaN if the poles were counted but not found.
    loop
        Instance paths of the amplifiers in the loop: grounding the output of any of them calms it.
    condition
        Gains at which it was seen, in words.
    confirmed
        Whether another fit order and a growing kick agree.
    declared
        Whether all of the loop stands in blocks that the netlist declares bistable or oscillating.
    """

    real: float
    imag: float
    loop: tuple[str, ...]
    condition: str
    confirmed: bool
    declared: bool

    def __str__(self) -> str:
        where = ", ".join(self.loop)
        if not np.isfinite(self.real):
            return f"unstable: a pole in the right half plane, in the loop of {where} {self.condition}"
        shown = f"{self.real:+.4g}" + (f" +- {abs(self.imag):.4g}j" if self.imag else "")
        hz = abs(complex(self.real, self.imag)) / (2.0 * np.pi)
        return (
            f"unstable: a pole at {shown} rad/s ({quantity(hz, 'Hz', 4)}) in the loop of {where} "
            f"{self.condition}"
        )


@dataclass(frozen=True)
class Latched:
    """An amplifier that stands at its limit while all inputs are at zero."""

    path: str
    volts: float

    def __str__(self) -> str:
        return f"the output of {self.path} stands at {signed(self.volts, 'V')} while all inputs are at zero"


@dataclass(frozen=True)
class Verdict:
    """What is known about the stability of a board.

    Attributes
    ----------
    instabilities, latched
        Loops whose disturbances grow, and amplifiers that are stuck at rest.
    gains_matter
        Whether some loop passes a multiplier, so that its poles move with the commanded gains.
    unjudged
        Why the board could not be judged, if so.
    """

    instabilities: tuple[Instability, ...] = ()
    latched: tuple[Latched, ...] = ()
    gains_matter: bool = False
    unjudged: str = ""

    @property
    def refused(self) -> tuple[Instability, ...]:
        """Those for which a run is refused."""
        return tuple(each for each in self.instabilities if each.confirmed and not each.declared)

    @property
    def stable(self) -> bool:
        """Whether nothing grows or is stuck that the netlist does not declare."""
        return not self.unjudged and not self.latched and all(each.declared for each in self.instabilities)

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as JSON-ready fields."""
        rows = [
            asdict(each)
            | {"loop": list(each.loop), "text": str(each)}
            | ({} if np.isfinite(each.real) else {"real": None, "imag": None})
            for each in self.instabilities
        ]
        return {
            "stable": self.stable,
            "refused": bool(self.refused),
            "instabilities": rows,
            "latched": [asdict(each) for each in self.latched],
            "gains_matter": self.gains_matter,
            "unjudged": self.unjudged,
        }

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Verdict:
        """Return what `as_dict` has written."""

        def number(value: float | None) -> float:
            return np.nan if value is None else float(value)

        instabilities = tuple(
            Instability(
                number(row["real"]), number(row["imag"]), tuple(map(str, row["loop"])),
                str(row["condition"]), bool(row["confirmed"]), bool(row["declared"]),
            )
            for row in stored["instabilities"]
        )  # fmt: skip
        latched = tuple(Latched(str(row["path"]), float(row["volts"])) for row in stored["latched"])
        return cls(instabilities, latched, bool(stored["gains_matter"]), str(stored["unjudged"]))

    def require(self, file: str) -> None:
        """Refuse a board that is certainly unstable.

        Raises
        ------
        InputError
            Naming every pole, its loop and its amplifiers.
        """
        if self.refused:
            raise InputError(
                Problem(
                    f"the board is {each}; look for positive feedback there, or declare a block that is "
                    "meant to do so (*@ stability=bistable or oscillating); solver.allow_unstable = true "
                    "runs it anyway",
                    file=file,
                    key=each.loop[0],
                )
                for each in self.refused
            )

    def cautions(self) -> list[Caution]:
        """Return what is doubtful, or was let pass by whoever allows unstable boards."""
        if self.unjudged:
            return [Caution("stability-unknown", f"the board's stability is unknown: {self.unjudged}",
                            "look at the loops with `cosim check`")]  # fmt: skip
        unstable = [
            Caution(
                "unstable-circuit",
                f"the board is {each}" + ("" if each.confirmed else " (no transient confirms it)"),
                "implicit steps may hide what grows there: believe nothing before the loop is mended",
            )
            for each in self.instabilities
            if not each.declared
        ]
        stuck = [
            Caution("output-latched", str(each), "look for positive or missing feedback around it")
            for each in self.latched
        ]
        return unstable + stuck


@dataclass(frozen=True)
class Question:
    """What a verdict depends on.

    Attributes
    ----------
    boards
        Decks to judge, with amplifiers of finite bandwidth.
    plain
        The board with parts of the shelf in place of vendors' models: judged where one of those is latched,
        since at that operating point its loop has no gain.
    commanded
        Gain pin -> volts that a scene commands.
    """

    boards: tuple[Deck, ...]
    plain: Deck | None = None
    commanded: Mapping[str, float] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Name of the verdict in the cache."""
        decks = [*self.boards, *([self.plain] if self.plain is not None else [])]
        gains = sorted((pin, repr(volts)) for pin, volts in self.commanded.items())
        texts = [(deck.text, deck.declared) for deck in decks]
        return "verdict-" + hashlib.sha256(repr((_VERSION, gains, texts)).encode()).hexdigest()


def known(question: Question) -> Verdict | None:
    """Return the verdict on the same decks, if it was reached before."""
    verdict = _stored(replace(question, commanded={}))
    return _stored(question) if verdict is None or (verdict.gains_matter and question.commanded) else verdict


def _stored(question: Question) -> Verdict | None:
    stored = load_arrays(question.digest)
    try:
        return Verdict.of(stored[0]) if stored else None
    except (KeyError, TypeError, ValueError):  # damaged: the board itself is at hand
        return None


def keep(question: Question, verdict: Verdict) -> None:
    """Keep a verdict; one that does not depend on the commanded gains for all of them."""
    if verdict.unjudged:
        return
    kept = question if verdict.gains_matter else replace(question, commanded={})
    store_arrays(kept.digest, verdict.as_dict(), {})
