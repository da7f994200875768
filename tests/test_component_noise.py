"""Component noise: each device once, through the multipliers, the same realisation in every model.

Expected values come from 4 k T R and the data sheets' densities, from ngspice's own `.noise` of the whole
board, and from an `.ac` of the whole board; the transfers under test are measured in pieces, at zero gain.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extraction_boards import board, in_child, shipped
from numpy.typing import NDArray
from support import BOARD1, GEAR, K_FS, KT, SIEMENS, TORQUE, V_FS, merge, scene_of, simulate, slider

from cosim.checking.check import check
from cosim.checking.check_target import load_subject
from cosim.checking.printout import describe
from cosim.circuits.decks import lockstep_deck
from cosim.circuits.extraction.noise_contributions import ComponentNoise
from cosim.circuits.linear_circuit import channel_names
from cosim.errors import InputError
from cosim.loop.component_noise import realise
from cosim.ngspice.deck import Deck
from cosim.ngspice.noise_deck import noisy
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.variants import parse_settings, variants

Array = NDArray[np.float64]
R_TIP = 0.1333
KT4 = 4 * 1.380649e-23 * 300.15
SWEEP = "dec 20 0.1 100k"


# ---- in a child: the whole board, without anything of the extraction


def board_lines(deck: Deck, volts: Mapping[str, float], more: list[str]) -> list[str]:
    lines = ["whole board", *deck.text.splitlines()[1:], f"Xboard {' '.join(deck.pins)} {deck.board}"]
    supplies = {"vcc": 15.0, "vee": -15.0}
    for pin in deck.pins:
        if not pin.startswith("imot"):
            lines.append(f"V_{pin} {pin} 0 dc {supplies.get(pin, volts.get(pin, 0.0))!r} ac 0")
    return [*lines, *more, ".end"]


def noise_of(payload: dict[str, Any], report: Any) -> Array:
    """`.noise` density [F] V/sqrt(Hz) of a node of the whole board."""
    simulator = Simulator()
    text = "\n".join(board_lines(payload["board"], payload["volts"], payload.get("more", [])))
    simulator.load(text + "\n", lines=payload["board"].lines)
    simulator.command(f"noise v({payload['node']}) v_pot1 {SWEEP} 1")
    simulator.command("setplot noise1")
    return np.asarray(simulator.vector("onoise_spectrum"), float)


def ac_of(payload: dict[str, Any], report: Any) -> NDArray[np.complex128]:
    """Motor currents [F, n] per ampere between two nodes of the whole board."""
    deck = payload["board"]
    first, second = payload["nodes"]
    simulator = Simulator()
    text = "\n".join(board_lines(deck, payload["volts"], [f"Iin {first} {second} dc 0 ac 1"]))
    simulator.load(text + "\n", lines=deck.lines)
    simulator.command(f"ac {SWEEP}")
    return np.stack([np.asarray(simulator.vector(f"imot{i + 1}"), complex) for i in range(deck.joints)], 1)


def extracted(payload: dict[str, Any], report: Any) -> ComponentNoise:
    """Measure without the cache."""
    from cosim.circuits.extraction.noise_contributions import extract_noise

    return extract_noise(payload["board"])


def measured(deck: Deck) -> ComponentNoise:
    result = in_child("test_component_noise:extracted", {"board": deck})
    assert isinstance(result, ComponentNoise)
    return result


def solved_noise(
    deck: Deck, volts: Mapping[str, float], node: str = "imot1", more: tuple[str, ...] = ()
) -> Array:
    payload = {"board": noisy(deck), "volts": dict(volts), "node": node, "more": list(more)}
    return np.asarray(in_child("test_component_noise:noise_of", payload))


POLY = "Ep x 0 poly(2) k 0 pot1 0 0 1 -1"


def power(noise: ComponentNoise, volts: Mapping[str, float], motor: int = 0) -> Array:
    control = np.array([volts.get(pin, 0.0) for pin in channel_names(noise.joints)])
    return np.real(noise.spectrum(control)[:, motor, motor])


# ---- sources


def test_densities_are_those_of_resistors_and_data_sheets() -> None:
    noise = measured(shipped(1, "ideal"))
    assert noise.notes == ()
    # before the spring: follower through -16.9, difference amplifier's own noise and its four resistors
    follower = (16.9 * 18e-9) ** 2
    own = (17.9 * 18e-9) ** 2 + KT4 * (16.9**2 * 10e3 + 169e3)
    other = KT4 * (10e3 * 169e3 / 179e3) * 17.9**2
    x = np.sum(np.abs(noise.x[:, :, 0]) ** 2, axis=1)
    np.testing.assert_allclose(x, follower + own + other, rtol=1e-6)  # gains of 1e9 and outputs of 1 Ohm
    # behind the multipliers, gains zero: their outputs, the summer and the driver into 5 Ohm
    weights = [10 / 24.3, 10 / 6.19, 10 / 20]
    summer = KT4 * 10e3 * (1 + sum(weights)) + ((1 + sum(weights)) * 18e-9) ** 2
    products = 0.8e-6**2 * (weights[0] ** 2 + weights[1] ** 2)
    driver = KT4 * (4 * 10e3 + 20e3) + (3 * 90e-9) ** 2
    volts = 4 * (summer + products) + driver
    np.testing.assert_allclose(power(noise, {}), volts / 25, rtol=4e-5)  # 0.1 Ohm of W in 6.19 kOhm, squared


@pytest.mark.parametrize("level", ["gbw", "full"])
def test_noise_is_the_same_at_every_level(level: str) -> None:
    noise, ideal = measured(shipped(1, level)), measured(shipped(1, "ideal"))
    at = np.searchsorted(ideal.hz, 10.0)
    # at 10 Hz bandwidths take nothing; full: ro of 125 Ohm inside loops, track and wiper 2.6 kOhm (1.5 %)
    for device in ("xdiff1.xop", "xder1.xop", "xsum1.xop", "xdrv1.xop", "xksp11.xmul", "xdiff1.r11"):
        one, other = (
            np.concatenate([n.x[at, n.devices.index(device)], n.motor[at, n.devices.index(device)]])
            for n in (noise, ideal)
        )
        # feedthrough of 0.3 % of the input noise at level full
        np.testing.assert_allclose(np.abs(one), np.abs(other), rtol=5e-3, atol=5e-3 * np.abs(other).max())


@pytest.mark.parametrize("ohms", [1e5, 1e6])
def test_kt_over_c_for_any_resistor(tmp_path: Path, ohms: float) -> None:  # hard case 9
    noise = measured(board(tmp_path, spring=f"Rk u1 k {ohms}\nCk k 0 1n\nEx x 0 k pot1 1"))
    corner, top = 1 / (2 * math.pi * ohms * 1e-9), 1e5
    inside = 2 / math.pi * (math.atan(top / corner) - math.atan(0.1 / corner))
    x = noise.x[:, noise.devices.index("rk"), 0]
    alone = ComponentNoise(**{**vars(noise), "motor": x[:, None, None], "x": 0 * noise.x[:, :1],
                              "devices": ("rk",)})  # fmt: skip
    rms = float(alone.rms(np.zeros(2))[0])
    # splines of 20 points a decade on a one-pole density
    assert rms == pytest.approx(2.0356e-6 * math.sqrt(inside), rel=1e-4)


@pytest.mark.parametrize("heat", [".temp 77", ".option temp=77"])
def test_every_resistor_has_its_own_temperature(tmp_path: Path, heat: str) -> None:
    """What a resistor's ``temp=`` does to `.noise` differs by version of ngspice."""
    lines = ["Rka ka 0 10k", "Rkb kb 0 10k temp=50", "Rkc kc 0 10k dtemp=23"]
    reader = "Ex x 0 vol='v(ka)+v(kb)+v(kc)+v(u1)-v(pot1)'"
    noise = measured(board(tmp_path, spring="\n".join([*lines, reader]), top=heat))
    assert noise.notes == ()
    for device, celsius in (("rka", 77.0), ("rkb", 50.0), ("rkc", 100.0)):
        density = math.sqrt(4 * 1.380649e-23 * (celsius + 273.15) * 10e3)
        x = np.abs(noise.x[:, noise.devices.index(device), 0])
        np.testing.assert_allclose(x, density, rtol=1e-6, err_msg=device)


