"""The energy ledger: who put energy into the device, and where it went.

Device: linkage and rotors. Over the run

    E_kin + E_grav + E_shafts  =  start  +  W_motors + W_operator + W_viscous + W_coulomb + W_stops + W_shafts
                                         +  residual

with the last four negative (shafts: where the effect is in force). Works are integrals of torque times speed
with the same interpolants that the integrator used: torque constant at its right-hand value behind a jump,
else linear or a parabola; speed a cubic through speeds and accelerations. The residual is therefore a measure
of the mechanical integration. With shafts, and in the linear loop, the integrator adds up the works itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.compiled import ArrayOf, entry, matrix, vector
from mech.energy import energy
from mech.kernels import jacobian
from mech.records import LINKAGE, NMAX, OPERATOR

#: Names of the works, in the order of `works`' columns.
WORKS = ("motors", "operator", "viscous", "coulomb", "stops", "shafts")
#: A ledger closes when its residual is below this share of the energy turned over: ten times what the shipped
#: scenes leave at their default steps (2e-8 to 1.2e-6), and far below any loss that a designer looks for.
CLOSURE = 1e-5
#: Energies below this [J] (1 mN over 10 mm) are not held to a share of themselves.
_LEAST_J = 1e-5
#: Gauss-Legendre of three points on [0, 1]: exact for torque (2) times speed (3) of degree five.
_NODES = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
#: Below this ratio of det(J J^T) to its squared trace the arm counts as stretched.
_FLAT = 1e-12
_WEIGHTS = (5 / 18, 8 / 18, 5 / 18)
_COULOMB = WORKS.index("coulomb")


@entry(LINKAGE, OPERATOR, int, vector, matrix, int, ArrayOf(np.float64, 3), matrix, matrix, int, int)
def torques_and_energy(
    p: Any,
    nobody: Any,
    n: int,
    torque_per_amp: NDArray[np.float64],
    rows: NDArray[np.float64],
    first: int,
    torques: NDArray[np.float64],
    energies: NDArray[np.float64],
    push: NDArray[np.float64],
    motors: int,
    stored: int,
) -> None:
    """Fill in, for every row, what the ledger and the report need beyond the streamed columns.

    `torques` [rows, 5, n] N m: joint torques of the first five workers; `energies` [rows, 3] J: kinetic,
    gravity, shafts; `motors`, `stored`: columns of the first motor's angle and of the shafts' energy;
    `push` [rows, 2] N: force at the fingertip that the motors' torques amount to, J^T F = tau (least squares
    for a redundant arm, its component along the arm's free direction for one joint or at full stretch).
    """
    jac = np.zeros((2, NMAX))
    q = np.zeros(NMAX)
    v = np.zeros(NMAX)
    for k in range(len(rows)):
        row = rows[k]
        for j in range(n):
            q[j] = row[first + j]
            v[j] = row[first + n + j]
            if p.shaft_on:
                v[n + j] = row[motors + n + j]
        jacobian(p, q, jac)
        for j in range(n):
            torques[k, 0, j] = torque_per_amp[j] * row[first + 3 * n + j]
            torques[k, 1, j] = jac[0, j] * row[first - 2] + jac[1, j] * row[first - 1]
            torques[k, 2, j] = row[first + 4 * n + j]
            torques[k, 3, j] = row[first + 5 * n + j]
            torques[k, 4, j] = row[first + 6 * n + j]
        energies[k, 0], energies[k, 1] = energy(p, nobody, q, v)
        energies[k, 2] = row[stored] if p.shaft_on else 0.0
        a = b = d = x = y = 0.0
        for j in range(n):
            a += jac[0, j] * jac[0, j]
            b += jac[0, j] * jac[1, j]
            d += jac[1, j] * jac[1, j]
            x += jac[0, j] * torques[k, 0, j]
            y += jac[1, j] * torques[k, 0, j]
        det = a * d - b * b
        if n > 1 and det > _FLAT * (a + d) * (a + d):
            push[k, 0] = (d * x - b * y) / det
            push[k, 1] = (a * y - b * x) / det
        else:
            push[k, 0] = x / (a + d)
            push[k, 1] = y / (a + d)


@entry(int, matrix, int, ArrayOf(np.float64, 3), matrix)
def works(
    n: int, rows: NDArray[np.float64], first: int, torques: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Work of each worker over each step [rows, 5] J; row 0 is zero."""
    for k in range(1, len(rows)):
        h = rows[k, 0] - rows[k - 1, 0]
        rule = rows[k, 1]
        for i in range(5):
            total = 0.0
            for j in range(n):
                g1, g0 = torques[k, i, j], torques[k - 1, i, j]
                v0, v1 = rows[k - 1, first + n + j], rows[k, first + n + j]
                a0, a1 = rows[k - 1, first + 2 * n + j], rows[k, first + 2 * n + j]
                c = 0.0
                if rule == 0.0:
                    g0 = g1
                    a0 = a1
                if i == _COULOMB:  # constant over a step, and changes at its end
                    total += torques[k - 1, i, j] * (rows[k, first + j] - rows[k - 1, first + j]) / h
                    continue
                elif rule == 2.0 and k > 1:
                    old = rows[k - 1, 0] - rows[k - 2, 0]
                    c = ((g1 - g0) / h - (g0 - torques[k - 2, i, j]) / old) / (h + old)
                for m in range(3):
                    x = _NODES[m]
                    y = 1.0 - x
                    g = g0 * y + g1 * x - c * h * h * x * y
                    v = y * y * (1 + 2 * x) * v0 + x * x * (3 - 2 * x) * v1 + h * x * y * (y * a0 - x * a1)
                    total += _WEIGHTS[m] * g * v
            out[k, i] = total * h


def summary(
    energies: NDArray[np.float64], totals: NDArray[np.float64], spring_j: NDArray[np.float64]
) -> dict[str, Any]:
    """Return the ledger of a run [J].

    Parameters
    ----------
    energies : [rows, 3] kinetic, gravity and shafts' energy, the last where there are shafts
    totals : [6] work of each worker over the run, in the order of `WORKS`; the last where there are shafts
    spring_j : [rows] energy stored in the analog springs as commanded

    Returns
    -------
    dict
        'start_j', 'end_j', 'work_j' by worker, 'spring_end_j', 'spring_max_j', 'turnover_j' (sum of all
        |work|), 'residual_j', 'closure' = |residual| / largest of turnover and energies, 'tolerance' and
        'closes'.
    """
    held = energies.sum(axis=1)
    residual = float(held[-1] - held[0] - totals.sum())
    scale = max(float(np.abs(totals).sum()), float(np.abs(held).max()), _LEAST_J)
    return {
        "start_j": float(held[0]),
        "end_j": float(held[-1]),
        "kinetic_end_j": float(energies[-1, 0]),
        "gravity_end_j": float(energies[-1, 1]),
        "work_j": {name: float(value) for name, value in zip(WORKS, totals, strict=False)},
        "spring_end_j": float(spring_j[-1]),
        "spring_max_j": float(spring_j.max()),
        "turnover_j": float(np.abs(totals).sum()),
        "residual_j": residual,
        "closure": abs(residual) / scale,
        "tolerance": CLOSURE,
        "closes": abs(residual) <= CLOSURE * scale,
    }
