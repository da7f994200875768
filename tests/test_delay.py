"""Delay of a spring, block by block: against formulas, the fitted model, and a known network."""

import numpy as np
import pytest
from extraction_boards import board, shipped

from cosim.circuits.delay import spring_delays
from cosim.ngspice.child import call

#: From netlists/: gain-bandwidths, multiplier's pole, winding.
TL072, OPA548, AD633 = 3e6, 1e6, 1e6
MOTOR_S = 1.5e-3 / 5.0


def extracted(deck):
    return call(
        "cosim.circuits.extraction:extract",
        {"board": deck, "model": "linear", "cache": False},
        deck=str(deck.path),
    )


def late(modes_a, b, c, d):
    """-H'(0)/H(0) of a state space."""
    x = np.linalg.solve(modes_a, b) if len(modes_a) else np.zeros((0, b.shape[1]))
    zeroth = d - (c @ x if len(modes_a) else 0.0)
    first = -(c @ np.linalg.solve(modes_a, x)) if len(modes_a) else np.zeros_like(d)
    return zeroth, first


def test_blocks_have_the_delays_of_their_formulas():
    """An amplifier of noise gain g is late by g/(2 pi GBW), its load and finite gain apart."""
    path = spring_delays(shipped(1, "gbw"))[0]
    assert [step.block for step in path.steps] == ["angle", "diffamp", "vca", "summer", "driver", "motor"]
    per_gain = 1.0 / (2.0 * np.pi * TL072)
    # noise gains: follower 1, difference amplifier 1 + 16.9, driver 1 + 2; the summing amplifier's three
    # input resistors (24.3k, 6.19k, 20k to 10k) make 1 + 10/24.3 + 10/6.19 + 10/20
    assert path.of("angle") == pytest.approx(per_gain, rel=5e-4)  # 1 Ohm into 5 kOhm: 2e-4
    assert path.of("diffamp") == pytest.approx(17.9 * per_gain, rel=1e-3)
    assert path.of("vca") == pytest.approx(1.0 / (2.0 * np.pi * AD633), rel=1e-3)
    summing = (1.0 + 10.0 / 24.3 + 10.0 / 6.19 + 10.0 / 20.0) * per_gain
    assert path.of("summer") == pytest.approx(summing, rel=2e-3)  # aol 2e5 and 0.1 Ohm of the multipliers
    assert path.of("driver") == pytest.approx(3.0 / (2.0 * np.pi * OPA548), rel=5e-3)  # aol 8e4, 5 Ohm load
    assert path.of("motor") == pytest.approx(MOTOR_S, rel=1e-6)


@pytest.mark.parametrize(("joints", "level", "driver"), [(1, "gbw", "current"), (2, "gbw", "voltage")])
def test_the_sum_is_the_whole_path_s_delay(joints, level, driver):
    """The fitted state space knows nothing of blocks; it is within its own error (1e-9), relative to 3e-4."""
    deck = shipped(joints, level, driver)
    circuit = extracted(deck)
    x0, x1 = late(circuit.a_pre, circuit.b_pre, circuit.c_pre, circuit.d_pre)
    y0, y1 = late(circuit.a_post, circuit.b_post, circuit.c_post, circuit.d_post)
    found = spring_delays(deck)
    assert [(path.joint, path.motor) for path in found] == [
        (j, i) for j in range(1, joints + 1) for i in range(1, joints + 1)
    ]
    for path in found:
        j, i = path.joint - 1, path.motor - 1
        c = i * joints + j
        whole = -(x1[c, j] / x0[c, j] + y1[i, c] / y0[i, c])
        assert path.total_s == pytest.approx(whole, rel=1e-5)
    if driver == "current":  # the amplifier leads what the winding lags: they are one loop
        assert found[0].steps[-1].block == "driver and motor"
        assert found[0].steps[-1].delay_s > 0.0


def test_op_amps_without_bandwidth_take_their_share_away():
    path = spring_delays(shipped(1, "ideal"))[0]
    # emf motor: no winding; what is left is gain 1e9 behind resistors, without any capacitor
    assert abs(path.total_s) < 1e-12


def test_a_known_lag_is_found_on_a_board_without_amplifiers(tmp_path):
    """1 ms before the multiplier, nothing after: all of it lies between pot and motor."""
    deck = board(tmp_path, spring="Ei xi0 0 u1 pot1 1\nRx xi0 x 1k\nCx x 0 1u")
    (path,) = spring_delays(deck)
    assert [step.block for step in path.steps] == ["motor"]
    assert path.total_s == pytest.approx(1e-3, rel=1e-6)  # read at a phase below 1e-3: cube 3e-7 of it
