"""Null forms cost nothing, noise is what it says, the energy ledger closes, and a run repeats to the byte."""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import SCENES, merge, quick, shared_child, simulate, slider
from toleranced_boards import PRESS, SUMMER, board

from cosim import cli
from cosim.effects import EFFECTS
from cosim.loop.noise import no_noise, potentiometer_noise
from cosim.plan import Plan, resolve
from cosim.scene import load_scene

IDEAL = ("opamp=ideal", "vca=ideal", "driver_level=ideal", "motor=ideal", "potentiometer=ideal",
         "differentiator=ideal")  # fmt: skip
OFF = tuple(
    f"{name}=false"
    for name in "encoder dac dac_settling coriolis viscous rotor_inertia operator_dynamics".split()
)


def slope(*effects: str, more: tuple[str, ...] = ()) -> Any:
    """The slope scene with every effect off, then those named, 0.5 s."""
    overrides = [f"effects.{setting}" for setting in (*IDEAL, *OFF, *effects)]
    return load_scene(SCENES / "slope.toml", [*overrides, "duration_s=0.5", *more])


def size(plan: Plan) -> dict[str, Any]:
    """Rows of ngspice's matrix: nodes and branches of the lockstep's deck."""
    out: dict[str, Any] = shared_child().call("support:count_equations", {"plan": plan})
    return out


# ---- what the netlist's levels add


def count(*effects: str, more: tuple[str, ...] = ()) -> int:
    return int(size(resolve(slope(*effects, more=more)))["count"])


def test_ideal_levels_add_no_equations() -> None:
    """Beyond ideal, gbw adds one equation an amplifier or multiplier, L a node and a branch a motor."""
    board = resolve(slope()).board
    bare = count()
    stages = {role: sum(a.role == role for a in board.amplifiers) for role in ("opamp", "vca", "driver")}
    assert stages == {
        "opamp": 6,
        "vca": 8,
        "driver": 2,
    }  # per joint angle, diff, sum (a pure differentiator has none); n^2 springs and dampers
    assert count("opamp=gbw") - bare == stages["opamp"]
    assert count("vca=gbw") - bare == stages["vca"]
    assert count("driver_level=gbw") - bare == stages["driver"]
    assert count("motor=emf") - bare == 0
    assert count("motor=full") - bare == 4
    assert count("potentiometer=full") - bare == 0
    # mid and inn for a branch; then its op-amp has a pole as any other
    assert count("differentiator=corner") - bare == 2
    assert count("differentiator=corner", "opamp=gbw") - bare == 2 + 8
    # single effects: the limit is a node before the output of the driver and one on either side
    assert count("driver_limit=true") - bare == 3 * stages["driver"]
    for name in ("opamp_offset", "vca_offset", "vca_gain_error", "vca_nonlinearity", "temperature"):
        assert count(f"{name}=true") == bare
    for name in ("opamp_slew", "opamp_saturation"):
        assert count("opamp=gbw", f"{name}=true") - bare == stages["opamp"]
    assert count("driver_level=gbw", "driver_limit=true") - bare == 3 * stages["driver"]


def test_ideal_level_leaves_no_trace_of_the_deeper_ones() -> None:
    plain = size(resolve(slope()))["names"]
    deep = size(resolve(slope("opamp=full", "vca=full", "driver_level=full", "motor=full")))["names"]
    assert len(deep) >= len(plain) + 3 * 8 + 2 * 2  # at least three more an op-amp and two a motor
    inner = [
        name
        for name in plain
        if any(name.endswith(tail) for tail in (".xop.x", ".xop.y", ".xmul.c", ".xmotor.a"))
    ]
    assert inner == []


