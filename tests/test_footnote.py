"""Footnote 1 as studies: numbers of theory, independent ways to the same quantity, and null forms."""

import re

import numpy as np
import pytest
from scipy import optimize
from support import SCENES

from cosim.analysis.stiffness_limits import limits
from cosim.analysis.tip import Wanted, reached, tip_of
from cosim.analysis.tip_noise import component_form, flat, position_density, pot_density, pot_form
from cosim.circuits.extraction.block_delays import spring_delays
from cosim.errors import InputError
from cosim.ngspice.child import call
from cosim.plan import resolve
from cosim.scene import Method, PotNoise, load_scene
from cosim.storage.checkpoint import Points
from cosim.studies.budget import loaded
from cosim.studies.delay_damping import active_from, block_delays, unstable_from
from cosim.studies.differentiator_corner import CornerParameters, passive
from cosim.studies.limit_shift import Gains, largest, speed_rms
from cosim.studies.rendering import passes, shown
from cosim.studies.study import load_study

PAPER = SCENES / "paper"


def scene(name, *changes):
    return load_scene(SCENES / f"{name}.toml", ("solver.model=linear", *changes))


@pytest.fixture(scope="module")
def carriage():
    return tip_of(scene("drop"))


@pytest.fixture(scope="module")
def arm():
    return tip_of(scene("slope"))


def tau_of(changed):
    return max(path.total_s for path in spring_delays(resolve(changed).board))


def rendered(tip):
    """What the board makes of 1 N/m: its resistors are not quite its design constants (1e-3)."""
    return float(tip.impedance(Wanted(1.0), np.array([1e-3]))[0].real)


def test_the_viscosity_is_back_emf_and_bearings(carriage):
    """kt^2 gear^2/R + viscous, over r^2: 0.04^2 64/5 and 5e-4 N m s/rad at 0.1333 m."""
    expected = (0.04**2 * 64 / 5.0 + 5e-4) / 0.1333**2
    # what is left of the driver's 10 mOhm behind a loop gain of 8e4/3 is 4e-7 Ohm beside 5 Ohm
    assert carriage.viscosity() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["drop", "slope"])
def test_delay_eats_all_damping_where_the_spring_turns_active(name, request):
    """b/sum(tau) from blocks, against the damping over all frequencies of the fitted circuit."""
    tip = request.getfixturevalue({"drop": "carriage", "slope": "arm"}[name])
    limit = tip.viscosity() / tau_of(tip.scene)
    assert active_from(tip) * rendered(tip) == pytest.approx(limit, rel=1e-6)


def test_a_mass_alone_is_stable_a_little_longer(carriage):
    """k < b/tau + b^2/m for one pole; the other delays are 0.6 % of the sum, and stand in it."""
    b, tau = carriage.viscosity(), tau_of(carriage.scene)
    mass = 0.1428 + 0.05 + 2e-6 * 64 / 0.1333**2
    # the back-EMF passes the winding as the spring does: only the bearings' part is free of the lag
    free = 5e-4 / 0.1333**2
    value = unstable_from(carriage) * rendered(carriage)
    assert b / tau < value < b / tau + b**2 / mass
    assert value == pytest.approx(b / tau + b * free / mass, rel=2e-3)


@pytest.mark.slow
def test_the_headline_s_tables_are_k_sum_tau_over_b(arm):
    spec = load_study(PAPER / "5_1_eta.toml")
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    limits = result.table("limits").columns
    b, tau = arm.viscosity(), tau_of(arm.scene)
    assert limits["practical limit b/sum [N/m]"][0] == pytest.approx(b / tau, rel=1e-9)
    assert limits["eta at 100 N/m [%]"][0] == pytest.approx(100.0 * 100.0 * tau / b, rel=1e-9)
    blocks = result.table("blocks").columns
    pairs = zip(blocks["case"], blocks["delay [us]"], strict=True)
    own = [late for case, late in pairs if case == "as built"]
    assert sum(own) == pytest.approx(1e6 * tau, rel=1e-9)
    assert all(verdict.holds for verdict in result.verdicts)
    band = result.table("viscosity").columns["b [N s/m]"]
    assert band[0] < b < band[-1]


