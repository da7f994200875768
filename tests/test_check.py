"""`cosim check`: figures against theory on the shipped and on textbook boards, findings, errors."""

import json
import math
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support import BOARD1, BOARD2, SCENES, scene_of, slider

from cosim.checking import measured_constants
from cosim.checking.check import check
from cosim.checking.check_target import load_subject
from cosim.checking.loops import encirclements, gain_margins, measure_loops, phase_margins
from cosim.checking.printout import describe
from cosim.checking.probed_board import ProbedBoard
from cosim.checking.requirements import Severity
from cosim.circuits.extraction.swing import swings
from cosim.cli import main
from cosim.errors import InputError, NoOperatingPoint
from cosim.ngspice.child import call, start_early
from cosim.ngspice.deck import load_deck
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.variants import parse_settings, variants

KT, GEAR, MOTOR_OHM, MOTOR_H, R_TIP = 0.04, 8.0, 5.0, 1.5e-3, 0.1333
#: Where log |T| and the phase are joined by straight lines (see `phase_margins`), doubled.
PHASE_DEG, LEVEL = 0.1, 1e-3


@pytest.fixture(scope="module")
def child():
    with start_early("cosim.checking.measured") as process:
        yield process


@pytest.fixture
def checked(child):
    def run(target=BOARD2, *settings, level=None, driver=None):
        (variant,) = variants(parse_settings(settings))
        return check(load_subject(str(target), variant, level, driver), child=child)

    return run


def problems(result, section):
    return [f for f in result.findings if f.section == section and f.severity is Severity.PROBLEM]


# --- loops: textbook cases -------------------------------------------------------------------------------


def bisect(level):
    """Frequency [Hz] at which a falling level is 1."""
    low, high = 1.0, 1e9
    for _ in range(200):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if level(middle) > 1 else (low, middle)
    return low


def margins(f_gbw, *poles_hz, aol=1e6):
    """Crossover [Hz], phase margin [deg] of aol/(1 + j f aol/f_gbw) behind more poles."""
    corners = [f_gbw / aol, *poles_hz]
    f = bisect(lambda hz: aol / math.prod(math.hypot(1, hz / p) for p in corners))
    return f, 180.0 - sum(math.degrees(math.atan(f / p)) for p in corners)


def textbook(folder, poles_hz, gbw_hz, feedback, ro=1e-3):
    """One-joint board whose only op-amp has these poles, with a feedback of the test's choice."""
    (folder / "parts").mkdir()
    stages, last = "", "x"
    for k, pole in enumerate(poles_hz):
        stages += f"G{k} 0 n{k} {last} 0 1\nR{k} n{k} 0 1\nC{k} n{k} 0 {1 / (2 * math.pi * pole)!r}\n"
        last = f"n{k}"
    (folder / "parts" / "amp.lib").write_text(
        "*@ role=opamp out=out swing=amp_swing\n.subckt amp p m out\n"
        f"Gx 0 x p m 1\nRx x 0 1meg\nCx x 0 {1 / (2 * math.pi * gbw_hz)!r}\n"
        f"{stages}Gout 0 out {last} 0 {1 / ro!r}\nRout out 0 {ro}\n.ends\n"
    )
    (folder / "board.cir").write_text(
        "Textbook loop\n.subckt board pot1 vel1 u1 ksp11 ksd11 cmd1 imot1 vcc vee\n"
        + feedback
        + "Gi 0 imot1 out 0 1\nRi imot1 0 1\n.ends board\n"
    )
    (loop,) = measure_loops(ProbedBoard(Simulator(), load_deck(folder / "board.cir")))
    return loop


def opened(poles, gbw, feedback="xamp pot1 out out amp\n", ro=1e-3):
    """Measure a textbook loop in a process of its own."""
    return call("test_check:loop_of", (poles, gbw, feedback, ro), time_limit_s=60)