@pytest.mark.parametrize(
    ("computer", "pins"),
    [
        # n = 2: u 2, ksp 4, ksd 4, cmd 2; a pin that the method never moves has no source
        ({"method": "continuous"}, 2 + 4),
        ({"method": "continuous", "analog_damping_n_s_per_m": 1.0}, 2 + 4 + 4),
        ({"method": "combined", "command_path": "cmd"}, 2 + 4 + 2),
        ({"method": "combined", "command_path": "u"}, 2 + 4),
        ({"method": "discrete", "analog_stiffness_n_per_m": 0.0}, 2 + 2),
        ({"method": "joint_pd", "discrete_stiffness_n_per_m": 0.0}, 2 + 2),
    ],
)
@pytest.mark.parametrize("motor", ["ideal", "emf", "full"])
def test_external_sources_are_those_that_move(computer: dict[str, Any], pins: int, motor: str) -> None:
    more = tuple(f"computer.{key}={value}" for key, value in computer.items())
    if computer["method"] == "continuous":
        more = (*more, "computer.discrete_stiffness_n_per_m=0.0")
    plan = resolve(slope(f"motor={motor}", more=more))
    speeds = 0 if motor == "ideal" else 2
    sources = plan.as_dict()["external_sources"]
    assert len(sources) == 2 + speeds + pins  # potentiometers, speeds, DAC channels
    assert [name for name in sources if name.startswith("vel")] == (["vel1", "vel2"] if speeds else [])


# ---- what the computer's and the linkage's effects add

STATES = ("points", "rejected", "discontinuities", "source_calls", "random_draws")


def pressed(**top: Any) -> dict[str, Any]:
    """Inside the wall from the start to the end, so that every sample writes."""
    return merge(slider(duration_s=0.5, device={"start": {"q_rad": [-0.03]}}, effects={"motor": "emf"}), top)


def stats(folder: Path, tables: dict[str, Any]) -> dict[str, int]:
    run = quick(folder, tables)
    return {name: run.stats[name] for name in STATES}


def bytes_of(run: Any) -> str:
    return hashlib.sha256(Path(run.signals.path).read_bytes()).hexdigest()


@pytest.mark.parametrize(
    "null",
    [
        {"effects": {"delay": True}, "computer": {"delay_periods": 0, "delay_fraction": 0.0}},
        {"computer": {"delay_periods": 3, "delay_fraction": 0.5}},
        {"computer": {"dac": {"settling_s": 1e-4, "skew_s": 1e-4, "bits": 8}}},
        {"computer": {"encoder": {"pulses_per_rev": 8}}},
        {"device": {"slider": {"viscous_n_m_s": 0.1, "coulomb_n_m": 0.1}}},
        {"device": {"potentiometer": {"noise_rad": 0.1, "noise_bandwidth_hz": 1e4}}},
        {"seed": 99},
    ],
    ids=lambda null: "-".join(f"{key}" for key in null),
)
def test_an_effect_that_is_off_changes_no_byte(tmp_path: Path, null: dict[str, Any]) -> None:
    """Data of an effect without the effect, or the effect with null data: the same run to the last bit."""
    plain, other = quick(tmp_path, pressed()), quick(tmp_path, pressed(**null))
    assert bytes_of(plain) == bytes_of(other)
    assert {k: plain.stats[k] for k in STATES} == {k: other.stats[k] for k in STATES}


#: Data of every effect that is no part of the netlist, as large as they may be; the effect itself is off.
DATA: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    (("pot_noise", "pot_linearity", "pot_calibration"), {"device": {"potentiometer": {
        "noise_rad": 0.1, "noise_bandwidth_hz": 1e4, "linearity_rad": 0.1, "gain_error": 0.1, "zero_rad": 0.1,
    }}}),
    (("component_noise",), {"device": {"component_noise_bandwidth_hz": 1e4}}),
    (("encoder",), {"computer": {"encoder": {"pulses_per_rev": 4, "decoding": 1}}}),
    (("dac", "dac_settling", "dac_skew"),
     {"computer": {"dac": {"bits": 4, "settling_s": 1e-3, "skew_s": 1e-3}}}),
    (("delay",), {"computer": {"delay_periods": 3, "delay_fraction": 0.5}}),
    (("period_jitter",), {"computer": {"jitter_share": 0.4}}),
    (("gravity", "viscous", "coulomb", "rotor_inertia", "end_stops", "shaft", "backlash"),
     {"device": {"slider": {
         "gravity_m_per_s2": [0.0, -9.81], "viscous_n_m_s": 0.1, "coulomb_n_m": 0.1,
         "rotor_inertia_kg_m2": 1e-5, "stops_rad": [[-0.031, 0.031]], "shaft_stiffness_n_m_per_rad": 10.0,
         "backlash_rad": 0.01,
     }}}),
    (("temperature",), {"device": {"temperature_c": 80.0}}),
)  # fmt: skip
#: What has no data of its own: on or off is all there is (its null limit is in test_null_limits.py).
NO_DATA = {"geometric_stiffness", "coriolis", "operator_dynamics"}


