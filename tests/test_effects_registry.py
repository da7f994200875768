"""Effects before anything has run: sizes, costs, what cannot apply, what goes together, what is predicted."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import GEAR, KT, MOTOR_OHM, SCENES, merge, scene_of, shared_child, simulate, slider

from cosim import effects
from cosim.comparisons.effects_ledger import effects_ledger
from cosim.effects import EFFECTS
from cosim.effects.scale import scale
from cosim.errors import InputError
from cosim.newproject import new_project
from cosim.plan import Plan, resolve
from cosim.scene import Effects, load_scene

NAMES = {effect.name: effect for effect in EFFECTS}
FORCES = ("peak_force", "peak_normal_force", "mean_normal_force", "steady_normal_force", "force_ripple")
IDEAL = ("opamp=ideal", "vca=ideal", "driver_level=ideal", "motor=emf", "differentiator=ideal")


def plan_of(scene: Any) -> Plan:
    plan = resolve(scene)
    plan.stated(shared_child())
    return plan


def shipped(name: str, *overrides: str) -> Plan:
    return plan_of(load_scene(SCENES / f"{name}.toml", overrides))


def size(plan: Plan, name: str) -> Any:
    return NAMES[name].size(plan.scene, plan.stated())


# ---- the registry and the scene's keys are one


def test_every_key_is_an_effect_and_every_default_its_null_form() -> None:
    keys = Effects()
    assert set(NAMES) == set(Effects.model_fields) - {"auto"}
    for name, effect in NAMES.items():
        value = getattr(keys, name)
        assert getattr(value, "value", value) == effect.null, name
        assert effect.null not in effect.on
        for other in (*effect.requires, *effect.excludes):
            assert other in NAMES


@pytest.mark.parametrize("name", ["press", "drop", "slope", "slope_joint_pd", "slope_discrete"])
def test_every_size_and_cost_is_a_finite_number_with_its_source(name: str) -> None:
    plan = shipped(name)
    facts = plan.as_dict()
    json.dumps(facts, allow_nan=False)
    for row in facts["effects"] + facts["left_out"]:
        value = row["size"]
        assert math.isfinite(value["value"]), row["name"]
        assert 0.0 <= value["force_n"] < math.inf, row["name"]
        assert value["source"]
        assert value["words"]
        assert row["cost"]["text"]
    value = {row["name"]: row["cost"] for row in facts["effects"] + facts["left_out"]}
    assert len(value) == len(NAMES)  # each once, in force or not
    # noise is drawn at twice its bandwidth: 100 Hz of the potentiometers and 1 kHz of the components
    assert [value[each]["events_per_s"] for each in ("pot_noise", "component_noise")] == [200.0, 2000.0]
    # one jump more a sample where the DACs skew; a number that is merely changed costs nothing
    assert value["dac_skew"]["events_per_s"] == pytest.approx(1.0 / plan.scene.computer.period_s)
    for each in ("gravity", "coriolis", "viscous", "encoder", "dac", "opamp_offset", "vca_offset"):
        assert (value[each]["events_per_s"], value[each]["states"]) == (0.0, 0), each
    # a pole an op-amp and a multiplier, and two a differentiator of each joint
    parts = [amplifier.role for amplifier in plan.board.amplifiers]
    for each in ("opamp", "vca"):
        assert value[each]["states"] == parts.count(each), each
    assert value["differentiator"]["states"] == 2 * plan.scene.joints


def test_what_is_left_out_comes_largest_first_and_what_cannot_apply_last() -> None:
    rows = shipped("drop").as_dict()["left_out"]
    apart = [bool(row["not_applicable"]) for row in rows]
    assert apart == sorted(apart)
    forces = [row["size"]["force_n"] for row in rows if not row["not_applicable"]]
    assert forces == sorted(forces, reverse=True)
    reasons = {row["name"]: row["not_applicable"] for row in rows if row["not_applicable"]}
    assert {"coriolis", "geometric_stiffness", "operator_dynamics", "delay", "dac_skew", "end_stops"} <= set(
        reasons
    )


# ---- formulas


def test_sizes_are_their_formulas() -> None:
    """From the drop's stated data: 0.2 kg on 200 N/m, 10 mm above the floor."""
    plan = shipped("drop", "effects.delay=true", "computer.delay_periods=1")
    speed, radius, wall = math.sqrt(2 * 9.81 * 0.01), 0.1333, 200.0
    at = scale(plan.scene, plan.stated())
    assert at.speed_m_per_s == pytest.approx(speed, rel=1e-9)
    assert size(plan, "gravity").force_n == pytest.approx(0.1928 * 9.81)
    assert size(plan, "delay").force_n == pytest.approx(wall * speed * 0.01)
    assert size(plan, "dac_settling").force_n == pytest.approx(wall * speed * 1e-5)
    assert size(plan, "period_jitter").force_n == pytest.approx(wall * speed * 0.01 * 0.01)
    assert size(plan, "coulomb").force_n == pytest.approx(0.016 / radius)
    assert size(plan, "viscous").force_n == pytest.approx(5e-4 / radius**2 * speed)
    brake = (KT * GEAR / radius) ** 2 / MOTOR_OHM
    assert size(plan, "driver").force_n == pytest.approx(brake * speed)
    assert size(plan, "encoder").value == pytest.approx(2 * math.pi / (500 * 4 * 8))
    assert size(plan, "dac").value == pytest.approx(20 / 2**12)
    assert size(plan, "pot_linearity").force_n == pytest.approx(100 * radius * 0.006)


