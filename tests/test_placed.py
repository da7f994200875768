"""Values of placed components against netlists that were edited by hand, and against decks of their own."""

import shutil

import numpy as np
import pytest
from drawn_models import UNREDUCED, apart
from extraction_boards import NETLISTS, extract, in_child, shipped

from cosim.circuits.draws.admittances import nominal_values
from cosim.errors import InputError
from cosim.ngspice.deck import load_deck
from cosim.ngspice.placed_values import Placed

LEVELS = {"opamp": "gbw", "vca": "gbw", "driver": "voltage", "driver_level": "gbw", "motor": "full"}
#: Components of every kind: in a block, on the board, and numbers of placed parts.
SOME = {
    "xdiff1.r11": 9.7e3, "xdiff2.r12": 171e3, "rsp12": 25e3, "rcmd2": 19e3, "xder1.c21": 1.04e-6,
    "xsum2.r31": 9.8e3, "xdrv1.r42": 20.3e3, "xdiff1.xop:tl072_gbw": 2.5e6, "xdrv2.xmotor:motor_r": 5.4,
    "xdrv1.xmotor:motor_l": 1.3e-3,
}  # fmt: skip
#: The same by hand, in the text of the shipped files.
BY_HAND = {
    "board2.cir": [
        ("xdiff1 u1 p1 x1 vcc vee diffamp", "xdiff1 u1 p1 x1 vcc vee diffamp_1 r11=9.7k"),
        ("xdiff2 u2 p2 x2 vcc vee diffamp", "xdiff2 u2 p2 x2 vcc vee diffamp_2"),
        ("Rsp12 wsp12 sum1 {r_sum_spring}", "Rsp12 wsp12 sum1 25k"),
        ("Rcmd2 cmd2 sum2 {r_sum_cmd}", "Rcmd2 cmd2 sum2 19k"),
        ("xder1 p1 y1 vcc vee differentiator", "xder1 p1 y1 vcc vee differentiator c21=1.04u"),
        ("xsum2 sum2 drv2 vcc vee summer", "xsum2 sum2 drv2 vcc vee summer r31=9.8k"),
        ("xdrv1 drv1 vel1 imot1 vcc vee driver", "xdrv1 drv1 vel1 imot1 vcc vee driver_1 r42=20.3k"),
        ("xdrv2 drv2 vel2 imot2 vcc vee driver", "xdrv2 drv2 vel2 imot2 vcc vee driver_2"),
        (".include 'blocks/summer.cir'", ".include 'blocks/summer.cir'\n.include 'blocks/own.cir'"),
    ],
}  # fmt: skip
OWN_BLOCKS = """* blocks of single places
.subckt diffamp_1 u pot out vcc vee params: r11={r_diff_in}
R11 pot inn {r11}
R12 inn out {r_diff_fb}
R13 u inp {r_diff_in}
R14 inp 0 {r_diff_fb}
xop inp inn vcc vee out tl072 gbw=2.5meg
.ends diffamp_1
.subckt diffamp_2 u pot out vcc vee
R11 pot inn {r_diff_in}
R12 inn out 171k
R13 u inp {r_diff_in}
R14 inp 0 {r_diff_fb}
xop inp inn vcc vee out tl072
.ends diffamp_2
.subckt driver_1 in vel imot vcc vee params: r42={r_drv_fb}
R41 in inn 10k
R42 inn out {r42}
xop 0 inn vcc vee out opa548
xmotor out 0 vel imot motor l=1.3m
.ends driver_1
.subckt driver_2 in vel imot vcc vee
R41 in inn 10k
R42 inn out 20k
xop 0 inn vcc vee out opa548
xmotor out 0 vel imot motor r=5.4
.ends driver_2
.param r_drv_in=10k r_drv_fb=20k
"""


def models(board, keys, sets, model="linear", **more):
    payload = {"board": board, "keys": keys, "nominal": nominal_values(board, keys), "model": model}
    return in_child("drawn_models:drawn", payload | {"sets": [list(map(float, s)) for s in sets]} | more)


def passive(board):
    """Every resistor and capacitor of a shipped board, outside its parts."""
    blocks = {"xdiff": ("r11", "r12", "r13", "r14"), "xder": ("c21", "r21", "r22", "c22"), "xsum": ("r31",)}
    keys = [f"{b}{j}.{e}" for b, all_ in blocks.items() for j in (1, 2) for e in all_]
    keys += [f"xdrv{j}.{e}" for j in (1, 2) for e in ("r41", "r42")]
    return [
        *keys,
        "rcmd1",
        "rcmd2",
        *(f"{kind}{i}{j}" for kind in ("rsp", "rsd") for i in (1, 2) for j in (1, 2)),
    ]


def sets_about(board, keys, spread, count, seed=1):
    rng = np.random.default_rng(seed)
    return nominal_values(board, keys) * (1.0 + spread * rng.uniform(-1.0, 1.0, (count, len(keys))))


def test_placed_values_equal_a_netlist_that_was_edited_by_hand(tmp_path):
    folder = tmp_path / "netlists"
    shutil.copytree(NETLISTS, folder)
    for name, edits in BY_HAND.items():
        text = (folder / name).read_text()
        for old, new in edits:
            assert text.count(old) == 1
            text = text.replace(old, new)
        (folder / name).write_text(text)
    (folder / "blocks" / "own.cir").write_text(OWN_BLOCKS)
    by_hand = extract(load_deck(folder / "board2.cir", levels=LEVELS))
    board = shipped(2, "gbw")
    assert apart(by_hand, extract(Placed.of(board, list(SOME)).deck(list(SOME.values()))), 1e8) < UNREDUCED
    why, (result,) = models(board, list(SOME), [list(SOME.values())])
    assert not why
    assert apart(by_hand, result, 1e8) < UNREDUCED


