"""One verdict on a circuit's stability: against the eigenvalues of an independent nodal analysis."""

import shutil
import warnings

import numpy as np
import pytest
from legitimate import BISTABLE, OSCILLATING, board_with
from reference.mna import Circuit
from slips import KINDS, NETLISTS, bench_text, slipped
from support import BOARD1, BOARD2, SCENES, scene_of, shared_child, slider

from cosim.circuits.boardgen import board_text
from cosim.circuits.instability.stability_verdict import Instability, Latched, Question, Verdict
from cosim.cli import main
from cosim.errors import InputError
from cosim.ngspice.deck import PartSwap, load_deck
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.stability_gate import FINITE, latched, question, verdict

#: Joints, one after the other, whose boards the suite judges; the slow test takes all six.
QUICK_JOINTS = (1, 2)
LEGITIMATE = [
    *((name, "bistable") for name in BISTABLE),
    *((name, "oscillating") for name in OSCILLATING),
]


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def judged(board, **more):
    return verdict(Question((board,), **more), board.path, shared_child())


def finite(path, drive="voltage"):
    return load_deck(path, levels={**FINITE, "driver": drive})


def fastest(board, gain):
    """The pole [rad/s] furthest to the right by the reference."""
    result = Circuit(bench_text(board, gain)).poles()
    return result[np.argmax(result.real)]


def truth(board):
    """The poles [rad/s] furthest to the right at no gain and at full scale.

    None where the circuit has no operating point, or its pole is at zero to rounding.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return [fastest(board, gain) for gain in (0.0, 10.0)]
        except (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError):
            return None


def grows(pole):
    """Whether a pole lies to the right by more than the eigenvalues' rounding."""
    return pole.real > 1e-9 * abs(pole)


def agrees(folder, seed):
    """Compare the verdict on a random slip with the truth; return what the truth was."""
    path, drive, result = slipped(folder, seed)
    board = finite(path, drive)
    poles, value = truth(board), judged(board)
    if poles is None:
        return None
    unstable = any(map(grows, poles))
    assert bool(value.refused) == unstable, f"seed {seed}: {result}: {value}"
    assert value.stable == (not unstable), f"seed {seed}: {result}: {value}"
    if unstable:  # the first gains that show it are told
        pole = next(filter(grows, poles))
        rows = [complex(each.real, each.imag) for each in value.instabilities]
        assert min(abs(each - pole) for each in rows) <= 0.05 * abs(pole)  # as well as two fits must agree
    return unstable


@pytest.mark.parametrize("drive", ["voltage", "current"])
def test_the_reference_is_ngspice_where_that_answers(drive):
    # the reference reads the deck and solves it on its own: what both say of .op and .ac is the same circuit
    board = finite(BOARD1, drive)
    circuit = Circuit(bench_text(board, 10.0))
    asked = [("vpot1", "imot1"), ("vu1", "xboard.x1"), ("vcmd1", "xboard.drv1"), ("vvel1", "imot1")]
    text = bench_text(board, 10.0)
    hz = [1.0, 300.0, 2e4, 3e6]
    for source, node in asked:
        mine = np.array([circuit.response(source, f, node) for f in hz])
        theirs = shared_child().call(
            "ngspice_targets:respond", {"text": text, "source": source, "node": node, "hz": hz}
        )
        assert np.abs(mine - theirs).max() <= 1e-9 * np.abs(theirs).max()


@pytest.mark.few(3)
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5, 12])
def test_a_random_slip_is_judged_as_its_eigenvalues_say(tmp_path, seed):
    agrees(tmp_path, seed)


@pytest.mark.slow
def test_two_hundred_random_slips_without_a_miss(tmp_path):
    by_name = {kind: [] for kind in KINDS}
    for seed in range(200):
        by_name[KINDS[seed % len(KINDS)]].append(agrees(tmp_path, seed))
    every = [each for row in by_name.values() for each in row]
    assert every.count(True) >= 30
    assert every.count(False) >= 120
    assert every.count(None) <= 15


