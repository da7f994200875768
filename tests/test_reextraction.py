"""Extraction again after changed values, against a full extraction of a deck that was written with them."""

import numpy as np
import pytest
from drawn_models import UNREDUCED, apart
from extraction_boards import NETLISTS, board, extract, in_child, shipped

from cosim.circuits.extraction.alter import Way, altered, handle
from cosim.errors import InputError
from cosim.ngspice.deck import load_deck

#: Every resistor and capacitor of the shipped boards that carries a tolerance.
NOMINAL = {
    "r_diff_in": 10e3, "r_diff_fb": 169e3, "c_der_in": 1e-6, "r_der_fb": 100e3, "r_der_in": 1.58e3,
    "c_der_fb": 1e-9, "r_sum_fb": 10e3, "r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_sum_cmd": 20e3,
    "r_drv_in": 10e3, "r_drv_fb": 20e3,
}  # fmt: skip


def again(deck, sets, band_hz=0.0, tolerance=0.0, **more):
    payload = {"board": deck, "band_hz": band_hz, "tolerance": tolerance, "sets": sets} | more
    return in_child("cosim.circuits.extraction.reextract:circuits", payload)


def drawn(rng, spread):
    return {name: value * (1.0 + rng.uniform(-spread, spread)) for name, value in NOMINAL.items()}


@pytest.mark.few(1)
@pytest.mark.parametrize("driver", ["voltage", "current"])
def test_toleranced_parts_agree_with_a_deck_of_their_own(driver):
    rng = np.random.default_rng(1)
    deck = shipped(2, "gbw", driver)
    sets = [drawn(rng, 0.2) for _ in range(6)]
    if driver == "current":
        for values in sets:
            values["r_drv_in"], values["r_drv_fb"] = 13.7e3 * 1.1, 2.8e3 * 0.9
    sets[3:] = [values | {"motor_r": 5.5, "tl072_gbw": 2.5e6} for values in sets[3:]]
    for values, each in zip(sets, again(deck, sets), strict=True):
        # the deck as if its files had been written with these values
        truth = extract(shipped(2, "gbw", driver, overrides={k: repr(v) for k, v in values.items()}))
        assert apart(truth, each, 1e8) < UNREDUCED
        assert apart(truth, each, 1e8, np.array([10.0, -3, 2, 7, 5, 1, -2, 10])) < UNREDUCED


def test_nothing_but_the_first_of_these_is_extracted_anew():
    # the current driver's zero lies on the motor's pole: values that part them need one more pole, once
    rng = np.random.default_rng(2)
    for driver, most in (("voltage", 0), ("current", 1)):
        sets = [drawn(rng, 0.05) for _ in range(5)]
        anew = [c for c in again(shipped(2, "gbw", driver), sets) if "extracted_anew" in c.certificate]
        assert len(anew) <= most, [c.certificate["extracted_anew"] for c in anew]


@pytest.mark.parametrize("tolerance", [1e-6, 1e-3])
def test_reduced_models_keep_the_tolerance(tolerance):
    rng = np.random.default_rng(3)
    deck = shipped(2, "gbw")
    sets = [drawn(rng, 0.2) for _ in range(4)]
    for values, each in zip(sets, again(deck, sets, 1e3, tolerance), strict=True):
        truth = extract(shipped(2, "gbw", overrides={k: repr(v) for k, v in values.items()}))
        assert "extracted_anew" not in each.certificate
        assert each.order < truth.order
        assert apart(truth, each, 1e3) <= tolerance + UNREDUCED
        assert each.certificate["error"] <= tolerance
    # as many states as a full extraction with the same band and tolerance, or nearly so
    full = extract(deck, band_hz=1e3, tolerance=tolerance)
    assert each.order <= full.order + 2


def test_values_do_not_stay():
    sets = [{"r_sum_fb": 12e3}, {}, {"motor_r": 6.0}, {"r_sum_fb": 12e3}, {"xdiff1.r12": 150e3}, {}]
    deck = shipped(1, "gbw")
    result = again(deck, sets)
    assert apart(result[0], result[3], 1e8) < UNREDUCED
    nominal = extract(deck)
    for k in (1, 5):
        assert apart(nominal, result[k], 1e8) < UNREDUCED
    assert apart(nominal, result[2], 1e8) > 1e-2
    assert apart(nominal, result[4], 1e8) > 1e-2


def test_one_instance_alone():
    # difference amplifier of joint 1: its X is the only one that changes
    deck = shipped(2, "gbw")
    (result,) = again(deck, [{"xdiff1.r12": 150e3}])
    before, after = (circuit.before(0.1j)[0].real for circuit in (extract(deck), result))
    # pot: -r12/r11; u: r14/(r13 + r14) (1 + r12/r11); op-amp gain 2e5, noise gain 17.9: 1e-4, changes by 1e-5
    assert after[0, 0] / before[0, 0] == pytest.approx(150 / 169, rel=2e-5)
    assert after[0, 2] / before[0, 2] == pytest.approx(160 / 179, rel=2e-5)
    assert after[1, 1] == pytest.approx(before[1, 1], rel=1e-9)
    assert after[1, 3] == pytest.approx(before[1, 3], rel=1e-9)


