"""Board and linkage as one system, against the roots of their characteristic polynomial."""

import numpy as np
import pytest

from cosim.circuits.extraction.motor_response import MotorResponse
from cosim.coupled_poles import growing, hidden

HZ = np.geomspace(1e-3, 1e9, 121)
S = 2j * np.pi * HZ


def late_spring(stiffness, tau, brake):
    """A board of one joint: a spring behind a lag, and a back-EMF; 1 N m/A and no gear."""
    rest = np.zeros((len(HZ), 1, 2), complex)
    rest[:, 0, 1] = -brake
    channel = (-stiffness / (1.0 + S * tau)).reshape(-1, 1, 1, 1)
    return MotorResponse(HZ, rest, channel, np.zeros(1), 10.0, ("ksp11",))


@pytest.mark.parametrize(("tau", "unstable"), [(0.9e-5, False), (1.1e-5, True)])
def test_a_late_spring_turns_unstable_where_routh_says(tau, unstable):
    # m tau s^3 + (m + b tau) s^2 + b s + k: stable for (m + b tau) b > m tau k, here tau < b/k (1 + ...)
    m, b, k = 1e-4, 1e-2, 1000.0
    roots = np.roots([m * tau, m + b * tau, b, k])
    assert (roots.real.max() > 0.0) == unstable
    result = growing(
        late_spring(k, tau, b), {"ksp11": 10.0}, np.array([[m]]), np.zeros((1, 1)), np.ones(1), 1.0
    )
    assert bool(result) == unstable
    if unstable:
        worst = roots[np.argmax(roots.real)]
        assert abs(complex(result[0].real, abs(result[0].imag)) - complex(worst.real, abs(worst.imag))) <= (
            0.05 * abs(worst)  # as two fits must agree
        )
        assert hidden(result, 1e-3)[0].code == "coupling-unstable"
        assert not hidden(result, 1e-5)  # such steps show it
    assert not growing(late_spring(k, tau, b), {}, np.array([[m]]), np.zeros((1, 1)), np.ones(1), 1.0)