@pytest.mark.parametrize(
    ("joints", "drive", "level"),
    [
        pytest.param(joints, drive, level, marks=() if joints in QUICK_JOINTS else pytest.mark.slow)
        for joints in range(1, 7)
        for drive in ("voltage", "current")
        for level in ("gbw", "full")
    ],
)
def test_the_shipped_boards_are_stable(tmp_path, joints, drive, level):
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    path = tmp_path / "netlists" / "own.cir"
    path.write_text(board_text(joints))
    levels = {role: "full" for role in FINITE} if level == "full" else FINITE
    result = judged(load_deck(path, levels={**levels, "driver": drive}))
    assert result.stable, result
    assert not result.instabilities


@pytest.mark.few(7)
@pytest.mark.parametrize(("name", "kind"), LEGITIMATE)
def test_a_declared_latch_or_oscillator_passes(tmp_path, name, kind):
    body = {**BISTABLE, **OSCILLATING}[name]
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    path = tmp_path / "netlists" / "board1.cir"
    path.write_text(board_with(BOARD1.read_text(), name, body, kind))
    board = finite(path)
    assert grows(fastest(board, 0.0)), "the circuit does not even start"
    result = judged(board)
    assert result.stable
    assert not result.refused
    assert all(each.declared for each in result.instabilities)
    assert result.instabilities


@pytest.mark.parametrize(
    "name", ["inverting Schmitt trigger", "negative resistance and a tank", "ring of three"]
)
def test_the_same_undeclared_is_refused(tmp_path, name):
    body = {**BISTABLE, **OSCILLATING}[name]
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    path = tmp_path / "netlists" / "board1.cir"
    path.write_text(board_with(BOARD1.read_text(), name, body, ""))
    result = judged(finite(path))
    assert result.refused
    assert all("xextra" in owner for each in result.refused for owner in each.loop)


def test_a_declaration_is_checked(tmp_path):
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    path = tmp_path / "netlists" / "board1.cir"
    path.write_text(board_with(BOARD1.read_text(), "x", "R1 in out 1k", "wobbly"))
    with pytest.raises(InputError, match=r"stability.*wobbly.*bistable, oscillating") as raised:
        finite(path)
    assert raised.value.problems[0].line
    path.write_text("*@ stability=bistable\n" + BOARD1.read_text())
    with pytest.raises(InputError, match="inside"):
        finite(path)


def swapped(tmp_path, block, old, new):
    """A project whose block has a slip; return its two boards."""
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    file = tmp_path / "netlists" / "blocks" / f"{block}.cir"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    return tmp_path / "netlists" / "board1.cir", tmp_path / "netlists" / "board2.cir"


IDEAL = {"opamp": "ideal", "vca": "ideal", "driver_level": "ideal", "motor": "emf"}
DYNAMIC = {"opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full", "differentiator": "corner"}
FULL = {**DYNAMIC, "opamp": "full", "driver_level": "full"}


@pytest.mark.parametrize(
    ("block", "old", "new", "amplifier"),
    [
        ("summer", "xop 0 sum", "xop sum 0", "xboard.xsum1.xop"),
        ("diffamp", "xop inp inn", "xop inn inp", "xboard.xdiff1.xop"),
        ("differentiator", "xop 0 inn", "xop inn 0", "xboard.xder1.xop"),
    ],
)
def test_hard_case_48_every_model_refuses_swapped_inputs(tmp_path, block, old, new, amplifier):
    board, _ = swapped(tmp_path, block, old, new)
    every = set()
    for model, effects in (("ideal", IDEAL), ("linear", DYNAMIC), ("spice", IDEAL), ("spice", FULL)):
        tables = slider(device={"board": str(board)}, effects=effects, solver={"model": model})
        plan = resolve(scene_of(tmp_path, tables))
        with pytest.raises(InputError) as raised:
            run(plan, tmp_path / "out", formats=(), child=shared_child())
        every.add(str(raised.value))
        assert amplifier in str(raised.value)
        assert "rad/s" in str(raised.value)
    assert len(every) == 1, "the models say different things"
    assert not (tmp_path / "out").exists()