def loop_of(payload, report):
    with tempfile.TemporaryDirectory() as folder:  # the child's own: it writes nowhere else
        return textbook(Path(folder), *payload)


def test_margin_of_a_follower_with_a_second_pole():
    loop = opened([10e6], 3e6)
    crossover, margin = margins(3e6, 10e6)
    assert loop.dc_gain == pytest.approx(1e6, rel=1e-2)  # 0.1 Hz is 1/30 of its pole
    assert loop.crossover_hz == pytest.approx(crossover, rel=LEVEL)
    assert loop.phase_margin_deg == pytest.approx(margin, abs=PHASE_DEG)
    assert loop.gain_margin_db is None  # two poles never reach -180 deg
    assert loop.stable


@pytest.mark.parametrize("pole", [5e6, 1e6])
def test_gain_margin_of_an_integrator_with_two_poles(pole):
    # phase -180 deg at the double pole itself, where |T| = gbw/(2 pole)
    loop = opened([pole, pole], 3e6)
    _, margin = margins(3e6, pole, pole)
    assert loop.gain_margin_db == pytest.approx(
        20 * math.log10(2 * pole / 3e6), abs=20 * math.log10(1 + LEVEL)
    )
    assert loop.phase_margin_deg == pytest.approx(margin, abs=PHASE_DEG)
    assert loop.stable == (pole > 1.5e6)
    assert (loop.phase_margin_deg > 0) == loop.stable


def test_feedback_divider_loads_the_output():
    # 1 kOhm of output resistance into 9 k + 1 k: T = A * 1k/(11k)
    feedback = "xamp pot1 inn out amp\nR1 out inn 9k\nR2 inn 0 1k\n"
    loop = opened([], 11e6, feedback, ro=1e3)
    assert loop.crossover_hz == pytest.approx(1e6, rel=LEVEL)
    assert loop.phase_margin_deg == pytest.approx(90.0, abs=PHASE_DEG)


def test_load_capacitance_eats_the_margin():
    # 100 Ohm and 10 nF: a pole at 159 kHz in a follower of 1 MHz
    feedback = "xamp pot1 out out amp\nCload out 0 10n\n"
    loop = opened([], 1e6, feedback, ro=100.0)
    crossover, margin = margins(1e6, 1 / (2 * math.pi * 100 * 10e-9))
    assert loop.crossover_hz == pytest.approx(crossover, rel=LEVEL)
    assert loop.phase_margin_deg == pytest.approx(margin, abs=PHASE_DEG)
    assert margin < 45


def test_margins_of_sampled_responses():
    f = np.geomspace(1, 1e6, 121)
    t = 1e3 / (1 + 1j * f / 10) ** 3  # crosses -180 deg at sqrt(3) 10 Hz with |T| = 125
    (crossover,), (margin,) = phase_margins(f, t)
    assert crossover == pytest.approx(10 * math.sqrt(99), rel=LEVEL)
    assert margin == pytest.approx(180 - 3 * math.degrees(math.atan(math.sqrt(99))), abs=PHASE_DEG)
    # three poles at one place: three times the curvature, 3*4e-4 of |T| and as much again from the phase
    assert gain_margins(t) == pytest.approx([-20 * math.log10(125)], abs=0.03)
    assert encirclements(t) == 2  # two poles of 1 + T in the right half plane
    assert encirclements(t / 200) == 0


# --- the shipped board -----------------------------------------------------------------------------------


def test_ideal_board_keeps_its_word(checked):
    result = checked(level="ideal")
    assert not result.findings
    assert {c.name for c in result.measured.constants} == {"v_rad", "k_fs", "c_fs", "v_nm", "w_rated"}
    assert len([c for c in result.measured.constants if c.name == "k_fs"]) == 4
    assert all(abs(c.deviation_percent) < 0.1 for c in result.measured.constants)
    assert all(loop.stable is None for loop in result.measured.loops)  # no bandwidth, no crossover
    assert all(rest.current_a == 0.0 for rest in result.measured.rest)


