"""A run of the `ideal` or `linear` model that leaves nothing on disk: one of thousands in one process."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.columns import columns, sample_columns
from cosim.loop.linear.run_linear import Clock, prepare
from cosim.loop.recorder import Recorder
from cosim.loop.signals import Layout, held_signals
from cosim.scene import PythonOperator, Scene
from cosim.types import Array

__all__ = ["HeldRun", "held_run", "is_compiled"]


@dataclass(frozen=True)
class HeldRun:
    """Signals and the computer's samples by name, and the energy ledger, as a stored run has them."""

    signals: dict[str, Array]
    samples: dict[str, Array]
    ledger: dict[str, Any]


def is_compiled(scene: Scene) -> bool:
    """Whether `held_run` can run a scene: nothing of it is the user's Python, no component makes noise."""
    python = scene.computer.law is not None or isinstance(scene.operator, PythonOperator)
    return not python and not scene.effects.component_noise


def held_run(scene: Scene, constants: DesignConstants, circuit: LinearCircuit) -> HeldRun:
    """Simulate a scene for which `is_compiled` holds.

    Raises
    ------
    SimulationError
        When the run fails.
    """
    packed = prepare(scene, constants, circuit, record=True)
    rows, samples = io.BytesIO(), io.BytesIO()
    recorder = Recorder(
        packed.memory, Clock(packed.memory.state[0]), Path(), lambda _: None, streams=(rows, samples)
    )
    packed.run()
    recorder.drain()
    if recorder.failure is not None:
        raise recorder.failure
    names = columns(packed.memory.drive, (), shafts=scene.effects.shaft)
    layout = Layout(tuple(names), packed.memory.drive, constants, packed.memory.state[0]["p"])
    table = np.frombuffer(rows.getbuffer()).reshape(-1, len(names))
    signals, ledger = held_signals(table, layout, packed.step.total)
    sampled = sample_columns(circuit.joints)
    each = np.ascontiguousarray(np.frombuffer(samples.getbuffer()).reshape(-1, len(sampled)).T)
    return HeldRun(signals, dict(zip(sampled, each, strict=True)), ledger)
