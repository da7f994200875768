"""Single effects of the circuit: their null forms, their formulas, and models that agree on them.

Numbers in comments are the hard cases' numbers of the project's list. Expected values come from the
resistors in the netlists, the parts' data and closed forms.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extraction_boards import board as stages
from extraction_boards import extract
from netlist_decks import NETLISTS, measures, parameters, run_program
from support import KT, MOTOR_OHM, TORQUE, merge, quick, scene_of, shared_child, slider

from cosim.analysis.extracted import circuit_of
from cosim.effects.circuit import CARRIED
from cosim.errors import InputError
from cosim.loop.linear.run_linear import prepare
from cosim.ngspice.deck import Deck, Feature, load_deck
from cosim.plan import resolve
from cosim.results import Run

OPAMP = parameters("parts/tl072.lib")
VCA = parameters("parts/ad633.lib")
DRIVER = parameters("parts/opa548.lib")
BLOCKS = parameters(
    *(f"blocks/{name}.cir" for name in ("diffamp", "differentiator", "summer", "driver_voltage"))
)
REACH = 0.1333
DYNAMIC = {"opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full", "differentiator": "corner"}
#: ngspice's relative tolerance as scenes have it: two runs that solve the same equations differ by no more.
RTOL = 1e-4


def features(*on: str, corner: bool = True) -> list[Feature]:
    """Every single effect off but those named."""
    return [*(Feature(name, name in on, roles) for name, roles in CARRIED.items()),
            Feature("differentiator_corner", corner)]  # fmt: skip


def board(*on: str, level: str = "ideal", corner: bool = True, **more: Any) -> Deck:
    levels = {"opamp": level, "vca": level, "driver_level": level, "motor": "ideal"}
    return load_deck(NETLISTS / "board1.cir", levels=levels, features=features(*on, corner=corner), **more)


def elements(deck: Deck) -> list[str]:
    return [line.text for line in deck.lines if not line.text.startswith((".", "*"))]


def moving(**top: Any) -> dict[str, Any]:
    """A carriage that a hand takes into a wall of spring and damper and out again."""
    base = slider(
        duration_s=0.4,
        computer={"period_s": 0.01, "analog_damping_n_s_per_m": 2.0},
        operator={
            "type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 10.0, "stiffness_n_per_m": 200.0,
            "waypoints_s_m": [[0.0, 0.0, 0.01], [0.25, 0.0, -0.02], [0.4, 0.0, 0.0]],
        },
        device={"start": {"q_rad": [0.05]}},
        solver={"max_step_s": 2e-4},
        effects={"operator_dynamics": True},
    )  # fmt: skip
    return merge(base, top)


def between(run: Run, times: Any, name: str) -> Any:
    """Values of a signal between its accepted points."""
    return np.interp(times, np.asarray(run.signals["time"]), np.asarray(run.signals[name]))


def apart(first: Run, second: Run, name: str = "imot1") -> float:
    """Largest difference of a signal in the middle of the periods, as a share of its largest value."""
    times = (np.arange(40) + 0.5) * 0.01
    a, b = between(first, times, name), between(second, times, name)
    return float(np.abs(a - b).max() / np.abs(b).max())


# ---- an effect that is off is not there


@pytest.mark.parametrize("level", ["ideal", "gbw", "full"])
def test_without_effects_the_deck_is_that_of_the_level(level: str) -> None:
    """No condition is left for ngspice, and nothing beyond what the files give with their own flags."""
    off = board(level=level)
    assert not [line for line in off.lines if line.keyword in (".if", ".else", ".endif", ".temp")]
    assert elements(off) == elements(load_deck(NETLISTS / "board1.cir", levels={
        "opamp": level, "vca": level, "driver_level": level}))  # fmt: skip


@pytest.mark.parametrize(
    ("name", "level", "added"),
    [
        ("opamp_slew", "gbw", -1),  # a bent source for a straight one and its loss
        ("opamp_saturation", "gbw", 2),  # two diodes
        ("opamp_offset", "ideal", 3 + 3),  # in op-amp and driver: a current for V_os, two for the inputs
        ("opamp_offset", "gbw", 3 + 3),
        ("vca_gain_error", "ideal", 0),
        ("vca_offset", "gbw", 0),
        ("vca_nonlinearity", "ideal", 0),
        ("driver_limit", "gbw", 5),  # a stage and two diodes, each with its shift, for a stage and a resistor
    ],
)
def test_each_effect_adds_its_own_elements_to_a_part(name: str, level: str, added: int) -> None:
    off, on = elements(board(level=level)), elements(board(name, level=level))
    assert len(on) - len(off) == added
    assert on != off


def test_pure_differentiator_has_no_op_amp_and_no_corner() -> None:
    assert len(board().amplifiers) - len(board(corner=False).amplifiers) == 1
    assert not [text for text in elements(board(corner=False)) if text.startswith(("C2", "R2"))]


def test_effect_that_a_part_cannot_carry_is_refused() -> None:
    for name in ("opamp_slew", "opamp_saturation"):
        with pytest.raises(InputError, match="does not carry this effect at its level ideal") as caught:
            board(name)
        assert caught.value.problems[0].key == f"effects.{name}"
    board("opamp_slew", level="full")  # is in it


def test_a_vendors_model_says_that_it_cannot_be_switched(tmp_path: Path) -> None:
    vendor = tmp_path / "v.lib"
    vendor.write_text(".subckt V1 1 2 3 4 5\nE1 5 0 1 2 1e5\nR1 3 4 1meg\n.ends\n")
    from cosim.ngspice.deck import PartSwap

    swap = {"tl072": PartSwap(vendor, "V1", "1 2 3 4 5")}
    deck = load_deck(NETLISTS / "board1.cir", parts=swap, features=features("opamp_offset"))
    assert any("vendor's model" in note for note in deck.notes)


def test_slew_without_bandwidth_is_refused_with_the_key(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"opamp_slew.*means nothing without effects.opamp"):
        resolve(scene_of(tmp_path, moving(effects={"opamp_slew": True})))


@pytest.mark.parametrize("name", ["opamp_slew", "opamp_saturation", "vca_nonlinearity"])
def test_what_bends_needs_ngspice(tmp_path: Path, name: str) -> None:
    tables = moving(effects={"opamp": "gbw", name: True}, solver={"model": "auto"})
    assert resolve(scene_of(tmp_path, tables)).model == "spice"
    with pytest.raises(InputError, match=name):
        resolve(scene_of(tmp_path, merge(tables, {"solver": {"model": "linear"}})))


@pytest.mark.parametrize(
    "name", ["opamp_offset", "vca_gain_error", "vca_offset", "driver_limit", "temperature"]
)
def test_what_is_straight_needs_no_dynamics(tmp_path: Path, name: str) -> None:
    tables = moving(effects={name: True}, solver={"model": "auto"})
    assert resolve(scene_of(tmp_path, tables)).model == "ideal"


# ---- null limits: the effect's own number at its end is the effect switched off


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("on", "numbers"),
    [
        ({"opamp_slew": True}, {"tl072_sr": "1e15"}),
        ({"opamp_saturation": True}, {"tl072_drop": "-1e4"}),
        ({"opamp_offset": True}, dict.fromkeys(("tl072_vos", "tl072_ib", "opa548_vos", "opa548_ib"), "0")),
        ({"vca_gain_error": True}, {"ad633_scale": "0"}),
        ({"vca_offset": True}, {"ad633_vosin": "0", "ad633_vosout": "0"}),
        ({"vca_nonlinearity": True}, {"ad633_nlx": "0", "ad633_nly": "0", "ad633_ft": "0"}),
        ({"driver_limit": True}, {"r_ilim": "-13749.9"}),  # 15000 * 4.75 V / 0.1 Ohm: 0.7 MA
        ({"potentiometer": "full"}, {"pot_r": "0", "pot_rw": "1"}),  # the ideal one has 1 Ohm
        ({"temperature": True}, {}),  # 27 C
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)  # fmt: skip
def test_null_limit_is_the_effect_switched_off(
    tmp_path: Path, on: dict[str, Any], numbers: dict[str, str]
) -> None:
    off = quick(tmp_path, moving(effects=DYNAMIC, device={"values": numbers}))
    null = quick(tmp_path, moving(effects={**DYNAMIC, **on}, device={"values": numbers}))
    difference = apart(null, off)
    print(f"{difference:.1e}")
    assert difference < RTOL


def test_corners_far_away_are_the_pure_differentiator(tmp_path: Path) -> None:
    far = {"r_der_in": "1m", "c_der_fb": "1e-18"}
    pure = quick(tmp_path, moving())
    with_corner = quick(tmp_path, moving(effects={"differentiator": "corner"}, device={"values": far}))
    # tau = 1 ns and 0.1 ps; both differentiate what the predictor gives, to the tolerance of ngspice
    assert apart(with_corner, pure) < 10 * RTOL


def test_nominal_temperature_changes_no_line() -> None:
    assert board(temperature_c=27.0).text == board().text
    assert board(temperature_c=37.0).text != board().text


# ---- what the formulas say


def test_offset_current_is_that_of_the_resistors() -> None:
    """With all pins at zero: the summing amplifier with its noise gain and bias, the driver behind it."""
    circuit = extract(board("opamp_offset"), "ideal")
    sums = BLOCKS["r_sum_fb"] * sum(1 / BLOCKS[f"r_sum_{name}"] for name in ("spring", "damper", "cmd"))
    summed = OPAMP["tl072_vos"] * (1 + sums) + OPAMP["tl072_ib"] * BLOCKS["r_sum_fb"]
    gain = BLOCKS["r_drv_fb"] / BLOCKS["r_drv_in"]
    driven = -gain * summed + DRIVER["opa548_vos"] * (1 + gain) + DRIVER["opa548_ib"] * BLOCKS["r_drv_fb"]
    # 1e-4: the multipliers' 0.1 Ohm, and an open-loop gain of 1e9 into 5 Ohm
    assert circuit.offset[0] == pytest.approx(driven / MOTOR_OHM, rel=1e-4)
    # the follower's V_os through -G, the difference amplifier's own through 1 + G: one V_os is left
    assert circuit.x_offset[0] == pytest.approx(OPAMP["tl072_vos"], rel=1e-3)  # bias currents: 17 uV
    # the differentiator: its own V_os and the bias current through 100 kOhm
    bias = OPAMP["tl072_ib"] * BLOCKS["r_der_fb"]
    assert circuit.x_offset[1] == pytest.approx(OPAMP["tl072_vos"] + bias, rel=1e-6)
    assert not circuit.y_offset.any()


def test_multiplier_offsets_are_found_apart() -> None:
    circuit = extract(board("vca_offset"), "ideal")
    np.testing.assert_allclose(circuit.x_offset, VCA["ad633_vosin"], rtol=1e-6)
    np.testing.assert_allclose(circuit.y_offset, VCA["ad633_vosin"], rtol=1e-6)
    np.testing.assert_allclose(circuit.gain, 0.1, rtol=1e-6)
    weights = BLOCKS["r_sum_fb"] * (1 / BLOCKS["r_sum_spring"] + 1 / BLOCKS["r_sum_damper"])
    driven = BLOCKS["r_drv_fb"] / BLOCKS["r_drv_in"] * weights * VCA["ad633_vosout"]
    assert circuit.offset[0] == pytest.approx(driven / MOTOR_OHM, rel=1e-4)  # 0.1 Ohm at the outputs


def test_gain_error_is_in_the_measured_gain() -> None:
    plain, off = (extract(board(*on), "ideal") for on in ((), ("vca_gain_error",)))
    np.testing.assert_allclose(off.gain / plain.gain, 1 + VCA["ad633_scale"] / 100, rtol=1e-9)
    assert VCA["ad633_scale"] == 0.25


def test_differentiator_has_both_corners() -> None:
    circuit = extract(board(level="ideal"), "linear")
    hz = np.logspace(0, 4, 41)
    s = 2j * np.pi * hz
    tau = (BLOCKS["r_der_in"] * BLOCKS["c_der_in"], BLOCKS["r_der_fb"] * BLOCKS["c_der_fb"])
    v_rad = 20.0 / math.radians(340)
    slope = v_rad * BLOCKS["r_der_fb"] * BLOCKS["c_der_in"]
    expected = -s * slope / ((1 + s * tau[0]) * (1 + s * tau[1]))
    np.testing.assert_allclose(circuit.before(s)[:, 1, 0], expected, rtol=1e-5)  # 340 deg to nine digits
    pure = extract(board(corner=False), "linear")
    np.testing.assert_allclose(pure.before(s)[:, 1, 0], -s * slope, rtol=1e-6)
    assert pure.order == 0


def test_warm_motor_has_more_resistance_and_less_torque(tmp_path: Path) -> None:
    """Ten kelvin: copper 3.9 %, the magnet -2 %; the differentiator 0.05 % and -0.2 %."""
    cold, warm = (extract(board(temperature_c=t), "ideal") for t in (27.0, 37.0))
    np.testing.assert_allclose(warm.d_post, cold.d_post / 1.039, rtol=1e-6)
    rate = warm.e_pre[1, 0] / cold.e_pre[1, 0]
    assert rate == pytest.approx((1 + 10 * 50e-6) * (1 - 10 * 200e-6), rel=1e-6)
    hot = {"temperature_c": 37.0, "start": {"q_rad": [-0.05]}}
    tables = slider(effects={"temperature": True}, device=hot, solver={"model": "ideal"})
    scene = scene_of(tmp_path, tables)
    stated = resolve(scene).stated(shared_child())
    assert stated.torque_per_amp == pytest.approx(0.98 * TORQUE, rel=1e-12)
    assert stated.kt == KT, "the computer believes what the board states"
    run = quick(tmp_path, tables)
    t, current, speed = (np.asarray(run.signals[name]) for name in ("time", "imot1", "v1"))
    push = np.trapezoid(current[t < 0.1], t[t < 0.1])  # until well inside the wall
    # steps of 2 ms at 20 rad/s: (0.002 * 20)^2 / 12 of the integral
    assert speed[t < 0.1][-1] * 0.2 * REACH**2 == pytest.approx(0.98 * TORQUE * push, rel=1e-3)


def test_back_emf_falls_with_the_magnet() -> None:
    decks = [
        load_deck(NETLISTS / "board1.cir", levels={"motor": "emf"}, features=features(), temperature_c=t)
        for t in (27.0, 37.0)
    ]
    cold, warm = (extract(deck, "ideal").d_post[0, -1] for deck in decks)
    assert warm / cold == pytest.approx(0.98 / 1.039, rel=1e-6)


def part(folder: Path, name: str, level: str, flags: tuple[str, ...], circuit: str) -> dict[str, float]:
    """Run a part alone in plain ngspice, single effects switched on as a bench does it."""
    deck = folder / "part.cir"
    switched = "".join(f".param {flag}=1\n" for flag in flags)
    rails = "Vcc vcc 0 15\nVee vee 0 -15\n"
    deck.write_text(
        f"a part alone\n.lib 'netlists/parts/{name}.lib' {level}\n{switched}{rails}{circuit}\n.end\n"
    )
    return measures(run_program(deck))


def test_slew_limit_makes_a_triangle_of_a_large_sine(tmp_path: Path) -> None:  # 38
    """Driven hard at the frequency f, a follower's output has the amplitude SR/(4 f)."""
    rate, hz = parameters("parts/ua741.lib")["ua741_sr"], 20e3
    circuit = f"Vin in 0 sin(0 50 {hz})\nx1 in out vcc vee out ua741\nRl out 0 100k\n"
    circuit += f".options reltol=1e-5\n.tran {1 / hz / 400} {42 / hz} {40 / hz} {1 / hz / 400}\n"
    circuit += ".measure tran hi max v(out)\n.measure tran lo min v(out)\n"
    result = part(tmp_path, "ua741", "gbw", ("opamp_slew",), circuit)
    # the input passes the output's range of 6 V at 50 V * 2 pi f = 6.3 V/us: the slope turns within 0.16 us
    # of each 25 us, in which it is smaller
    assert (result["hi"] - result["lo"]) / 2 == pytest.approx(rate / (4 * hz), rel=0.01)
    without = part(tmp_path, "ua741", "gbw", (), circuit)
    assert without["hi"] > 40