def test_delays_are_the_blocks_time_constants(checked):
    steps = {s.block: s.delay_s for s in checked(level="gbw").measured.steps if s.joint == 1}
    # noise gain over 2 pi GBW: difference amplifier 1 + 169/10; summer 1 + 10k (2/24.3k + 2/6.19k + 1/20k)
    gbw = 2 * math.pi * 3e6
    summer = 1 + 10 * (2 / 24.3 + 2 / 6.19 + 1 / 20)
    # finite gain (2e5, 8e4) and the 1 Ohm outputs take up to 2e-4 of each; the driver's noise gain of 3 at
    # 1 MHz stands beside L/R
    assert steps["xdiff1"] == pytest.approx(17.9 / gbw, rel=1e-3)
    assert steps["xksp11"] == pytest.approx(1 / (2 * math.pi * 1e6), rel=1e-3)
    assert steps["xsum1"] == pytest.approx(summer / gbw, rel=1e-3)
    assert steps["xangle1"] == pytest.approx(1 / gbw, rel=1e-3)
    assert steps["xdrv1"] == pytest.approx(3 / (2 * math.pi * 1e6), rel=5e-3)  # aol 8e4, a load of 5 Ohm
    assert steps["motor"] == pytest.approx(MOTOR_H / MOTOR_OHM, rel=1e-6)


def test_back_emf_pays_for_the_delay(checked):
    (brake,) = checked(BOARD1, level="gbw").measured.brakes
    b = KT**2 * GEAR**2 / MOTOR_OHM
    assert brake.viscosity_n_m_s == pytest.approx(b, rel=1e-4)
    assert brake.stiffness_n_per_m == pytest.approx(b / brake.delay_s / R_TIP**2, rel=1e-4)
    assert brake.eta == pytest.approx(3.0003 * brake.delay_s / b, rel=1e-3)


def test_full_board_passes_and_names_the_parts_errors(checked):
    result = checked()
    assert result.count(Severity.PROBLEM) == 0
    warned = [f.message for f in result.findings]
    # full: 0.25 % scale error and 2.598*(0.4 + 0.1) % - 0.26 % of small-signal gain from the nonlinearity
    assert any(m.startswith("k_fs is off by +1.3") and "errors of the parts" in m for m in warned)
    (case, *_) = result.measured.headroom.cases
    assert case.current_a == pytest.approx(0.875, rel=5e-3)  # at rated the cubic has come back
    assert result.measured.rest[0].force_n < 0.05
    limits = result.measured.headroom.limits_a
    assert limits == pytest.approx([1.987, 1.987], rel=0.03)  # the clamp is two diodes


def test_an_edited_resistor_is_found(checked):
    result = checked(BOARD2, "r_diff_fb=171k", level="ideal")
    # R12 and R14 move together: the gain is 17.1 instead of 16.9
    off = {c.name: c.deviation_percent for c in result.measured.constants if abs(c.deviation_percent) > 0.1}
    assert off.keys() == {"k_fs"}  # a multiplier makes rated torque with the volts of before
    assert off["k_fs"] == pytest.approx(100 * (171 / 169 - 1), abs=0.01)
    assert len(problems(result, "constants")) == 1


def test_one_instance_edited_shows_at_its_own_places(checked):
    result = checked(BOARD2, "xder1.r22=110k", level="ideal")
    off = {(c.name, c.where) for c in result.measured.constants if abs(c.deviation_percent) > 0.1}
    assert off == {("c_fs", "11"), ("c_fs", "21")}
    assert "11, 21" in problems(result, "constants")[0].message


def test_swapped_gains_are_found(checked, tmp_path):
    project(tmp_path, ("xksp12 x2 ksp12", "xksp12 x2 ksp21"), ("xksp21 x1 ksp21", "xksp21 x1 ksp12"))
    result = checked(tmp_path / "board2.cir", level="ideal")
    assert any("k_fs is off by -100 % at 12, 21" in f.message for f in problems(result, "constants"))