def test_a_data_sheets_density_does_not_follow_the_circuits_temperature() -> None:
    room, hot = measured(shipped(1, "ideal")), measured(shipped(1, "ideal", temperature_c=77.0))
    for device, factor in (("xdiff1.xop", 1.0), ("xdiff1.r11", math.sqrt(350.15 / 300.15))):
        one, other = (np.abs(n.x[:, n.devices.index(device), 0]) for n in (room, hot))
        np.testing.assert_allclose(other, factor * one, rtol=1e-6, err_msg=device)


# ---- through the multipliers


@pytest.mark.parametrize(("level", "driver", "bound"), [
    ("ideal", "voltage", 1e-6), ("gbw", "current", 1e-6), ("full", "voltage", 1e-3),
])  # fmt: skip
def test_sum_over_devices_is_what_noise_says_at_three_gains(level: str, driver: str, bound: float) -> None:
    # full: the multiplier's product is off proportionality by up to 0.1 % of full scale in Y
    deck = shipped(1, level, driver)
    noise = measured(deck)
    sizes = []
    for share in (0.0, 0.5, 1.0):
        volts = {pin: share * V_FS for pin in channel_names(1)}
        result = solved_noise(deck, volts)
        np.testing.assert_allclose(np.sqrt(power(noise, volts)), result, rtol=bound)
        sizes.append(result[60])
    assert sizes[2] > 1.5 * sizes[0]  # at 100 Hz the gains matter
    assert not noise.notes