def test_a_pole_at_the_end_of_the_band_hides_no_slower_one(tmp_path):
    """Two fits agree on +2.5e8 +- 2.8e10j as well, which is none: the board ran with a caution only.

    Found by the random search; seen to fail where the fastest candidate alone is kicked.
    """
    lags = "Rs1 out f1 10k\nCs1 f1 0 4.308e-08\nRs2 f1 f2 10k\nCs2 f2 0 4.308e-08\nxop wiper f2"
    path, _ = swapped(tmp_path, "angle", "xop wiper out", lags)
    values = {"r_sum_spring": "23332", "r_sum_damper": "5712.7", "r_diff_fb": "1.3887e+05"}
    board = load_deck(path, levels={**FINITE, "driver": "voltage"}, overrides=values)
    pole = fastest(board, 0.0)
    (instability,) = judged(board).refused
    told = complex(instability.real, instability.imag)
    assert abs(told - complex(pole.real, abs(pole.imag))) < 0.05 * abs(pole)


def test_rounding_behind_ideal_amplifiers_is_no_pole(tmp_path):
    """Gains of 1e9 leave 6e-10 of a path to rounding; 42 poles on both sides of the axis fit that too.

    `linear` refused the board as unstable with a pole at +67 +- 460j rad/s, which the reference has not.
    Found by the random search; seen to fail with `_NEEDED` at `GOOD`.
    """
    _, path = swapped(tmp_path, "diffamp", ".ends", "Rslip out inp 1.577e+06\n.ends")
    overrides = (
        f"device.board={str(path)!r}", "effects.opamp=ideal", "effects.vca=gbw",
        "effects.driver_level=ideal",
        "effects.motor=full", "effects.differentiator=corner", "effects.driver_limit=true",
        "device.values.r_sum_spring=26097", "device.values.r_sum_damper=9562.6",
        "device.values.r_diff_fb=2.1816e+05",
    )  # fmt: skip
    plan = resolve(load_scene(SCENES / "slope.toml", overrides))
    assert not any(map(grows, truth(question(plan).boards[0])))
    payload = {"board": plan.board, "model": "linear", "band_hz": 1e4, "tolerance": 1e-3, "cache": False}
    circuit = shared_child().call("cosim.circuits.extraction.extract:extract", payload)
    assert circuit.certificate["fit_error"] < 1e-8


def test_whoever_allows_it_may_look(tmp_path):
    board, _ = swapped(tmp_path, "summer", "xop 0 sum", "xop sum 0")
    tables = slider(
        device={"board": str(board)}, effects=FULL, duration_s=0.05, solver={"allow_unstable": True}
    )
    done = run(resolve(scene_of(tmp_path, tables)), tmp_path / "out", formats=(), child=shared_child())
    assert not done.plan["stability"]["stable"]
    assert done.plan["stability"]["instabilities"][0]["loop"] == ["xboard.xsum1.xop"]


def test_check_says_the_same_and_fails(tmp_path, capsys):
    board, _ = swapped(tmp_path, "summer", "xop 0 sum", "xop sum 0")
    assert main(["check", str(board)]) == 2
    out = capsys.readouterr().out
    assert "unstable: a pole at +" in out
    assert "xboard.xsum1.xop" in out
    assert main(["check", str(BOARD1)]) == 0
    assert "stable" in capsys.readouterr().out


def test_a_verdict_is_kept_by_content(tmp_path, monkeypatch):
    scene = scene_of(tmp_path, slider(effects=DYNAMIC))
    asked = question(resolve(scene))
    first = verdict(asked, BOARD1, shared_child())
    monkeypatch.setattr("cosim.stability_gate.call", lambda *a, **k: pytest.fail("asked again"))
    assert verdict(asked, BOARD1) == first
    # no loop of this board passes a multiplier: other gains, the same verdict
    stiff = scene_of(tmp_path, slider(effects=DYNAMIC, computer={"analog_stiffness_n_per_m": 30.0}))
    assert question(resolve(stiff)).commanded != asked.commanded
    assert verdict(question(resolve(stiff)), BOARD1) == first


