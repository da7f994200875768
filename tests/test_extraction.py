"""From netlist to model: against whole boards in ngspice, textbook circuits, boards to be refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from extraction_boards import DAMPER, STATED, SUM, board, differences, extract, in_child, shipped

from cosim.circuits.extraction.certificate import cautions
from cosim.errors import InputError
from cosim.ngspice.deck import PartSwap, load_deck

VENDOR = Path(__file__).parent / "data" / "ngspice" / "vendor"


@pytest.mark.few(2)
@pytest.mark.parametrize("driver", ["voltage", "current"])
@pytest.mark.parametrize("level", ["ideal", "gbw"])
def test_board2_agrees_with_the_whole_board_at_any_gains(level, driver):
    deck = shipped(2, level, driver)
    circuit = extract(deck)
    volts = np.array([10.0, -3.0, 2.0, 7.0, 5.0, 1.0, -2.0, 10.0])
    # an op-amp gain of 1e9 costs ngspice itself as many digits: 7e-9 between one gain alone and all
    rounding = 1e9 * 2.0**-52 if level == "ideal" else 0.0
    assert differences(deck, circuit, volts).max() < STATED + rounding


@pytest.mark.parametrize("driver", ["voltage", "current"])
def test_real_parts_agree_at_full_scale(driver):
    # at full scale, where they are measured; elsewhere the multiplier's nonlinearity shows, see below
    deck = shipped(2, "full", driver)
    circuit = extract(deck)
    assert differences(deck, circuit, np.full(8, 10.0)).max() < STATED
    # its gain error at other control voltages is certified, as a share of full scale
    off = circuit.certificate["control_nonlinearity"]
    assert 1e-4 < off < 0.02
    assert differences(deck, circuit, np.full(8, 5.0)).max() < 2.0 * off + STATED


def test_orders_are_those_of_the_circuit():
    # one pole an op-amp, C21, C22 before; multiplier, summing amplifier, driver and L/R after
    circuit = extract(shipped(1, "gbw"))
    assert (len(circuit.a_pre), len(circuit.a_post)) == (5, 4)
    # ideal parts: the two capacitors
    assert extract(shipped(1, "ideal")).order == 2


def test_ideal_gains_are_those_of_the_resistors():
    circuit = extract(shipped(2, "ideal"), "ideal")
    pot = 20.0 / 5.93411946
    # op-amp gain 1e9, multiplier's 0.1 Ohm into 6.19k: 2e-5 of the damper's path, 4e-6 of the spring's
    assert circuit.d_pre[0] == pytest.approx([-16.9 * pot, 0, 16.9, 0], rel=1e-7, abs=1e-12)
    assert circuit.d_pre[1] == pytest.approx([0, -16.9 * pot, 0, 16.9], rel=1e-7, abs=1e-12)
    assert circuit.e_pre[4:] == pytest.approx(
        -0.1 * pot * np.array([[1, 0], [0, 1]] * 2), rel=1e-7, abs=1e-12
    )
    assert circuit.gain == pytest.approx(np.full(8, 0.1), rel=1e-7)
    spring, damper = 0.4 * 10 / 24.3 / (1 + 0.1 / 24.3e3), 0.4 * 10 / 6.19 / (1 + 0.1 / 6.19e3)
    want = [spring, spring, 0, 0, damper, damper, 0, 0, 0.2, 0, -0.04 / 5, 0]
    assert circuit.d_post[0] == pytest.approx(want, rel=1e-7, abs=1e-12)
    assert circuit.order == 0


def test_hard_case_2_follower_keeps_its_gain_error(tmp_path):
    deck = board(tmp_path, spring="Gx 0 x u1 x 1e6\nRx x 0 1")
    expected = 1e6 / (1e6 + 1)  # 0.999999000001
    assert extract(deck, "ideal").d_pre[0, 1] == pytest.approx(expected, rel=1e-14)
    circuit = extract(deck)
    assert circuit.before(1e-3j)[0, 0, 1].real == pytest.approx(expected, rel=1e-13)


def test_hard_case_3_femtofarad_and_teraohm(tmp_path):
    circuit = extract(board(tmp_path, spring="R1 u1 a 1e12\nC1 a 0 1e-15\nEx x 0 a 0 1"))
    pole = circuit.poles[np.argmin(np.abs(circuit.poles + 1000.0 + 1.0))]
    # gmin is 1e-12 S only at junctions; the resistor's own conductance makes the pole
    poles = np.sort(circuit.poles.real)
    assert poles == pytest.approx([-1000.0, -1000.0], rel=1e-9)
    assert pole.imag == 0.0


def test_op_amp_pole_by_the_textbook(tmp_path):
    # inverting amplifier, gain -10, GBW 1 MHz, open-loop gain 1e5: noise gain 11
    gbw, aol = 2 * np.pi * 1e6, 1e5
    stage = (
        f"R1 u1 m 10k\nR2 m x 100k\nGa 0 a 0 m 1m\nRa a 0 {aol * 1e3!r}\nCa a 0 {1e-3 / gbw!r}\nEx x 0 a 0 1"
    )
    circuit = extract(board(tmp_path, spring=stage))
    poles = np.sort(circuit.poles.real)
    assert poles[0] == pytest.approx(-gbw * (1 / 11 + 1 / aol), rel=1e-9)
    assert circuit.before(0j)[0, 0, 1].real == pytest.approx(-10 / (1 + 11 / aol), rel=1e-11)


def test_hard_case_4_nearly_equal_poles(tmp_path):
    # two buffered RC sections, time constants 1 and 1/(1 + 1e-8) s: step response of u, t exp(-t) at heart
    stage = "R1 u1 a 1meg\nC1 a 0 1u\nEa b 0 a 0 1\nR2 b c 1meg\nC2 c 0 0.99999999u\nEx x 0 c 0 1"
    circuit = extract(board(tmp_path, spring=stage))
    s = 2j * np.pi * np.geomspace(0.1, 1e8, 300)
    truth = 1 / ((1 + s) * (1 + s * 0.99999999))
    assert np.abs(circuit.before(s)[:, 0, 1] - truth).max() < STATED * np.abs(truth).max()
    # the model computes with numbers of the circuit's own size, not with residues of 1e8 that cancel
    assert max(np.abs(circuit.c_pre).max(), np.abs(circuit.d_pre).max()) < 1e3


def test_three_equal_poles(tmp_path):
    stage = "".join(f"R{k} n{k} a{k} 1k\nC{k} a{k} 0 1u\nE{k} n{k + 1} 0 a{k} 0 1\n" for k in (1, 2, 3))
    circuit = extract(
        board(tmp_path, spring=f"E0 n1 0 u1 0 1\n{stage}Ex x 0 n4 0 1", damper="Ey y 0 pot1 0 1")
    )
    s = 2j * np.pi * np.geomspace(0.1, 1e8, 300)
    assert np.abs(circuit.before(s)[:, 0, 1] - (1 + s / 1e3) ** -3).max() < STATED
    assert circuit.order == 3


def test_hard_case_6_poles_from_a_tenth_to_a_thousand_million(tmp_path):
    rates = [0.1, 1e3, 1e6, 1e9]
    sections = "".join(f"R{k} u1 a{k} 1k\nC{k} a{k} 0 {1e-3 / rate!r}\n" for k, rate in enumerate(rates))
    circuit = extract(board(tmp_path, spring=sections + "Bx x 0 V=v(a0)+v(a1)+v(a2)+v(a3)-v(pot1)"))
    # 1e3 is the damper's as well: another input, another state
    assert np.sort(-circuit.poles.real) == pytest.approx([0.1, 1e3, 1e3, 1e6, 1e9], rel=1e-9)
    # fast poles come split off: each in a block of its own, so no exponential ever mixes 1e9 with 0.1
    assert np.count_nonzero(circuit.a_pre) == len(circuit.a_pre)


def test_feedthrough_and_zero_in_the_right_half_plane(tmp_path):
    # all-pass (1 - s t)/(1 + s t), t = 1 ms: feedthrough -1
    stage = "R1 u1 a 1k\nC1 a 0 1u\nBx x 0 V=2*v(a)-v(u1)"
    circuit = extract(board(tmp_path, spring=stage))
    assert circuit.d_pre[0, 1] == pytest.approx(-1.0, rel=1e-9)
    s = 2j * np.pi * np.geomspace(0.1, 1e8, 50)
    assert np.abs(circuit.before(s)[:, 0, 1]) == pytest.approx(np.ones(50), rel=1e-9)


def test_unstable_board_is_refused_with_its_pole(tmp_path):
    # positive feedback: gain 2 around an integrator of 1 ms with loss: s = (2 - 1)/1 ms
    stage = "Bloop b 0 V=2*v(a)+v(u1)\nR1 b a 1k\nC1 a 0 1u\nEx x 0 a 0 1"
    with pytest.raises(InputError, match=r"unstable: before the multipliers there is a pole at 1000 rad/s"):
        extract(board(tmp_path, spring=stage))


def test_unstable_oscillation_after_the_multipliers(tmp_path):
    # s^2 - 200 s + 1e6: 100 +- 995j
    loop = (
        "Bq q1 0 V=v(ws)+v(wd)+v(cmd1)\nBa 0 s1 I=v(q1)-v(s2)+0.2*v(s1)\nC1 s1 0 1m\n"
        "Bb 0 s2 I=v(s1)\nC2 s2 0 1m\nRa s1 0 1e12\nRb s2 0 1e12\nBi imot1 0 V=v(s2)-0.01*v(vel1)"
    )
    with pytest.raises(InputError, match=r"after the multipliers there is a pole at 100 \+- 995j rad/s"):
        extract(board(tmp_path, output=loop))


def test_damper_with_a_dc_gain_is_no_ideal_damper(tmp_path):
    deck = board(tmp_path, damper=DAMPER + "\nRleak pot1 ya 1k")
    with pytest.raises(InputError, match=r"ksd11.*DC gain"):
        extract(deck, "ideal")
    assert extract(deck).order == 1


def test_damper_without_a_limit_is_refused(tmp_path):
    # a corner at 1e-4 rad/s: below it nothing is measured
    deck = board(tmp_path, damper="Cy pot1 ya 1\nRy ya 0 1e4\nEy y 0 0 ya 1")
    with pytest.raises(InputError, match=r"ksd11.*no limit"):
        extract(deck, "ideal")


def test_bent_control_is_refused_by_linear(tmp_path):
    bent = "xs x c ws mul\nBc c 0 V=v(ksp11)*(1-0.004*v(ksp11))\nxd y ksd11 wd mul"
    deck = board(tmp_path, multipliers=bent)
    with pytest.raises(InputError, match=r"ksp11.*proportionality.*`spice`"):
        extract(deck)


def test_slightly_bent_control_is_certified(tmp_path):
    bent = "xs x c ws mul\nBc c 0 V=v(ksp11)*(1-0.0005*v(ksp11))\nxd y ksd11 wd mul"
    circuit = extract(board(tmp_path, multipliers=bent))
    # gain g(v) = v (1 - v/2000) against v g(10)/10: largest at v = -10, where both signs of the bend add up
    assert circuit.certificate["control_nonlinearity"] == pytest.approx(1.005 / 0.995 - 1, rel=1e-6)
    assert circuit.certificate["control_nonlinearity_worst"] == "ksp11"


def test_slow_control_path_is_certified(tmp_path):
    slow = "xs x c ws mul\nRc ksp11 c 1k\nCc c 0 1n\nxd y ksd11 wd mul"
    circuit = extract(board(tmp_path, multipliers=slow), band_hz=1e3)
    assert circuit.certificate["control_delay_s"] == pytest.approx(1e-6, rel=1e-3)
    assert circuit.certificate["control_error"] == pytest.approx(2 * np.pi * 1e3 * 1e-6, rel=1e-3)


def test_multipliers_are_recognised_by_what_drives_them(tmp_path):
    # the instances are named after the wrong pins, X and control change places in the subcircuit's names
    odd = ".subckt odd p q w\nvb p pi 0\nva q qi 0\nvc zi 0 dc 0\nBw w 0 V=v(pi)*v(qi)/10+v(zi)\n.ends odd"
    crossed = "xksd ksp11 x ws odd\nxksp y ksd11 wd mul"
    circuit = extract(board(tmp_path, multipliers=crossed, top=odd), "ideal")
    assert circuit.certificate["probes"]
    assert circuit.d_pre[0] == pytest.approx([-1.0, 1.0])
    assert circuit.e_pre[1] == pytest.approx([-1e-3])


def test_current_limit_is_the_clamp_of_the_driver(tmp_path):
    output = "Bs s 0 V=v(ws)+v(wd)+v(cmd1)-0.01*v(vel1)\nBi imot1 0 V=max(-1.5,min(2.5,v(s)))"
    deck = board(tmp_path, output=output)
    for model in ("ideal", "linear"):
        assert extract(deck, model).limit == pytest.approx(np.array([[-1.5, 2.5]]))
    free = extract(board(tmp_path))
    assert free.limit.tolist() == [[-np.inf, np.inf]]


@pytest.mark.parametrize("model", ["ideal", "linear"])
def test_offset_is_always_there_and_rounding_is_none(tmp_path, model):
    assert extract(board(tmp_path, output=SUM + "+0.125"), model).offset == pytest.approx([0.125])
    still = extract(board(tmp_path), model)
    assert not np.concatenate([still.offset, still.x_offset, still.y_offset]).any()


def test_board_without_probes_is_lumped_and_says_so(tmp_path):
    top = ".subckt bare x y w\nBw w 0 V=v(x)*v(y)/10\n.ends bare"
    bare = "xs x ksp11 ws bare\nxd y ksd11 wd bare"
    output = "Bs s 0 V=v(ws)+v(wd)+v(cmd1)\nRs s o 1k\nCs o 0 1u\nBi imot1 0 V=v(o)-0.01*v(vel1)"
    deck = board(tmp_path, multipliers=bare, output=output, top=top)
    circuit = extract(deck, band_hz=50.0)
    assert not circuit.certificate["probes"]
    # all dynamics stand before the multiplier, so a gain step is early by the delay of the whole path
    assert np.abs(circuit.after(1e6j)[0, 0, :2]) == pytest.approx([1.0, 1.0])
    assert "at once" in circuit.certificate["gain_step"]
    assert circuit.certificate["gain_step_delay_s"] == pytest.approx(1e-3, rel=1e-6)
    assert differences(deck, circuit, np.array([4.0, -7.0])).max() < STATED
    still = extract(deck, "ideal")
    assert still.d_pre[0] * still.gain[0] * 10.0 == pytest.approx([-1.0, 1.0], rel=1e-9)


def test_vendor_macro_model():
    swap = {"opamp": PartSwap(VENDOR / "boyle.lib", *_vendor())}
    deck = shipped(1, "gbw", parts=swap)
    circuit = extract(deck)
    assert differences(deck, circuit, np.array([10.0, 10.0])).max() < STATED


def _vendor():
    """Name and pins of the Boyle model among the test data."""
    for line in (VENDOR / "boyle.lib").read_text().splitlines():
        words = line.split()
        if words[:1] and words[0].lower() == ".subckt":
            return words[1], "1 2 3 4 5"
    raise AssertionError("no subcircuit")


def test_one_per_cent_of_a_resistor_moves_the_gain_by_its_share():
    before = extract(shipped(1, "gbw"), "ideal")
    after = extract(shipped(1, "gbw", overrides={"r_sum_spring": "24.543k"}), "ideal")
    assert after.d_post[0, 0] / before.d_post[0, 0] == pytest.approx(1 / 1.01, rel=1e-6)
    assert after.d_post[0, 1] / before.d_post[0, 1] == pytest.approx(
        1.0, rel=1e-5
    )  # noise gain of the summer


def test_cache_serves_the_same_board_only(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    from cosim.circuits.extraction import extract as extraction
    from cosim.circuits.extraction import path_measurement

    deck = board(tmp_path)
    stages: list[dict[str, object]] = []
    payload = {"board": deck, "model": "ideal", "band_hz": 0.0, "tolerance": 0.0}

    class Measured(Exception):
        pass

    def refuse(*_: object, **__: object) -> None:
        raise Measured

    first = in_fresh_child(payload)
    monkeypatch.setattr(path_measurement, "Session", refuse)
    again = extraction.extract(dict(payload), stages.append)
    assert not stages
    for name, value in first.arrays().items():
        assert (again.arrays()[name] == value).all(), name
    assert again.certificate == first.certificate
    for other in (
        {"model": "linear"},
        {"band_hz": 1.0},
        {"board": board(tmp_path, spring="Ex x 0 u1 pot1 1.01")},
    ):
        with pytest.raises(Measured):
            extraction.extract(payload | other, stages.append)


def in_fresh_child(payload):
    """A child that sees the test's environment."""
    from cosim.ngspice.child import call

    return call("cosim.circuits.extraction.extract:extract", payload, time_limit_s=60.0)