def test_poses_reach_the_whole_workspace(arm):
    poses = reached(arm, 5, 0.15)
    assert len(poses) == 25
    # 1/(w^T B^-1 w) with equal joints' B: B/|J^T n|^2, and |J^T n| is at most the reach of both
    inner = arm.joint_viscosity()
    assert inner == pytest.approx(np.diag(np.diag(inner)), abs=1e-9)
    for tip in poses:
        assert tip.viscosity() == pytest.approx(inner[0, 0] / (tip.torques @ tip.torques), rel=1e-6)
    assert block_delays([]) == {}


ONLY_WINDING = ("effects.opamp=ideal", "effects.vca=ideal", "effects.driver_level=ideal")
HZ = np.geomspace(0.1, 1e3, 9)


def test_a_spring_behind_the_winding_loses_what_one_pole_takes():
    """k/(1 + jwL/R): K falls by 1/(1 + (wL/R)^2), and delay eats k L/R of the damping by as much."""
    tip = tip_of(scene("slope", *ONLY_WINDING))
    stiff, damping = shown(tip, Wanted(100.0), HZ)
    still = tip.impedance(Wanted(100.0), np.array([1e-4]))[0].real
    x = 2.0 * np.pi * HZ * 1.5e-3 / 5.0
    assert stiff == pytest.approx(still / (1.0 + x**2), rel=1e-6)
    assert damping == pytest.approx(-still * 3e-4 / (1.0 + x**2), rel=1e-6)


def test_a_damper_behind_the_corners_of_its_differentiator():
    """c/((1 + jw 1.58 ms)(1 + jw 0.1 ms)): the values of the netlist, all else ideal."""
    tip = tip_of(scene("slope", *ONLY_WINDING, "effects.motor=emf"))
    stiff, damping = shown(tip, Wanted(0.0, 2.0), HZ)
    jw = 2j * np.pi * HZ
    expected = jw * 2.0 / ((1.0 + jw * 1.58e-3) * (1.0 + jw * 1e-4))
    scale = damping[0] / (expected.imag[0] / (2.0 * np.pi * HZ[0]))
    assert scale == pytest.approx(1.0, abs=1e-3)  # the board's resistors against its design constants
    assert damping == pytest.approx(scale * expected.imag / (2.0 * np.pi * HZ), rel=1e-6)
    assert stiff == pytest.approx(scale * expected.real, rel=1e-6)


def test_where_an_error_passes_a_limit_is_found_between_points():
    hz = np.geomspace(1.0, 100.0, 21)
    assert passes(hz, 1e-4 * hz**2, 0.05) == pytest.approx(
        np.sqrt(500.0), rel=1e-12
    )  # straight in logarithms
    assert passes(hz, 1e-9 * hz, 0.05) is None
    assert passes(hz, 1.0 + hz, 0.05) == 1.0
    assert passes(hz, np.full(21, np.nan), 0.05) == 1.0  # NaN is no small error


@pytest.mark.slow
def test_the_corner_of_the_differentiator_is_what_the_damper_s_stiffness_betrays():
    """c w^2 sum(tau) of stiffness from a late damper: at 10 Hz 2 (20 pi)^2 2 ms is 15 N/m of 100."""
    spec = load_study(PAPER / "5_2_rendering.toml")
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    holds = {verdict.claim.split(" is ")[0]: verdict.holds for verdict in result.verdicts}
    assert holds["stiffness of the spring alone"]
    assert holds["damping of the damper alone"]
    assert not holds["stiffness of spring and damper together"]
    reach = result.table("reach").columns
    worst = reach["worst error up to 10 Hz [%]"]
    late = 1.58e-3 + 1e-4 + 3e-4
    expected = 2.0 * (20.0 * np.pi) ** 2 * late
    # of the next order in w tau: (0.12)^2
    assert worst[2] == pytest.approx(expected, rel=0.02)
    # the certificate bounds each path by its own maximum; what is seen of the spring is far below it
    assert result.table("certificate").columns["spring [%]"][0] > worst[0]


@pytest.mark.parametrize(("corner_hz", "newtons"), [(5, 0.05), (20, 0.20), (100, 1.0), (1000, 9.3)])
def test_noise_through_the_differentiator_is_theory_s(corner_hz, newtons):
    """White 6 mrad over 10 kHz through c = 2 N s/m, one corner: 0.05 / 0.20 / 1.0 / 9.3 N rms, as printed."""
    resistor = 1.0 / (2.0 * np.pi * corner_hz * 1e-6)
    tip = tip_of(
        scene("drop", *ONLY_WINDING, "effects.motor=emf", f"device.values.r_der_in={resistor!r}",
              "device.values.c_der_fb=1f")
    )  # fmt: skip
    value = float(pot_form(tip, flat(0.006, 1e4)).rms(0.0, 2.0))
    assert value == pytest.approx(newtons, rel=0.03)  # two digits are printed
    slope = 2.0 * 2.0 * np.pi * corner_hz * 0.006 * 0.1333
    exact = slope * np.sqrt(1.0 - corner_hz / 1e4 * np.arctan(1e4 / corner_hz))
    # the board's resistors against its constants 1e-3, and the trapezoid's error
    assert value == pytest.approx(exact, rel=2e-3)


