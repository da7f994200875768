"""Compiled energy of the mechanics: kinetic, and of gravity."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.compiled import entry, vector
from mech.records import LINKAGE, OPERATOR

Record = Any
Vector = NDArray[np.float64]


@entry(LINKAGE, OPERATOR, vector, vector, result=(float, float))
def energy(p: Record, op: Record, q: Vector, v: Vector) -> tuple[float, float]:
    """Kinetic and gravity energy [J], rotors and operator's mass included; not what shafts hold.

    Their sum changes by the work of tau, w.f_drive and w.tau_*. For the device alone pass a
    `NoOperator` record; the operator's work is then that of w.f_op. The weight of the operator's mass
    counts when the operator `falls`. Zero of the gravity energy: the robot's origin.
    """
    tip_mass = op.mass
    heavy_mass = op.mass * op.falls
    rotors = 0.0
    if p.shaft_on:
        for i in range(p.n):
            rotors += 0.5 * p.rotor[i] * v[p.n + i] * v[p.n + i]
    if p.slider:
        r = p.length[0]
        inertia = p.couple[0, 0] + tip_mass * r * r + p.armature[0]
        along = p.gravity[0] * p.direction[0] + p.gravity[1] * p.direction[1]
        lift = -(p.moment[0] + heavy_mass * r) * q[0] * along
        lift -= heavy_mass * (p.gravity[0] * p.origin[0] + p.gravity[1] * p.origin[1])
        return 0.5 * inertia * v[0] * v[0] + rotors, lift
    kinetic = rotors
    potential = -heavy_mass * (p.gravity[0] * p.origin[0] + p.gravity[1] * p.origin[1])
    phi = 0.0
    rate = 0.0
    for i in range(p.n):
        phi += q[i]
        rate += v[i]
        moment = p.moment[i] + heavy_mass * p.length[i]
        potential -= moment * (p.gravity[0] * math.cos(phi) + p.gravity[1] * math.sin(phi))
        kinetic += 0.5 * p.armature[i] * v[i] * v[i]
        kinetic += 0.5 * (p.couple[i, i] + tip_mass * p.length[i] * p.length[i]) * rate * rate
        turn = 0.0  # phi_i - phi_j, from the joint angles between them: no cancellation
        other = rate
        for j in range(i - 1, -1, -1):
            turn += q[j + 1]
            other -= v[j + 1]
            couple = p.couple[i, j] + tip_mass * p.length[i] * p.length[j]
            kinetic += couple * math.cos(turn) * rate * other
    return kinetic, potential
