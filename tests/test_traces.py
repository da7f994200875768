"""Signals between their rows: integrals, peaks and shares of known functions, whatever the rows."""

import math

import numpy as np
import pytest

from cosim.signal_statistics import Spans, Trace, changes, together


def grid(h: float, end: float, seed: int = 0) -> np.ndarray:
    """Rows about `h` apart, unevenly so."""
    steps = np.random.default_rng(seed).uniform(0.5, 1.5, math.ceil(3 * end / h)) * h
    t = np.concatenate([[0.0], np.cumsum(steps)])
    return np.append(t[t < end - 0.2 * h], end)


def smooth(t: np.ndarray) -> np.ndarray:
    return np.zeros(len(t) - 1, bool)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("turns", [20, 200])
def test_a_sine(known: bool, turns: int) -> None:
    """Means, squares, tops and shares of sin t over 0 to 7 rad, rows 2 pi/turns apart on average.

    With known slopes a cubic is off by h^4/384 of the fourth derivative; with those of parabolas by
    h^3/(9 sqrt 3) of the third at most, 1.5 h being the longest step.
    """
    h = 2 * math.pi / turns
    t = grid(h, 7.0)
    trace = Trace(t, np.sin(t), smooth(t), slope=np.cos(t) if known else None)
    bound = (1.5 * h) ** 4 / 384 if known else (1.5 * h) ** 3 / (9 * math.sqrt(3))
    assert trace.mean() == pytest.approx((1 - math.cos(7.0)) / 7.0, abs=bound)
    assert trace.mean_square() == pytest.approx(0.5 - math.sin(14.0) / 28.0, abs=2 * bound)
    assert trace.peak() == pytest.approx(1.0, abs=bound)
    above = trace.above(0.5)
    expected = [math.pi / 6, 5 * math.pi / 6, 2 * math.pi + math.pi / 6]
    assert [above.begin[0], above.end[0], above.begin[1]] == pytest.approx(expected, abs=2 * bound)
    assert above.end[-1] == 7.0
    over = trace.mean_over(Spans(above.begin[:1], above.end[:1]))
    assert over == pytest.approx(math.sqrt(3) / (2 * math.pi / 3), abs=3 * bound)
    part = trace.cut(1.0, 2.0)
    assert part.mean() == pytest.approx(math.cos(1.0) - math.cos(2.0), abs=bound)
    assert part.peak() == pytest.approx(1.0, abs=bound)
    late = trace.peak(Spans(np.array([2.0]), np.array([3.0])))
    assert late == pytest.approx(math.sin(2.0), abs=2 * bound)  # it falls: largest where the span begins


def test_a_jump_is_taken_with_its_right_hand_value() -> None:
    """1 up to t = 1, then 3 - t: the row at 1 holds the left limit, the next one stands shortly behind."""
    t = np.concatenate([np.linspace(0.0, 1.0, 5), 1.0 + np.array([1e-3, 8e-3, 0.3, 0.7, 1.0])])
    y = np.where(t <= 1.0, 1.0, 3.0 - t)
    dac = np.where(t <= 1.0, 0.0, 5.0)
    trace = Trace(t, y, changes([dac], len(t)))
    # over the step of 1 ms the value is that of its end: off by 1e-3 squared over two
    assert trace.mean() == pytest.approx((1.0 + 1.5) / 2.0, abs=5.1e-7)
    assert trace.peak() == pytest.approx(3.0 - 1.001, abs=1e-12)
    assert trace.above(1.5).length == pytest.approx(0.5, abs=1e-9)


def test_two_rows_at_one_time_are_a_jump_as_well() -> None:
    t, y = np.array([0.0, 1.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0, 1.0])
    trace = Trace(t, y, changes([y], 4))
    assert trace.mean() == pytest.approx(0.5, abs=1e-15)
    assert trace.above(0.5).length == pytest.approx(1.0, abs=1e-15)


def test_a_signal_at_its_limit_has_no_top_above_it() -> None:
    t = np.linspace(0.0, 2.0, 21)
    trace = Trace(t, np.minimum(t * t, 1.0), smooth(t))
    assert trace.peak() == 1.0


