"""Measures that need no run: values from theory, reached by every command, and no simulation for them."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import (
    COMMAND_TRUE,
    EMF_TRUE,
    K_FS,
    MOTOR_H,
    MOTOR_OHM,
    SCENES,
    SPRING_TRUE,
    V_NM,
    Arm,
    scene_of,
    shared_child,
    slider,
)

from cosim.analysis.device_passivity import law_of
from cosim.catalogue import MEASURES, NAMES, OF_A_RUN, needing_no_run
from cosim.circuits.extraction.block_delays import spring_delays
from cosim.cli import main
from cosim.comparisons import measure_values
from cosim.comparisons.board_measures import board_measures
from cosim.plan import resolve
from cosim.results import Run
from cosim.scene import load_scene

IDEAL = ("opamp=ideal", "vca=ideal", "driver_level=ideal", "motor=emf", "differentiator=ideal")
DROP, SLOPE, PRESS = (str(SCENES / f"{name}.toml") for name in ("drop", "slope", "press"))
#: What the model of a slider's circuit and the root of its border are good to.
CLOSE = 1e-6
RADIUS, MASS, PERIOD = 0.1333, 0.2, 0.025
VISCOSITY = EMF_TRUE / RADIUS**2
DISCRETE = {"method": "discrete", "discrete_stiffness_n_per_m": 10.0, "analog_stiffness_n_per_m": 0.0}


def measured(plan: Any, *names: str) -> dict[str, float]:
    rows, lacking = board_measures(plan, names, child=shared_child())
    assert not lacking
    return {name: row["value"] for name, row in rows.items()}


def of_slider(folder: Path, *names: str, motor: str = "emf", **computer: Any) -> dict[str, float]:
    tables = slider(computer=computer, effects={"motor": motor}, solver={"model": "auto"})
    return measured(resolve(scene_of(folder, tables)), *names)


# ---- values


def test_limits_of_a_sampled_wall_on_a_mass(tmp_path: Path) -> None:
    """k* = b (1-E)/(tau (1-E) - T E), E = exp(-T/tau), tau = m/b; passive up to 2b/T."""
    slider = of_slider(tmp_path, "k_max", "k_margin", "passive_stiffness", **DISCRETE)
    rendered = COMMAND_TRUE * V_NM
    tau = MASS / VISCOSITY
    e = math.exp(-PERIOD / tau)
    exact = VISCOSITY * (1 - e) / (tau * (1 - e) - PERIOD * e)
    assert slider["k_max"] * rendered == pytest.approx(exact, rel=CLOSE)
    assert slider["k_margin"] == slider["k_max"] / 10.0
    assert slider["passive_stiffness"] * rendered == pytest.approx(2 * VISCOSITY / PERIOD, rel=CLOSE)


def test_converters_that_settle_are_late_by_half_of_it(tmp_path: Path) -> None:
    """The mean of a ramp from code to code; what the delay is past whole periods."""
    for settling, skew, delay, expected in ((2e-3, 0.0, 0, (0, 1e-3)), (2e-3, 1e-3, 1, (1, 2e-3))):
        tables = slider(
            computer={**DISCRETE, "dac": {"settling_s": settling, "skew_s": skew}, "delay_periods": delay},
            effects={"dac_settling": True, "dac_skew": skew > 0.0, "delay": delay > 0},
        )
        law = law_of(scene_of(tmp_path, tables))
        assert len(law.a) == expected[0]  # a state a whole period of delay
        assert law.lag_s == pytest.approx(expected[1], rel=1e-9)


def test_limits_of_an_analog_spring_behind_the_windings_lag(tmp_path: Path) -> None:
    """Spring and back-EMF act through one pole L/R: active and unstable from b R/L, and eta = k L/(R b)."""
    slider = of_slider(tmp_path, "k_max", "passive_stiffness", "eta", motor="full")
    lag = MOTOR_H / MOTOR_OHM
    limit = VISCOSITY / lag
    for name in ("k_max", "passive_stiffness"):
        assert slider[name] * SPRING_TRUE / K_FS == pytest.approx(limit, rel=1e-5), name
    # the delay is read at a phase of 1e-3: its cube is 1e-6 of it
    assert slider["eta"] == pytest.approx(100.0 / limit, rel=1e-5)


def test_what_is_rendered_of_what_is_commanded(tmp_path: Path) -> None:
    """Of ideal parts the gains of the netlist over the constants that it states, spring and damper."""
    shares = of_slider(tmp_path, "stiffness_share", "damping_share", analog_damping_n_s_per_m=2.0)
    assert shares["stiffness_share"] == pytest.approx(SPRING_TRUE / K_FS, rel=CLOSE)
    # r_der_fb c_der_in = 0.1 s in the place of 16.9, 6.19 kOhm in the place of 24.3 kOhm
    damper = SPRING_TRUE * 0.1 / 16.9 * (24.3e3 + 0.1) / (6.19e3 + 0.1)
    assert shares["damping_share"] == pytest.approx(damper / 0.06969, rel=1e-5)
    plan = resolve(scene_of(tmp_path, slider(computer=DISCRETE, solver={"model": "auto"})))
    names = ("stiffness_share", "damping_share", "leakage")
    rows, lacking = board_measures(plan, names, child=shared_child())
    assert not rows
    assert all("commands no analog" in why for why in lacking.values())


def test_an_offset_of_the_potentiometer_is_a_force_of_two_springs_in_series(tmp_path: Path) -> None:
    """A hand of stiffness K holds the spring k, which an angle off by e stretches by r e: r e k K/(k + K)."""
    noise, hand = 0.003, 135.0
    tables = slider(
        device={"potentiometer": {"noise_rad": noise}, "start": {"q_rad": [-0.05]}},
        effects={"motor": "emf", "pot_noise": "static", "operator_dynamics": True},
        operator={"type": "hand", "mass_kg": 0.3, "damping_n_s_per_m": 6.0, "stiffness_n_per_m": hand,
                  "waypoints_s_m": [[0.0, 0.0, -0.02]]},
        solver={"model": "auto"},
    )  # fmt: skip
    result = measured(resolve(scene_of(tmp_path, tables)), "force_noise")["force_noise"]
    spring = 100.0 * SPRING_TRUE / K_FS
    assert result == pytest.approx(RADIUS * noise * spring * hand / (spring + hand), rel=1e-5)
    plan = resolve(scene_of(tmp_path, slider(solver={"model": "auto"})))
    rows, lacking = board_measures(plan, ("force_noise",), child=shared_child())
    assert not rows
    assert "no noise of its potentiometers" in lacking["force_noise"]


def test_eta_is_of_the_slowest_path() -> None:
    """A summing amplifier at a noise gain of hundreds makes the paths to motor 2 some 20 us later."""
    plan = resolve(load_scene(SLOPE, ["device.values.xsum2.r31=1meg", "solver.model=linear"]))
    totals = [path.total_s for path in spring_delays(plan.board, shared_child())]
    assert max(totals) > min(totals) + 1e-5
    scene = plan.scene
    assert scene.wall is not None
    assert scene.device.chain is not None
    l1, l2 = scene.device.chain.lengths_m
    arm = Arm(l1, l2, 0, 0, 0, 0, 0, 0, 0)
    w = arm.jacobian(arm.inverse(np.array(scene.wall.point_m))).T @ np.array(scene.wall.normal)
    b = (EMF_TRUE + scene.device.chain.viscous_n_m_s[0]) / float(w @ w)  # both joints alike
    value = measured(plan, "eta")["eta"]
    assert value == pytest.approx(100.0 * max(totals) / b, rel=1e-3)


def test_what_no_viscosity_and_no_lag_leave(tmp_path: Path) -> None:
    none = of_slider(tmp_path, "k_max", "passive_stiffness", motor="ideal", **DISCRETE)
    assert none == {"k_max": 0.0, "passive_stiffness": 0.0}
    plan = resolve(scene_of(tmp_path, slider(effects={"motor": "emf"}, solver={"model": "auto"})))
    rows, lacking = board_measures(plan, ("k_max", "passive_stiffness", "phase_margin"), child=shared_child())
    assert not rows
    assert set(lacking) == {"k_max", "passive_stiffness", "phase_margin"}


@pytest.mark.parametrize("pair", ["12", "21"])
def test_one_multiplier_off_makes_curl_and_feeds_energy(pair: str) -> None:
    """Against Ksp written out with one cross gain 1 % up: the circle's area by a polygon of 20000 corners."""
    up = 1.01
    null = [f"effects.{each}" for each in IDEAL]
    values = f"device.values.Rsp{pair}={24.3e3 / up!r}"
    plan = resolve(load_scene(SLOPE, [*null, "solver.model=auto", values]))
    scene = plan.scene
    assert scene.wall is not None
    assert scene.device.chain is not None
    l1, l2 = scene.device.chain.lengths_m
    arm = Arm(l1, l2, 0, 0, 0, 0, 0, 0, 0)
    point, normal = np.array(scene.wall.point_m), np.array(scene.wall.normal)
    jac = arm.jacobian(arm.inverse(point))
    w = jac.T @ normal
    ksp = scene.computer.analog_stiffness_n_per_m * SPRING_TRUE / K_FS * np.outer(w, w)
    i, j = (int(digit) - 1 for digit in pair)
    ksp[i, j] *= (24.3e3 + 0.1) / (24.3e3 / up + 0.1)
    inverse = np.linalg.inv(jac)
    tip = inverse.T @ ksp @ inverse
    turns = 2 * np.pi * np.arange(20000) / 20000
    path = np.array([arm.inverse(point + 0.01 * np.array([math.cos(a), math.sin(a)])) for a in turns])
    after = np.roll(path, -1, axis=0)
    area = 0.5 * float(np.sum(path[:, 0] * after[:, 1] - path[:, 1] * after[:, 0]))
    result = measured(plan, "curl", "circle_energy", "least_stiffness", "leakage", "stiffness_share")
    tangent = np.array([-normal[1], normal[0]])
    leak = float(tangent @ tip @ normal) / float(normal @ tip @ normal)
    assert result["leakage"] == pytest.approx(leak, rel=1e-4)
    assert abs(leak) > 1e-4
    share = float(normal @ tip @ normal) / scene.computer.analog_stiffness_n_per_m
    assert result["stiffness_share"] == pytest.approx(share, rel=CLOSE)
    # gains of the model are good to 1e-7 of the largest, the difference of two of them to 1e-5
    assert result["curl"] == pytest.approx(tip[0, 1] - tip[1, 0], rel=1e-4)
    assert result["circle_energy"] == pytest.approx(abs((ksp[0, 1] - ksp[1, 0]) * area), rel=1e-4)
    assert result["least_stiffness"] == pytest.approx(np.linalg.eigvalsh((ksp + ksp.T) / 2)[0], rel=1e-2)
    assert result["least_stiffness"] < 0.0