def test_every_effect_is_shown_to_leave_nothing_when_it_is_off() -> None:
    """Those of the netlist by its equations (test_ideal_levels_add_no_equations), the others by runs."""
    netlist = {effect.name for effect in EFFECTS if effect.home == "netlist"}
    assert {effect.name for effect in EFFECTS} == netlist | NO_DATA.union(*(names for names, _ in DATA))


@pytest.mark.parametrize("model", ["ideal", "spice"])
def test_data_of_effects_that_are_off_are_not_there(tmp_path: Path, model: str) -> None:
    """All at once and each group alone: same bytes, points, breakpoints, calls and draws."""
    groups = [data for _, data in DATA]
    every: dict[str, Any] = {}
    for data in groups:
        every = merge(every, data)
    base = pressed(solver={"model": model})
    plain = quick(tmp_path, base)
    for data in (every, *groups) if model == "ideal" else (every,):
        other = quick(tmp_path, merge(base, data))
        assert bytes_of(plain) == bytes_of(other), data
        known = [name for name in STATES if name in plain.stats]
        assert [plain.stats[name] for name in known] == [other.stats[name] for name in known]
        assert other.plan["effects"] == plain.plan["effects"]
        assert other.plan["circuit_states"] == plain.plan["circuit_states"]


def test_what_converters_delay_and_noise_add(tmp_path: Path) -> None:
    plain = stats(tmp_path, pressed())
    coded = stats(tmp_path, pressed(effects={"dac": True}))
    assert coded["points"] <= plain["points"] * 1.02  # rounding the codes moves steps, it adds no instants
    encoded = stats(tmp_path, pressed(effects={"encoder": True}))
    assert encoded["points"] <= plain["points"] * 1.02
    settled = stats(
        tmp_path, pressed(effects={"dac": True, "dac_settling": True}, computer={"dac": {"settling_s": 1e-4}})
    )
    assert settled["points"] > coded["points"]
    assert settled["random_draws"] == 0
    noisy = stats(tmp_path, pressed(effects={"pot_noise": "white"}))
    assert noisy["random_draws"] == math.ceil(0.5 * 200) + 2  # ticks at twice 100 Hz, one joint, both ends
    assert noisy["points"] >= 100
    still = stats(tmp_path, pressed(effects={"pot_noise": "static"}))
    assert still["random_draws"] == 1
    assert still["points"] <= plain["points"] * 1.05


def test_gravity_friction_and_coriolis_off_are_not_computed(tmp_path: Path) -> None:
    """Off means absent from the record that the kernels work on, and from the ledger."""
    run = simulate(slope(), tmp_path / "off")
    for name in ("viscous", "coulomb", "stops"):
        assert run.ledger["work_j"][name] == 0.0
    for name in ("p_visc", "p_coul", "p_stop", "e_grav"):
        assert not np.asarray(run.signals[name]).any()
    named = {row["name"] for row in run.plan["effects"]}
    assert named == set()
    assert {row["name"] for row in run.plan["left_out"]} == {effect.name for effect in EFFECTS}
    both = simulate(slope("viscous=true", "coulomb=true", "coriolis=true", "gravity=true"), tmp_path / "on")
    assert both.ledger["work_j"]["viscous"] < 0
    assert both.ledger["work_j"]["coulomb"] < 0
    assert np.asarray(both.signals["e_grav"]).any()