def test_what_noise_bends_is_straight_between_rows() -> None:
    t = np.arange(101.0)
    y = np.random.default_rng(1).normal(size=101)
    trace = Trace(t, y, smooth(t), bent=True)
    assert trace.mean() == pytest.approx(np.trapezoid(y, t) / 100.0, abs=1e-13)
    assert trace.peak() == y.max()
    crossings = np.flatnonzero(np.diff(np.sign(y)) != 0)
    assert len(trace.above(0.0).begin) == math.ceil((len(crossings) + (y[0] > 0)) / 2)


def test_a_dip_between_two_rows_is_seen() -> None:
    """A parabola that is above its level between two rows only: known slopes tell."""
    t = np.array([0.0, 1.0, 2.0, 3.0])
    y, slope = 0.1 - (t - 1.5) ** 2, -2 * (t - 1.5)
    trace = Trace(t, y, smooth(t), slope=slope)
    assert trace.peak() == pytest.approx(0.1, abs=1e-15)
    assert trace.above(0.0).length == pytest.approx(2 * math.sqrt(0.1), abs=1e-14)


def test_spans_together() -> None:
    one = Spans(np.array([0.0, 4.0]), np.array([1.0, 5.0]))
    two = Spans(np.array([0.5, 7.0]), np.array([2.0, 8.0]))
    both = together([one, two])
    assert both.begin.tolist() == [0.0, 4.0, 7.0]
    assert both.end.tolist() == [2.0, 5.0, 8.0]
    assert together([Spans(np.zeros(0), np.zeros(0))]).length == 0.0


@pytest.mark.parametrize("rows", [1, 2])
def test_a_run_of_a_row_or_two(rows: int) -> None:
    t = np.arange(float(rows))
    trace = Trace(t, np.full(rows, 2.0), smooth(t) if rows > 1 else np.zeros(0, bool))
    assert trace.mean() == 2.0
    assert trace.peak() == 2.0
    assert trace.mean_square() == 4.0
    assert trace.above(1.0).length == float(rows - 1)


def test_no_parabola_goes_across_a_kink() -> None:
    """Level to t = 1, then exp: a row at the kink, one 1e-5 behind it, and steps of 0.05 before."""
    t = np.concatenate(
        [np.linspace(0.0, 1.0, 21), 1.0 + np.array([1e-5, 1e-4, 1e-3]), np.linspace(1.01, 2.0, 100)]
    )
    y = np.where(t < 1.0, 0.0, np.expm1(-20.0 * (t - 1.0)))
    kinks = t == 1.0
    exact = (1 - math.exp(-20.0)) / 20.0 - 1.0
    assert 2.0 * Trace(t, y, smooth(t), kinks=kinks).mean() == pytest.approx(exact, abs=2e-5)
    # one that nobody tells of is seen by itself: the parabola across is by far the more curved one
    assert 2.0 * Trace(t, y, smooth(t)).mean() == pytest.approx(exact, abs=2e-5)


@pytest.mark.parametrize("gap", [1.0, 2.0, 3.0, 5.0, 20.0])
def test_what_settles_faster_than_rows_follow_has_no_top_behind_it(gap: float) -> None:
    """1 - exp(-t) - 1e-4 t behind a kink, rows `gap` time constants apart: its top is at t = ln 1e4."""
    t = np.concatenate([np.linspace(-5.0, 0.0, 6), gap * np.arange(1, 60)])
    y = np.where(t <= 0.0, 0.0, -np.expm1(-t) - 1e-4 * t)
    peak = 1.0 - 1e-4 - 1e-4 * math.log(1e4)
    result = Trace(t, y, smooth(t), kinks=t == 0.0).peak()
    # rows alone show all but exp(-gap) and 1e-4 gap of it; nothing is invented on top but a parabola's error
    assert -math.exp(-gap) - 1e-4 * gap <= result - peak <= 5e-3 * min(1.0, 2.0 / gap)


def test_a_dac_that_is_an_ulp_of_time_early_at_the_end_of_a_ramp_holds() -> None:
    end = 0.14839280000000002
    volts = np.array([0.0, 0.0, end * (1 - 4e-13), end, end])
    assert changes([volts], 5).tolist() == [False, True, False, False]
    assert changes([np.array([1.0 - 2.0**-29, 1.0])], 2).tolist() == [True]  # the least that a DAC can do


