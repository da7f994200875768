"""Chains of poles: poles near to each other share one set of states instead of large residues that cancel.

A chain of first and second order sections in a row is driven by 1; its states are a basis of what its poles
make.
"""

from __future__ import annotations

import numpy as np

from cosim.types import Array, Complex

__all__ = ["NEAR", "chain_basis", "chain_matrices", "chained", "least_squares", "states_of"]


#: Poles nearer to each other than this (relative) share a chain instead of having residues of their own.
NEAR = 0.01


def states_of(pole: complex) -> int:
    """Return how many real states a pole has, with its conjugate."""
    return 2 if pole.imag else 1


def chained(poles: Complex) -> list[list[complex]]:
    """Group poles that lie near to each other, by ascending magnitude."""
    chains: list[list[complex]] = []
    for pole in poles[np.argsort(np.abs(poles))].tolist():
        near = [c for c in chains if any(abs(pole - other) < NEAR * abs(pole) for other in c)]
        merged = [other for chain in near for other in chain] + [pole]
        chains = [chain for chain in chains if chain not in near] + [merged]
    return chains


def chain_basis(s: Complex, chains: list[list[complex]]) -> Complex:
    """Return 1 and the states of the chains driven by 1; shape [F, 1 + states]."""
    columns = [np.ones(len(s), complex)]
    for chain in chains:
        drive = np.ones(len(s), complex)
        for pole in chain:
            size = abs(pole)
            if pole.imag:
                drive = drive * size**2 / (s * s - 2.0 * pole.real * s + size**2)
                columns += [drive, drive * s / size]
            else:
                drive = drive * size / (s - pole.real)
                columns.append(drive)
    return np.stack(columns, axis=1)


def chain_matrices(chain: list[complex]) -> tuple[Array, Array]:
    """Return A and B of a chain, whose states `chain_basis` evaluates."""
    size = sum(states_of(pole) for pole in chain)
    a, b = np.zeros((size, size)), np.zeros(size)
    at, previous = 0, None
    for pole in chain:
        rate = abs(pole)
        if pole.imag:
            a[at : at + 2, at : at + 2] = [[0.0, rate], [-rate, 2.0 * pole.real]]
            driven = at + 1
        else:
            a[at, at] = pole.real
            driven = at
        if previous is None:
            b[driven] = rate
        else:
            a[driven, previous] = rate
        previous = at
        at += states_of(pole)
    return a, b


def least_squares(basis: Complex, f: Complex) -> Array:
    """Return real weights [1 + states, paths] that make `basis @ weights` nearest to `f`."""
    left = np.concatenate([basis.real, basis.imag])
    right = np.concatenate([f.real, f.imag])
    size = np.abs(left).max(axis=0)
    size[size == 0.0] = 1.0  # a pole so far away or so near to 0 that nothing is left of it
    out: Array = np.linalg.lstsq(left / size, right, rcond=1e-15)[0] / size[:, None]
    return out