def test_board_without_probes_agrees_too(tmp_path: Path) -> None:
    spring, damper = "Rk u1 k 10k\nCk k 0 1n\nEx x 0 k pot1 1", "Cy pot1 ya 1u\nRy ya 0 1k\nEy y 0 0 ya 1"
    bare = "Bs ws 0 V=v(x)*v(ksp11)/10\nBd wd 0 V=v(y)*v(ksd11)/10"
    deck = board(tmp_path, spring=spring, damper=damper, multipliers=bare,
                 output="Rs ws s 10k\nRo s 0 10k\nBi imot1 0 V=v(s)+v(wd)+v(cmd1)-0.01*v(vel1)")  # fmt: skip
    noise = measured(deck)
    assert noise.probes == ()
    for volts in ({}, {"ksp11": 3.0}, {"ksp11": 10.0, "ksd11": -5.0}):
        np.testing.assert_allclose(np.sqrt(power(noise, volts)), solved_noise(deck, volts), rtol=1e-6)


GAINS = {"ksp11": 10.0, "ksp12": -3.0, "ksp21": -6.0, "ksp22": 8.0, "ksd11": 5.0, "ksd12": 2.0, "ksd21": 9.0}


def test_motors_share_what_a_device_makes() -> None:
    deck = shipped(2, "gbw", "current")
    noise = measured(deck)
    control = np.array([GAINS.get(pin, 0.0) for pin in channel_names(2)])
    cross = noise.spectrum(control)[:, 0, 1]
    # the real part by `.noise` alone: <i1 i2> = (|i1 + i2|^2 - |i1 - i2|^2)/4
    sums = ("Esum isum 0 vol='v(imot1)+v(imot2)'", "Edif idif 0 vol='v(imot1)-v(imot2)'")
    both = [solved_noise(deck, GAINS, node, sums) ** 2 for node in ("isum", "idif")]
    scale = np.sqrt(power(noise, GAINS, 0) * power(noise, GAINS, 1))
    assert np.abs(cross.real - (both[0] - both[1]) / 4).max() < 1e-6 * scale.max()
    assert cross.real[0] < -5e-3 * scale[0]  # 10 * -6 and -3 * 8: what is shared is opposed
    # the complex value of two devices by `.ac` of the whole board at these gains; the follower's noise turns,
    # as springs and dampers take it to either motor in other proportions
    turns = []
    for device, nodes, ohms in (
        ("xdiff1.r11", ("xboard.p1", "xboard.xdiff1.inn"), 10e3),
        ("xangle1.xop", ("xboard.xangle1.xop.noise_node", "0"), 18e-9**2 / KT4),
    ):
        payload = {"board": noisy(deck), "volts": GAINS, "nodes": nodes}
        h = np.asarray(in_child("test_component_noise:ac_of", payload)) * math.sqrt(KT4 / ohms)
        mine = noise.currents(control)[:, noise.devices.index(device)]
        expected = h[:, 0] * h[:, 1].conj()
        value = mine[:, 0] * mine[:, 1].conj()
        assert np.abs(value - expected).max() < 1e-6 * np.abs(expected).max()
        turns.append(np.abs(np.angle(expected[:80])).max())  # below 1 kHz
    assert turns[1] > 0.1


