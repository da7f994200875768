"""Figs 15 to 18: what a trace says of the sink, the drag and footnote 1, and where it says no."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import SCENES, Arm, simulate

from cosim.measures import wall_frame
from cosim.scene import load_scene
from cosim.studies.study import load_study, run_study
from cosim.studies.wall_trace import SINK, TraceParameters, quasi_static, verdicts

#: The discrete part alone, and with the analog one, as the paper has them [N/m].
ALONE, BOTH = 133.0, 233.0


def one(name: str, *, stiffness: float = ALONE, ratio: float = 1e-3, error: float = 1.0) -> dict[str, Any]:
    """A run: 1 N on a wall of a stiffness, dragged along by a ratio, a share of its error explained."""
    acceleration = np.linspace(-1.0, 1.0, 21)
    grid = {"time [s]": [0.0], "normal force [N]": [1.0], "tangential force [N]": [0.0], "depth [mm]": [7.5],
            "along the wall [mm]": [0.0]}  # fmt: skip
    return {
        "measures": {
            "steady_penetration": 1.0 / stiffness, "steady_normal_force": 1.0,
            "rendered_stiffness": stiffness, "tangential_ratio": ratio, "force_ripple": 1e-3,
        },
        "signals": grid,
        "quasi_static": {
            "error_n": (-0.08 * acceleration).tolist(), "acceleration_m_per_s2": acceleration.tolist(),
            "inertia_n": (-0.08 * error * acceleration).tolist(),
        },
    }  # fmt: skip


def judged(*runs: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
    given = TraceParameters(runs=tuple(asked for asked, _ in runs))  # type: ignore[arg-type]
    by_name = {asked["name"]: got for asked, got in runs}
    return {verdict.id: verdict.holds for verdict in verdicts(given, by_name)}


DISCRETE = ({"name": "discrete"}, one("discrete"))


@pytest.mark.parametrize(
    ("stiffness", "holds"),
    [(BOTH, True), (ALONE / 0.8, False), (ALONE / 0.5, False), (ALONE, False)],
)
def test_the_sink_is_judged_by_the_papers_two_stiffnesses(stiffness: float, holds: bool) -> None:
    assert pytest.approx(ALONE / BOTH, abs=5e-4) == SINK
    assert judged(DISCRETE, ({"name": "combined"}, one("combined", stiffness=stiffness)))["F16/17"] is holds


@pytest.mark.parametrize(("ratio", "holds"), [(0.3, True), (0.11, False)])
def test_drag_is_judged_against_the_coupled_gains(ratio: float, holds: bool) -> None:
    coupled = ({"name": "discrete"}, one("discrete", ratio=0.02))
    assert judged(coupled, ({"name": "every joint"}, one("every joint", ratio=ratio)))["F18"] is holds


@pytest.mark.parametrize(
    ("share", "holds"), [(1.0, True), (0.9, True), (0.5, False), (0.0, False), (-1.0, False)]
)
def test_inertia_must_explain_the_error(share: float, holds: bool) -> None:
    assert judged(({"name": "discrete"}, one("discrete", error=share)))["N2"] is holds


def test_inertia_is_what_the_textbooks_arm_takes() -> None:
    """An arm led along a path: J^-T tau less the force at the hand is J^-T (M q'' + h), sign and size."""
    scene = load_scene(SCENES / "slope.toml")
    chain, wall = scene.device.chain, scene.wall
    assert chain is not None
    assert wall is not None
    rotor = chain.rotor_inertia_kg_m2[0] * 8.0**2
    arm = Arm(*chain.lengths_m, *chain.masses_kg, *chain.coms_m, *chain.inertias_kg_m2, rotor)
    point, normal = np.array(wall.point_m), np.array(wall.normal)
    along = np.array([normal[1], -normal[0]])
    t = np.arange(0.0, scene.duration_s + 5e-4, 5e-4)
    # along the wall and 8 to 12 mm into it, all of it in contact
    tip = (
        point
        - np.outer(0.010 + 0.002 * np.sin(2 * np.pi * 3.0 * t), normal)
        - np.outer(0.02 + 0.02 * np.sin(2 * np.pi * 1.5 * t), along)
    )
    q = np.array([arm.inverse(r) for r in tip])
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)
    torque = np.column_stack([0.1 * np.cos(5 * t), 0.1 * np.sin(7 * t)])
    motors, hand = np.zeros_like(tip), np.zeros_like(tip)
    for k in range(len(t)):
        m, h = arm.mass_and_bias(q[k], v[k], 0.0)
        back = np.linalg.inv(arm.jacobian(q[k]).T)
        motors[k] = back @ torque[k]
        hand[k] = -(back @ (torque[k] - m @ a[k] - h))  # of the operator on the device
    signals = {"time": t, "x": tip[:, 0], "y": tip[:, 1], "fx": hand[:, 0], "fy": hand[:, 1],
               "fmx": motors[:, 0], "fmy": motors[:, 1], "q1": q[:, 0], "q2": q[:, 1], "v1": v[:, 0],
               "v2": v[:, 1]}  # fmt: skip
    held = quasi_static(
        SimpleNamespace(scene=scene, signals=signals, plan={"constants": {"gear": 8.0}}),  # type: ignore[arg-type]
        1e-3,
    )
    assert len(held["error"]) > 1500
    size = float(np.abs(held["error"]).max())
    assert size > 0.05
    # differences over 1 ms of 3 Hz err by (w dt)^2/6 = 6e-5; the ends of the run by w dt/2
    np.testing.assert_allclose(held["inertia"][2:-2], held["error"][2:-2], atol=1e-3 * size)


def test_a_run_with_everything_is_no_method_of_its_own() -> None:
    """Coulomb friction drags as joint PD does: what it is worth is told, the method is not judged by it."""
    combined = ({"name": "combined"}, one("combined", stiffness=BOTH))
    every = ({"name": "all", "all_of": "combined"}, one("all", stiffness=0.95 * BOTH, ratio=0.31))
    result = judged(DISCRETE, combined, every)
    assert result == {"F16/17": True, "N1": None, "N2": True}


def test_a_short_trace_from_scene_to_verdicts(tmp_path: Any) -> None:
    """The paper's own file with its first three runs, on the linear model."""
    text = (SCENES / "paper" / "3_fig16_18.toml").read_text(encoding="utf-8")
    head = text[: text.index("# Everything that can be")].replace("../slope.toml", str(SCENES / "slope.toml"))
    short = 'set = ["solver.model=linear"]\n\n[parameters]'
    file = tmp_path / "trace.toml"
    file.write_text(head.replace("[parameters]", short, 1), encoding="utf-8")
    result = run_study(load_study(file), tmp_path / "out")
    assert {v.id: v.holds for v in result.verdicts} == {"F16/17": True, "F18": True, "N2": True}
    runs = result.table("runs").columns
    assert all("opamp gbw" in held and "coulomb" not in held for held in runs["effects in force"])
    assert runs["circuit"] == ["linear"] * 3
    stiffness = runs["rendered stiffness [N/m]"]
    # the slide ends within the last fifth: mean force over mean depth, back-EMF and counts in it
    assert stiffness[:2] == pytest.approx([ALONE, BOTH], rel=0.05)
    assert json.loads((tmp_path / "out" / "study.json").read_text())["verdicts"]