def test_a_span_within_another_adds_nothing() -> None:
    both = together([Spans(np.array([0.0, 20.0]), np.array([10.0, 21.0])),
                     Spans(np.array([1.0, 3.0]), np.array([2.0, 4.0]))])  # fmt: skip
    assert both.begin.tolist() == [0.0, 20.0]
    assert both.end.tolist() == [10.0, 21.0]


@pytest.mark.parametrize("crossing", [0.5, 1e-4, 0.9995, 1.0])
def test_a_crossing_of_a_cubic_that_is_nearly_straight_is_exact(crossing: float) -> None:
    """t + 1e-5 t^3, its slopes known: without its cubic term the crossing at 0.5 is off by 1.25e-6."""
    t = np.array([0.0, 1.0, 2.0])
    trace = Trace(t, t + 1e-5 * t**3, smooth(t), slope=1.0 + 3e-5 * t**2)
    begin = trace.above(crossing + 1e-5 * crossing**3).begin
    assert begin == pytest.approx([crossing], abs=1e-12)


def test_a_part_keeps_what_its_signal_is() -> None:
    """A part of noise is straight between its rows, and a part with a kink has it where it was."""
    t, y = np.arange(11.0), np.random.default_rng(2).normal(size=11)
    noise = Trace(t, y, smooth(t), bent=True)
    inner = np.trapezoid(y[2:9], t[2:9])
    halves = [(y[1] + 3 * y[2]) / 8, (3 * y[8] + y[9]) / 8]  # half a step before and behind
    assert noise.cut(1.5, 8.5).mean() == pytest.approx((inner + sum(halves)) / 7.0, abs=1e-14)
    t = np.linspace(0.0, 2.0, 9)
    bend = Trace(t, np.where(t < 1.0, t - 1.0, (t - 1.0) ** 2), smooth(t), kinks=t == 1.0)
    assert bend.cut(0.5, 1.5).mean() == pytest.approx(-1 / 8 + 1 / 24, abs=1e-15)


@pytest.mark.parametrize("step", [0.5, np.nextafter(0.5, 1.0)])  # the last bit of one is even, of one odd
def test_a_part_jumps_where_its_signal_does(step: float) -> None:
    """The middle of a jump's step, one number long, is one of its ends: by it a part knew no jump there."""
    t = np.array([0.0, 0.25, step, step, 0.75, 1.0])
    jump = Trace(t, np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), smooth(t))
    assert jump.cut(0.3, 0.7).mean() == pytest.approx(0.5, abs=1e-15)
    assert jump.cut(0.3, 0.7).mean_square() == pytest.approx(0.5, abs=1e-15)


def test_the_peak_within_spans_is_that_of_their_rows_as_well() -> None:
    t, y = np.arange(5.0), np.array([0.0, 1.0, 5.0, 2.0, 9.0])
    trace = Trace(t, y, smooth(t), bent=True)
    assert trace.peak(Spans(np.array([0.5]), np.array([3.5]))) == 5.5  # straight from 2 to 9 at the end
    assert trace.peak(Spans(np.array([1.5]), np.array([2.5]))) == 5.0


def test_a_step_between_two_kinks_is_straight() -> None:
    t, y = np.arange(4.0), np.array([0.0, 0.0, 1.0, 1.0])
    trace = Trace(t, y, smooth(t), kinks=np.array([False, True, True, False]))
    assert trace.mean() == pytest.approx(0.5, abs=1e-15)
    assert trace.mean_square() == pytest.approx((1 / 3 + 1.0) / 3.0, abs=1e-15)


def test_behind_a_kink_begins_a_parabola_of_its_own() -> None:
    """t - 1 up to t = 1, then (t - 1)^2: both are exact, though no parabola about the kink is bent."""
    t = np.arange(5.0)
    y = np.where(t < 1.0, t - 1.0, (t - 1.0) ** 2)
    assert Trace(t, y, smooth(t), kinks=t == 1.0).mean() == pytest.approx((9.0 - 0.5) / 4.0, abs=1e-14)
