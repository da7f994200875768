"""A device's project to break: the netlists as shipped and a short scene of the two-joint arm on a wall."""

import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

SCENE = """\
title = "Short press"
duration_s = 0.1

[device]
board = "netlists/board2.cir"
linkage = "chain"
[device.chain]
lengths_m = [0.1, 0.1]
masses_kg = [0.1, 0.1]
coms_m = [0.05, 0.05]
inertias_kg_m2 = [8.333e-5, 8.333e-5]
rotor_inertia_kg_m2 = [2e-6, 2e-6]
[device.start]
tip_m = [0.07, 0.154]  # 1 mm inside of the wall

[computer]
period_s = 0.025
method = "combined"
analog_stiffness_n_per_m = 100.0
discrete_stiffness_n_per_m = 50.0

[wall]
point_m = [0.07, 0.155]
normal = [0.0, 1.0]

[operator]
type = "hand"
waypoints_s_m = [[0.0, 0.07, 0.154]]

[effects]
opamp = "gbw"
vca = "gbw"
driver_level = "gbw"
motor = "full"
encoder = true
dac = true
rotor_inertia = true
operator_dynamics = true

[solver]
model = "spice"
"""


@dataclass(frozen=True)
class Project:
    """A folder with ``netlists/`` and ``scene.toml``."""

    folder: Path

    @property
    def scene(self) -> Path:
        return self.folder / "scene.toml"

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace the first `old` in a file."""
        path = self.folder / file
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    def user_operator(self, text: str) -> None:
        """Let the class Push of a Python file with this text hold the fingertip."""
        (self.folder / "push.py").write_text(text, encoding="utf-8")
        old = SCENE[SCENE.index("[operator]") : SCENE.index("[effects]")]
        self.edit("scene.toml", old, '[operator]\ntype = "python"\nfile = "push.py:Push"\n\n')

    def user_law(self, text: str) -> None:
        """Let the class Law of a Python file with this text control the device."""
        (self.folder / "law.py").write_text(text, encoding="utf-8")
        self.edit("scene.toml", 'method = "combined"', 'method = "combined"\nlaw = "law.py:Law"')

    def start(self, setting: str, after: int = 0) -> "subprocess.Popen[str]":
        """Run the scene in a process of its own; return when `after` runs are done and one writes rows."""
        scratch = self.folder.parent / "scratch"
        scratch.mkdir()
        process = subprocess.Popen(
            [sys.executable, "-m", "cosim.cli", "run", "scene.toml", "-o", "out", "--set", setting],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(scratch)},
        )
        end = time.monotonic() + 300
        while time.monotonic() < end:
            assert process.poll() is None, process.communicate()
            rows = [path for path in scratch.glob("cosim-ngspice.*/out/rows.f64") if path.stat().st_size]
            if rows and len(list(self.folder.glob("out/*/run.json"))) == after:
                return process
            time.sleep(0.02)
        process.kill()
        raise AssertionError("no run wrote rows within five minutes")


def lay_out(folder: Path) -> Project:
    """Make the project in a new folder."""
    folder.mkdir(parents=True)
    shutil.copytree(ROOT / "netlists", folder / "netlists")
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    return Project(folder)
