"""``cosim new``: a project that loads, and never over something that is there."""

import csv
import shutil
import subprocess
from pathlib import Path

import pytest

from cosim.assets import netlists_folder
from cosim.cli import main
from cosim.errors import InputError
from cosim.newproject import new_project
from cosim.scene import load_scene
from cosim.studies.claims import load_claims
from cosim.studies.study import is_study, load_study


@pytest.mark.parametrize("joints", range(1, 7))
def test_project_has_a_board_and_scenes_that_load(tmp_path: Path, joints: int) -> None:
    folder = tmp_path / "mydevice"
    written = new_project(folder, joints)
    assert sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file()) == written
    board = folder / "netlists" / f"board{joints}.cir"
    assert f".subckt board{joints} " in board.read_text()
    scenes = [load_scene(file) for file in (folder / "scenes").glob("*.toml")]
    assert scenes
    for scene in scenes:
        assert scene.joints == joints
        assert scene.device.board == board
    for part in ("blocks", "parts"):
        shipped = {path.name for path in (netlists_folder() / part).iterdir()}
        assert {path.name for path in (folder / "netlists" / part).iterdir()} == shipped


def test_includes_of_the_board_are_in_the_project(tmp_path: Path) -> None:
    new_project(tmp_path / "dev", 3)
    board = tmp_path / "dev" / "netlists" / "board3.cir"
    includes = [
        line.split()[1].strip("'\"") for line in board.read_text().splitlines() if line.startswith(".include")
    ]
    assert includes
    assert all((board.parent / include).is_file() for include in includes)


def test_readme_names_a_scene_that_is_there(tmp_path: Path) -> None:
    for joints in (1, 2, 3):
        folder = tmp_path / f"dev{joints}"
        new_project(folder, joints)
        text = (folder / "README.md").read_text()
        named = {word for word in text.split() if word.startswith("scenes/") and word.endswith(".toml")}
        assert named
        assert all((folder / word).is_file() for word in named)


def test_the_paper_s_studies_run_on_the_project_s_board(tmp_path: Path) -> None:
    folder = tmp_path / "dev"
    new_project(folder)
    files = [path for path in sorted((folder / "scenes" / "paper").glob("*.toml")) if is_study(path)]
    assert {"0_1_acceptance.toml", "3_fig16_18.toml", "7_footnote2.toml"} <= {path.name for path in files}
    for file in files:  # every study finds its scene, and the scene the project's own board
        assert load_study(file).scene().device.board == folder / "netlists" / "board2.cir"
    assert load_claims(folder / "scenes" / "paper").claims
    new_project(tmp_path / "one", 1)  # the drop test is of one joint
    assert (tmp_path / "one" / "scenes" / "paper" / "1_fig13.toml").is_file()
    new_project(tmp_path / "three", 3)
    assert not (tmp_path / "three" / "scenes" / "paper").exists()


def test_a_resistor_of_the_project_reaches_its_studies(tmp_path: Path) -> None:
    """The practical limit of analog stiffness is b/sum(tau): tau is L/R of the motor, b is kt^2/R."""
    folder = tmp_path / "dev"
    new_project(folder)
    study = folder / "scenes" / "paper" / "mine.toml"
    study.write_text(
        'study = "eta"\ntitle = "Mine"\nscene = "../slope.toml"\n[parameters]\npoints = 5\n'
        'stiffness_n_per_m = 100.0\n[[parameters.cases]]\nname = "as built"\n'
    )

    def limits(out: str, *more: str) -> list[float]:
        command = ["report", str(study), "-o", str(tmp_path / out), *more]
        assert main(command) == 0
        with (tmp_path / out / "data" / "mine_limits.csv").open() as stream:
            return [float(row["practical limit b/sum [N/m]"]) for row in csv.DictReader(stream)]

    before = limits("before")
    after = limits("after", "--set", "motor_l=3m")
    assert "--set motor_l=3m" in (tmp_path / "after" / "report.html").read_text()
    # twice the inductance doubles the winding's share of the delay, 99 % of it with voltage drive
    assert after[0] / before[0] == pytest.approx(0.5, rel=0.02)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="nothing was changed"):
        new_project(tmp_path / "dev")
    assert [path.name for path in tmp_path.rglob("*")] == ["dev", "mine.txt"]


def test_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "dev").mkdir()
    assert new_project(tmp_path / "dev", 1)


@pytest.mark.parametrize("joints", [0, -1, 7])
def test_impossible_numbers_of_joints(tmp_path: Path, joints: int) -> None:
    with pytest.raises(InputError, match="1 to 6"):
        new_project(tmp_path / "dev", joints)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="the ngspice program is not installed")
def test_ngspice_reads_the_board(tmp_path: Path) -> None:
    """The scene's choice of parts is made by the loader; here the ideal ones are named by hand."""
    new_project(tmp_path / "dev", 1)
    netlists = tmp_path / "dev" / "netlists"
    libraries = [f".lib 'parts/{part.name}' ideal" for part in sorted((netlists / "parts").glob("*.lib"))]
    pins = "pot1 vel1 u1 ksp11 ksd11 cmd1 imot1 vcc vee"
    sources = [f"v{pin} {pin} 0 0" for pin in pins.split() if pin not in ("imot1", "vcc", "vee")]
    deck = ["* bench", *libraries, ".include 'blocks/driver_voltage.cir'", ".include 'board1.cir'", *sources]
    deck += ["vcc vcc 0 15", "vee vee 0 -15", f"xboard {pins} board1", ".op", ".end"]
    (netlists / "bench.cir").write_text("\n".join(deck) + "\n")
    done = subprocess.run(
        ["ngspice", "-n", "-b", "bench.cir"],
        cwd=netlists,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
