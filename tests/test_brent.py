"""Roots and minima on a line against closed forms, and against scipy's own Brent."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from cosim.analysis.brent import minimum, root

#: Functions with one root in the bracket, and the root.
CROSSINGS = [
    (lambda x: x * x - 2.0, 0.0, 2.0, math.sqrt(2.0)),
    (lambda x: math.cos(x) - x, 0.0, 1.0, 0.7390851332151607),
    (lambda x: (x - 1.0) ** 9, -3.0, 7.5, 1.0),
    (lambda x: math.exp(x) - 1e9, 0.0, 700.0, math.log(1e9)),
    (lambda x: -1.0 if x < 0.3 else 1.0, -1.0, 1.0, 0.3),
    (lambda x: 1e-300 * math.atan(1e6 * (x - 0.25)), -1e5, 1.0, 0.25),
    (lambda x: math.log(x / 1234.5), 1.0, 1e7, 1234.5),
]


@pytest.mark.parametrize(("function", "low", "high", "exact"), CROSSINGS)
def test_a_root_is_found_by_the_same_steps_as_scipys(function, low, high, exact):
    """As near as is asked for; with the same points on the way, but for how a processor rounds."""
    ours, theirs = [], []
    for rtol, xtol in ((8.9e-16, 2e-12), (1e-9, 1e-300), (1e-6, 2e-12)):
        found = root(lambda x: ours.append(x) or function(x), low, high, rtol=rtol, xtol=xtol)
        known = brentq(
            lambda x: theirs.append(x) or function(x), low, high, rtol=rtol, xtol=xtol, maxiter=500
        )
        # a root of the ninth order is flat over eps^(1/9) of the bracket
        flat = 0.1 if exact == 1.0 else 0.0
        assert abs(found - exact) <= xtol + 2.0 * rtol * abs(exact) + flat
        assert abs(found - known) <= xtol + 2.0 * rtol * abs(exact) + flat
    assert ours == pytest.approx(theirs, rel=1e-6)


def test_a_root_at_an_end_is_the_end():
    assert root(lambda x: x - 3.0, 3.0, 5.0, xtol=1e-12) == 3.0
    assert root(lambda x: x - 3.0, 1.0, 3.0, xtol=1e-12) == 3.0


def test_no_root_is_made_up():
    with pytest.raises(ValueError, match=r"same sign at 0\.0 and 1\.0"):
        root(lambda x: 1.0 + x, 0.0, 1.0, xtol=1e-12)
    with pytest.raises(ValueError, match="no number at"):
        root(lambda x: math.nan if 0.0 < x < 1.0 else x - 0.5, 0.0, 1.0, xtol=1e-12)
    with pytest.raises(RuntimeError, match="no root was found"):
        root(lambda x: -1.0 if x < 0.0 else 1.0, -1e300, 1e299, rtol=0.0, xtol=0.0)


@pytest.mark.parametrize(
    ("function", "low", "high", "exact"),
    [
        (lambda x: (x - 1.0) ** 2 + 3.0, -2.0, 5.0, 1.0),
        (lambda x: -math.sin(x), 0.0, 3.0, math.pi / 2.0),
        (lambda x: abs(x - 0.125), -1.0, 1.0, 0.125),
        (lambda x: x, 2.0, 3.0, 2.0),
        (lambda x: -x, 2.0, 3.0, 3.0),
        (lambda x: x**4 - 3.0 * x**3 + 2.0, 0.5, 4.0, 2.25),
        (lambda x: 7.0, 0.0, 1.0, None),
    ],
)
def test_a_minimum_is_found_by_the_same_steps_as_scipys(function, low, high, exact):
    """A parabola is flat over the root of rounding about its minimum; scipy's answer is the same."""
    ours, theirs = [], []
    place, value = minimum(lambda x: ours.append(x) or function(x), low, high, xtol=1e-12)
    known = minimize_scalar(
        lambda x: theirs.append(float(x)) or function(x),
        bounds=(low, high), method="bounded", options={"xatol": 1e-12},
    )  # fmt: skip
    assert value == function(place)
    assert ours == pytest.approx(theirs, rel=1e-7)
    assert (place, value) == pytest.approx((known.x, known.fun), rel=1e-7)
    if exact is not None:
        assert place == pytest.approx(exact, abs=10.0 * math.sqrt(np.finfo(float).eps) * abs(exact))