def test_unstable_values_are_reported_with_the_pole(tmp_path):
    # s = (k - 1)/1 ms for a loop gain k = r/1k
    stage = (
        "Bs s 0 V=v(u1)\nR9 f 0 {rloop}\nGf 0 f a 0 1m\nR1 f2 a 1k\nEf f2 0 f 0 1\nC1 a 0 1u\n"
        "Rs s a 1k\nEx x 0 a 0 1"
    )
    deck = board(tmp_path, spring=stage, top=".param rloop=100")
    good, bad, after = again(deck, [{"rloop": 500.0}, {"rloop": 3e3}, {"rloop": 500.0}])
    assert isinstance(bad, InputError)
    assert "unstable" in str(bad)
    assert "1000 rad/s" in str(bad)  # (3 - 1 - 1)/1 ms
    assert "159.2 Hz" in str(bad)
    assert apart(good, after, 1e8) < UNREDUCED


def test_cancelled_pole_appears(tmp_path):
    # (1 + s R2 C2)/(1 + s R1 C1) with equal time constants is 1: no pole until one changes
    stage = "R1 u1 a 1k\nC1 a 0 1u\nEa b 0 a 0 1\nR3 b x1 1k\nC2 b x1 1u\nR4 x1 0 1k\nEx x 0 x1 0 1"
    deck = board(tmp_path, spring=stage)
    sets = [{"C2": c} for c in (2e-6, 3e-6, 5e-7)]
    for values, each in zip(sets, again(deck, sets), strict=True):
        truth = extract(altered(deck, {k: repr(v) for k, v in values.items()}))
        assert apart(truth, each, 1e8) < UNREDUCED


def test_values_over_four_decades():
    deck = shipped(1, "gbw")
    sets = [{"r_der_in": r, "motor_l": inductance} for r in (15.8, 158e3) for inductance in (1.5e-5, 0.15)]
    for values, each in zip(sets, again(deck, sets), strict=True):
        truth = extract(shipped(1, "gbw", overrides={k: repr(v) for k, v in values.items()}))
        assert apart(truth, each, 1e8) < UNREDUCED


def test_current_limit_and_offset_follow(tmp_path):
    output = (
        "Bs s 0 V=v(ws)+v(wd)+v(cmd1)-0.01*v(vel1)+0.125\nRl k 0 {lim}\nIl 0 k 1\n"
        "Bi imot1 0 V=max(-v(k),min(v(k),v(s)))"
    )
    deck = board(tmp_path, output=output, top=".param lim=2")
    (result,) = again(deck, [{"lim": 1.5}])
    assert result.limit == pytest.approx(np.array([[-1.5, 1.5]]))
    assert result.offset == pytest.approx([0.125])


def test_board_without_probes_takes_the_long_way(tmp_path):
    top = ".subckt bare x y w\nBw w 0 V=v(x)*v(y)/10\n.ends bare\n.param gain=1k"
    deck = board(tmp_path, multipliers="xs x ksp11 ws bare\nxd y ksd11 wd bare", top=top,
                 spring="R1 u1 a 1k\nR2 a 0 {gain}\nEx x 0 a pot1 1")  # fmt: skip
    (result,) = again(deck, [{"gain": 3e3}])
    assert "probes" in result.certificate["extracted_anew"]
    assert result.response(1j, np.array([10.0, 0.0]))[0, 0, 1].real == pytest.approx(0.75, rel=1e-9)


def test_what_is_no_value_is_refused():
    deck = shipped(1, "gbw")
    unknown, nan = again(deck, [{"r_sum_fbb": 1.0}, {"r_sum_fb": float("nan")}])
    assert "nearest is r_sum_fb" in str(unknown)
    assert "not a number" in str(nan)


def test_ways_to_a_value():
    deck = shipped(2, "gbw")
    assert handle(deck, "r_sum_fb").targets == ("r.xboard.xsum1.r31", "r.xboard.xsum2.r31")
    assert handle(deck, "xdiff1.r12").targets == ("r.xboard.xdiff1.r12",)
    # also in expressions, {ke/r}: ngspice has to read the deck again
    assert handle(deck, "motor_r").way is Way.PARAMETER
    assert handle(deck, "xsum1.xop.gbw").way is Way.DECK


def test_a_deck_of_its_own_is_the_one_that_overrides_make():
    values = {"r_sum_fb": "12k", "xdiff1.r12": "150k", "motor_r": "6"}
    levels = {"opamp": "gbw", "vca": "gbw", "driver": "voltage", "driver_level": "gbw", "motor": "full"}
    plain = load_deck(NETLISTS / "board2.cir", levels=levels)
    written = load_deck(NETLISTS / "board2.cir", levels=levels, overrides=values)
    assert sorted(altered(plain, values).text.splitlines()) == sorted(written.text.splitlines())
