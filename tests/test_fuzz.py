"""The fuzzers in short: `make fuzz` runs them at length."""

import os
from pathlib import Path

import pytest
from fuzz import commands, mc_kills, targets

from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene

SEED = 20261129
NAMES = ("scenes", "netlists", "settings", "ranges", "studies", "results", "raw", "csv", "points")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stored result to damage."""
    folder = tmp_path_factory.mktemp("stored") / "result"
    scene = targets.scenes_folder() / "press.toml"
    run(resolve(load_scene(scene, ["duration_s=0.05", "solver.model=linear"])), folder)
    return folder


@pytest.mark.few(4)
@pytest.mark.parametrize("name", NAMES)
def test_a_reader_says_what_is_wrong(name: str, result: Path, tmp_path: Path) -> None:
    readers = {target.name: target for target in targets.readers(tmp_path, result)}
    assert tuple(readers) == NAMES
    outcome = targets.exercise(readers[name], SEED, 40, tmp_path / "home")
    assert outcome.refused > 0


def test_whole_commands_end_with_words(result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(targets.ROOT), os.environ.get("PYTHONPATH", "")]))
    codes = commands.exercise(targets.Project(tmp_path / "project"), result, tmp_path, SEED, 3)
    assert sum(codes.values()) >= 3


def test_what_is_killed_goes_on_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(targets.ROOT), os.environ.get("PYTHONPATH", "")]))
    commands.kill_and_resume(targets.Project(tmp_path / "project"), tmp_path, SEED, 1)


@pytest.mark.slow
def test_studies_that_are_killed_go_on_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every victim twice, once with what was finished marked; `python -m tests.fuzz` kills fifty times."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(targets.ROOT), os.environ.get("PYTHONPATH", "")]))
    counts = mc_kills.kill_studies(targets.Project(tmp_path / "project"), tmp_path, SEED, 6)
    assert counts["samples kept"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_reader_says_what_is_wrong_at_length(name: str, result: Path, tmp_path: Path) -> None:
    readers = {target.name: target for target in targets.readers(tmp_path, result)}
    targets.exercise(readers[name], SEED + 1, 1000, tmp_path / "home")
