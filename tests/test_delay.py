"""Delay of a spring, block by block: against formulas, the fitted model, and a known network."""

import json
import shutil

import numpy as np
import pytest
from extraction_boards import NETLISTS, board, shipped

from cosim import cli
from cosim.analysis.extracted import circuit_of
from cosim.assets import scenes_folder
from cosim.circuits.extraction.block_delays import spring_delays
from cosim.ngspice.child import call
from cosim.ngspice.deck import load_deck
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.studies.analog_limit import lag

#: From netlists/: gain-bandwidths, multiplier's pole, winding.
TL072, OPA548, AD633 = 3e6, 1e6, 1e6
MOTOR_S = 1.5e-3 / 5.0


def extracted(deck):
    return call(
        "cosim.circuits.extraction.extract:extract",
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
    result = spring_delays(deck)
    assert [(path.joint, path.motor) for path in result] == [
        (j, i) for j in range(1, joints + 1) for i in range(1, joints + 1)
    ]
    for path in result:
        j, i = path.joint - 1, path.motor - 1
        c = i * joints + j
        value = -(x1[c, j] / x0[c, j] + y1[i, c] / y0[i, c])
        assert path.total_s == pytest.approx(value, rel=1e-5)
    if driver == "current":  # the amplifier leads what the winding lags: they are one loop
        assert result[0].steps[-1].block == "driver and motor"
        assert result[0].steps[-1].delay_s > 0.0


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


# --- own topologies: every delay is -H'/H at s = 0, from the values in the lines ---------------------------

#: Stages between the difference amplifier and the multiplier: from `a` to `b`.
LEAD = ".subckt lead a b vcc vee\nR1 a p 10k\nC1 a p 1u\nR2 p 0 10k\nxop p b vcc vee b tl072\n.ends lead"
LAG = ".subckt lag a b vcc vee\nR1 a p 10k\nC1 p 0 1u\nxop p b vcc vee b tl072\n.ends lag"
DIRECT = ".subckt direct a b vcc vee\nxop a b vcc vee b tl072\n.ends direct"
ADD = ".subckt add a c b vcc vee\nR1 a m 10k\nR2 c m 10k\nR3 m b 10k\nxop 0 m vcc vee b tl072\n.ends add"
SALLEN_KEY = (
    ".subckt sk a b vcc vee\nR1 a n 10k\nR2 n p 10k\nC1 n b 1u\nC2 p 0 500n\n"
    "xop p b vcc vee b tl072\n.ends sk"
)
INVERTING = ".subckt inv a b vcc vee\nR1 a m 10k\nR2 m b 20k\nC2 m b 100n\nxop 0 m vcc vee b tl072\n.ends inv"
LOOP = (
    ".subckt outer a o b vcc vee\nxop a o vcc vee b tl072\n.ends outer\n"
    ".subckt inner b o vcc vee\nR1 b p 1k\nC1 p 0 100n\nxop p o vcc vee o opa2134\n.ends inner"
)
#: Lines of the board in place of the wire, and delay [s] by instance.
OWN = {
    # lead: R1 R2 C1/(R1 + R2) - R1 C1 = 5 ms - 10 ms; lag: R1 C1
    "lead and lag": (
        f"{LEAD}\n{LAG}", "xlead x1 l1 vcc vee lead\nxlag l1 xx vcc vee lag", {"xlead": -5e-3, "xlag": 1e-2},
    ),
    "lag and lead": (
        f"{LEAD}\n{LAG}", "xlag x1 l1 vcc vee lag\nxlead l1 xx vcc vee lead", {"xlag": 1e-2, "xlead": -5e-3},
    ),
    # half of the signal is late by 10 ms
    "two branches": (
        f"{LAG}\n{DIRECT}\n{ADD}",
        "xlag x1 l1 vcc vee lag\nxdirect x1 l2 vcc vee direct\nxadd l1 l2 xx vcc vee add",
        {"xlag and xdirect and xadd": 5e-3},
    ),
    # C2 (R1 + R2)
    "Sallen-Key": (SALLEN_KEY, "xsk x1 xx vcc vee sk", {"xsk": 1e-2}),
    "inverting lag": (INVERTING, "xinv x1 xx vcc vee inv", {"xinv": 2e-3}),
    # inside a loop of gain 2e5 the lag of 0.1 ms is 0.1 ms/2e5; 1/(2 pi GBW) of the outer one stands beside
    "one loop around two amplifiers": (
        LOOP, "xouter x1 xx l1 vcc vee outer\nxinner l1 xx vcc vee inner",
        {"xouter and xinner": 1.0 / (2.0 * np.pi * TL072) + 1e-4 / 2e5},
    ),
}  # fmt: skip


def own_board(folder, blocks, lines, driver="voltage"):
    """The shipped board of one joint with stages of one's own between difference amplifier and multiplier."""
    shutil.copytree(NETLISTS, folder / "netlists")
    path = folder / "netlists" / "board1.cir"
    text = path.read_text()
    wire = "xksp11 x1 ksp11 wsp11 vcc vee vca"
    assert wire in text
    path.write_text(
        text.replace(".subckt board1", f"{blocks}\n.subckt board1").replace(
            wire, f"{lines}\nxksp11 xx ksp11 wsp11 vcc vee vca"
        )
    )
    levels = {"opamp": "gbw", "vca": "gbw", "driver": driver, "driver_level": "gbw", "motor": "full"}
    return load_deck(path, levels=levels)


@pytest.mark.few(4)
@pytest.mark.parametrize("driver", ["voltage", "current"])
@pytest.mark.parametrize("name", OWN)
def test_own_topologies_are_resolved_or_lumped(tmp_path, name, driver):
    blocks, lines, expected = OWN[name]
    plain = spring_delays(shipped(1, "gbw", driver))[0]
    (path,) = spring_delays(own_board(tmp_path, blocks, lines, driver))
    by_name = {step.instance: step.delay_s for step in path.steps}
    own = list(expected)
    assert [each for each in by_name if each in own] == own, by_name
    for instance, delay in expected.items():
        # an op-amp of noise gain 1 to 3 adds up to 0.2 us, finite gain (2e5) 2e-5 of a lag
        assert by_name[instance] == pytest.approx(
            delay, rel=1e-4, abs=2e-7 if delay > 1e-6 or delay < 0 else 1e-9
        )
    # what was there before is as it was; the difference amplifier drives a lighter or heavier load of 1 Ohm
    others = {step.instance: step.delay_s for step in plain.steps}
    assert by_name.keys() - set(own) == others.keys()
    for instance, delay in others.items():
        assert by_name[instance] == pytest.approx(delay, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(
    "more", [(), ("vca_offset=true", "opamp_offset=true", "driver=current")], ids=["", "offsets"]
)
def test_four_tell_one_delay(more, capsys):
    """Certificate, study of the analog limit, blocks and `check`: of the spring alone, whatever leaks by it.

    They share no code but ngspice: derivatives of the fitted state space, its response at a low frequency,
    products of cuts, and a sweep. A fit is right to 1e-6 and better.
    """
    asked = [*(f"effects.{each}" for each in more), "solver.model=linear"]
    plan = resolve(load_scene(scenes_folder() / "press.toml", asked))
    circuit, constants = circuit_of(plan)
    value = circuit.certificate["delay_s"]
    words = ["check", str(plan.scene.file), "--json", *(word for each in asked for word in ("--set", each))]
    assert cli.main(words) in (0, 1)
    paths = json.loads(capsys.readouterr().out)["checks"][0]["paths"]
    seen = next(path["delay_s"] for path in paths if path["kind"] == "pot" and path["joint"] == 1)
    total_s = spring_delays(plan.board)[0].total_s
    for other in (value["spring_before"] + value["after"], lag(constants, circuit), seen):
        assert other == pytest.approx(total_s, rel=1e-5)
