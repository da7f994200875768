"""The scene's time limit holds for every call that a command makes of a child process."""

import ast
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from project import ROOT, Project, lay_out

from cosim import cli
from cosim.ngspice import child
from mech.library_files import FOLDER, folder

LIMIT_S = 543.5
Limits = dict[str, set[float | None]]
ETA = """\
study = "eta"
title = "Delay"
scene = "scene.toml"
[parameters]
stiffness_n_per_m = 100.0
largest_eta = 0.05
[[parameters.cases]]
name = "as built"
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Project:
    """A short linear scene with a limit of its own; nothing of a circuit is in the cache yet."""
    monkeypatch.setenv(FOLDER, str(folder()))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    project = lay_out(tmp_path / "device")
    project.edit("scene.toml", 'model = "spice"', f'model = "linear"\ntime_limit_s = {LIMIT_S}')
    project.edit("scene.toml", "duration_s = 0.1", "duration_s = 0.05")
    (project.folder / "eta.toml").write_text(ETA, encoding="utf-8")
    monkeypatch.chdir(project.folder)
    return project


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> Limits:
    """Time limits of all calls, by their targets."""
    seen: Limits = {}
    call = child.Child.call

    def listened(self: child.Child, target: str, payload: object, **more: Any) -> Any:
        seen.setdefault(target.partition(":")[0], set()).add(more.get("time_limit_s"))
        return call(self, target, payload, **more)

    monkeypatch.setattr(child.Child, "call", listened)
    return seen


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("command", "asks"),
    [
        (("check", "scene.toml"), {"cosim.checking.measured", "cosim.circuits.instability.search"}),
        (
            ("noise", "scene.toml", "--set", "effects.component_noise=true"),
            {"cosim.circuits.extraction.extract", "cosim.circuits.extraction.noise_contributions"},
        ),
        (("nodes", "scene.toml"), {"cosim.loop.recordable"}),
        (("plan", "scene.toml"), {"cosim.circuits.extraction.design_numbers"}),
        (
            ("run", "scene.toml", "-o", "out"),
            {"cosim.loop.linear.run_linear", "cosim.circuits.instability.search"},
        ),
        (("run", "scene.toml", "-o", "out", "--model", "spice"), {"cosim.loop.spice.run_spice"}),
        (
            ("compare", "scene.toml", "--set", "r_sum_spring=20k", "--measure", "peak_current", "--most", "1",
             "-o", "out"),
            {"cosim.loop.linear.run_linear", "cosim.circuits.instability.search"},
        ),
        (
            ("sweep", "scene.toml", "computer.analog_stiffness_n_per_m=50,60", "--measure", "peak_current",
             "--measure", "eta", "-o", "out"),
            {"cosim.loop.linear.run_linear", "cosim.circuits.extraction.block_delays"},
        ),
        (
            ("report", "eta.toml", "-o", "out"),
            {"cosim.circuits.extraction.extract", "cosim.circuits.extraction.block_delays"},
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)  # fmt: skip
def test_every_call_has_the_scenes_limit(
    project: Project, limits: Limits, command: Sequence[str], asks: set[str]
) -> None:
    assert cli.main(command) == 0
    assert asks <= set(limits)
    assert {target: each for target, each in limits.items() if each != {LIMIT_S}} == {}


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "command",
    [("check", "scene.toml"), ("stability", "scene.toml", "-o", "out"), ("device", "scene.toml"),
     ("noise", "scene.toml"), ("effects", "scene.toml", "-o", "out"),
     ("compare", "scene.toml", "--set", "r_sum_spring=20k", "-o", "out"),
     ("report", "eta.toml", "-o", "out")],
    ids=lambda command: command[0],
)  # fmt: skip
def test_what_hangs_is_ended(
    project: Project,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: Sequence[str],
) -> None:
    """Whatever the command asks, its child answers never."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    project.edit("scene.toml", f"time_limit_s = {LIMIT_S}", "time_limit_s = 1.0")
    call = child.Child.call

    def hung(self: child.Child, target: str, payload: object, **more: Any) -> Any:
        return call(self, "ngspice_targets:spin", payload, **more)

    monkeypatch.setattr(child.Child, "call", hung)
    assert cli.main(command) == 1
    assert "the time limit of 1 s is over" in capsys.readouterr().err


def test_no_call_is_without_a_limit() -> None:
    """What no command above reaches in a short test, such as the longer studies."""
    silent, count = [], 0
    for file in sorted((ROOT / "cosim").rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        imported = {
            each.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module == "cosim.ngspice.child"
            for each in node.names
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "call":
                count += "call" in imported
                if "call" in imported and "time_limit_s" not in {each.arg for each in node.keywords}:
                    silent.append(f"{file.relative_to(ROOT)}:{node.lineno}")
    assert count > 10
    assert silent == []