def test_margins_and_rest_are_those_of_the_check(capsys: pytest.CaptureFixture[str]) -> None:
    full = ["effects.opamp=full", "effects.opamp_offset=true", "effects.driver=current"]
    assert main(["check", DROP, *(word for each in full for word in ("--set", each)), "--json"]) == 0
    board = json.loads(capsys.readouterr().out)["checks"][0]
    measures, lacking = board_measures(
        resolve(load_scene(DROP, full)), ("rest_force", "phase_margin", "gain_margin"), child=shared_child()
    )
    assert measures["rest_force"]["value"] == max(abs(row["force_n"]) for row in board["rest"]) > 0.0
    for name, unit in (("phase_margin", "deg"), ("gain_margin", "db")):
        margins = [row[f"{name}_{unit}"] for row in board["loops"] if row[f"{name}_{unit}"] is not None]
        assert measures[name]["value"] == min(margins) if margins else name in lacking


def test_every_measure_says_what_it_is() -> None:
    assert set(OF_A_RUN) | set(needing_no_run(NAMES)) == set(NAMES)
    assert len(needing_no_run(NAMES)) == 14
    assert all(measure.text and measure.name == name for name, measure in MEASURES.items())


# ---- every command reaches them, and simulates nothing for them


@pytest.fixture
def no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a simulation for a measure that needs none")

    monkeypatch.setattr(measure_values, "run", refuse)