def test_saturation_clips_and_leaves_the_rest_alone(tmp_path: Path) -> None:
    swing = 15 - OPAMP["tl072_drop"]
    opened = "Vin in 0 1\nx1 in 0 vcc vee out tl072\nRl out 0 100k\n.dc Vin -1 1 2\n"
    opened += ".measure dc lo find v(out) at=-1\n.measure dc hi find v(out) at=1\n"
    result = part(tmp_path, "tl072", "gbw", ("opamp_saturation",), opened)
    # 1 V at the input gives 10 uA into diodes of 1e-15 A: 0.595 V, of which 0.6 V were expected
    assert result["hi"] == pytest.approx(swing, rel=1e-3)
    assert result["lo"] == pytest.approx(-swing, rel=1e-3)
    follower = "Vin in 0 1\nx1 in out vcc vee out tl072\nRl out 0 100k\n.dc Vin 10 12 2\n"
    follower += ".measure dc out find v(out) at=10\n"
    assert part(tmp_path, "tl072", "gbw", ("opamp_saturation",), follower)["out"] == pytest.approx(
        10, rel=1e-5
    )


def test_nonlinearity_and_feedthrough_are_the_data_sheets(tmp_path: Path) -> None:
    """Cubic errors that peak at 1/sqrt(3) of full scale, and a x^2 / 10 V with the other input at zero."""

    def w(x: float, y: float, *flags: str) -> float:
        circuit = f"Vx x 0 {x!r}\nVy y 0 {y!r}\nx1 x 0 y 0 w 0 vcc vee ad633\n.dc Vx {x!r} {x + 1!r} 1\n"
        circuit += f".measure dc w find v(w) at={x!r}\n"
        return part(tmp_path, "ad633", "gbw", flags, circuit)["w"]

    peak = 10 / math.sqrt(3)
    both = (VCA["ad633_nlx"], VCA["ad633_nly"])
    error = w(peak, 10.0, "vca_nonlinearity") - w(peak, 10.0)
    # of X its peak; of Y none at full scale, s - s^3 = 0; feedthrough a (x^2 + y^2) / 10 V and a^2 x y / 10 V
    a = VCA["ad633_ft"] / 100
    through = a * (peak**2 + 10.0**2) / 10 + a**2 * peak
    assert error == pytest.approx(both[0] / 100 * peak * 2.598 * (1 - 1 / 3) + through, rel=0.02)
    assert w(10.0, 0.0, "vca_nonlinearity") == pytest.approx(VCA["ad633_ft"] / 100 * 10, rel=0.02)
    # each error alone is part of all of them
    every = ("vca_gain_error", "vca_offset", "vca_nonlinearity")
    circuit = (
        "Vx x 0 5\nVy y 0 -8\nx1 x 0 y 0 w 0 vcc vee ad633\n.dc Vx 5 6 1\n.measure dc w find v(w) at=5\n"
    )
    full, sums = (part(tmp_path, "ad633", *case, circuit)["w"] for case in (("full", ()), ("gbw", every)))
    assert sums == pytest.approx(full, abs=2e-5)  # six digits printed