# ---- potentiometer noise


def white(
    rms: float = 0.006, seed: int = 0, bandwidth: float = 200.0, duration: float = 4.0
) -> dict[str, Any]:
    """A joint held in free space by nothing: the noise does not move it."""
    return slider(
        seed=seed,
        duration_s=duration,
        wall=None,
        effects={"pot_noise": "white"},
        device={"potentiometer": {"noise_rad": rms, "noise_bandwidth_hz": bandwidth}},
    )


def test_white_noise_has_its_rms_and_every_tick_is_a_point(tmp_path: Path) -> None:
    rms, bandwidth, duration = 0.006, 200.0, 4.0
    run = quick(tmp_path, white(rms, 11, bandwidth, duration))
    t, seen = np.asarray(run.signals["time"]), np.asarray(run.signals["pot1"] - run.signals["q1"])
    grid = np.arange(round(duration * 2 * bandwidth)) / (2 * bandwidth)
    index = np.searchsorted(t, grid - 1e-12)
    assert np.abs(t[index] - grid).max() < 1e-12
    # linear between points: mean square of a line from a to b is (a^2 + a b + b^2)/3
    a, b = seen[:-1], seen[1:]
    square = float(np.sum(np.diff(t) * (a * a + a * b + b * b) / 3) / (t[-1] - t[0]))
    # of N independent ticks: relative deviation of the mean square sqrt(2/N) times at most 1.1 (ends shared)
    deviation = 1.1 * math.sqrt(2 / len(grid))
    print(f"rms {math.sqrt(square):.6f}, {deviation / 2:.1%} is one standard deviation")
    assert abs(square / rms**2 - 1) < 4 * deviation
    assert abs(seen.mean()) < 4 * rms / math.sqrt(len(grid)) * 1.3
    # neighbouring ticks are independent
    ticks = seen[index]
    assert abs(np.corrcoef(ticks[1:], ticks[:-1])[0, 1]) < 4 / math.sqrt(len(grid))


def test_noise_is_linear_between_its_ticks(tmp_path: Path) -> None:
    run = quick(tmp_path, merge(white(bandwidth=20.0, duration=0.5), {"solver": {"max_step_s": 2e-3}}))
    t, seen = np.asarray(run.signals["time"]), np.asarray(run.signals["pot1"] - run.signals["q1"])
    grid = np.arange(20) / 40
    knots = seen[np.searchsorted(t, grid - 1e-12)]
    inside = t <= grid[-1]
    assert inside.sum() > 100
    np.testing.assert_allclose(seen[inside], np.interp(t[inside], grid, knots), atol=1e-12)


def test_noise_is_seeded_and_its_streams_do_not_know_of_each_other(tmp_path: Path) -> None:
    def ticks(run: Any, name: str = "1") -> Any:
        t = np.asarray(run.signals["time"])
        seen = np.asarray(run.signals[f"pot{name}"] - run.signals[f"q{name}"])
        return seen[np.searchsorted(t, np.arange(50) / 400 - 1e-12)]

    first = quick(tmp_path, white(seed=5, duration=0.2))
    again = quick(tmp_path, white(seed=5, duration=0.2))
    other = quick(tmp_path, white(seed=6, duration=0.2))
    assert bytes_of(first) == bytes_of(again)
    assert np.abs(np.corrcoef(ticks(first), ticks(other))[0, 1]) < 4 / math.sqrt(50)
    # other effects, and a second joint, leave the first joint's values alone
    dressed = quick(
        tmp_path,
        merge(white(seed=5, duration=0.2), {"effects": {"encoder": True, "dac": True, "motor": "emf"}}),
    )
    np.testing.assert_allclose(ticks(dressed), ticks(first), atol=1e-15)
    noise = ("pot_noise=white",)
    more = ("seed=5", "device.potentiometer.noise_bandwidth_hz=200.0")
    two = simulate(slope(*noise, more=more), tmp_path / "two")
    # pot is told by the predictor, q corrected afterwards: the defect lies between
    np.testing.assert_allclose(ticks(two), ticks(first), atol=2 * two.stats["defect_max_rad"])
    assert np.abs(np.corrcoef(ticks(two, "1"), ticks(two, "2"))[0, 1]) < 4 / math.sqrt(50)