def test_what_noise_does_not_pass_is_named(tmp_path: Path) -> None:
    deck = board(tmp_path, spring=f"Rk u1 k 10k\nRl k 0 10k\n{POLY}")
    noise = measured(deck)
    # ngspice 39 makes an XSPICE device of a POLY source, where noise goes astray; 44 has nothing to be told
    assert noise.notes == () or ("rk, rl" in noise.notes[0] and "POLY" in noise.notes[0])
    x = np.abs(noise.x[:, noise.devices.index("rk"), 0])
    np.testing.assert_allclose(x, math.sqrt(KT4 * 10e3) / 2, rtol=1e-6)


@pytest.mark.parametrize("reader", ["Ep x 0 k pot1 1", POLY])
def test_shot_noise_of_a_diode_heard_or_not(tmp_path: Path, reader: str) -> None:
    lines = f"Ib 0 k 1m\nDk k 0 dx\n.model dx d(is=1e-15)\nRu u1 0 1meg\n{reader}"
    deck = board(tmp_path, spring=lines)
    noise = measured(deck)
    x = np.abs(noise.x[:, noise.devices.index("dk"), 0])
    # sqrt(2 q I) into the diode's k T/(q I)
    expected = math.sqrt(2 * 1.602176634e-19 * 1e-3) * 1.380649e-23 * 300.15 / 1.602176634e-19 / 1e-3
    np.testing.assert_allclose(x, expected, rtol=1e-4)
    assert noise.notes == () or "poly" in reader


def test_a_negative_resistor_is_left_out_with_a_note_and_all_others_are_heard(tmp_path: Path) -> None:
    # 1 kOhm beside -3 kOhm are 1.5 kOhm; ngspice takes the root of 4 k T / R
    noise = measured(board(tmp_path, spring="Rk u1 k 1k\nRn k 0 -3k\nEx x 0 k pot1 1"))
    assert "rn" not in noise.devices
    assert any("rn" in note and "negative" in note for note in noise.notes)
    x = np.abs(noise.x[:, noise.devices.index("rk"), 0])
    np.testing.assert_allclose(x, math.sqrt(KT4 / 1e3) * 1.5e3, rtol=1e-6)


# ---- in time


#: Instants between two ticks at which a run is read.
FINE = 10


def tables(model: str, on: bool = True, **top: Any) -> dict[str, Any]:
    """A heavy carriage 1 mm inside the wall: the spring's gain stands, the noise moves nothing."""
    base = slider(
        duration_s=0.2, seed=7,
        device={
            "slider": {"mass_kg": 100.0},
            "start": {"q_rad": [-0.0075]},
            "component_noise_bandwidth_hz": 500.0,
        },
        effects={"component_noise": on}, solver={"model": model, "rtol": 1e-6, "max_step_s": 1e-3},
    )  # fmt: skip
    return merge(base, top)


def noise_current(folder: Path, model: str, **top: Any) -> tuple[Array, Any]:
    """What the effect adds to the motor's current, ten times between two ticks of its grid [A]."""
    (folder / model).mkdir(parents=True)
    runs = [
        simulate(scene_of(folder, tables(model, on, **top)), folder / model / str(on)) for on in (True, False)
    ]
    duration = float(runs[0].signals["time"][-1])
    times = np.arange(FINE, round(duration * 1000) * FINE) / (1000 * FINE)
    one, none = (np.interp(times, run.signals["time"], run.signals["imot1"]) for run in runs)
    return one - none, runs[0]