def test_multipliers_offset_feeds_the_other_input_through(tmp_path: Path) -> None:
    circuit = "Vx x 0 10\nVy y 0 0\nx1 x 0 y 0 w 0 vcc vee ad633\n.dc Vx 0 10 10\n"
    circuit += ".measure dc a find v(w) at=0\n.measure dc b find v(w) at=10\n"
    result = part(tmp_path, "ad633", "ideal", ("vca_offset",), circuit)
    assert result["b"] - result["a"] == pytest.approx(VCA["ad633_vosin"], rel=1e-4)


def test_saturating_multiplier_in_a_loop_oscillates_as_its_describing_function_says(
    tmp_path: Path,
) -> None:  # 39
    """Three equal lags behind a multiplier of full-scale control: N(a) K = 8, N the clipper's."""
    gain, clip, tau = 24.0, 15 - VCA["ad633_drop"], 1e-3
    lags = "".join(
        f"E{k} e{k} 0 {a} 0 {g}\nR{k} e{k} {b} 1k\nC{k} {b} 0 {tau / 1e3}\n"
        for k, a, b, g in ((1, "w", "a", -gain), (2, "a", "b", 1), (3, "b", "c", 1))
    )
    # the multiplier sees c / 10, so that its input stays inside its own range
    circuit = f"Ex x 0 c 0 1\nVy y 0 10\nx1 x 0 y 0 w 0 vcc vee ad633\n{lags}.ic v(c)=5\n"
    circuit += f".options reltol=1e-5\n.tran 20u {60 * tau} {40 * tau} 20u uic\n"
    circuit += ".measure tran hi max v(c)\n.measure tran lo min v(c)\n"
    result = part(tmp_path, "ad633", "full", (), circuit)

    def describing(a: float) -> float:
        return 2 / math.pi * (math.asin(1 / a) + math.sqrt(1 - 1 / a**2) / a)

    low, high = 1.0 + 1e-9, 100.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if describing(middle) > 8 / gain else (low, middle)
    # the lags leave (2/sqrt(28))^3 = 5 % of a clipped wave's third harmonic (a fifth), 1 % of the amplitude;
    # the data sheet's errors bend the characteristic by 2 %
    assert (result["hi"] - result["lo"]) / 2 == pytest.approx(low * clip, rel=0.03)


