"""The rules of the integrator are exact for the accelerations that they interpolate: their coefficients."""

import numpy as np
import pytest

from cosim.loop.spice.adams import correct, predict
from cosim.loop.state import STATE

Q0, V0, OLD, H = 0.3, -1.2, 0.7e-3, 1.1e-3


def moved(acceleration, h):
    """Angle and speed [rad, rad/s] after `h` s under a polynomial acceleration [rad/s^2]."""
    speed = acceleration.integ(k=V0)
    return speed.integ(k=Q0)(h), speed(h)


def at(acceleration, history):
    s = np.zeros(1, STATE)[0]
    s["coordinates"], s["history"], s["h_old"] = 1, history, OLD
    s["q"][0], s["v"][0] = Q0, V0
    s["a"][0], s["a_old"][0] = acceleration(0.0), acceleration(-OLD)
    return s


@pytest.mark.parametrize(("history", "degree"), [(0, 0), (1, 0), (2, 1)])
def test_predictor_is_exact_to_its_degree(history, degree):
    acceleration = np.polynomial.Polynomial([40.0, 3e4, -2e7][: degree + 1])
    q, v = np.zeros(1), np.zeros(1)
    predict(at(acceleration, history), H, q, v)
    assert (q[0], v[0]) == pytest.approx(moved(acceleration, H), rel=1e-14)


@pytest.mark.parametrize(("history", "degree"), [(0, 0), (1, 1), (2, 2)])
def test_corrector_is_exact_to_its_degree(history, degree):
    acceleration = np.polynomial.Polynomial([40.0, 3e4, -2e7][: degree + 1])
    s = at(acceleration, history)
    correct(s, H, np.array([acceleration(H)]), H, True)
    assert (s["q"][0], s["v"][0]) == pytest.approx(moved(acceleration, H), rel=1e-14)


def test_behind_a_jump_the_corrector_holds_the_new_acceleration():
    s = at(np.polynomial.Polynomial([40.0]), 0)
    correct(s, H, np.array([-500.0]), H, True)
    assert (s["q"][0], s["v"][0]) == pytest.approx(moved(np.polynomial.Polynomial([-500.0]), H), rel=1e-14)


def test_defect_is_what_the_predictor_got_wrong():
    acceleration = np.polynomial.Polynomial([40.0, 3e4, -2e7])
    s = at(acceleration, 2)
    q, v = np.zeros(1), np.zeros(1)
    predict(s, H, q, v)
    s["q_trial"][0], s["v_trial"][0] = q[0], v[0]
    defect = correct(s, H, np.array([acceleration(H)]), H, True)
    exact = moved(acceleration, H)
    # as accurate as the difference of two numbers of order one
    assert defect == pytest.approx(abs(exact[0] - q[0]) + H * abs(exact[1] - v[0]), abs=1e-15)


@pytest.mark.parametrize("trapezoids", [0, 1])
def test_impulse_of_a_settling_current_has_no_error_by_the_rule_that_the_circuit_has(trapezoids):
    """L di/dt = 1 - i by trapezoids of growing steps, i an acceleration: its integral is t - L i, exactly."""
    inductance, i, v, t = 1.0, 0.0, 0.0, 0.0
    s = at(np.polynomial.Polynomial([0.0]), 1)
    s["v"][0], s["steps"]["trapezoids"] = 0.0, trapezoids
    for h in np.geomspace(0.01, 1.0, 20):
        z = h / inductance
        new = (i * (1.0 - z / 2.0) + z) / (1.0 + z / 2.0)
        correct(s, h, np.array([new]), h, True)
        s["a_old"][0], s["a"][0], s["h_old"], s["history"] = i, new, h, 2
        i, t = new, t + h
    v = float(s["v"][0])
    exact = t - inductance * i
    if trapezoids:
        assert v == pytest.approx(exact, rel=1e-13)
    else:
        assert abs(v - exact) > 1e-3  # what the parabola makes of the same points
