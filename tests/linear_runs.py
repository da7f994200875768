"""Boards as formulas, and scenes run on them by exact propagation."""

import ctypes
import math
from dataclasses import replace
from typing import Any

import numpy as np
from slope import RADIUS
from support import (
    GEAR,
    KT,
    MOTOR_OHM,
    POT_V,
    SIEMENS,
    V_NM,
)

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.columns import columns, sample_columns
from cosim.loop.linear.run_linear import Propagation, prepare
from cosim.scene import Scene

Array = Any


CONSTANTS = DesignConstants(
    v_rad=3.37034, k_fs=3.0003, c_fs=0.06969, v_fs=10, v_nm=V_NM, kt=KT, gear=GEAR, i_rated=0.875,
    i_limit=1.987, dac_v=10, dac_bits=12, w_rated=5.316, r_tip=RADIUS,
)  # fmt: skip


def ideal(n: int, *, emf: bool = True, limit: float = math.inf) -> LinearCircuit:
    """The board's gains from its resistors; no dynamics."""
    m = 2 * n * n
    d_pre, e_pre, d_post = np.zeros((m, 2 * n)), np.zeros((m, n)), np.zeros((n, m + 2 * n))
    for i in range(n):
        for j in range(n):
            spring, damper = i * n + j, n * n + i * n + j
            d_pre[spring, j], d_pre[spring, n + j] = -16.9 * POT_V, 16.9
            e_pre[damper, j] = -0.1 * POT_V
            d_post[i, spring] = 10e3 / 24.3e3 / (1 + 0.1 / 24.3e3) * SIEMENS
            d_post[i, damper] = 10e3 / 6.19e3 * SIEMENS
        d_post[i, m + i] = 0.5 * SIEMENS
        d_post[i, m + n + i] = -KT / MOTOR_OHM if emf else 0.0
    none = np.zeros((0, 0))
    return LinearCircuit(
        joints=n, model="ideal", a_pre=none, b_pre=np.zeros((0, 2 * n)), c_pre=np.zeros((m, 0)), d_pre=d_pre,
        e_pre=e_pre, gain=np.full(m, 0.1), a_post=none, b_post=np.zeros((0, m + 2 * n)),
        c_post=np.zeros((n, 0)), d_post=d_post, offset=np.zeros(n), limit=np.array([[-limit, limit]] * n),
    )  # fmt: skip


def lagging(circuit: LinearCircuit, before: float, after: float) -> LinearCircuit:
    """The circuit with one pole [rad/s] in front of every multiplier and one behind, for each motor."""
    m, n = len(circuit.gain), circuit.joints
    return replace(
        circuit, model="linear",
        a_pre=-before * np.eye(m), b_pre=before * circuit.d_pre, c_pre=np.eye(m), d_pre=0 * circuit.d_pre,
        a_post=-after * np.eye(n), b_post=after * circuit.d_post, c_post=np.eye(n), d_post=0 * circuit.d_post,
    )  # fmt: skip


def propagate(
    scene: Scene, circuit: LinearCircuit, *, tol: float = 1e-7, rows: bool = True, exact: bool = True
) -> Propagation:
    """A run in this process, all its rows and samples in memory."""
    made = prepare(scene, CONSTANTS, circuit, record=rows, row_capacity=200_000, sample_capacity=300_000)
    state = made.memory.state[0]
    state["steps"]["tol"] = tol
    if not exact:
        made.exact.on[0] = 0
    stop = ctypes.CFUNCTYPE(None)(lambda: None)
    state["drain_address"] = ctypes.cast(stop, ctypes.c_void_p).value
    made.run()
    assert state["fault"] == 0
    return made


def rows(made: Propagation, name: str) -> Array:
    state = made.memory.state[0]
    return made.memory.rows[: state["rows"]["used"], columns(made.memory.drive, ()).index(name)]


def samples(made: Propagation, name: str) -> Array:
    state = made.memory.state[0]
    return made.memory.samples[: state["samples"]["used"], sample_columns(int(state["n"])).index(name)]
