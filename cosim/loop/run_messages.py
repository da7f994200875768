"""What parent and child say to each other of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.circuits.decks import Tolerances
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.ngspice.deck import Deck
from cosim.scene import Scene

__all__ = ["RunAnswer", "RunRequest"]


@dataclass(frozen=True)
class RunRequest:
    """What a time loop needs to simulate a scene.

    Attributes
    ----------
    scene, board : the scene and its flat deck
    constants : what the board's designer states for the computer
    model : circuit model: ideal, linear or spice
    recorded, watched : nodes written at every point; nodes of which the peak is kept
    tolerances : ngspice's error control
    predicted_points : of the run
    folder : where signals.raw and samples.f64 are written
    """

    scene: Scene
    board: Deck
    constants: DesignConstants
    model: str
    recorded: tuple[str, ...]
    watched: tuple[str, ...]
    tolerances: Tolerances
    predicted_points: float
    folder: Path


@dataclass(frozen=True)
class RunAnswer:
    """Results of a run beside signals.raw and samples.f64, which are in the request's folder.

    Attributes
    ----------
    ledger : energy [J] by where it went
    sample_columns : names of the columns of samples.f64
    stats : what the run cost and how wrong its coupling was
    ngspice : version of the library
    printed : lines that law and operator of the user printed
    component_noise : what is drawn and what is left out, where the scene has it
    circuit : what was simulated, of the models ideal and linear
    peaks, clipped_s, swings : by node: largest |v| [V], how long it was at its limit, the limit [V]
    end : of the model spice; volts of 'nodes' and 'pins' at the last point, 'speed_rad_per_s' of the fastest
        joint, 'hung' as of `cosim.loop.spice.watch`; of a device at rest the 'operating_point' of the nodes
    """

    ledger: Mapping[str, Any]
    sample_columns: Sequence[str]
    stats: Mapping[str, Any]
    ngspice: str
    printed: Sequence[str]
    component_noise: Mapping[str, Any] | None
    circuit: LinearCircuit | None = None
    peaks: Mapping[str, float] = field(default_factory=dict)
    clipped_s: Mapping[str, float] = field(default_factory=dict)
    swings: Mapping[str, float] = field(default_factory=dict)
    end: Mapping[str, Any] | None = None