def test_sizes_of_a_hand_s_path_and_of_a_shaft() -> None:
    """Turned operators that no test saw: the peak speed of a path, springs in series, offsets."""
    shafts = ("device.chain.shaft_stiffness_n_m_per_rad=[10.0,40.0]", "effects.shaft=true")
    plan = shipped("press", "operator.waypoints_s_m=[[0.0,0.07,0.157],[0.2,0.07,0.117]]", *shafts)
    at = scale(plan.scene, plan.stated())
    # 40 mm in 0.2 s by minimum jerk: 15/8 of the mean speed (Flash and Hogan 1985)
    assert at.speed_m_per_s == pytest.approx(15 / 8 * 0.04 / 0.2, rel=1e-12)
    wall, shaft = 100.0, 10.0 / at.reach_m**2  # N/m, the softer shaft at the tip
    both = 1.0 / (1.0 / wall + 1.0 / shaft)
    # four multipliers of a joint's spring and damper, 5 mV out and twice 5 mV in at full scale each; 5.316 V
    # at one of them are 0.875 A
    offset = 4 * 15e-3 * 0.875 / 5.316 * KT * GEAR / at.reach_m
    assert size(plan, "vca_offset").force_n == pytest.approx(offset, rel=1e-9)
    assert size(plan, "shaft").force_n == pytest.approx(at.force_n * (1.0 - both / wall), rel=1e-9)


def test_sizes_follow_the_board_and_its_parts() -> None:
    """No number about the board stands in Python: what the netlist states decides."""
    plain = shipped("slope")
    slow = shipped("slope", "device.values.tl072_gbw=0.3meg")
    assert size(slow, "opamp").value == pytest.approx(10 * size(plain, "opamp").value)
    weak = shipped("slope", "device.values.motor_r=10")
    assert size(weak, "driver").force_n == pytest.approx(size(plain, "driver").force_n / 2)
    coarse = shipped("slope", "device.values.dac_bits=8")
    assert size(coarse, "dac").value == pytest.approx(16 * size(plain, "dac").value)


def test_a_part_that_states_nothing_is_bounded_by_the_drivers_limit() -> None:
    plan = shipped("slope")
    stated = replace(plan.stated(), numbers={})
    limit = stated.i_limit * stated.kt * stated.gear / stated.r_tip
    for name in ("opamp", "vca", "driver_level", "motor"):
        assert NAMES[name].size(plan.scene, stated).force_n == pytest.approx(limit), name


# ---- what goes together


@pytest.fixture
def tied(monkeypatch: pytest.MonkeyPatch) -> None:
    """The registry with an effect that requires one and excludes another."""
    made = replace(NAMES["dac_skew"], requires=("dac",), excludes=("delay",))
    monkeypatch.setattr(
        effects, "EFFECTS", tuple(made if each.name == "dac_skew" else each for each in EFFECTS)
    )