def test_models_see_one_realisation(tmp_path: Path) -> None:
    ideal, run = noise_current(tmp_path, "ideal")
    gain = float(run.samples["ksp11"][0]) * V_FS / K_FS
    assert gain > 4.0
    linear, _ = noise_current(tmp_path, "linear")
    spice, _ = noise_current(tmp_path, "spice")
    rms = ideal.std()
    # no dynamics in ideal parts; the carriage gives way to the noise by less than 1e-9 of a spring's length
    assert np.abs(linear - ideal).max() < 1e-6 * rms
    # ngspice's Newton stops at rtol 1e-6 of 0.1 A and of volts behind the gains
    assert np.abs(spice - ideal).max() < 0.03 * rms
    noise = measured(resolve(scene_of(tmp_path, tables("ideal"))).board)
    grid = realise(noise, 7, 0.2, 500.0)
    through, command = np.real(noise.through[0, 0]), float(np.real(noise.command[0, 0, 0]))
    expected = (
        through[0] * noise.gain[0] * gain * grid.values[:, grid.group[0]] + command * grid.values[:, -1]
    )
    # the mean of 200 values, rms/14, pushes 100 kg for 0.2 s: 4.1e-10 m into 100 N/m, 2.4 N/A
    at_ticks = ideal[::FINE]
    np.testing.assert_allclose(at_ticks, expected[1 : len(at_ticks) + 1], rtol=0, atol=3 * 1.4e-3 * rms)


def spread(noise: ComponentNoise, control: Array, band: float, duration: float) -> tuple[float, float]:
    """Mean square of the current up to `band` and its standard deviation over a run (Bendat and Piersol)."""
    f = np.linspace(noise.hz[0], band, 20001)
    s = np.interp(f, noise.hz, np.real(noise.spectrum(control)[:, 0, 0]))
    return float(np.trapezoid(s, f)), math.sqrt(float(np.trapezoid(s * s, f)) / duration)


@pytest.mark.parametrize("model", ["ideal", "spice"])
def test_rms_of_a_run_is_the_integral_of_the_spectrum(tmp_path: Path, model: str) -> None:
    current, run = noise_current(
        tmp_path, model, duration_s=4.0, computer={"analog_stiffness_n_per_m": 160.0}
    )
    gain = float(run.samples["ksp11"][0]) * V_FS / K_FS
    noise = measured(resolve(scene_of(tmp_path, tables(model))).board)
    square, deviation = spread(noise, np.array([gain, 0.0]), 500.0, 4.0)
    print(f"{math.sqrt(square):.4g} A expected, {current.std():.4g} A found, {deviation / square:.1%}")
    assert abs(np.mean(current**2) - square) < 4 * deviation


def test_low_band_does_not_depend_on_the_grid() -> None:  # hard case 10
    noise = measured(shipped(1, "ideal"))
    duration, result = 20.0, []
    for bandwidth in (200.0, 1000.0, 5000.0):
        grid = realise(noise, 3, duration, bandwidth)
        x = grid.values[: round(duration / grid.dt), 0]
        density = np.abs(np.fft.rfft(x)) ** 2 * 2 * grid.dt / len(x)
        f = np.fft.rfftfreq(len(x), grid.dt)
        # what a line from tick to tick keeps of it
        density = density * np.sinc(f * grid.dt) ** 4
        result.append(density[(f > 1) & (f < 100)].mean())
    expected = np.sum(np.abs(noise.x[60, :, 0]) ** 2)
    # of 99 Hz times 20 s = 1980 independent exponential values
    np.testing.assert_allclose(result, expected, rtol=4 / math.sqrt(1980))


