"""Boards with a slip that makes some of them unstable, for the random search; and the truth about each.

The truth is by the eigenvalues of a nodal analysis that shares no code with the program: it reads the flat
deck on its own (`tests/reference/mna.py`).
"""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.rig import ROOT
from cosim.accuracy.hard_cases.circuit_cases import inputs_exchanged
from cosim.ngspice.deck import Deck
from tests.reference.mna import Circuit
from tests.slips import bench_text

#: Blocks whose amplifier may have its inputs swapped.
_SWAPPED = ("angle", "diffamp", "differentiator", "summer", "driver_voltage")
#: Where two inputs pull: a resistor from the output to the other input, and two lags within a loop [Ohm, F].
_OHM, _FARAD, _LAG_OHM = (4.0, 6.5), (-13.0, -7.0), "10k"
#: The pole that is told is within this share of the true one, as well as two fits must agree.
_SAME_POLE = 0.05


@dataclass(frozen=True)
class Slip:
    """What is wrong with a board: the file of netlists/blocks, what is made of its text, and words for it.

    Where it is `uneven`, an amplifier weighs angle and equilibrium differently, and a turned arm meets other
    forces.
    """

    block: str
    change: Callable[[str], str]
    words: str
    uneven: bool = False

    def board(self, name: str, folder: Path) -> Path:
        """Write the shipped board `name` with the slip into a folder; return its file."""
        shutil.copytree(ROOT / "netlists", folder, dirs_exist_ok=True)
        file = folder / "blocks" / f"{self.block}.cir"
        before = file.read_text(encoding="utf-8")
        after = self.change(before)
        if after == before:
            raise ValueError(f"{self.words}: nothing changed")
        file.write_text(after, encoding="utf-8")
        return folder / name


def slip(rng: np.random.Generator) -> Slip:
    """Draw a slip: inputs swapped, a resistor that feeds back to the wrong input, or lags in a loop."""
    kind = str(rng.choice(["swapped", "positive", "lagging"]))
    if kind == "swapped":
        block = str(rng.choice(_SWAPPED))
        return Slip(block, inputs_exchanged, f"{block}: inputs swapped")
    if kind == "positive":
        ohm = f"{10 ** rng.uniform(*_OHM):.4g}"
        return Slip("diffamp", lambda text: text.replace(".ends", f"Rslip out inp {ohm}\n.ends"),
                    f"diffamp: {ohm} Ohm from the output to the other input", uneven=True)  # fmt: skip
    farad = f"{10 ** rng.uniform(*_FARAD):.4g}"
    rows = f"Rs1 out f1 {_LAG_OHM}\nCs1 f1 0 {farad}\nRs2 f1 f2 {_LAG_OHM}\nCs2 f2 0 {farad}\n"
    return Slip("angle", lambda text: text.replace("xop wiper out", f"{rows}xop wiper f2"),
                f"angle: two lags of {_LAG_OHM}Ohm and {farad} F within the follower")  # fmt: skip


def growing(board: Deck, gains: Mapping[str, float]) -> list[complex] | None:
    """Return the poles [rad/s] that grow, of the gains pins at none, at full scale and as commanded [V].

    None where the circuit has no operating point.
    """
    out: list[complex] = []
    held = tuple(f"V{pin} " for pin in gains)
    for volts in (dict.fromkeys(gains, 0.0), dict.fromkeys(gains, 10.0), gains):
        rows = [row for row in bench_text(board, 0.0).split("\n") if not row.startswith(held)]
        text = "\n".join([*rows, *(f"V{pin} {pin} 0 {each!r}" for pin, each in volts.items())])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                poles = Circuit(text).poles()
            except (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError):
                return None
        out += [complex(pole) for pole in poles if pole.real > 1e-9 * abs(pole)]
    return out


def is_told(words: str, poles: list[complex]) -> bool:
    """Whether a refusal tells a pole that is among the true ones."""
    _, _, rest = words.partition("a pole at ")
    told = rest.partition(" rad/s")[0].replace("j", "").split(" +- ")
    try:
        pole = complex(*(float(number) for number in told))
    except (TypeError, ValueError):
        return "in the right half plane" in words
    return any(abs(complex(p.real, abs(p.imag)) - pole) <= _SAME_POLE * abs(pole) for p in poles)