@pytest.mark.usefixtures("tied")
def test_missing_and_excluded_effects_are_refused_together(tmp_path: Path) -> None:
    tables = slider(effects={"dac_skew": True, "delay": True})
    with pytest.raises(InputError) as caught:
        resolve(scene_of(tmp_path, tables))
    problems = caught.value.problems
    assert [problem.key for problem in problems] == ["effects.dac_skew"] * 2
    assert "effects.dac" in problems[0].message
    assert "effects.delay" in problems[1].message
    resolve(scene_of(tmp_path, merge(tables, {"effects": {"dac": True, "delay": False}})))


# ---- what a plan predicts


@pytest.mark.few(9)
@pytest.mark.parametrize("name", ["press", "drop", "slope"])
@pytest.mark.parametrize("model", ["ideal", "linear", "spice"])
@pytest.mark.parametrize("more", [[], ["effects.pot_noise=white"], ["solver.max_step_s=5e-4"]],
                         ids=["as it stands", "noise", "short steps"])  # fmt: skip
def test_predicted_points_are_within_a_factor_of_two(
    tmp_path: Path, name: str, model: str, more: list[str]
) -> None:
    null = [f"effects.{setting}" for setting in IDEAL] if model == "ideal" else []
    plan = shipped(name, f"solver.model={model}", *null, *more)
    stats = simulate(plan.scene, tmp_path / "run").stats
    assert 0.5 < plan.cost()["points"] / stats["points"] < 2.0


FULL = ("effects.opamp=full", "effects.vca=full", "effects.driver_level=full")
#: What a scene may ask for in `spice` that moves its price.
PRICED = {
    "full": FULL,
    "slew": ("effects.opamp_slew=true", "effects.opamp_saturation=true"),
    "limit": ("effects.driver_limit=true",),
    "component noise": ("effects.component_noise=true",),
    "full, component noise": (*FULL, "effects.component_noise=true"),
    "rtol 1e-6": ("solver.rtol=1e-6",),
    "rtol 1e-3": ("solver.rtol=1e-3",),
    "rtol 1e-6, white noise": ("solver.rtol=1e-6", "effects.pot_noise=white"),
    "analog damper": ("computer.analog_damping_n_s_per_m=1",),
}
EVERY = ["press", "drop", "slope", "slope_combined", "slope_discrete", "slope_joint_pd"]
#: All of them, the first scene's among the fast tests; `slope_discrete` has no analog damper.
PAIRS = [
    pytest.param(name, more, id=f"{name}, {what}", marks=() if name == EVERY[0] else pytest.mark.slow)
    for name in EVERY
    for what, more in PRICED.items()
    if (name, what) != ("slope_discrete", "analog damper")
]


@pytest.mark.parametrize(("name", "more"), PAIRS)
def test_levels_noise_and_tolerance_are_priced_in_points(
    tmp_path: Path, name: str, more: tuple[str, ...]
) -> None:
    plan = shipped(name, "solver.model=spice", "duration_s=0.5", *more)
    stats = simulate(plan.scene, tmp_path / "run").stats
    ratio = plan.cost()["points"] / stats["points"]
    print(f"{ratio:.2f}")
    assert 0.5 < ratio < 2.0


LAW = """
from cosim.loop.userlaw import Command
class Still:
    def control(self, sample):
        return Command()
"""
JITTER = ("effects.period_jitter=uniform", "computer.jitter_share=0.05")
BY_LAW = (
    "computer.law='{folder}/law.py:Still'",
    "computer.method=discrete",
    "computer.analog_stiffness_n_per_m=0",
)
#: What asks for other steps or for Python; a project of `new` where a number of joints stands for the scene.
OTHERS = [
    pytest.param(name, more, model, id=f"{name} {what} {model}", marks=() if name != 6 else pytest.mark.slow)
    for model in ("spice", "linear")
    for name, what, more in (
        ("press", "current drive", ("effects.driver=current",)),
        ("drop", "current drive", ("effects.driver=current",)),
        ("slope_discrete", "jitter", JITTER),
        ("drop", "jitter", JITTER),
        ("press", "own law", BY_LAW),
        (3, "joints", ()),
        (6, "joints", ()),
    )
]