# ---- the driver's limit


def pushed(limit: bool, model: str, **more: Any) -> dict[str, Any]:
    """A hand pushes with up to 5 N into a wall of 150 N/m, the driver set to its rated 0.875 A."""
    return merge(
        slider(
            duration_s=2.0,
            device={"values": {"r_ilim": repr(15000 * 4.75 / 0.875 - 13750)}},
            computer={"period_s": 0.01, "analog_stiffness_n_per_m": 150.0},
            operator={
                "type": "hand", "mass_kg": 0.0, "damping_n_s_per_m": 20.0, "stiffness_n_per_m": 100.0,
                "waypoints_s_m": [[0.0, 0.0, 0.0]],
                "force_s_n": [[0.1, 0.0, 0.0], [0.5, 0.0, -5.0], [1.0, 0.0, -5.0], [1.2, 0.0, 0.0],
                              [1.5, 0.0, -1.0]],
            },
            effects={"driver_limit": limit, "operator_dynamics": True},
            solver={"model": model},
        ),
        more,
    )  # fmt: skip


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("model", "chosen"),
    [("ideal", {}), ("linear", {}), ("spice", {}), ("linear", DYNAMIC), ("spice", DYNAMIC)],
)
def test_driver_limit_is_a_clamp_in_every_model(
    tmp_path: Path, model: str, chosen: dict[str, Any]
) -> None:  # 40
    """0.875 A are 0.28 N m and 2.10 N at 133.3 mm; behind the clamp nothing winds up."""
    run = quick(tmp_path, pushed(True, model, effects=chosen))
    free = quick(tmp_path, pushed(False, model, effects=chosen))
    t = np.linspace(0.7, 0.98, 57)
    force = TORQUE * between(run, t, "imot1") / REACH
    # 0.05 % a decade of current is how sharp the limit's diodes are, and they divert a decade more or less
    # than they were made for; the wall would ask for 5 N * 150/250 = 3 N
    np.testing.assert_allclose(force, 0.28 / REACH, rtol=0.001)
    assert (TORQUE * between(free, t, "imot1") / REACH > 2.5).all()
    late = np.linspace(1.7, 1.98, 57)  # 0.5 s after the release: time constant 20/250 s, six of them
    np.testing.assert_allclose(between(run, late, "imot1"), between(free, late, "imot1"), atol=3e-3 * 0.875)
    # no wind-up: the current leaves the clamp when the wall asks for less, not later
    away = np.asarray(run.signals["time"]) > 1.0
    current, angle = (np.asarray(run.signals[name])[away] for name in ("imot1", "q1"))
    asked = -np.asarray(free.signals["imot1"]) @ np.asarray(free.signals["q1"])
    slope = asked / (np.asarray(free.signals["q1"]) @ np.asarray(free.signals["q1"]))
    if not chosen:  # without back-EMF and lag current and angle go together; the knee is as soft
        np.testing.assert_allclose(current, np.clip(-slope * angle, -0.875, 0.875), atol=0.012 * 0.875)


