"""Memory of a step: the state of the circuit, and scratch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.loop.linear.step_maps import Ints, Matrix, Plan, Vector
from cosim.types import Array
from mech.records import NMAX


class StepMemory(NamedTuple):
    """State of the circuit and scratch memory of a step.

    Attributes
    ----------
    states : [before + after] states of the circuit at the accepted point
    features, results : inputs and outputs of the maps for the step on trial
    gains : [m] multiplier gains over the step
    nodes : [3 n] motor currents at the nodes, of what does not change between the sweeps
    matrix : [3 n, moving] motor currents at the nodes per unit of what changes; moved : [moving] that
    a, new : [3, NMAX] accelerations at the nodes of the step on trial, before and after a sweep
    a_new : [NMAX] scratch; error : [5] noise at both ends and the nodes
    last : [3, NMAX] coefficients of the accelerations' parabola of the accepted step
    work : [6] J by worker, of the step on trial; total : accepted
    scale : [0] h of the accepted step
    holds : [4, NMAX] torques that hold joints at rest, at the nodes and the end of the step on trial
    low : [NMAX] what rounding has left out of the angles [rad]: a stop away from zero is met by far less
    hit : [NMAX] -1, 0, +1: the joint that hits a stop which does not give
    clamp : [n] -1, 0, +1: the motor that is at its lowest or highest current
    current : [n] motor currents at the accepted point, not clamped
    before : [n] torques of the motors before what happens at the accepted point
    """

    states: Vector
    features: Vector
    results: Vector
    gains: Vector
    nodes: Vector
    matrix: Matrix
    moved: Vector
    a: Matrix
    a_new: Vector
    new: Matrix
    error: Vector
    last: Matrix
    work: Vector
    total: Vector
    scale: Vector
    holds: Matrix
    low: Vector
    hit: Ints
    clamp: Vector
    current: Vector
    before: Vector


def step_memory(k: Plan, states: Array) -> StepMemory:
    """Return scratch memory for a circuit whose states start at `states`."""
    n = k.n
    return StepMemory(
        states=states, features=np.zeros(k.features), results=np.zeros(k.results),
        gains=np.zeros(len(k.gain)), nodes=np.zeros(3 * n), matrix=np.zeros((3 * n, k.moving)),
        moved=np.zeros(k.moving), a=np.zeros((3, NMAX)), new=np.zeros((3, NMAX)), a_new=np.zeros(NMAX),
        error=np.zeros(5), last=np.zeros((3, NMAX)),
        work=np.zeros(6), total=np.zeros(6), scale=np.zeros(1), holds=np.zeros((4, NMAX)),
        low=np.zeros(NMAX), hit=np.zeros(NMAX, np.int64), clamp=np.zeros(n), current=np.zeros(n),
        before=np.zeros(n),
    )  # fmt: skip