@pytest.mark.few(4)
@pytest.mark.parametrize(("name", "more", "model"), OTHERS)
def test_joints_drives_jitter_and_laws_are_priced_in_points(
    tmp_path: Path, name: str | int, more: tuple[str, ...], model: str
) -> None:
    plan = other(tmp_path, name, more, model, "duration_s=0.5")
    ratio = plan.cost()["points"] / simulate(plan.scene, tmp_path / "run").stats["points"]
    assert 0.5 < ratio < 2.0


def other(folder: Path, name: str | int, more: tuple[str, ...], model: str, *last: str) -> Plan:
    (folder / "law.py").write_text(LAW)
    file = SCENES / f"{name}.toml"
    if isinstance(name, int):
        file = next(path for path in new_project(folder / "project", name) if path.name == "press.toml")
    changes = [change.format(folder=folder) for change in more]
    return plan_of(load_scene(file, [f"solver.model={model}", *changes, *last]))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "more", "seconds"), [("press", BY_LAW, 20), ("drop", JITTER, 2)])
def test_jitter_and_laws_are_priced_in_seconds(
    tmp_path: Path, name: str, more: tuple[str, ...], seconds: int
) -> None:
    """As those of the shipped scenes, in our own loop, of which Python is most; before all is at rest."""

    def ratio(plan: Plan) -> float:
        best = min(simulate(plan.scene).stats["cpu_s"] for _ in range(3))
        return plan.cost()["seconds"] / best

    machine = ratio(shipped("press", "solver.model=spice"))
    assert 0.5 < ratio(other(tmp_path, name, more, "linear", f"duration_s={seconds}")) / machine < 2.0


def test_elements_of_every_level_are_priced() -> None:
    """By runs of three scenes: full takes 2.5 times the time of a point at gbw (2.1 to 2.8), slew and
    saturation 2.2 times (1.5 to 2.8).
    """

    def micro(*more: str) -> float:
        cost = shipped("press", "solver.model=spice", *more).cost()
        return cost["seconds"] / cost["points"]

    assert micro(*FULL) / micro() == pytest.approx(2.5, rel=0.35)
    assert micro(*PRICED["slew"]) / micro() == pytest.approx(2.2, rel=0.35)
    plain = shipped("press").cost()
    assert plain["start_seconds"] > 10 * plain["seconds"]  # a short run is mostly its start


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_predicted_seconds_are_within_a_factor_of_two(tmp_path: Path, name: str) -> None:
    """Of one another: the machine's speed, taken from the press scene, is no part of it."""

    def ratio(scene: str, *more: str) -> float:
        plan = shipped(scene, *more)
        runs = (simulate(plan.scene, tmp_path / f"{scene} {len(more)} {k}") for k in range(3))
        best = min(run.stats["cpu_s"] for run in runs)
        for k in range(3):
            shutil.rmtree(tmp_path / f"{scene} {len(more)} {k}")
        return plan.cost()["seconds"] / best

    null = [f"effects.{setting}" for setting in IDEAL]
    machine = ratio("press", "solver.model=spice")
    # a millisecond of it would be the caches', not the loop's; a carriage that has come to rest costs less
    long = "duration_s=5" if name == "drop" else "duration_s=60"
    for more in (
        ("solver.model=linear", long),
        ("solver.model=ideal", long, *null),
        *(("solver.model=spice", *pair.values[1]) for pair in PAIRS if pair.values[0] == name),
    ):
        value = ratio(name, *more) / machine
        print(f"{name} {more}: {value:.2f}")
        assert 0.5 < value < 2.0, more


def test_a_plan_tells_the_states_of_every_model() -> None:
    """board2 has two capacitors for each of two differentiators; gbw and full add theirs, L one a motor."""
    spice = shipped("slope", *(f"effects.{setting}" for setting in IDEAL[:3]), "effects.motor=ideal")
    assert spice.circuit_states() == 4
    more = shipped("slope", *(f"effects.{setting}" for setting in IDEAL[:3]), "effects.motor=full")
    assert more.circuit_states() == 4 + 2
    assert shipped("slope").circuit_states() == 4 + 2 + 8 + 8 + 2
    null = [f"effects.{setting}" for setting in IDEAL]
    assert shipped("slope", "solver.model=ideal", *null).circuit_states() == 0
    linear = shipped("slope", "solver.model=linear")
    linear.extracted(shared_child())
    states = linear.circuit_states()
    assert states is not None
    assert 4 <= states <= 24