@pytest.mark.parametrize("model", ["ideal", "linear"])
def test_the_limit_of_a_negative_current_is_the_mirror_of_a_positive_ones(tmp_path: Path, model: str) -> None:
    """Wall and push turned round: every signal changes its sign and nothing else."""
    turned = {
        "wall": {"point_m": [0.0, 0.0], "normal": [0.0, -1.0]},
        "operator": {"force_s_n": [[0.1, 0.0, 0.0], [0.5, 0.0, 5.0], [1.0, 0.0, 5.0], [1.2, 0.0, 0.0],
                                   [1.5, 0.0, 1.0]]},
    }  # fmt: skip
    up, down = (quick(tmp_path, pushed(True, model, **more)) for more in ({}, turned))
    t = np.linspace(0.0, 1.98, 397)
    assert between(down, t, "imot1").min() == pytest.approx(-0.875, rel=0.001)
    assert between(up, t, "imot1").max() == pytest.approx(0.875, rel=0.001)
    # the two sides of the limit are diodes of their own, one within 0.1 % of the other
    for name, scale in (("imot1", 0.875), ("y", 0.02), ("v1", 1.0), ("fmy", 2.1)):
        np.testing.assert_allclose(between(up, t, name), -between(down, t, name), atol=1e-3 * scale)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_at_an_accepted_point_the_clamped_current_accelerates(tmp_path: Path, sign: float) -> None:
    """Run into the clamp and stopped there: torque is the limit's, acceleration what Newton says of it."""
    turned = {
        "duration_s": 0.9,
        "wall": {"point_m": [0.0, 0.0], "normal": [0.0, sign]},
        "operator": {"force_s_n": [[0.1, 0.0, 0.0], [0.5, 0.0, -5.0 * sign]]},
    }
    scene = scene_of(tmp_path, pushed(True, "ideal", **turned))
    circuit, constants = circuit_of(resolve(scene), child=shared_child())
    run = prepare(scene, constants, circuit, record=False)
    run.run()
    state = run.memory.state[0]
    low, high = circuit.limit[0]
    assert state["tau"][0] == pytest.approx(TORQUE * (high if sign > 0 else low), rel=1e-9)
    hand = -5.0 * sign - 100.0 * REACH * state["q"][0] - 20.0 * REACH * state["v"][0]
    newton = (state["tau"][0] + REACH * hand) / (0.2 * REACH**2)
    assert state["a"][0] == pytest.approx(newton, abs=1e-6 * 5.0 / (0.2 * REACH))


