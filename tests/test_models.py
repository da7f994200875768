"""The effects choose the circuit model; the three models agree where their effects do."""

import numpy as np
import pytest
from support import quick, scene_of, slider, toml

from cosim.assets import scenes_folder
from cosim.cli import main
from cosim.errors import InputError
from cosim.plan import resolve
from cosim.scene import load_scene

#: Without rounding in the computer, so that models are compared and not encoder counts.
SMOOTH = ("effects.encoder=false", "computer.dac.bits=30")


@pytest.mark.parametrize(
    ("effects", "model"),
    [
        ({}, "ideal"),
        ({"motor": "emf", "gravity": True, "encoder": True}, "ideal"),
        ({"motor": "full"}, "linear"),
        ({"opamp": "gbw"}, "linear"),
        ({"vca": "gbw", "driver_level": "gbw"}, "linear"),
        ({"opamp": "full"}, "spice"),
        ({"vca": "full"}, "spice"),
        ({"potentiometer": "full"}, "ideal"),
    ],
)
def test_the_cheapest_model_that_carries_the_effects(tmp_path, effects, model):
    tables = slider(effects=effects, solver={"model": "auto"})
    assert resolve(scene_of(tmp_path, tables)).model == model


def test_a_node_to_record_needs_ngspice(tmp_path):
    tables = slider(record={"nodes": ["xboard.x1"]}, solver={"model": "auto"})
    assert resolve(scene_of(tmp_path, tables)).model == "spice"


def test_a_forced_model_names_every_effect_it_cannot_carry(tmp_path):
    tables = slider(
        effects={"opamp": "full", "motor": "full", "vca": "gbw"},
        record={"nodes": ["xboard.x1"]},
        solver={"model": "ideal"},
    )
    with pytest.raises(InputError) as caught:
        resolve(scene_of(tmp_path, tables))
    assert {problem.key for problem in caught.value.problems} == {
        "effects.opamp",
        "effects.vca",
        "effects.motor",
        "record.nodes",
    }


def test_a_forced_model_on_the_command_line(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(toml(slider(effects={"opamp": "full"})))
    assert main(["run", str(scene), "--model", "linear", "-o", str(tmp_path / "out")]) == 2
    assert "cannot carry" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def run_scene(tmp_path, name, *overrides):
    from support import simulate

    return simulate(
        load_scene(scenes_folder() / name, overrides), tmp_path / f"{name}{len(overrides)}{overrides[0]}"
    )


def difference(first, second, signal):
    t = np.linspace(0.0, first.scene.duration_s, 2001)
    values = [np.interp(t, run.signals["time"], run.signals[signal]) for run in (first, second)]
    return float(np.abs(values[0] - values[1]).max())


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["press.toml", "slope.toml", "slope_joint_pd.toml"])
def test_linear_agrees_with_ngspice(tmp_path, name):
    """Both solve the same circuit; ngspice at rtol 1e-6 is within 1e-4 of the peak force of its limit."""
    tight = ("solver.rtol=1e-6", "solver.max_step_s=5e-4")
    spice = run_scene(tmp_path, name, "solver.model=spice", *SMOOTH, *tight)
    linear = run_scene(tmp_path, name, "solver.model=linear", *SMOOTH)
    assert linear.plan["model"] == "linear"
    peak = float(np.abs(spice.signals["fy"]).max())
    for axis in "xy":
        assert difference(spice, linear, axis) < 1e-6
    # forces jump at samples: compare the motors' work, which integrates them
    work = spice.ledger["work_j"]["motors"]
    assert linear.ledger["work_j"]["motors"] == pytest.approx(work, rel=1e-4)
    assert peak > 0.5


def test_ideal_is_the_circuit_without_dynamics(tmp_path):
    """With ideal parts ngspice solves the same equations: the differentiator has no part in this scene."""
    null = [f"effects.{name}=ideal" for name in ("opamp", "vca", "driver_level", "differentiator")]
    spice = run_scene(
        tmp_path, "slope.toml", "solver.model=spice", *SMOOTH, *null, "effects.motor=emf", "solver.rtol=1e-6"
    )
    ideal = run_scene(tmp_path, "slope.toml", "solver.model=ideal", *SMOOTH, *null, "effects.motor=emf")
    for axis in "xy":
        assert difference(spice, ideal, axis) < 1e-6
    assert ideal.plan["certificate"]["footnote_1"]["sentence"].startswith("up to")


def test_a_resistor_reaches_every_model(tmp_path):
    """A 10 % larger spring resistor renders a 1/1.1 weaker spring in all three: r_sum_fb / r_sum_spring."""
    share = {}
    for model in ("ideal", "linear", "spice"):
        stiff = [
            quick(
                tmp_path,
                slider(
                    duration_s=1.0,
                    effects={"motor": "emf", "operator_dynamics": True},
                    operator={
                        "type": "hand",
                        "waypoints_s_m": [[0.0, 0.0, 0.0]],
                        "force_s_n": [[0.0, 0.0, 0.0], [0.5, 0.0, -0.5]],
                    },
                    solver={"model": model},
                    device={"values": values},
                ),
            ).measures["rendered_stiffness"]["value"]
            for values in ({}, {"r_sum_spring": "26.73k"})
        ]
        share[model] = stiff[1] / stiff[0]
    for model, value in share.items():
        assert value == pytest.approx(24.3 / 26.73, rel=1e-3), model


#: Parts without dynamics, so that all three models carry the scene and solve the same equations.
STATIC = tuple(f"effects.{name}=ideal" for name in ("opamp", "vca", "driver_level", "differentiator"))


@pytest.mark.few(3)
@pytest.mark.parametrize("name", ["press", "drop", "slope", "slope_discrete", "slope_joint_pd"])
def test_models_agree_in_pairs_where_all_apply(tmp_path, name):
    """Ideal and linear leave what the extractions do, 1e-9 of each path.

    ngspice at rtol 1e-6 and short steps is within a fifth of the 1e-3 that it may be wrong by. With the hand
    that is much less; the dropped mass, which nothing but back-EMF damps, adds its errors up over bounces.
    """
    tight = ("effects.motor=emf", "duration_s=1.0", *SMOOTH, *STATIC)
    finer = ("solver.rtol=1e-6", "solver.max_step_s=5e-4")
    runs = {
        model: run_scene(tmp_path, f"{name}.toml", f"solver.model={model}", *tight, *more)
        for model, more in (("ideal", ()), ("linear", ()), ("spice", finer))
    }
    assert [run.plan["model"] for run in runs.values()] == list(runs)
    for (first, second), bound in {
        ("ideal", "linear"): 1e-7, ("ideal", "spice"): 2e-4, ("linear", "spice"): 2e-4,
    }.items():  # fmt: skip
        apart = max(difference(runs[first], runs[second], axis) for axis in "xy")
        travel = max(float(np.ptp(runs[first].signals[axis])) for axis in "xy")
        print(name, first, second, f"{apart / travel:.1e}")
        assert apart < bound * travel
        assert runs[first].ledger["work_j"]["motors"] == pytest.approx(
            runs[second].ledger["work_j"]["motors"], rel=2e-4
        )