def test_a_cut_wire_is_no_number(checked, tmp_path):
    project(tmp_path, ("Rcmd1 cmd1 sum1", "Rcmd1 cmd1 0"))
    result = checked(tmp_path / "board2.cir", level="ideal")
    assert next(c.measured for c in result.measured.constants if c.name == "v_nm") is None
    assert any("v_nm (1): nothing comes through" in f.message for f in result.findings)
    assert "v_nm" in describe(result)
    json.dumps(result.as_dict(), allow_nan=False)


def test_clipping_inside_the_working_range_is_found(checked):
    # gain 26: at 100 N/m, 157.6 mrad * 3.37 V/rad * 26 = 13.8 V of 13.5 V
    result = checked(BOARD2, "r_diff_fb=260k", level="full")
    messages = [f.message for f in problems(result, "headroom")]
    assert any("xboard.xdiff1.xop" in m and "100 N/m" in m for m in messages)
    # more gain behind the multiplier: 5.3 V * 12/24.3 are rated torque
    low = checked(BOARD2, "r_sum_spring=12k", level="ideal")
    assert any("multiplier 11 makes" in f.message for f in problems(low, "headroom"))


@pytest.mark.parametrize(("edit", "path"), [((), "xdrv"), (("r_drv_fb=2k",), "xsum")])
def test_the_speed_at_which_the_damper_clips_is_that_of_the_first_amplifier(checked, edit, path):
    """Driver 15 V less 3.7 V, summing amplifier less 1.5 V; a rad/s is v_rad r_der_fb c_der_in 10/6.19 V."""
    result = checked(BOARD1, *edit, level="gbw")
    summed = 3.37034 * 0.1 * 10.0 / 6.19
    first = {"xdrv": 11.3 / (2.0 * summed), "xsum": 13.5 / summed}[path]
    (speed,) = result.measured.headroom.speeds
    assert (speed.joint, speed.path) == (1, f"xboard.{path}1.xop")
    # op-amps of a gain of 106 dB, and the differentiator's corner at 100 Hz, seen at 0.1 Hz
    assert speed.speed_rad_per_s == pytest.approx(first, rel=1e-4)


def current_loop():
    """Loop gain of the current drive at the motor: integrator with its zero, motor, the op-amp's own loop."""

    def t(f):
        s = 2j * math.pi * f
        zf, zin = 124e3 + 1 / (s * 2.2e-9), 1 / (1 / 13.7e3 + 1 / 2.8e3)
        inner = 1e6 / (1j * f) * zin / (zin + zf)  # OPA548, 1 MHz
        return zf / 2.8e3 / (1 + 1 / inner) * 0.511 / (5.511 + s * MOTOR_H)

    return t


def test_current_loop_and_its_margin(checked):
    loops = {loop.path: loop for loop in checked(BOARD1, level="gbw", driver="current").measured.loops}
    outer = loops["xboard.xdrv1.xmotor"]
    t = current_loop()
    f = bisect(lambda hz: abs(t(hz)))
    # parts below 1e-3: the motor's loading of r_sense's divider, the OPA548's finite gain and 10 mOhm
    assert outer.crossover_hz == pytest.approx(f, rel=2e-3)
    assert outer.phase_margin_deg == pytest.approx(180 + math.degrees(np.angle(t(f))), abs=0.2)
    slow = checked(BOARD1, "cc_drv=22p", level="gbw", driver="current")
    assert any("xdrv1" in f.message for f in problems(slow, "loops"))


def test_voltage_drive_has_no_current_loop(checked):
    assert not [loop for loop in checked(BOARD1, level="gbw").measured.loops if loop.kind == "motor"]


