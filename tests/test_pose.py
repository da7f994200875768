"""What is kept of the mechanics about the start is what they are, and goes with every table that moves it."""

from pathlib import Path

import numpy as np
import pytest

from cosim import pose_matrices
from cosim.circuits.cache import folder
from cosim.scene import load_scene

SCENES = Path(__file__).resolve().parents[1] / "scenes"


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return folder()


def test_a_start_is_computed_once(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(SCENES / "press.toml")
    first = pose_matrices.at_start(scene, 8.0)
    monkeypatch.setattr(pose_matrices, "_about", lambda *_: pytest.fail("computed again"))
    again = pose_matrices.at_start(scene, 8.0)
    for key, value in vars(first).items():
        np.testing.assert_array_equal(getattr(again, key), value)


@pytest.mark.parametrize(
    "change",
    ["device.start.elbow=-1", "operator.mass_kg=0.5", "effects.rotor_inertia=false", "wall.normal=[1.0, 0.0]",
     "effects.operator_dynamics=false"],
)  # fmt: skip
def test_a_change_of_the_scene_is_another_start(empty_cache: Path, change: str) -> None:
    key = change.partition("=")[0]
    plain = load_scene(SCENES / "press.toml")
    if key == "device.start.elbow" and plain.device.start.q_rad is not None:
        pytest.skip("the scene starts at angles")
    pose_matrices.at_start(plain, 8.0)
    pose_matrices.at_start(load_scene(SCENES / "press.toml", [change]), 8.0)
    assert len(list(empty_cache.glob("start-*"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK not an archive"])
def test_a_damaged_file_is_computed_anew(empty_cache: Path, damage: bytes) -> None:
    scene = load_scene(SCENES / "press.toml")
    first = pose_matrices.at_start(scene, 8.0)
    (kept,) = empty_cache.glob("start-*")
    kept.write_bytes(damage)
    np.testing.assert_array_equal(pose_matrices.at_start(scene, 8.0).mass, first.mass)
