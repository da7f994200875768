"""The model as the time loop uses it: its shapes, its limits, and a gain step against ngspice."""

from dataclasses import replace

import numpy as np
import pytest
from extraction_boards import board, extract, in_child, shipped
from scipy.linalg import expm

from cosim.circuits.linear_circuit import LinearCircuit, channel_names


def blank(joints=1, **more):
    """A circuit of nothing, of the right shapes."""
    n, m = joints, 2 * joints**2
    arrays = {
        "a_pre": np.zeros((0, 0)), "b_pre": np.zeros((0, 2 * n)), "c_pre": np.zeros((m, 0)),
        "d_pre": np.zeros((m, 2 * n)), "e_pre": np.zeros((m, n)), "gain": np.zeros(m),
        "a_post": np.zeros((0, 0)), "b_post": np.zeros((0, m + 2 * n)), "c_post": np.zeros((n, 0)),
        "d_post": np.zeros((n, m + 2 * n)), "offset": np.zeros(n),
        "limit": np.tile([-np.inf, np.inf], (n, 1)),
    } | more  # fmt: skip
    return LinearCircuit(joints, "linear", **arrays)


def test_channels_are_springs_then_dampers_row_by_row():
    assert channel_names(2) == ["ksp11", "ksp12", "ksp21", "ksp22", "ksd11", "ksd12", "ksd21", "ksd22"]


def test_wrong_shapes_and_numbers_are_refused():
    with pytest.raises(ValueError, match="gain has the shape"):
        blank(gain=np.zeros(3))
    with pytest.raises(ValueError, match="offset is not finite"):
        blank(offset=np.array([np.nan]))
    with pytest.raises(ValueError, match="limit is not finite"):
        blank(limit=np.array([[np.nan, 1.0]]))
    assert blank(2).order == 0


def test_response_of_a_circuit_written_by_hand():
    circuit = blank(
        d_pre=np.array([[-1.0, 2.0], [0.0, 0.0]]), e_pre=np.array([[0.0], [-0.5]]), gain=np.array([0.1, 0.2]),
        d_post=np.array([[3.0, 4.0, 5.0, -6.0]]),
    )  # fmt: skip
    value = circuit.response(2j, np.array([10.0, 1.0]))[0, 0]
    assert value == pytest.approx([-3.0 - 0.5 * 2j * 0.2 * 4, 6.0, 5.0, -6.0])


def test_linear_goes_to_ideal_as_frequency_goes_to_zero():
    deck = shipped(2, "gbw")
    ideal, linear = extract(deck, "ideal"), extract(deck)
    s = 1e-3j  # rad/s; the slowest pole is at 634 rad/s: error s/634 = 2e-6
    volts = np.linspace(1.0, 8.0, 8)
    one, two = ideal.before(s)[0], linear.before(s)[0]
    assert np.abs(one - two)[:4].max() < 2e-6 * np.abs(one)[:4].max()
    assert np.abs(one - two)[4:].max() < 2e-6 * np.abs(one)[4:].max()
    assert np.abs(ideal.response(s, volts) - linear.response(s, volts)).max() < 1e-6 * 10.0


@pytest.mark.parametrize("model", ["ideal", "linear"])
def test_footnote_is_true(model):
    deck = shipped(1, "gbw")
    band = 100.0
    promise = extract(deck, model, band_hz=band, tolerance=1e-3).certificate["footnote_1"]
    full, ideal = extract(deck), extract(deck, "ideal")
    s = 2j * np.pi * np.linspace(0.01, band, 2000)
    truth, gains = full.response(s, np.array([10.0, 0.0])), ideal.response(s, np.array([10.0, 0.0]))
    spring = np.abs(truth - gains)[:, 0, 0].max() / np.abs(truth[:, 0, 0]).max()
    command = np.abs(truth - gains)[:, 0, 2].max() / np.abs(truth[:, 0, 2]).max()
    truth, gains = full.response(s, np.array([0.0, 10.0])), ideal.response(s, np.array([0.0, 10.0]))
    damper = np.abs(truth - gains)[:, 0, 0].max() / np.abs(truth[:, 0, 0]).max()
    # the bound is that of both sides of the multiplier together, so it may be larger, but not by much
    for name, each in (("spring", spring), ("command", command), ("damper", damper)):
        assert each <= promise["error"][name] <= 1.3 * each, name
    assert "at most" in promise["sentence"]


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-6])
def test_reduced_model_keeps_its_promise(tolerance):
    deck = shipped(2, "full")
    band = 2e3
    small, full = extract(deck, band_hz=band, tolerance=tolerance), extract(deck)
    certificate = small.certificate
    assert certificate["error"] <= tolerance
    assert certificate["order"] == small.order < full.order == certificate["full_order"]
    s = 2j * np.pi * np.linspace(1.0, band, 1000)
    for channel in (0, 3, 4, 7):
        volts = np.zeros(8)
        volts[channel] = 10.0
        one, two = small.response(s, volts), full.response(s, volts)
        top = np.abs(two).max(axis=0)
        # the product of two maxima may lie above the maximum of the product: 2 is ample for these low-passes
        assert (
            np.abs(one - two).max(axis=0) <= 2 * certificate["error"] * np.maximum(top, 1e-4 * top.max())
        ).all()
    assert (small.poles.real < 0).all()


