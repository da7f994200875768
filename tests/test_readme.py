"""The README's tour works as it stands: every command in it is run, in order, in an empty folder."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.newproject import new_project

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def commands():
    """Commands of the README's shell blocks, in order."""
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL):
        yield from (line for line in block.splitlines() if line.strip())


def test_the_tour(tmp_path):
    if shutil.which("ngspice") is None:
        pytest.skip("the ngspice program is not installed")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    script = "set -e\n" + "\n".join(commands())
    done = subprocess.run(
        ["sh", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "mydevice/out/slope/report/report.html").is_file()
    stiffness = re.search(
        r"^rendered_stiffness\s+([\d.]+) N/m\s+([\d.]+) N/m.*?([\d.]+) N/m \(", done.stdout, re.M
    )
    assert stiffness is not None, done.stdout
    small, larger, smallest = (float(value) for value in stiffness.groups())
    assert larger < small < smallest  # 24.5k, 24.3k, 20k: the tour says that it falls as the resistor grows


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
