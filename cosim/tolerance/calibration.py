"""Calibration: the computer of each device knows the gains that its own board renders, not the design's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cosim.circuits.design_constants import Stated
from cosim.circuits.linear_circuit import LinearCircuit

__all__ = ["calibrated"]

#: Where a damper's gain is measured [rad/s]: far below its corners, far above leakage.
_SLOW = 1e-2


def calibrated(constants: Stated, circuit: LinearCircuit) -> Stated:
    """Return the constants of a computer that knows the static gains of its device.

    One gain each for springs, dampers and commands, as the computer has them: the mean over the joints
    of what a joint's own path renders at full scale. Differences between joints stay.

    Parameters
    ----------
    constants
        Of the design, with the motors' own torque constants.
    circuit
        Of the device.
    """
    n, m = circuit.joints, len(circuit.gain)
    per_amp = constants.torques_per_amp(n)
    springs, dampers = list[float](), list[float]()
    for joint in range(n):
        for first, s, gains in ((0, 0.0, springs), (n * n, 1j * _SLOW, dampers)):
            volts = np.zeros(m)
            volts[first + joint * n + joint] = constants.v_fs
            row = circuit.response(s, volts)[0][joint, joint]
            gains.append(float(-per_amp[joint]) * float(row.real if s == 0.0 else row.imag / _SLOW))
    command = circuit.response(0.0, np.zeros(m))[0].real[:, 2 * n : 3 * n]
    per_volt = float(np.mean(np.diag(command) * per_amp))
    return replace(constants, k_fs=float(np.mean(springs)), c_fs=float(np.mean(dampers)), v_nm=1.0 / per_volt)