def test_damaged_cache_is_ignored_with_a_word(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    payload = {"board": board(tmp_path), "model": "ideal", "band_hz": 0.0, "tolerance": 0.0}
    first = in_fresh_child(payload)
    (file,) = (tmp_path / "cache" / "cosim" / "circuits").iterdir()
    data = file.read_bytes()
    from cosim.circuits import cache

    asked = cache.Asked(payload["board"].text, "ideal", 0.0, 0.0)
    for damaged in (b"", data[:-40], b"x" + data[1:], data[:300] + b"\0" + data[301:]):
        file.write_bytes(damaged)
        known, note = cache.load(asked)
        if damaged != data:
            assert known is None or known.arrays().keys() == first.arrays().keys()
        if known is None:
            assert str(file) in note
    file.write_bytes(b"rubbish")
    again = in_fresh_child(payload)
    assert (again.d_pre == first.d_pre).all()
    assert cache.load(asked)[0] is not None  # written anew


def test_lumped_gain_step_is_late_by_what_is_stated(tmp_path):
    # the model's current jumps with the gain; in the circuit it follows, and what is missing to the jump adds
    # up to the stated delay times the last value, whatever the poles
    top = ".subckt bare x y w\nBw w 0 V=v(x)*v(y)/10\n.ends bare"
    output = (
        "Bs s 0 V=v(ws)+v(wd)+v(cmd1)\nRs s o 1k\nCs o 0 1u\nEo q 0 o 0 1\nRt q r 1k\nCt r 0 0.2u\n"
        "Bi imot1 0 V=v(r)-0.01*v(vel1)"
    )
    bare = "xs x ksp11 ws bare\nxd y ksd11 wd bare"
    deck = board(tmp_path, multipliers=bare, output=output, top=top)
    stated = extract(deck).certificate["gain_step_delay_s"]
    assert stated == pytest.approx(1.2e-3, rel=1e-6)  # R C of both sections
    table = in_child(
        "extraction_boards:step_response",
        {
            "board": deck,
            "sources": {"u1": "dc 1", "ksp11": f"pwl(0 0 1m 0 {1e-3 + 1e-9} 5)"},
            "tran": "tran 10u 30m 0 10u",
        },
    )
    times, current = table[:, 0], table[:, 1]
    assert current[-1] == pytest.approx(0.5, rel=1e-6)
    after = times >= 1e-3
    missing = np.trapezoid(1.0 - current[after] / current[-1], times[after])
    assert missing == pytest.approx(stated, rel=1e-3)  # the integral of 10 us steps


def crossed(top="", inside=""):
    """Board of two joints, all formulas, with room for what joins them."""
    multiplier = ".subckt mul x y w\nvpx x xi 0\nvpy y yi 0\nBw w 0 V=v(xi)*v(yi)/10\n.ends mul"
    rows = [
        ".param v_fs=10",
        ".param dac_v=10",
        ".csparam v_fs={v_fs}",
        ".csparam dac_v={dac_v}",
        multiplier,
        top,
    ]
    rows.append(
        ".subckt board pot1 pot2 vel1 vel2 u1 u2 ksp11 ksp12 ksp21 ksp22 ksd11 ksd12 ksd21 ksd22 cmd1 cmd2 "
        "imot1 imot2 vcc vee"
    )
    for j in (1, 2):
        rows.append(f"Ex{j} x{j}a 0 u{j} pot{j} 1\nRx{j} x{j}a x{j} {j}k\nCx{j} x{j} 0 1u")
        rows.append(f"Cy{j} pot{j} y{j} 1u\nRy{j} y{j} 0 {j}k")
    for i in (1, 2):
        for j in (1, 2):
            rows.append(f"xs{i}{j} x{j} ksp{i}{j} ws{i}{j} mul\nxd{i}{j} y{j} ksd{i}{j} wd{i}{j} mul")
        total = "+".join(f"v(w{kind}{i}{j})" for kind in "sd" for j in (1, 2))
        rows.append(
            f"Bs{i} s{i} 0 V={total}+v(cmd{i})-0.01*v(vel{i})\nRs{i} s{i} o{i} 1k\nCs{i} o{i} 0 0.{i}u"
        )
    rows += ["Bi1 imot1 0 V=v(o1)", "Bi2 imot2 0 V=v(o2)", inside, ".ends board"]
    return "* two joints\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    "joined",
    [
        "",
        "Rj x1 x2 5k",  # the difference amplifiers load each other
        "Cj y1 y2 300n",  # at high frequencies only
        "Rj o1 o2 3k",  # one motor's current in the other's
    ],
)
def test_joints_that_reach_each_other(tmp_path, joined):
    file = tmp_path / "board.cir"
    file.write_text(crossed(inside=joined))
    deck = load_deck(file)
    circuit = extract(deck)
    for volts in (np.full(8, 10.0), np.array([10.0, -3.0, 2.0, 7.0, 5.0, 1.0, -2.0, 10.0])):
        assert differences(deck, circuit, volts).max() < STATED
    cross = np.abs(circuit.response(2000j, np.full(8, 1e-9) + 10.0 * np.eye(8)[0])[0, 1, 0])
    assert (cross > 1e-4) == (joined == "Rj o1 o2 3k")


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        ("C1 u1 x 1u", r"floating node: xboard\.x has no DC path to ground"),
        ("I1 0 q 1m\nCq q 0 1u\nEx x 0 q 0 1", r"floating node: xboard\.q has no DC path"),
        ("V1 u1 0 1\nEx x 0 u1 pot1 1", r"loop of voltage sources or inductors through v\.xboard\.v1"),
        ("L1 u1 0 1m\nEx x 0 u1 pot1 1", r"loop of voltage sources or inductors through l\.xboard\.l1"),
    ],
)
@pytest.mark.parametrize("model", ["ideal", "linear"])
def test_hard_case_41_no_operating_point_names_the_node(tmp_path, stage, words, model):
    with pytest.raises(InputError, match=words):
        extract(board(tmp_path, spring=stage), model)


@pytest.mark.parametrize("model", ["ideal", "linear"])
@pytest.mark.parametrize(
    "dead",
    [{"damper": "Ey y 0 0 0 1"}, {"output": "Bi imot1 0 V=v(ws)+v(cmd1)-0.01*v(vel1)"}],
    ids=["nothing reaches it", "it reaches nothing"],
)
def test_a_path_that_leads_nowhere_is_named(tmp_path, model, dead):
    circuit = extract(board(tmp_path, **dead), model)
    assert circuit.certificate["dead"] == ["ksd11"]
    (caution,) = cautions(circuit.certificate)
    assert caution.code == "dead-gain"
    assert "ksd11" in caution.text
    json.dumps(circuit.certificate, allow_nan=False)
    # the spring is what it was: 1 A/V
    assert circuit.response(0.0, np.array([10.0, 10.0]))[0, 0].real[:2] == pytest.approx([-1.0, 1.0])
    assert cautions(extract(board(tmp_path), model).certificate) == []
