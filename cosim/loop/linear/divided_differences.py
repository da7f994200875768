"""Divided differences of the exponential: what a cascade of poles makes of a polynomial input, exactly.

With nodes a, b (poles times the step) and r zeros (integrators: those that make t^k of a constant, and
those that take moments of the output)

    F_r(a) = exp[a, 0 .. 0],    G_r(a, b) = exp[a, b, 0 .. 0]

F_r is the phi function of exponential integrators. No matrix is exponentiated, so nothing depends on how
fast a pole is: small nodes by Taylor series and downward recurrence, large ones by upward recurrence, each
in the direction in which errors shrink (Higham, Functions of Matrices, 2008, section 10.7; Al-Mohy and
Higham 2011).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mech.compiled import ArrayOf, entry, inner

#: Largest number of zeros among the nodes: degree four of the input, its own integration, three moments.
TOP = 8
#: Below this modulus the Taylor series: 30 terms leave 3^30/38! = 4e-31, cancellation costs less than e^3.
_NEAR, _TERMS = 3.0, 30
_INVERSE_FACTORIAL = np.array([1.0 / float(np.prod(np.arange(1.0, k + 1))) for k in range(TOP + _TERMS + 2)])

Array = Any


@inner
def expm1(z: complex) -> complex:
    """Return exp(z) - 1 without cancellation at small z."""
    if abs(z) < 0.5:
        total = 0.0 * z
        for k in range(18, 0, -1):
            total = (total + _INVERSE_FACTORIAL[k]) * z
        return complex(total)
    return complex(np.exp(z) - 1.0)


@entry(complex, ArrayOf(np.complex128, 1))
def single(z: complex, out: Array) -> None:
    """Fill `out[r]` with F_r(z), r = 0 .. TOP; `z` of any size whose exponential does not overflow."""
    if abs(z) <= _NEAR:
        total = 0.0 * z
        for k in range(_TERMS, -1, -1):
            total = total * z + _INVERSE_FACTORIAL[k + TOP]
        out[TOP] = total
        for r in range(TOP - 1, 1, -1):
            out[r] = z * out[r + 1] + _INVERSE_FACTORIAL[r]
        out[1] = z * out[2] + 1.0
        out[0] = np.exp(z)
        return
    out[0] = np.exp(z)
    for r in range(TOP):
        out[r + 1] = (out[r] - _INVERSE_FACTORIAL[r]) / z


@entry(ArrayOf(np.complex128, 1), ArrayOf(np.complex128, 2))
def singles(z: Array, out: Array) -> None:
    """Fill each row of `out` with what `single` makes of one of `z`."""
    for i in range(len(z)):
        single(z[i], out[i])


@entry(complex, complex, ArrayOf(np.complex128, 1), ArrayOf(np.complex128, 1), ArrayOf(np.complex128, 1))
def double(a: complex, b: complex, of_a: Array, of_b: Array, out: Array) -> None:
    """Fill `out[r]` with G_r(a, b), r = 0 .. TOP; `of_a` and `of_b` as `single` fills them."""
    if abs(a) <= _NEAR and abs(b) <= _NEAR:
        # sum over j of the complete homogeneous polynomial of a, b of degree j, over (j + TOP + 1)!
        power = 1.0 + 0.0 * b
        symmetric = 1.0 + 0.0 * a
        total = symmetric * _INVERSE_FACTORIAL[TOP + 1]
        for j in range(1, _TERMS + 1):
            power = power * b
            symmetric = symmetric * a + power
            total += symmetric * _INVERSE_FACTORIAL[j + TOP + 1]
        out[TOP] = total
        for r in range(TOP - 1, -1, -1):
            out[r] = of_b[r + 1] + a * out[r + 1]
        return
    gap = a - b
    if abs(gap) < 1.0:
        out[0] = of_b[0] * (expm1(gap) / gap if gap != 0.0 else 1.0)
    else:
        out[0] = (of_a[0] - of_b[0]) / gap
    if abs(a) >= abs(b):
        for r in range(TOP):
            out[r + 1] = (out[r] - of_b[r + 1]) / a
    else:
        for r in range(TOP):
            out[r + 1] = (out[r] - of_a[r + 1]) / b
