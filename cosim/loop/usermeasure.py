"""A measure of the user's own: a Python class in a file, asked once a run has ended.

The class has one method, `measure(run) -> float`, and may state `unit` and `text`. `[measures] names` lists
it as ``file.py:Class``; results, tables and sweeps call it by the name of its class.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.design_constants import DesignConstants
from cosim.errors import SimulationError
from cosim.loop.userclass import PrintCapture, in_users_words, load_class
from cosim.scene import Scene
from cosim.storage.rawfile import read_raw

__all__ = ["Recorded", "measured"]


@dataclass(frozen=True)
class Recorded:
    """A finished run, as a measure sees it.

    Attributes
    ----------
    scene, board : the scene that ran and the board's design constants
    signals : name -> [points], SI units; ``time`` [s] among them
    samples : name -> [samples] of the computer
    """

    scene: Scene
    board: DesignConstants
    signals: Mapping[str, NDArray[np.float64]]
    samples: Mapping[str, NDArray[np.float64]]


def measured(payload: dict[str, Any], report: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """Ask every measure of a list; runs in the child.

    Parameters
    ----------
    payload
        'scene', 'constants', 'raw' (path of the signals), 'samples', 'names' (each ``file.py:Class``)

    Returns
    -------
    dict
        'rows': class -> {value, unit, text}; 'printed': its lines

    Raises
    ------
    InputError, SimulationError
        For a class that cannot be made, and for one whose measure raises or is no finite number.
    """
    scene: Scene = payload["scene"]
    run = Recorded(scene, payload["constants"], read_raw(Path(payload["raw"])), payload["samples"])
    printed, rows = PrintCapture(), {}
    names: Iterable[str] = payload["names"]
    for where in names:
        made = load_class(
            where,
            scene.file,
            key="measures.names",
            what="an own measure",
            method="measure(run)",
            printed=printed,
        )
        try:
            with printed.listening():
                value = float(made.measure(run))
        except BaseException as error:
            raise in_users_words(where, error, output=printed) from error
        if not math.isfinite(value):
            raise SimulationError(f"{where}: the measure is not finite: {value}")
        unit, text = str(getattr(made, "unit", "")), str(getattr(made, "text", "") or "own measure")
        rows[where.rpartition(":")[2]] = {"value": value, "unit": unit, "text": text}
    return {"rows": rows, "printed": printed.lines}