def make(kind: str, joints: int = 2, seed: int = 3) -> Any:
    return potentiometer_noise(kind, joints, seed, 10.0, 0.006, 100.0, 0.1, 2 * math.pi)


def test_kinds_of_noise() -> None:
    assert no_noise(2).draws == 0
    assert make("none").draws == 0
    wide = make("peak_to_peak").grid
    assert np.abs(wide).max() <= 0.003
    assert np.ptp(wide) > 0.0059  # 2002 uniform values each
    assert wide.std() == pytest.approx(0.006 / math.sqrt(12), rel=0.05)
    offset = make("static")
    assert offset.dt == 0.0
    assert (offset.table[0] == offset.table[1]).all()
    many = np.array([make("static", 1, seed).table[0, 0] for seed in range(400)])
    assert many.std() == pytest.approx(0.006, rel=4 / math.sqrt(2 * 400))
    place = make("position")
    assert place.dt == 0.0
    # 129 independent knots a joint over two turns, unit mean square at and between them
    assert place.table.std(axis=0) == pytest.approx([0.006, 0.006], rel=4 / math.sqrt(2 * 126))
    assert (make("position").table == place.table).all()
    assert not np.allclose(place.table[:, 0], place.table[:, 1])
    # joint 1 of a board of one joint, of two, of six: the same stream
    for kind in ("white", "peak_to_peak"):
        assert (make(kind, 1).grid[:, 0] == make(kind, 6).grid[:, 0]).all()


def test_noise_of_position_is_silent_at_rest_and_repeats_with_the_angle(tmp_path: Path) -> None:
    tables = slider(wall=None, effects={"pot_noise": "position"}, device={"start": {"q_rad": [0.3]}})
    still = quick(tmp_path, tables)
    error = np.asarray(still.signals["pot1"] - still.signals["q1"])
    assert np.ptp(error) == 0.0
    assert error[0] != 0.0
    moving = quick(tmp_path, merge(tables, {"device": {"start": {"q_rad": [0.0], "v_rad_per_s": [1.0]}}}))
    error_moving = np.asarray(moving.signals["pot1"] - moving.signals["q1"])
    q = np.asarray(moving.signals["q1"])
    assert np.interp(0.3, q, error_moving) == pytest.approx(error[0], abs=1e-5)  # table of 1.6 mrad, linear
    assert 0.001 < error_moving.std() < 0.012


# ---- energy


def closes(run: Any, bound: float = 3e-6) -> None:
    """The residual is what the integration leaves.

    A step is wrong by 1e-7 rad at most, of a travel of 0.1 rad or more: some 1e-6 of the energy. Kinks within
    a step (a stop that is met, friction that changes sign within 0.01 rad/s) lower the order there.
    """
    ledger = run.ledger
    total = ledger["end_j"] - ledger["start_j"] - sum(ledger["work_j"].values())
    # rounding of the sum, which Python adds in another way since 3.12
    assert total == pytest.approx(ledger["residual_j"], abs=4e-16 * ledger["turnover_j"])
    print(f"closure {ledger['closure']:.1e} of {ledger['turnover_j']:.2e} J")
    assert ledger["closure"] < bound


