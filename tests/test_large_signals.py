"""Boards whose gain at rated current is another than at rest: told, or refused, by their `.dc` sweep."""

from types import SimpleNamespace

import numpy as np
import pytest
from extraction_boards import board, extract, shipped

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction import limits_and_offsets
from cosim.circuits.extraction.certificate import cautions
from cosim.circuits.extraction.large_signal import large_signal_error
from cosim.circuits.extraction.large_signal import measure as bends
from cosim.circuits.extraction.limits_and_offsets import current_limits
from cosim.circuits.extraction.motor_response import measure
from cosim.circuits.extraction.path_measurement import Session
from cosim.errors import InputError, NoOperatingPoint, Problem
from cosim.ngspice.deck import PartSwap
from cosim.plausibility import of_circuit, of_response

RATED = 0.5


def board_with(folder, current):
    """Board of one joint with a current of the sum s of what its multipliers give."""
    total = "(v(ws)+v(wd)+v(cmd1)-0.01*v(vel1))"
    return board(
        folder,
        top=f".param i_rated={RATED}\n.csparam i_rated={{i_rated}}",
        output=f"Bs s 0 V={total}\nBi imot1 0 V={current}",
    )


def bent_board(folder, cubic):
    """Board with i = s + cubic s^3."""
    return board_with(folder, f"v(s)+{cubic!r}*v(s)*v(s)*v(s)")


def error_of(session):
    return large_signal_error(session, current_limits(session))


@pytest.mark.parametrize("cubic", [0.0, 0.1, -0.2, 1.0])
def test_the_error_is_that_of_the_cubic_at_rated_current(tmp_path, cubic):
    # at full scale u goes to the sum with gain 1, so that the sweep ends at s = i_rated
    error, pin = error_of(Session(bent_board(tmp_path, cubic)))
    assert error == pytest.approx(abs(cubic) * RATED**3 / RATED, rel=1e-6, abs=1e-12)
    assert pin == ("ksp11" if cubic else pin)


def test_a_board_that_states_no_rated_current_is_not_judged(tmp_path):
    assert error_of(Session(board(tmp_path))) is None
    assert "large_signal_error" not in extract(board(tmp_path)).certificate


def test_a_bent_board_is_warned_of_and_one_that_is_far_off_refused(tmp_path):
    for cubic in (0.04, 0.06, 0.12):  # 1, 1.5 and 3 %
        result = cautions(extract(bent_board(tmp_path, cubic)).certificate)
        bent = [each for each in result if each.code == "not-linear"]
        assert len(bent) == (cubic * RATED**2 > 0.02)
        for each in bent:
            assert "3 % of rated current" in each.text
            assert "spice" in each.advice
    with pytest.raises(InputError, match=r"25 % of rated current.*`spice`"):
        extract(bent_board(tmp_path, 1.0))


#: An op-amp with a class B output stage without bias: 0.6 V of each diode are crossed by the loop alone, and
#: the loop has little gain to do so.
CLASS_B = """\
.subckt crossed 1 2 3 4 5
G1 0 x 1 2 1m
Rx x 0 20k
Cx x 0 53p
Dp x y DX
Dn y x DX
Ry y 0 1k
Rq y x 1meg
E5 z 0 y 0 1
Rz z 5 50
Rs 3 4 100k
.model DX D(is=1e-12)
.ends crossed
"""


@pytest.mark.parametrize("joints", [1, 2])
def test_a_board_of_op_amps_without_bias_is_refused_with_the_reason(tmp_path, joints):
    file = tmp_path / "crossed.lib"
    file.write_text(CLASS_B)
    deck = shipped(joints, "gbw", parts={"opamp": PartSwap(file, "crossed", "1 2 3 4 5")})
    with pytest.raises(InputError, match="at rest") as caught:
        extract(deck)
    assert caught.value.problems[0].key.startswith("ksp")
    # the model `ideal` has gains of its own and is told of, without the advice to correct constants
    circuit = extract(deck, "ideal")
    constants = DesignConstants.read(Session(deck).simulator.constants(), "")
    assert [each.code for each in of_circuit(circuit, constants)] == ["not-linear"]
    # nor does a run on ngspice, which knows the board's bends, blame constants for its slope at rest
    response = measure({"board": deck}, lambda _: None)
    assert not list(of_response(response, constants, lambda: bends({"board": deck}, lambda _: None)))
    assert [c.code for c in of_response(response, constants, lambda: 0.0)] == ["constant-missed"] * 3


