"""The README's tour works as it stands: every command in it is run, in order, in an empty folder."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli import main
from cosim.newproject import new_project

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


#: The tour: one block of commands a test, each in a project as the first block makes it.
FIRST, *BLOCKS = (block.splitlines() for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL))
STIFFNESS = re.compile(r"([\d.]+)(?: ± [\d.]+)? N/m")


def shell(lines, folder):
    """Run lines as they would be typed; what they print."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-c", "set -e\n" + "\n".join(lines)],
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.long
def test_the_tour_begins_as_typed(tmp_path):
    assert FIRST[0].startswith("cosim new ")
    shell([*FIRST, *BLOCKS[0]], tmp_path)
    assert (tmp_path / "mydevice/out/slope/report/report.html").is_file()


def shorten(scenes, seconds):
    """Let the scenes of the tour last so long."""
    for name in ("press", "slope"):
        text, count = re.subn(
            r"(?m)^duration_s = \S+", f"duration_s = {seconds}", (scenes / f"{name}.toml").read_text()
        )
        assert count == 1
        (scenes / f"{name}.toml").write_text(text)


@pytest.mark.long
@pytest.mark.parametrize("lines", BLOCKS[1:], ids=lambda lines: lines[-1][:40])
def test_the_tour_goes_on(lines, tmp_path, monkeypatch, capsys):
    """Each line in turn; its own commands without a new process for each."""
    if shutil.which("ngspice") is None and any(line.startswith("ngspice") for line in lines):
        pytest.skip("the ngspice program is not installed")
    new_project(tmp_path / "mydevice", 2)
    monkeypatch.chdir(tmp_path / "mydevice")
    tries = "cosim run scenes/press.toml" in lines[0]
    if not tries:  # that a command works needs no long run
        shorten(Path("scenes"), 0.4)
    for line in lines:
        program, *words = shlex.split(line)
        if program == "cosim":
            assert main(words) == 0, line
        else:
            shell([line], tmp_path / "mydevice")
    printed = capsys.readouterr().out
    if tries:
        (row,) = re.findall(r"^rendered_stiffness .*", printed, re.M)
        small, larger, smallest = (float(value) for value in STIFFNESS.findall(row))
        # 24.5k, 24.3k, 20k: the tour says that it falls as the resistor grows
        assert larger < small < smallest


@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
def test_the_python_of_the_readme_runs(tmp_path, monkeypatch):
    (text,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    new_project(tmp_path / "mydevice", 2)
    monkeypatch.chdir(tmp_path / "mydevice")
    names = {}
    exec(text, names)
    assert names["run"].scene.device.values == {"r_sum_spring": "24k"}
    assert names["force"].shape == names["run"].signals["time"].shape


def test_what_the_readme_names_exists():
    for target in re.findall(r"^make (\w+)", README, re.M):
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M), target
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (ROOT / picture).is_file(), picture
    for folder in re.findall(r"^\| `(\w+)/` \|", README, re.M):
        assert (ROOT / folder).is_dir(), folder


def test_studies_that_the_readme_names_are_where_it_says(tmp_path):
    """In the tour's project of two joints, or, told so, in one of one joint."""
    for joints in (1, 2):
        new_project(tmp_path / str(joints), joints)
    held = {j: {path.name for path in (tmp_path / str(j) / "scenes/paper").glob("*.toml")} for j in (1, 2)}
    tour = README[: README.index("## The paper, reproduced")]
    for paragraph in tour.split("\n\n"):
        for name in re.findall(r"(\d\w*_\w+\.toml)", paragraph):
            assert name in held[1 if "--joints 1" in paragraph else 2], name
    shipped = {path.name for path in (ROOT / "scenes/paper").glob("*.toml")}
    assert set(re.findall(r"(\d\w*_\w+\.toml)", README)) <= shipped


def test_the_effects_table_is_complete():
    from cosim.scene import Effects

    table = README[README.index("| effects | values |") :]
    for name in Effects.model_fields:
        assert f"`{name}`" in table, name