def test_noise_of_resistors_is_theirs(checked):
    (noise, *_) = checked(BOARD1, level="ideal").measured.noise
    assert noise.gains == "all gains zero"
    kt4 = 4 * 1.380649e-23 * 300.15
    summer = kt4 * (10e3**2 * (1 / 24.3e3 + 1 / 6.19e3 + 1 / 20e3) + 10e3)
    volts = 4 * (summer + kt4 * 10e3) + kt4 * 20e3  # driver: gain 2, its input and feedback resistors
    # 0.1 and 1 Ohm outputs of ideal parts add 1e-4; ngspice integrates a flat spectrum exactly
    force = math.sqrt(volts * (1e5 - 0.1)) / MOTOR_OHM * KT * GEAR / R_TIP
    assert noise.force_n == pytest.approx(force, rel=2e-3)
    shares = {c.name: c.share_percent for c in noise.top}
    assert noise.complete
    assert shares["rsd11"] == pytest.approx(100 * 4 * kt4 * 10e3**2 / 6.19e3 / volts, rel=1e-2)


def test_potentiometer_noise_through_spring_and_damper(checked):
    (pot,) = checked(BOARD1, level="ideal").measured.pot_noise
    assert pot.spring_n == pytest.approx(0.006 * 3.0003 / R_TIP, rel=1e-3)
    assert pot.soft_n == pytest.approx(100 * R_TIP * 0.006, rel=1e-3)
    # white to B through c s/(1 + s/w1) with w1 at 100.7 Hz, the second corner at 1.6 kHz beside it
    f = np.linspace(0, 100, 20001)
    h = 2 * np.pi * f / np.abs(1 + 1j * f * 2 * np.pi * 1.58e-3) / np.abs(1 + 1j * f * 2 * np.pi * 1e-4)
    rms = 0.006 * math.sqrt(np.trapezoid(h**2, f) / 100)
    # trapezoids at 20 points a decade: h^2 grows as f^2, 0.5*(ln 10/20)^2/... = 0.3 % at most
    assert pot.damper_n == pytest.approx(rms * 0.06969 / R_TIP, rel=3e-3)


def test_a_scene_states_its_effects_and_bounds_the_step(checked, tmp_path):
    scene = scene_of(tmp_path, slider(effects={"motor": "full", "opamp": "gbw"}))
    result = checked(scene.file)
    assert {p.name: p.level for p in result.subject.board.parts}["tl072"] == "gbw"
    inertia = 0.2 * R_TIP**2
    assert result.coupling.step_s == pytest.approx(0.5 * inertia / (KT**2 * GEAR**2 / MOTOR_OHM), rel=1e-4)
    assert checked(scene.file, level="ideal").coupling is None


def test_a_swapped_part_is_checked_as_it_is(checked, tmp_path):
    scene = scene_of(tmp_path, slider(device={"parts": {"tl072": "opa2134"}}, effects={"opamp": "gbw"}))
    loops = {loop.path: loop for loop in checked(scene.file).measured.loops}
    angle = loops["xboard.xangle1.xop"]
    assert angle.part == "opa2134"
    assert angle.crossover_hz == pytest.approx(8e6, rel=1e-2)  # its GBW; 1 Ohm into 10 kOhm