# ---- the measured ledger


def test_the_ledger_runs_each_choice_once_and_names_what_cannot_apply(tmp_path: Path) -> None:
    tables = slider(
        duration_s=0.06,
        device={"start": {"q_rad": [-0.03]}, "slider": {"viscous_n_m_s": 1e-3}},
        computer={"dac": {"skew_s": 1e-3}},
    )
    scene_of(tmp_path, tables)
    rows: list[tuple[int, int]] = []
    ledger = effects_ledger(
        tmp_path / "scene.toml", child=shared_child(), on_progress=lambda *at: rows.append(at[:2])
    )
    assert ledger.runs == len(rows)
    assert [done for done, _ in rows] == list(range(len(rows)))
    assert {total for _, total in rows} == {ledger.runs}
    assert ledger.runs <= 2 * len(ledger.rows) + 2
    reasons = {"coulomb", "rotor_inertia", "end_stops", "delay", "dac_settling", "coriolis",
               "operator_dynamics", "geometric_stiffness"}  # fmt: skip
    assert reasons <= set(ledger.not_applicable)
    measured = {row.effect for row in ledger.rows}
    assert measured | set(ledger.not_applicable) == set(NAMES)
    assert not measured & set(ledger.not_applicable)
    assert {"dac_skew", "viscous", "opamp", "period_jitter"} <= measured


#: One flipped count or code hides what a small effect does: both as fine as they may be.
FINE = ("computer.encoder.pulses_per_rev=1000000", "computer.dac.bits=30")
#: Two models solve one scene to some 1e-4 of its forces, and an effect may call for another model.
MODEL_SHARE = 1e-4
#: A force that sets in at once makes a wall without damping swing by twice itself.
SWING = 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["press", "drop", "slope"])
def test_a_priori_sizes_are_estimates_from_above(name: str) -> None:
    """No measure of force changes by more, alone and on top of all, but for a choice between devices.

    Where an effect is switched off, what means nothing without it goes as well: their sizes add up. Without
    gravity the drop's mass meets no floor, so that there only the side on top of all says something.
    """
    path = SCENES / f"{name}.toml"
    ledger = effects_ledger(path, ("solver.model=auto", *FINE))
    stated = load_scene(path)
    null = {e.name: e.value(stated) if e.design else e.null for e in EFFECTS}
    every = dict(null)
    for row in ledger.rows:
        if not NAMES[row.effect].design and every[row.effect] == NAMES[row.effect].null:
            every[row.effect] = row.value if row.value not in ("True", "False") else row.value == "True"

    def force(settings: dict[str, Any], names: list[str]) -> float:
        words = [f"effects.{key}={str(value).lower()}" for key, value in settings.items()]
        plan = shipped(name, "solver.model=auto", *FINE, *words)
        return float(sum(size(plan, each).force_n for each in names))

    too_small = []
    for row in ledger.rows:
        effect = NAMES[row.effect]
        if effect.design:
            continue
        value = row.value if row.value != "True" else True
        needed = {other: NAMES[other].on[0] for other in effect.requires}
        gone = [e.name for e in EFFECTS if e is effect or effect.name in e.requires]
        gone += [e.name for e in EFFECTS if set(e.requires) & set(gone) and e.name not in gone]
        sides = [(row.off, {**every, effect.name: value}, [g for g in gone if every[g] != NAMES[g].null])]
        if name != "drop":
            sides.append((row.on, {**null, **needed, effect.name: value}, [effect.name]))
        for changes, settings, names in sides:
            moved = max((abs(changes[key]) for key in FORCES if key in changes), default=0.0)
            room = SWING * force(settings, names) + MODEL_SHARE * ledger.full["peak_force"]["value"]
            if not moved <= room:
                too_small.append((effect.name, value, names, moved, room))
    assert too_small == []
