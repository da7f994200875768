"""Offsets of the multipliers' inputs as a state that never moves, so that compiled code knows of none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cosim.circuits.linear_circuit import LinearCircuit

__all__ = ["shifted"]


def shifted(circuit: LinearCircuit) -> LinearCircuit:
    """Return the circuit with `x_offset` as what a last state before the multipliers gives, whose value is 1.

    A circuit without such offsets is returned as it is.
    """
    if not circuit.x_offset.any():
        return circuit
    before = len(circuit.a_pre)
    a = np.zeros((before + 1, before + 1))
    a[:before, :before] = circuit.a_pre
    return replace(
        circuit,
        a_pre=a,
        b_pre=np.vstack([circuit.b_pre, np.zeros(circuit.b_pre.shape[1])]),
        c_pre=np.column_stack([circuit.c_pre, circuit.x_offset]),
        x_offset=np.zeros(len(circuit.gain)),
    )