def test_a_number_that_others_are_made_of_changes_these_for_one_part():
    """15000 x 4.75 V over 13750 and r_ilim, as the part's file has it, and not for the other driver."""
    deck = Placed.of(shipped(2, "gbw"), ["xdrv1.xop:r_ilim"]).deck([10e3])
    heads = {line.text.split()[1]: line.text for line in deck.lines if line.text.startswith(".subckt opa548")}
    (own,) = (text for name, text in heads.items() if name != "opa548")
    assert own.endswith("ilim={(15000*4.75/(13750+(10000.0)))}")
    assert "ilim={opa548_ilim}" in heads["opa548"]


def test_values_as_designed_change_nothing():
    board = shipped(2, "gbw")
    keys = [*passive(board), "xdiff1.xop:tl072_gbw", "xdrv1.xmotor:motor_r"]
    as_designed = nominal_values(board, keys)
    assert dict(zip(keys, as_designed, strict=True))["xdiff2.r12"] == 169e3
    assert apart(extract(board), extract(Placed.of(board, keys).deck(as_designed)), 1e8) < UNREDUCED


@pytest.mark.few(1)
@pytest.mark.parametrize("driver", ["voltage", "current"])
def test_draws_agree_with_decks_of_their_own(driver):
    board = shipped(2, "gbw", driver)
    keys = [*passive(board), "xder2.xop:tl072_aol", "xdiff1.xop:tl072_gbw", "xdrv2.xmotor:motor_l"]
    sets = sets_about(board, keys, 0.1, 3)
    why, result = models(board, keys, sets)
    assert not why
    for values, circuit in zip(sets, result, strict=True):
        truth = extract(Placed.of(board, keys).deck(values))
        assert apart(truth, circuit, 1e8) < UNREDUCED
        assert apart(truth, circuit, 1e8, np.array([10.0, -3, 2, 7, 5, 1, -2, 10])) < UNREDUCED


def test_offsets_and_limits_follow_the_draw():
    board = shipped(2, "full")
    keys = passive(board)
    sets = sets_about(board, keys, 0.05, 2)
    _, result = models(board, keys, sets)
    for values, circuit in zip(sets, result, strict=True):
        truth = extract(Placed.of(board, keys).deck(values))
        assert np.abs(truth.offset).max() > 1e-3
        # right to first order in offsets of some mV, on multipliers that are bent by 0.4 % at full scale
        np.testing.assert_allclose(circuit.offset, truth.offset, atol=1e-9)
        np.testing.assert_allclose(circuit.x_offset, truth.x_offset, rtol=1e-6)
        np.testing.assert_allclose(circuit.limit, truth.limit, rtol=1e-12)


def test_the_order_of_the_draws_does_not_matter():
    board = shipped(2, "gbw", "current")
    keys = passive(board)
    sets = sets_about(board, keys, 0.02, 4)
    # far away: the differentiator without its capacitor has another number of poles
    far = sets[:1] * np.where([key.endswith("c21") for key in keys], 1e-9, 1.0)
    sets = np.concatenate([sets[:2], far, sets[2:]])
    _, first = models(board, keys, sets, reduced=(1e3, 1e-6))
    assert [k for k, circuit in enumerate(first) if "anew" in circuit.certificate] == [2]
    order = [2, 4, 0, 3, 1]
    _, second = models(board, keys, sets[order], reduced=(1e3, 1e-6))
    for place, circuit in zip(order, second, strict=True):
        for name, value in circuit.arrays().items():
            assert np.array_equal(value, first[place].arrays()[name]), (place, name)


def test_reduced_and_ideal_models_of_draws():
    board = shipped(2, "gbw")
    keys = passive(board)
    sets = sets_about(board, keys, 0.05, 2)
    for circuit, values in zip(models(board, keys, sets, reduced=(1e3, 1e-4))[1], sets, strict=True):
        truth = extract(Placed.of(board, keys).deck(values))
        assert circuit.order < truth.order
        assert apart(truth, circuit, 1e3) <= 1e-4 + UNREDUCED
    for circuit, values in zip(models(board, keys, sets, "ideal")[1], sets, strict=True):
        truth = extract(Placed.of(board, keys).deck(values), model="ideal")
        np.testing.assert_allclose(circuit.d_pre, truth.d_pre, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(circuit.e_pre, truth.e_pre, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(circuit.d_post, truth.d_post, rtol=1e-8, atol=1e-12)


def test_a_value_that_is_no_admittance_is_extracted_anew():
    board = shipped(2, "gbw", features=())
    key = "xksp11.xmul:ad633_bw"  # the pole of the multiplier stands in a capacitor
    assert not models(board, [key], [[0.9e6]])[0]
    full = shipped(2, "full")
    why, (result,) = models(full, ["xksp11.xmul:ad633_scale"], [[1.0]])
    assert "otherwise than as an admittance" in why
    truth = extract(Placed.of(full, ["xksp11.xmul:ad633_scale"]).deck([1.0]))
    assert apart(truth, result, 1e8) < UNREDUCED


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("xdif1.r11", "no instance xdif1, nearest is xdiff1"),
        ("xdiff1.r19", "no element r19, nearest is r1"),
        ("xdiff1.xop:tl072_gbv", "uses a parameter tl072_gbv"),
        ("xksp11", "not an element with one value"),
    ],
)
def test_unknown_components_are_reported(key, words):
    with pytest.raises(InputError, match=words):
        Placed.of(shipped(2, "gbw"), [key])