def test_noise_of_a_spring_is_what_it_is_multiplied_by(carriage):
    """0.006 rad at 133 mm and 100 N/m: 0.080 N, the whole band far below the winding's pole."""
    value = float(pot_form(carriage, flat(0.006, 10.0)).rms(100.0, 0.0))
    assert value == pytest.approx(0.080, rel=2e-3)
    assert float(pot_form(carriage, flat(0.006, 10.0)).rms(0.0, 0.0)) == 0.0


def test_the_density_of_drawn_noise_has_the_kind_s_variance():
    """White keeps its rms; a width of w, uniform at the ticks, is w/sqrt(12) there and 2/3 of it between."""
    given = scene("slope")
    for kind, expected in ((PotNoise.WHITE, 0.006**2), (PotNoise.PEAK_TO_PEAK, 0.006**2 / 12.0 * 2.0 / 3.0)):
        hz, power = pot_density(given, kind)
        assert np.trapezoid(power, hz) == pytest.approx(expected, rel=1e-3)
    assert pot_density(given, PotNoise.STATIC) is None
    assert pot_density(given, PotNoise.POSITION) is None


def test_component_noise_is_what_noise_says(carriage):
    """The form in (1, k, c) against `ComponentNoise.rms` at the same gains, another rule of integration."""
    board = resolve(carriage.scene).board
    noise = call(
        "cosim.circuits.extraction.noise_contributions:component_noise",
        {"board": board},
        deck=str(board.path),
    )
    form = component_form(carriage, noise, 1e3)
    for wanted in (Wanted(), Wanted(100.0), Wanted(150.0, 2.0)):
        current = noise.rms(carriage.control(wanted), (0.1, 1e3))[0]
        expected = current * carriage.constants.torque_per_amp / 0.1333
        assert float(form.rms(wanted.stiffness, wanted.damping)) == pytest.approx(expected, rel=1e-3)


def test_the_verdict_of_footnote_1(tmp_path):
    """At the paper's point: by delay as the headline says, by stiffness error as the spectra say."""
    short = tmp_path / "short.toml"
    text = (PAPER / "5_3_footnote.toml").read_text(encoding="utf-8")
    text = text.replace('"../slope.toml"', f'"{SCENES / "slope.toml"}"')
    text = re.sub(r"(?m)^corners_hz.*$", "corners_hz = [100.73097664044009]", text)
    text = re.sub(r"(?m)^drivers_hz.*$", "drivers_hz = [1e6]", text)
    short.write_text(re.sub(r"(?m)^points.*$", "points = 3", text), encoding="utf-8")
    spec = load_study(short)
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    at, parts = result.table("at").columns, result.table("parts").columns
    holds = [verdict.holds for verdict in result.verdicts]
    assert holds == [True, True, False, None]
    tip = tip_of(scene("slope"))
    assert at["eta [%]"][0] == pytest.approx(1e4 * tau_of(tip.scene) / tip.viscosity(), rel=1e-5)
    stiff, _ = shown(tip, Wanted(100.0, 2.0), np.array([10.0]))
    assert at["stiffness error [%]"][2] == pytest.approx(abs(float(stiff[0]) - 100.0), rel=1e-9)
    # values of the netlist, extracted again: within 1e-6 of each path (tests of re-extraction)
    eta = [0.05 * value for value in parts["eta / limit"][:3]]
    assert eta == pytest.approx([0.01 * value for value in at["eta [%]"][:3]], rel=1e-4)
    # both joints' noise through k w: 0.006 k |w|, less what the winding takes of a band of 100 Hz
    white = at["force noise, white [N rms]"][0]
    assert white == pytest.approx(0.006 * 100.0 * np.linalg.norm(tip.torques), rel=0.02)


IDEAL = (*ONLY_WINDING, "effects.motor=emf", "effects.encoder=false", "effects.dac=false",
         "effects.dac_settling=false")  # fmt: skip