def test_correlation_of_the_realisation_is_that_of_the_circuit() -> None:
    noise = measured(shipped(2, "gbw", "current"))
    grid = realise(noise, 1, 30.0, 500.0)
    # X of joint 1's spring and of its damper share the follower; those of different joints share nothing
    groups = {pin: int(grid.group[c]) for c, pin in enumerate(channel_names(2))}
    assert groups["ksp11"] == groups["ksp21"] != groups["ksp12"]
    spring, damper, far = (grid.values[:, groups[pin]] for pin in ("ksp11", "ksd11", "ksp12"))
    table = np.stack([noise.x[:, :, channel_names(2).index(pin)] for pin in ("ksp11", "ksd11")])
    f = np.linspace(0.1, 500.0, 5000)

    def covariance(a: int, b: int) -> float:
        density = np.real(np.sum(table[a] * table[b].conj(), axis=1))
        return float(np.trapezoid(np.interp(f, noise.hz, density), f))

    expected = covariance(0, 1) / math.sqrt(covariance(0, 0) * covariance(1, 1))
    assert np.corrcoef(spring, damper)[0, 1] == pytest.approx(expected, abs=4 / math.sqrt(30_000))
    assert abs(np.corrcoef(spring, far)[0, 1]) < 4 / math.sqrt(30_000)
    again = realise(noise, 1, 30.0, 500.0)
    assert (again.values == grid.values).all()
    assert (realise(noise, 2, 30.0, 500.0).values != grid.values).any()


# ---- off


def test_off_draws_nothing_and_leaves_no_source(tmp_path: Path) -> None:
    coarse = {"max_step_s": 2e-3}
    silent = scene_of(tmp_path, tables("spice", on=False, solver=coarse))
    plan = resolve(silent)
    assert "cmd1" not in plan.circuit.channels
    deck = lockstep_deck(plan.board, plan.circuit, plan.tolerances, ())
    assert "vpx x xi 0" in deck
    assert "noise" not in deck.lower().replace("noisy=0", "")
    off = simulate(silent, tmp_path / "off")
    on = simulate(scene_of(tmp_path, tables("spice", solver=coarse)), tmp_path / "on")
    assert off.stats["random_draws"] == 0
    assert off.plan["component_noise"] is None
    assert off.stats["points"] < 200 <= on.stats["points"]  # 200 ticks
    about = on.plan["component_noise"]
    assert on.stats["random_draws"] % about["devices"] == 0
    assert about["left_out_a"]["gains_zero"][0] > 5 * about["rms_a"]["gains_zero"][0]  # 1e5 Hz against 500 Hz


def test_a_priori_size_is_what_is_measured(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, tables("spice"), "device.component_noise_bandwidth_hz=1000.0")
    (row,) = [row for row in resolve(scene).as_dict()["effects"] if row["name"] == "component_noise"]
    noise = measured(shipped(1, "ideal"))
    rms = float(noise.rms(np.zeros(2), (0.0, 1e3))[0]) * KT * GEAR / R_TIP
    # the estimate is of the multipliers only, with a weight of 4 for 24.3k/6.19k = 3.93; the rest is below
    assert row["size"]["value"] == pytest.approx(rms, rel=0.05)
    assert row["size"]["force_n"] > 2.5 * rms
    assert resolve(scene).cost()["noise_points"] > 400


def test_check_tells_it_by_device() -> None:
    (variant,) = variants(parse_settings([]))
    done = check(load_subject(str(BOARD1), variant, "ideal", "voltage"))
    components = done.measured.components
    assert components.devices[0].device == "xksd11.xmul"
    force = 0.8e-6 * 10 / 6.19 * SIEMENS * math.sqrt(999.9) * TORQUE / R_TIP
    assert components.devices[0].rest_n == pytest.approx(force, rel=1e-4)
    # powers of independent devices add up
    assert math.sqrt(sum(d.spring_n**2 for d in components.devices)) == pytest.approx(
        components.spring_n, rel=1e-6
    )
    result = describe(done)
    assert "Noise by component" in result
    assert "xksd11.xmul" in result


def test_spice_needs_probes_and_says_so(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, tables("spice", on=True))
    from cosim.loop.component_noise import ComponentGrid
    from cosim.loop.spice.run_spice import _with_probes

    grid = ComponentGrid(np.zeros((2, 3)), 1e-3, np.zeros(2, np.int64), (), (), 0, {})
    with pytest.raises(InputError, match="probe in series with X"):
        _with_probes(grid, resolve(scene).board)