def test_a_loop_through_a_multiplier_is_judged_at_the_commanded_gains(tmp_path):
    """W = X y/10 V fed back to X: from x1 over 500 Ohm and from 4 W over 1 kOhm, X = (2 x1 + 4 W)/3.

    The loop's gain is 4 y/30 V: stable at no gain, a pole in the right half plane beyond 7.5 V.
    """
    shutil.copytree(NETLISTS, tmp_path / "netlists")
    path = tmp_path / "netlists" / "board1.cir"
    line = "xksp11 x1 ksp11 wsp11 vcc vee vca"
    looped = "\n".join([
        "xksp11 xq ksp11 wsp11 vcc vee vca", "Efour w4 0 wsp11 0 4", "Rin x1 xq 500", "Rfb w4 xq 1k",
    ])  # fmt: skip
    assert line in BOARD1.read_text()
    path.write_text(BOARD1.read_text().replace(line, looped))
    board = finite(path)
    result = judged(board)
    pole = fastest(board, 10.0)
    assert fastest(board, 0.0).real < 0.0 < pole.real
    assert [each.condition for each in result.refused] == ["with all gains at full scale"]
    assert result.refused[0].real == pytest.approx(pole.real, rel=0.05)  # as well as two fits must agree
    assert result.gains_matter


#: An op-amp in the manner of old macro-models: its common-mode gain rises with frequency and never falls. The
#: resistor between its inputs then pushes the output along, the harder the faster: a pole on the right at
#: 2/(3e-8 * 0.1) * (600k/100 + 1) = 4e12 rad/s as a follower, where no part is what its model says.
RISING = """\
.subckt rising 1 2 3 4 5
R1 1 m 250k
R2 m 2 250k
G1 0 c m 0 3e-8
L1 c d 0.1
R3 d 0 1k
E1 7 1 c 0 1
RID 7 2 600k
G2 0 x 7 2 1m
RX x 0 200meg
CX x 0 159p
G3 0 y x 0 1u
RY y 0 1meg
CY y 0 5.3f
E2 z 0 y 0 1
RO z 5 100
RP 3 4 20k
.ends rising
"""


def rising(folder, pins):
    (folder / "rising.lib").write_text(RISING)
    part = PartSwap(folder / "rising.lib", "rising", pins)
    return load_deck(BOARD1, levels={**FINITE, "driver": "voltage"}, parts={"opamp": part})


def test_a_pole_where_no_part_is_what_its_model_says_condemns_no_board(tmp_path):
    board = rising(tmp_path, "1 2 3 4 5")
    poles = Circuit(bench_text(board, 0.0)).poles()
    right = np.abs(poles[poles.real > 0.0])
    assert right.size > 0
    assert right.min() > 2.0 * np.pi * 1e10
    result = judged(board)
    assert result.instabilities == ()
    assert result.stable


def test_such_a_part_hides_no_slip(tmp_path):
    result = judged(rising(tmp_path, "2 1 3 4 5"))  # its inputs swapped
    assert not result.stable
    value = result.instabilities[0]
    # as a follower: the gain of 1 MHz at its whole output on the right
    assert 2e6 < value.real < 2.0 * np.pi * 30e6


@pytest.mark.parametrize(
    "number", [6, 12, *(pytest.param(k, marks=pytest.mark.slow) for k in range(24) if k not in (6, 12))]
)
def test_a_fit_that_finds_far_poles_in_rounding_takes_nothing_back(tmp_path, number):
    """A follower behind two lags R C: its poles x/(R C) solve x (1 + 3 x + x^2) + w R C = 0, w of its gain.

    Seen to fail where poles beyond 10 GHz were believed of a fit alone: 6 and 12 passed as stable.
    """
    rng = np.random.default_rng(number)
    gain_hz, lag = 10.0 ** rng.uniform(5, 7), rng.uniform(4.0, 200.0)
    farad = lag / (2.0 * np.pi * gain_hz * 1e4)
    lags = f"Rs1 out f1 10k\nCs1 f1 0 {farad!r}\nRs2 f1 f2 10k\nCs2 f2 0 {farad!r}"
    board, _ = swapped(tmp_path, "angle", "xop wiper out", f"{lags}\nxop wiper f2")
    values = {"tl072_gbw": repr(gain_hz)}
    result = judged(load_deck(board, levels={**FINITE, "driver": "voltage"}, overrides=values))
    expected = np.roots([1.0, 3.0, 1.0, lag]).real.max() / (farad * 1e4)
    # 1 Ohm of the output against 1.58 kOhm of the differentiator, and a second pole at 10 MHz
    assert [each.real for each in result.refused] == [pytest.approx(expected, rel=0.05)]