MASS = 0.1428 + 0.05 + 2e-6 * 64 / 0.1333**2
DISCRETE = Gains(name="discrete only")


@pytest.mark.parametrize("period", [0.003, 0.025, 0.1])
def test_an_ideal_circuit_has_theory_s_border(period):
    """k* = b (1 - E)/(tau (1 - E) - T E), with the board's command gain (1/v_nm of the constants: 1e-6)."""
    tip = tip_of(scene("drop", *IDEAL))
    b = tip.viscosity()
    tau = MASS / b
    e = np.exp(-period / tau)
    expected = b * (1.0 - e) / (tau * (1.0 - e) - period * e)
    assert largest(tip, DISCRETE, period) == pytest.approx(expected, rel=1e-6)


def test_the_winding_costs_stiffness_as_a_delay_does():
    """K < b/(T/2 + t_d) for b T/m << 1 (here 0.018), t_d = L/R, whose braking is late as well."""
    b = tip_of(scene("drop", *IDEAL)).viscosity()
    tip = tip_of(scene("drop", *IDEAL, "effects.motor=full"))
    assert largest(tip, DISCRETE, 0.003) == pytest.approx(b / (0.0015 + 0.0003), rel=0.02)


def test_the_speed_at_rest_under_white_force():
    """v^2 = S/(4 m b) for force noise of the one-sided density S, far wider than the mass follows."""
    wide = "device.potentiometer.noise_bandwidth_hz=1e4"
    tip = tip_of(scene("drop", *IDEAL, wide))
    b = tip.viscosity()
    density = 1.5 * (0.006 * 0.1333 * 100.0) ** 2 / 1e4  # 2 h var, h = 1/(2 bandwidth), var = 1.5 rms^2
    gains = Gains(name="soft", stiffness_n_per_m=100.0)
    result = speed_rms(tip, gains, 0.003, 1.0, PotNoise.WHITE)
    # the computer's 1 N/m takes b by K T/2 = 0.0015 of 1.18
    assert result == pytest.approx(np.sqrt(density / (4.0 * MASS * b)), rel=3e-3)


def test_noise_that_belongs_to_the_angle_has_its_rms_and_its_slope():
    """Blended values: mean square 1 and mean square slope (pi/2)^2 for each step of one, at any speed."""
    given = scene("drop")
    hz, power = position_density(given, 0.75)
    assert np.trapezoid(power, hz) == pytest.approx(0.006**2, rel=2e-3)
    slope = np.trapezoid(power * (2.0 * np.pi * hz) ** 2, hz)
    # the slope jumps at the knots, so its density falls with 1/f^2: 30 steps' worth leave 1 % beyond
    assert slope == pytest.approx((0.5 * np.pi * 0.006 * 0.75 / 0.1) ** 2, rel=0.02)


def test_passive_stiffness_over_the_corner_is_that_of_the_limits():
    """The same extension of the passivity condition by `limits`, and the active damper told as such."""
    tip = tip_of(scene("drop", "computer.period_s=0.025", "effects.encoder=false", "effects.dac=false"))
    given = CornerParameters(stiffness_n_per_m=0.0, damping_n_s_per_m=2.0)
    result = passive(tip, given)
    changed = tip.with_computer(method=Method.COMBINED, analog_stiffness_n_per_m=0.0,
                                analog_damping_n_s_per_m=2.0, discrete_stiffness_n_per_m=1.0)  # fmt: skip
    assert result == pytest.approx(limits(changed).passive_n_per_m, rel=1e-3)
    # c in three lags, b behind one of them: far beyond 8 b it must be active
    assert passive(tip, CornerParameters(damping_n_s_per_m=20.0)) is None


def test_a_loaded_wiper_bends_the_scale():
    """R = R_L over 340 degrees, maximum of (2 x - 1)(1 - 1/(1 + x (1 - x))) found by its derivative."""
    x = optimize.brentq(
        lambda x: 2.0 * (x - x * x) * (1.0 + x - x * x) + (2.0 * x - 1.0) * (1.0 - 2.0 * x), 0.6, 0.95
    )
    most = (2.0 * x - 1.0) * (1.0 - 1.0 / (1.0 + x - x * x))
    assert loaded(1e4, 1e4, 5.934) == pytest.approx(
        most * 5.934 / 2.0, rel=1e-5
    )  # 2000 points, quadratic top
    assert loaded(1e4, 1e12, 5.934) < 1e-7


