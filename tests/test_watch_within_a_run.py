"""What starts within a run is seen: outputs that latch later, operating points that are left, other poses."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import ROOT, SCENES, Arm, scene_of, shared_child, simulate, slider

from cosim import stability_gate
from cosim.plan import resolve
from cosim.pose_matrices import at_start
from cosim.results import Run
from cosim.scene import load_scene

#: One command of 0.6 N m, some 9 V at the pin: then the law asks for nothing any more.
LAW = """
from cosim.loop.userlaw import Command
class Kick:
    def control(self, sample):
        return Command(torque_n_m=[0.6 if sample.tick == 2 else 0.0])
"""
#: Drives the summing node once the output is below -3 V, and drives nothing about the operating point.
HANG = "Bhang 0 sum I={amps}/(1+exp(4*(V(out)+3)))"


def run(folder: Path, amps: float, mass_kg: float, duration_s: float) -> Run:
    shutil.copytree(ROOT / "netlists", folder / "netlists")
    block = folder / "netlists" / "blocks" / "summer.cir"
    line = "R31 sum out {r31}"
    block.write_text(block.read_text().replace(line, f"{line}\n{HANG.format(amps=amps)}"))
    (folder / "law.py").write_text(LAW)
    tables = slider(
        duration_s=duration_s,
        device={"board": str(folder / "netlists" / "board1.cir"), "slider": {"mass_kg": mass_kg}},
        computer={"law": f"{folder}/law.py:Kick", "method": "discrete", "analog_stiffness_n_per_m": None},
        effects={"opamp": "full", "vca": "gbw", "driver": "voltage", "driver_level": "gbw", "motor": "full"},
    )  # fmt: skip
    return simulate(scene_of(folder, tables))


def test_an_output_that_latches_within_a_run_is_reported(tmp_path: Path) -> None:
    """1.4 mA through the 10k of the feedback ask for 14 V, more than the amplifier has, after the kick.

    The kick is at 50 ms. The carriage is so heavy that it stands still for a while, and moves at the end.
    """
    result = run(tmp_path, 1.4e-3, mass_kg=200.0, duration_s=0.5)
    assert abs(result.signals["v1"][-1]) > stability_gate.REST_RAD_PER_S  # the end tells nothing
    (doubt,) = [c.text for c in result.warnings if c.code == "output-latched" and "xsum1.xop" in c.text]
    since, unit = doubt.split()[1:3]
    assert unit == "ms"
    assert 50.0 <= float(since) <= 75.0


def test_an_operating_point_that_is_left_is_reported(tmp_path: Path) -> None:
    """0.8 mA ask for 8 V: no limit is reached, but the circuit without a past stands at 0 V."""
    result = run(tmp_path, 0.8e-3, mass_kg=1e3, duration_s=0.15)
    rows = [c.text for c in result.warnings if c.code == "operating-point-left"]
    assert any("xboard.xsum1.xop" in text and "-7.99 V" in text for text in rows), rows


def test_a_healthy_board_says_nothing(tmp_path: Path) -> None:
    result = run(tmp_path, 0.0, mass_kg=1e3, duration_s=0.15)
    assert not {c.code for c in result.warnings} & {"output-latched", "operating-point-left"}


def test_the_poses_that_a_run_reached_are_judged_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the inertia of each pose, by the textbook's arm."""
    plan = resolve(load_scene(SCENES / "press.toml", ["effects.rotor_inertia=false"]))
    start = at_start(plan.scene, 8.0).q
    q = start + np.array([[0.0, 0.0], [0.05, 0.0], [0.5, 0.3], [0.2, -0.4]])
    poses = stability_gate.reached(plan, q)
    assert {tuple(pose) for pose in poses} == {tuple(q[2]), tuple(q[3])}
    masses: list[Any] = []
    monkeypatch.setattr(
        stability_gate, "growing", lambda response, volts, mass, *_: masses.append(mass) or []
    )
    assert stability_gate.coupled(plan, shared_child(), poses) == []
    hand = plan.scene.operator.mass_kg  # type: ignore[union-attr]
    arm = Arm(0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 8.333e-5, 8.333e-5, 0.0)
    expected = [arm.mass_and_bias(pose, np.zeros(2), hand)[0] for pose in poses for _ in range(2)]
    np.testing.assert_allclose(masses, expected, rtol=1e-9)