@pytest.mark.parametrize("joints", [1, 2])
@pytest.mark.parametrize("driver", ["voltage", "current"])
def test_the_shipped_boards_bend_as_little_as_their_multipliers(joints, driver):
    at_gbw, _ = error_of(Session(shipped(joints, "gbw", driver)))
    assert at_gbw < 1e-7  # of solved formulas
    # level full: 0.4 % of full scale of X and 0.1 % of Y at most, and offsets of 5 mV at 10 V
    at_full, _ = error_of(Session(shipped(joints, "full", driver)))
    assert 1e-4 < at_full < 0.004 + 0.001 + 0.0005


def clamped_board(folder, limit):
    """Board with a current that stops at a limit."""
    return board_with(folder, f"min(max(v(s),{-limit!r}),{limit!r})")


@pytest.mark.parametrize("share", [0.2, 0.7, 1.5])
def test_a_limit_of_the_current_below_rated_is_no_bend(tmp_path, share):
    """A driver that is set to less than rated: models have the limit itself, and it is all that bends."""
    circuit = extract(clamped_board(tmp_path, share * RATED))
    assert circuit.limit == pytest.approx(np.array([[-share, share]]) * RATED, rel=1e-9)
    assert circuit.certificate["large_signal_error"] < 1e-9
    assert not cautions(circuit.certificate)


def test_sweeps_leave_every_pin_as_it_was():
    session = Session(shipped(1, "gbw"))
    session.hold({"u1": 0.3})  # shows in the current if a gain stays
    rest = session.operating_point(["imot1"])
    error_of(session)
    np.testing.assert_array_equal(session.operating_point(["imot1"]), rest)


class _Bench:
    """A board of two channels whose amplifiers stand at their limit above so many volts at X."""

    channels = ("ksp11", "ksd11")
    multipliers = (SimpleNamespace(x="vx1"), SimpleNamespace(x="vx2"))

    def __init__(self):
        self.held = {}

    def hold(self, pins):
        self.held |= pins


@pytest.mark.parametrize("without_point", [False, True])
@pytest.mark.parametrize(("limit", "known"), [(2.0, 1.0), (0.5, 0.1), (0.05, 0.01)])
def test_the_control_path_is_measured_below_the_limit_of_low_supplies(
    monkeypatch, limit, known, without_point
):
    def measured(bench, _band_hz, volts):
        bench.held |= dict.fromkeys(("vx1", "vx2"), volts)
        if volts > limit and without_point:
            raise NoOperatingPoint([Problem("no DC operating point")])
        return np.array([volts, np.nan if volts > limit else 2.0 * volts]), 0.25

    monkeypatch.setattr(limits_and_offsets, "_dynamics_at", measured)
    bench = _Bench()
    delays, worst = limits_and_offsets._dynamics(bench, 100.0)
    assert (delays.tolist(), worst) == ([known, 2.0 * known], 0.25)
    assert not any(bench.held.values())


def test_a_control_path_that_is_never_seen_is_no_number_but_zero(monkeypatch):
    monkeypatch.setattr(limits_and_offsets, "_dynamics_at", lambda *_: (np.array([1e-9, np.nan]), 0.0))
    assert limits_and_offsets._dynamics(_Bench(), 100.0)[0].tolist() == [1e-9, 0.0]

    def lost(*_):
        raise NoOperatingPoint([Problem("no DC operating point")])

    monkeypatch.setattr(limits_and_offsets, "_dynamics_at", lost)
    with pytest.raises(NoOperatingPoint):
        limits_and_offsets._dynamics(_Bench(), 100.0)