def test_budgets_have_the_sizes_of_their_data_sheets(arm):
    spec = load_study(PAPER / "5_6_budget.toml")
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    errors, forces = result.table("errors").columns, result.table("forces").columns
    mrad = dict(zip(errors["source"], errors["at the joint [mrad]"], strict=True))
    assert mrad["noise, white"] == 6.0
    assert mrad["encoder, a count"] == pytest.approx(0.3927 / np.sqrt(12.0), rel=1e-3)  # x4, gear 8
    assert mrad["DAC of u, a code"] == pytest.approx(1.449 / np.sqrt(12.0), rel=1e-3)  # 12 bit of 20 V
    # 100 Ohm and a quarter of 10 kOhm, 30 pA of a TL072, 3.37 V/rad
    assert mrad["wiper loading, bias current"] == pytest.approx(1e3 * 2600 * 30e-12 / 3.37034, rel=1e-6)
    # at the tip: random errors as squares, the largest one of each joint at once, the same one with its sign
    millimetres = dict(zip(errors["source"], errors["all joints, along the normal [mm]"], strict=True))
    lever, pot = arm.torques, arm.scene.device.potentiometer
    assert millimetres["noise, white"] == pytest.approx(6.0 * np.hypot(*lever), rel=1e-12)
    assert millimetres["linearity"] == pytest.approx(1e3 * pot.linearity_rad * np.abs(lever).sum(), rel=1e-12)
    assert millimetres["linearity"] == pytest.approx(1.32, abs=0.005)
    assert millimetres["calibration, zero"] == pytest.approx(1e3 * pot.zero_rad * abs(lever.sum()), rel=1e-12)
    assert millimetres["calibration, zero"] == pytest.approx(1.100, abs=0.0005)
    gain = 1e3 * pot.gain_error * abs(lever @ arm.q)  # what (1 + g) q shows for q moves the tip by
    assert millimetres["calibration, gain"] == pytest.approx(gain, rel=1e-12)
    # 1.627 at q = (0.6, 1.1); the wall is touched a little beside it
    assert millimetres["calibration, gain"] == pytest.approx(1.627, abs=0.01)
    newtons = dict(zip(forces["source"], forces["force [N rms]"], strict=True))
    w, motion = np.linalg.norm(arm.torques), np.linalg.norm(arm.motion)
    assert newtons["white, tip held"] == pytest.approx(0.006 * 100.0 * w, rel=0.02)  # the winding takes 1 %
    assert newtons["encoder, discrete stiffness"] == pytest.approx(133 * w * 0.3927e-3 / 12**0.5, rel=1e-3)
    assert newtons["DAC of cmd"] == pytest.approx(motion * 20 / 4096 / 15.625 / 12**0.5, rel=1e-9)
    board = resolve(arm.scene).board
    noise = call(
        "cosim.circuits.extraction.noise_contributions:component_noise",
        {"board": board},
        deck=str(board.path),
    )
    together = float(component_form(arm, noise, 1e3).rms(100.0, 0.0))
    assert newtons["all together"] == pytest.approx(together, rel=1e-9)
    assert all(verdict.holds is not False for verdict in result.verdicts)


NO_VISCOSITY = ("effects.motor=ideal", "effects.viscous=false")


@pytest.mark.parametrize(
    ("file", "old", "new", "overrides", "reason"),
    [
        ("5_1_eta", "", "", NO_VISCOSITY, "no viscosity that delay could eat"),
        ("5_3_footnote", '"opa548_gbw"', '"opa549_gbw"', (), "nearest is opa548_gbw"),
        ("5_3_footnote", '"r_der_in"', '"r_no"', (), "r_no.*must be .params of the board"),
        ("5_4_shift", "drop.toml", "slope.toml", (), "that of one joint"),
        ("5_5_corner", '"c_der_in"', '"c_no"', (), "corner_parameter.*must be .params"),
    ],
)
def test_what_cannot_be_studied_is_reported(tmp_path, file, old, new, overrides, reason):
    text = (PAPER / f"{file}.toml").read_text(encoding="utf-8").replace(old, new)
    path = tmp_path / "bad.toml"
    path.write_text(text.replace('"../', f'"{SCENES}/'), encoding="utf-8")
    spec = load_study(path, overrides)
    with Points(None) as points, pytest.raises(InputError, match=reason):
        spec.study.analyse(spec, points)
