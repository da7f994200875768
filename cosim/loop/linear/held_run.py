"""Runs of the `ideal` or `linear` model that leave nothing on disk: thousands in one process."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.columns import columns, sample_columns
from cosim.loop.dac_channels import drive
from cosim.loop.linear.exact_matrices import Step
from cosim.loop.linear.run_linear import Clock, with_circuit
from cosim.loop.recorder import Recorder
from cosim.loop.setup import pack
from cosim.loop.signals import Layout, held_signals
from cosim.scene import PythonOperator, Scene
from cosim.types import Array

__all__ = ["HeldRun", "HeldRuns", "is_compiled"]


@dataclass(frozen=True)
class HeldRun:
    """Signals and the computer's samples by name, and the energy ledger, as a stored run has them."""

    signals: dict[str, Array]
    samples: dict[str, Array]
    ledger: dict[str, Any]


def is_compiled(scene: Scene) -> bool:
    """Whether `HeldRuns` can run a scene: nothing of it is the user's Python, no component makes noise."""
    python = scene.computer.law is not None or isinstance(scene.operator, PythonOperator)
    return not python and not scene.effects.component_noise


class HeldRuns:
    """Runs of one scene with one circuit after the other, in the same memory.

    Parameters
    ----------
    scene
        One for which `is_compiled` holds.
    constants
        Of the board as the computer knows it.
    """

    def __init__(self, scene: Scene, constants: DesignConstants) -> None:
        self.scene, self.constants = scene, constants
        self._memory = pack(scene, constants, drive(scene), (), ())
        self._start = self._memory.state.tobytes()
        self._expected: tuple[Step, ...] = ()

    def run(self, circuit: LinearCircuit) -> HeldRun:
        """Simulate the scene with a circuit.

        Raises
        ------
        SimulationError
            When the run fails.
        """
        memory = self._memory
        memory.state.view(np.uint8)[:] = np.frombuffer(self._start, np.uint8)
        packed = with_circuit(
            memory, self.scene, self.constants, circuit, record=True, expected=self._expected
        )
        rows, samples = io.BytesIO(), io.BytesIO()
        recorder = Recorder(memory, Clock(memory.state[0]), Path(), lambda _: None, streams=(rows, samples))
        packed.run()
        recorder.drain()
        self._expected = tuple(packed.asked)
        if recorder.failure is not None:
            raise recorder.failure
        names = columns(memory.drive, (), shafts=self.scene.effects.shaft)
        layout = Layout(tuple(names), memory.drive, self.constants, memory.state[0]["p"])
        table = np.frombuffer(rows.getbuffer()).reshape(-1, len(names))
        signals, ledger = held_signals(table, layout, packed.step.total)
        sampled = sample_columns(circuit.joints)
        each = np.ascontiguousarray(np.frombuffer(samples.getbuffer()).reshape(-1, len(sampled)).T)
        return HeldRun(signals, dict(zip(sampled, each, strict=True)), ledger)