def test_a_stuck_output_at_rest_is_reported(tmp_path):
    """Hard case 49: Newton finds an output at its limit, where the loop has no gain and nothing grows."""
    board, _ = swapped(tmp_path, "summer", "xop 0 sum", "xop sum 0")
    result = Verdict(latched=(Latched("xboard.xsum1.xop", 13.4),))
    assert not result.stable
    assert "xboard.xsum1.xop" in result.cautions()[0].text
    # an offset pushes the clamped amplifier to its rail before Newton begins
    file = tmp_path / "netlists" / "blocks" / "summer.cir"
    file.write_text(file.read_text().replace("R31 sum out {r31}", "R31 sum out {r31}\nIpush 0 sum 3m"))
    levels = {role: "full" for role in FINITE}
    at_rest = judged(load_deck(board, levels={**levels, "driver": "voltage"}))
    # 47 finds no operating point at all, and that is said
    stuck = [each.path for each in at_rest.latched]
    assert "xboard.xsum1.xop" in stuck or "no DC operating point" in at_rest.cautions()[0].text


def test_an_output_that_hangs_at_the_end_of_a_run_is_reported(tmp_path):
    """The summing amplifier asks for -10k/20k of the command: -2 V at 4 V, and 13.4 V is not that."""
    plan = resolve(scene_of(tmp_path, slider(effects=FULL)))
    node = next(a.out_node for a in plan.board.amplifiers if a.path == "xboard.xsum1.xop")
    end = {"nodes": {node: 13.4}, "pins": {"cmd1": 4.0}, "speed_rad_per_s": 0.0}
    (result,) = latched(plan, end, {node: 13.5}, shared_child())
    assert "xboard.xsum1.xop" in result.text
    assert "-2 V" in result.text
    # it is overdriven where its inputs ask for more than it can, and nobody knows while the device moves
    assert not latched(plan, end | {"pins": {"cmd1": -40.0}}, {node: 13.5}, shared_child())
    assert not latched(plan, end | {"speed_rad_per_s": 1.0}, {node: 13.5}, shared_child())
    assert not latched(plan, end | {"nodes": {node: 9.0}}, {node: 13.5}, shared_child())


def test_a_verdict_survives_its_file():
    odd = Instability(np.nan, np.nan, ("a", "b"), "with all gains at zero", confirmed=False, declared=False)
    known = Instability(2.5e4, 8e4, ("c",), "at full scale", confirmed=True, declared=True)
    result = Verdict((known,), (Latched("d", 12.0),), gains_matter=True)
    assert Verdict.of(result.as_dict()) == result
    again = Verdict.of(Verdict((odd,)).as_dict())
    assert np.isnan(again.instabilities[0].real)
    assert again.instabilities[0].loop == ("a", "b")
    assert not again.refused
    assert again.cautions()


@pytest.mark.parametrize("board", [BOARD1, BOARD2])
def test_a_known_board_is_not_judged_again(board, monkeypatch):
    """A verdict is kept by the board's content: the second asks no process, but reads a file."""
    deck = finite(board)
    first = judged(deck)

    def never(*arguments, **more):
        raise AssertionError("judged again")

    monkeypatch.setattr("cosim.stability_gate.call", never)
    assert verdict(Question((deck,)), deck.path) == first


@pytest.mark.parametrize("model", ["spice", "linear"])
def test_a_board_that_cannot_be_judged_runs_with_a_warning(tmp_path, monkeypatch, capsys, model):
    why = "the impedances of the board are lost in rounding at 1e+09 Hz"
    monkeypatch.setattr("cosim.runner.verdict", lambda *_, **__: Verdict(unjudged=why))
    out = tmp_path / "out"
    short = ["--set", "duration_s=0.05", "--model", model, "--no-estimate"]
    assert main(["run", str(SCENES / "press.toml"), *short, "-o", str(out)]) == 0
    shown = capsys.readouterr()
    assert f"warning: the board's stability is unknown: {why}" in shown.out + shown.err
    assert "stability-unknown" in (out / "run.json").read_text()
