"""Names of files that no file can have: an error in words, wherever a name is taken."""

from pathlib import Path

import pytest
from project import lay_out

from cosim.cli import main

LONG = "x" * 300
ODD = [LONG, f"{LONG}/y", "a\\u0000b", "no/such/place", "."]


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize(
    "key",
    [
        'device.board="{}.cir"',
        'computer.law="{}.py:Law"',
        'operator={{type="python", file="{}.py:Push"}}',
        'device.parts={{opamp={{file="{}.lib", subckt="X", pins="1 2 3 4 5"}}}}',
    ],
)
def test_a_key_of_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, name: str) -> None:
    project = lay_out(tmp_path / "device")
    assert main(["plan", str(project.scene), "--set", key.format(name)]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("command", ["plan", "check", "report", "stability"])
def test_the_scene_and_what_it_extends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, name: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(f'extends = "{name}.toml"\n')
    assert main([command, str(scene)]) == 2
    assert main([command, f"{tmp_path}/{name}.toml"]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("name", ODD)
def test_an_include(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    project = lay_out(tmp_path / "device")
    project.edit("netlists/board2.cir", ".include", f'.include "{name}.cir"\n.include')
    assert main(["plan", str(project.scene)]) == 2
    assert "Traceback" not in capsys.readouterr().err