def test_a_vendors_model_is_checked_and_what_cannot_be_known_is_reported(checked, tmp_path):
    vendor = Path(__file__).parent / "data" / "ngspice" / "vendor" / "boyle.lib"
    swap = {"file": str(vendor), "subckt": "TL072", "pins": "1 2 3 4 5", "dialect": "pspice"}
    result = checked(scene_of(tmp_path, slider(device={"parts": {"opamp": swap}})).file)
    message = " ".join(f.message for f in result.findings)
    assert "states no output limit" not in message
    limits = {s.path: s for s in result.measured.headroom.swings}
    # its clamps: 2.2 V below either supply and one diode's 0.7 V above that
    assert limits["xboard.xdiff1.xop"].limit_v == pytest.approx(13.5, abs=0.1)
    assert limits["xboard.xdiff1.xop"].limit_from == "measured"
    loops = {loop.path: loop for loop in result.measured.loops}
    # 3 MHz, less what 125 Ohm lose into 10 kOhm beside 1.58 kOhm (8 %) and a second pole (a few percent)
    assert loops["xboard.xangle1.xop"].crossover_hz == pytest.approx(2.7e6, rel=0.05)
    assert 45 < loops["xboard.xangle1.xop"].phase_margin_deg < 90
    # the board's own share is told without it
    assert all(abs(c.ideal_deviation_percent) < 0.01 for c in result.measured.constants)


# --- errors and the command ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("role", "lines", "pins", "limit", "source"),
    [
        ("opamp", "Bo 5 0 V=max(-9,min(9.5,1e5*v(1,2)))", "1 2 3 4 5", 9.0, "measured"),
        ("opamp", "Eo 5 0 1 2 1e5", "1 2 3 4 5", 15.0, "supplies"),
        ("driver", "Bo 5 0 V=max(-11,min(11,1e5*v(1,2)))", "1 2 3 4 5", 11.0, "measured"),
        ("vca", "Bo 5 0 V=max(-8,min(8.5,v(1,2)*v(6,7)/10+v(8)))", "1 2 6 7 5 8 3 4", 8.0, "measured"),
        ("opamp", "Eo 5 0 1 2 1e-3", "1 2 3 4 5", None, ""),
    ],
)
def test_what_a_part_does_not_state_is_measured_of_it_alone(
    checked, tmp_path, role, lines, pins, limit, source
):
    extra = " 6 7 8" if role == "vca" else ""
    (tmp_path / "op.lib").write_text(
        f".subckt myop 1 2 3 4 5{extra}\n{lines}\nrp 3 4 10k\nri 1 2 1meg\n.ends\n"
    )
    swap = {"file": "op.lib", "subckt": "myop", "pins": pins}
    scene_of(tmp_path, slider(device={"parts": {role: swap}}))
    deck = resolve(load_scene(tmp_path / "scene.toml")).board
    result = call("test_check:swings_of", {"board": deck})
    mine = [a.path for a in deck.amplifiers if a.part == "myop"]
    assert mine
    for path in mine:
        assert (
            (result[path].limit_v, str(result[path].source)) == (pytest.approx(limit), source)
            if limit
            else (path not in result)
        )


def swings_of(payload, report):
    return swings(Simulator(), payload["board"])


@pytest.mark.parametrize(
    ("made", "note"),
    [
        ("eo y 0 x 0 1\nro y n 126\nrn n 5 -26", "negative"),
        ("j$a 3 y sp nj\nrs sp 5 100\nro y x 0.1\n.model nj njf(vto=-1 beta=1e-3)\n.param z=0", ""),
    ],
    ids=["negative-resistor", "dollar"],
)
def test_noise_that_one_element_does_not_tell_costs_no_check(checked, tmp_path, made, note):
    (tmp_path / "op.lib").write_text(
        f".subckt myop 1 2 3 4 5\nga 0 x 1 2 1m\nra x 0 200meg\nca x 0 53p\n{made}\nrp 3 4 10k\n.ends\n"
    )
    swap = {"file": "op.lib", "subckt": "MYOP", "pins": "1 2 3 4 5", "dialect": "pspice"}
    scene_of(tmp_path, slider(device={"parts": {"opamp": swap}}))
    result = checked(tmp_path / "scene.toml")
    message = [f.message for f in result.findings if f.section == "noise"]
    assert all(note in message for message in message)
    assert bool(note) == bool(message)
    assert result.measured.components.rest_n > 0.0
    # the multipliers' resistors among others
    assert all(n.current_a > 0.0 and n.complete for n in result.measured.noise)