def test_looser_tolerance_takes_fewer_states():
    deck = shipped(1, "full")
    orders = [extract(deck, band_hz=1e3, tolerance=t).order for t in (1e-1, 1e-2, 1e-4, 1e-7)]
    assert orders == sorted(orders)
    assert orders[0] <= 3  # the differentiator's corner and L/R are slow; nothing else is
    assert orders[-1] <= extract(deck).order


def propagate(circuit, times, u, gains):
    """Currents at `times` for a constant u from rest, the spring's gain pin following `gains(t)` in steps.

    Exact between the steps: X is an exponential response, w = gain X Y feeds the second network.
    """
    before, after = len(circuit.a_pre), len(circuit.a_post)
    out = np.zeros(len(times))
    state = np.linalg.solve(-circuit.a_pre, circuit.b_pre @ [0.0, u]) if before else np.zeros(0)
    x = (circuit.c_pre @ state + circuit.d_pre @ [0.0, u])[0]  # u has stood for long: X is at rest
    inside, now = np.zeros(after), 0.0
    for k, t in enumerate(times):
        w = circuit.gain[0] * x * gains(0.5 * (now + t))
        drive = np.zeros(circuit.b_post.shape[1])
        drive[0] = w
        rest = np.linalg.solve(-circuit.a_post, circuit.b_post @ drive)
        inside = rest + expm(circuit.a_post * (t - now)) @ (inside - rest)
        out[k] = (circuit.c_post @ inside + circuit.d_post @ drive)[0]
        now = t
    return out


def test_gain_step_passes_through_summer_driver_and_motor_only():
    # u stands at 0.2 V; at 1 ms the spring's gain steps from 0 to 5 V
    deck = shipped(1, "gbw")
    u, level, at = 0.2, 5.0, 1e-3
    rise = 1e-9
    table = in_child(
        "extraction_boards:step_response",
        {
            "board": deck,
            "sources": {"u1": f"dc {u}", "ksp11": f"pwl(0 0 {at} 0 {at + rise} {level})"},
            "tran": "tran 2u 4m 0 2u",
        },
    )
    times, current = table[1:, 0], table[1:, 1]
    circuit = extract(deck)
    mine = propagate(circuit, times, u, lambda t: level * min(max((t - at) / rise, 0.0), 1.0))
    # second-order Gear with steps of 2 us on poles of 3e3 and (settling within a step) 2e6 rad/s
    assert np.abs(mine - current).max() < 1e-3 * np.abs(current).max()
    # one lumped model before the multiplier would jump at once
    soon = times[times > at + 2e-5][0]
    assert abs(np.interp(soon, times, current)) < 0.1 * np.abs(current).max()


def test_models_carry_the_same_limit():
    deck = shipped(2, "full")
    ideal, linear = extract(deck, "ideal"), extract(deck)
    assert (ideal.limit == linear.limit).all()
    # OPA548 with r_ilim = 22.1k: 1.987 A by its formula, a diode's knee below it
    assert (np.abs(ideal.limit) < 2.0).all()
    assert (np.abs(ideal.limit) > 1.9).all()
    assert ideal.certificate["current_limited"]


def test_certificate_is_json():
    import json

    promise = extract(shipped(1, "gbw"), band_hz=1e3, tolerance=1e-3).certificate
    assert json.loads(json.dumps(promise, allow_nan=False)) == promise


def test_circuit_survives_a_pickle(tmp_path):
    import pickle

    circuit = extract(board(tmp_path))
    again = pickle.loads(pickle.dumps(circuit))
    for name, value in circuit.arrays().items():
        assert (value == again.arrays()[name]).all()
    assert replace(circuit, certificate={}).certificate == {}