@pytest.mark.slow
@pytest.mark.parametrize("reading", ["white", "peak noise", "static", "position"])
def test_with_everything_on_friction_drags_by_what_it_holds_at_the_joints(reading: str) -> None:
    """J^-T tau_c sign(v) along the wall, some 0.3 of the normal force, on top of what drags without it."""
    spec = load_study(SCENES / "paper" / "3_fig16_18.toml")
    (settings,) = [each.set for each in spec.parameters.runs if each.name.startswith("all on, " + reading)]
    held = {name.partition("=")[0] for name in settings}
    assert held >= {"effects.component_noise", "effects.coulomb", "effects.pot_noise", "effects.opamp"}
    scene = load_scene(SCENES / "slope.toml", settings)
    rough = simulate(scene)
    smooth = simulate(load_scene(SCENES / "slope.toml", [*settings, "effects.coulomb=false"]))
    t = np.asarray(rough.signals["time"])
    q, v = (np.array([np.asarray(rough.signals[f"{name}{j}"]) for j in (1, 2)]) for name in ("q", "v"))
    (l1, l2), (nx, ny) = scene.device.chain.lengths_m, scene.wall.normal
    jacobian = np.array(
        [[-l1 * np.sin(q[0]) - l2 * np.sin(q[0] + q[1]), -l2 * np.sin(q[0] + q[1])],
         [l1 * np.cos(q[0]) + l2 * np.cos(q[0] + q[1]), l2 * np.cos(q[0] + q[1])]]
    ).transpose(2, 1, 0)  # fmt: skip
    torque = -np.array(scene.device.chain.coulomb_n_m) * np.sign(v.T)
    drag = np.linalg.solve(jacobian, torque[:, :, None])[:, :, 0] @ np.array([ny, -nx])
    seen = [wall_frame(run.scene, run.signals) for run in (rough, smooth)]
    smooth_there = np.interp(t, np.asarray(smooth.signals["time"]), seen[1]["tangent"])
    # while both joints turn, in the wall and settled from its blow; what sticks at the end is held by less
    sliding = (np.abs(v) > 0.05).all(axis=0) & (seen[0]["penetration"] > 0.0) & (t > 1.0)
    step = np.gradient(t)[sliding]
    assert step.sum() > 0.3
    extra = float(np.sum((seen[0]["tangent"] - smooth_there)[sliding] * step) / step.sum())
    expected = float(np.sum(drag[sliding] * step) / step.sum())
    assert extra == pytest.approx(expected, rel=0.1)  # and inertia
    assert rough.measures["tangential_ratio"]["value"] == pytest.approx(0.31, abs=0.05)