def test_limit_is_absent_when_off(tmp_path: Path) -> None:
    for level in ("ideal", "gbw"):
        model = "ideal" if level == "ideal" else "linear"
        assert np.isinf(extract(board(level=level), model).limit).all()
        limit = extract(board("driver_limit", level=level), model).limit
        expected = 15000 * 4.75 / (13750 + DRIVER["r_ilim"])
        np.testing.assert_allclose(limit, [[-expected, expected]], rtol=0.001)  # sharpness of the diodes
        # the driver is odd; points of one sweep are so to 1e-6 only (seen with `_settled` left out)
        np.testing.assert_allclose(limit[:, 0], -limit[:, 1], rtol=1e-9)


# ---- models agree on what both carry


@pytest.mark.few(6)
@pytest.mark.parametrize(
    "on",
    [
        {}, {"opamp_offset": True}, {"vca_gain_error": True}, {"vca_offset": True}, {"driver_limit": True},
        {"potentiometer": "full"}, {"temperature": True}, {"differentiator": "corner"},
        {"opamp_offset": True, "vca_offset": True, "vca_gain_error": True, "driver_limit": True},
    ],
    ids=lambda on: "-".join(on) or "none",
)  # fmt: skip
@pytest.mark.parametrize("dynamic", [False, True], ids=["static", "dynamic"])
def test_models_agree(tmp_path: Path, on: dict[str, Any], dynamic: bool) -> None:
    if "differentiator" in on and dynamic:
        pytest.skip("is among the dynamic ones")
    chosen = {**(DYNAMIC if dynamic else {}), **on}
    device = {"temperature_c": 50.0}
    runs = {
        model: quick(tmp_path, moving(effects=chosen, device=device, solver={"model": model}))
        for model in ("ideal", "linear", "spice")
        if model != "ideal" or not (dynamic or "differentiator" in on)
    }
    if "ideal" in runs:
        # the same equations, integrated by the same loop: what the two extractions leave, 1e-9 of each path
        assert apart(runs["ideal"], runs["linear"]) < 1e-7
    difference = apart(runs["linear"], runs["spice"])
    print(f"{difference:.1e}")
    assert difference < 10 * RTOL  # hard cases: at most 1e-3 from ngspice


def test_offsets_are_asked_for(tmp_path: Path) -> None:
    still = {"start": {"q_rad": [0.05]}}
    run = quick(tmp_path, slider(wall=None, device=still, effects={"opamp_offset": True}))
    assert run.signals["imot1"][0] != 0.0


# ---- boards that ngspice solves, or says why not


@pytest.mark.parametrize("gain", [0.5, -3.0, 2.0, 10.0])
def test_algebraic_loop_is_solved_whatever_its_gain(tmp_path: Path, gain: float) -> None:  # 35
    """A driver that feeds its own current back: u / (1 - g), although turns diverge from |g| = 1."""
    output = f"Bi imot1 0 V=v(ws)+v(wd)+v(cmd1)+{gain}*v(imot1)"
    circuit = extract(stages(tmp_path, output=output), "ideal")
    np.testing.assert_allclose(circuit.d_post[0, 2], 1 / (1 - gain), rtol=1e-9)


def test_algebraic_loop_of_gain_one_is_refused(tmp_path: Path) -> None:  # 35
    with pytest.raises(InputError, match="imot1"):
        extract(stages(tmp_path, output="Bi imot1 0 V=v(ws)+v(wd)+v(cmd1)+v(imot1)"), "ideal")