def project(folder, *edits):
    """Copy of the shipped netlists with a text of board2 replaced."""
    import shutil

    shutil.copytree(BOARD2.parent, folder, dirs_exist_ok=True)
    text = BOARD2.read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (folder / "board2.cir").write_text(text)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("xdiff1 u1 p1 x1", "Rbad x1\nxdiff1 u1 p1 x1", "Rbad"),
        ("xdiff1 u1 p1 x1", "Vbad x1 0 1\nVworse x1 0 2\nxdiff1 u1 p1 x1", "vbad"),
        ("xdiff1 u1 p1 x1", "Cbad alone 0 1n\nCworse alone x1 1n\nxdiff1 u1 p1 x1", "alone"),
    ],
    ids=["syntax", "no operating point", "floating node"],
)
def test_a_broken_netlist_is_the_users_mistake(tmp_path, capsys, old, new, reason):
    project(tmp_path, (old, new))
    code = main(["check", str(tmp_path / "board2.cir")])
    out = capsys.readouterr()
    assert code == 2, out
    assert reason.lower() in out.err.lower()
    assert "Traceback" not in out.err


def test_command_prints_sections_and_counts(capsys):
    assert main(["check", str(SCENES / "slope.toml")]) == 0
    text = capsys.readouterr().out
    for word in ("Design constants", "Out of contact", "Headroom", "Loops", "Paths", "Noise", "Coupling"):
        assert word in text
    assert text.splitlines()[-1] == "0 problems, 0 warnings"


def test_strict_and_json(capsys):
    given = ["check", str(BOARD1), "--level", "ideal", "--json", "--set", "r_diff_fb=169k,171k"]
    assert main(given) == 0
    first = json.loads(capsys.readouterr().out)["checks"]
    assert [done["problems"] for done in first] == [0, 1]
    assert main([*given, "--strict"]) == 2
    assert json.loads(capsys.readouterr().out)["checks"] == first


def test_a_board_has_no_scene_keys():
    (variant,) = variants(parse_settings(["computer.period_s=0.01"]))
    with pytest.raises(InputError, match="no scene keys"):
        load_subject(str(BOARD1), variant, None, None)


def test_a_point_that_is_not_found_at_rated_current_leaves_the_rest(monkeypatch):
    class Still:
        joints = 1

        def hold_only(self, _values):
            pass

    def lost(*_):
        raise NoOperatingPoint("board.cir: no DC operating point: these did not converge: out")

    monkeypatch.setattr(measured_constants, "_real", lambda *_: 2.0)
    monkeypatch.setattr(measured_constants, "_rate", lambda *_: 0.5)
    monkeypatch.setattr(measured_constants, "multiplier_volts", lost)
    notes: list[str] = []
    constants = SimpleNamespace(kt=1.0, gear=1.0, v_fs=1.0)
    result = measured_constants.measure_constants(Still(), constants, [], notes)
    assert "w_rated" not in {name for name, _ in result}
    assert result["k_fs", "11"][0] is not None
    (note,) = notes
    assert note.startswith("w_rated 11 is not known: ")
    assert "no DC operating point" in note


def test_the_most_current_is_that_of_the_dacs_own_range(capsys):
    """DACs of 0.2 V, gains at 10 V full scale: (u k_fs/v_rad + cmd/v_nm)/(kt gear), far from any limit.

    With both at 10 V, as shipped, the one range cannot be told from the other.
    """
    assert main(["check", str(SCENES / "press.toml"), "--set", "dac_v=0.2", "--json"]) in (0, 1)
    out = json.loads(capsys.readouterr().out)["checks"][0]["headroom"]["limits_a"]
    wanted = (0.2 * 3.0003 / 3.37034 + 0.2 / 15.625) / (0.04 * 8)
    assert out == pytest.approx([wanted] * 2, rel=2e-3)  # design constants are rounded, amplifiers finite