def json_of(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    out: dict[str, Any] = json.loads(capsys.readouterr().out)
    return out


@pytest.mark.usefixtures("no_run")
def test_run_sweep_and_compare_agree_without_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ("--measure", "k_max", "--measure", "eta")
    runs = json_of(capsys, "run", DROP, "--set", "motor_l=1.5m,3m", *asked)["runs"]
    rows = [[run["measures"][name]["value"] for name in ("k_max", "eta")] for run in runs]
    assert [run["folder"] for run in runs] == [None, None]
    assert rows[1][1] > 1.5 * rows[0][1]  # of three lags that of the winding is by far the largest
    swept = json_of(capsys, "sweep", DROP, "motor_l=1.5m,3m", *asked)["measures"]
    assert [list(pair) for pair in zip(swept["k_max"], swept["eta"], strict=True)] == rows
    sides = json_of(capsys, "compare", DROP, "--set", "motor_l=3m", *asked)["measures"]
    assert [[side[name]["value"] for name in ("k_max", "eta")] for side in sides] == rows
    assert not (tmp_path / "out" / "drop").exists()


@pytest.mark.usefixtures("no_run")
def test_effects_on_a_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A limit of its own for every choice of effects: without a back-EMF there is none."""
    folder = scene_of(tmp_path, slider(effects={"motor": "emf"}, computer=DISCRETE)).file
    result = json_of(capsys, "effects", str(folder), "--measure", "k_max")
    assert result["runs"] == 0
    rows = {(row["effect"], row["value"]): row["on"].get("k_max") for row in result["rows"]}
    limit = of_slider(tmp_path, "k_max", **DISCRETE)["k_max"]  # nothing is stable without the back-EMF
    assert rows["motor", "emf"] == pytest.approx(limit, rel=CLOSE)


def test_a_scene_names_them_and_a_result_keeps_them(tmp_path: Path) -> None:
    tables = slider(duration_s=0.05, effects={"motor": "full"}, measures={"names": ["eta", "peak_force"]},
                    solver={"model": "linear"})  # fmt: skip
    plan = resolve(scene_of(tmp_path, tables))
    measure_values.run_with_measures(plan, tmp_path / "run", formats=(), child=shared_child())
    kept = Run.load(tmp_path / "run").measures
    assert list(kept) == ["eta", "peak_force"]
    assert kept["eta"]["value"] == measured(plan, "eta")["eta"]


def test_slips_name_the_measure(capsys: pytest.CaptureFixture[str]) -> None:
    wall = ("--set", "wall={point_m=[0.0,9.0],normal=[0.0,1.0]}")
    for words, each in (
        (["run", DROP, "--measure", "k_maximum"], "nearest is k_max"),
        (["effects", DROP, "--measure", "kmax"], "nearest is k_max"),
        (["compare", DROP, "--set", "seed=2", "--measure", "etta"], "nearest is eta"),
        (["effects", DROP, "--measure", "curl"], "it is of an arm of two joints"),
        (["run", SLOPE, "--measure", "k_max", *wall], "wall.point_m"),
    ):
        assert main(words) == 2, words
        assert each in capsys.readouterr().err