@pytest.mark.parametrize("name", ["press", "drop", "slope", "slope_discrete", "slope_joint_pd"])
def test_energy_ledger_closes(tmp_path: Path, name: str) -> None:
    run = simulate(load_scene(SCENES / f"{name}.toml"), tmp_path / "run")
    closes(run)
    # the integrals of the recorded powers are the works (trapezoid on recorded points: second order)
    t = np.asarray(run.signals["time"])
    for column, worker in (("p_mot", "motors"), ("p_op", "operator"), ("p_visc", "viscous")):
        work = np.trapezoid(run.signals[column], t)
        assert work == pytest.approx(run.ledger["work_j"][worker], abs=2e-2 * run.ledger["turnover_j"])
    assert run.ledger["work_j"]["viscous"] < 0


@pytest.mark.parametrize("name", ["drop", "slope"])
def test_energy_ledger_closes_with_coulomb_friction(tmp_path: Path, name: str) -> None:
    scenes = [
        load_scene(SCENES / f"{name}.toml", ["effects.coulomb=true", tolerance]) for tolerance in TOLERANCES
    ]
    coarse, fine = (simulate(scene, tmp_path / str(k)) for k, scene in enumerate(scenes))
    closes(coarse, 1e-5)
    closes(fine)
    assert coarse.ledger["work_j"]["coulomb"] < 0
    assert np.asarray(coarse.signals["p_coul"]).max() <= 0


TOLERANCES = ("solver.coupling_tolerance_rad=1e-7", "solver.coupling_tolerance_rad=1e-10")


def test_energy_ledger_closes_with_end_stops_hit_at_speed(tmp_path: Path) -> None:
    stops = {"stops_rad": [[-0.1, 0.1]], "stop_stiffness_n_m_per_rad": 20.0, "stop_damping_n_m_s": 1.0}
    tables = slider(
        duration_s=1.0,
        wall=None,
        device={"slider": stops, "start": {"q_rad": [0.0], "v_rad_per_s": [2.0]}},
        effects={"motor": "emf", "end_stops": True},
    )
    coarse, fine = (quick(tmp_path, tables, tolerance) for tolerance in TOLERANCES)
    closes(coarse, 1e-4)
    closes(fine)
    assert np.asarray(coarse.signals["q1"]).max() > 0.1
    assert coarse.ledger["work_j"]["stops"] < 0  # Hunt and Crossley: gives back less than it took


# ---- repeatability


@pytest.mark.parametrize("name", ["slope", "drop"])
def test_same_scene_and_seed_give_the_same_bytes(tmp_path: Path, name: str) -> None:
    scene = load_scene(SCENES / f"{name}.toml", ["effects.pot_noise=white", "duration_s=0.5"])
    first, again = simulate(scene, tmp_path / "a"), simulate(scene, tmp_path / "b")
    assert bytes_of(first) == bytes_of(again)
    assert (tmp_path / "a" / "samples.csv").read_bytes() == (tmp_path / "b" / "samples.csv").read_bytes()


def test_plan_tells_every_effect_once() -> None:
    plan = resolve(slope("motor=full", "pot_noise=white")).as_dict()
    rows = [row["name"] for row in plan["effects"] + plan["left_out"]]
    assert sorted(rows) == sorted(effect.name for effect in EFFECTS)
    assert {row["name"] for row in plan["effects"]} == {"motor", "pot_noise"}
    assert plan["predicted"]["noise_points"] > 0


@pytest.mark.parametrize("granted", ["--include", "--trust", ""])
def test_effects_takes_the_permissions_that_its_refusal_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], granted: str
) -> None:
    """It named --include and --trust, and the command had neither."""
    outside = tmp_path / "vendor"
    edit = ("board2.cir", "'blocks/summer.cir'", f"'{outside / 'summer.cir'}'")
    scene = f"device.board={board(tmp_path, edit)}"
    outside.mkdir()
    (tmp_path / "netlists" / SUMMER).rename(outside / "summer.cir")
    words = [granted, *([str(outside)] if granted == "--include" else [])] if granted else []
    code = cli.main(["effects", str(PRESS), "--measure", "curl", "--set", scene, *words])
    captured = capsys.readouterr()
    assert (code, "--include" in captured.err) == ((0, False) if granted else (2, True))
